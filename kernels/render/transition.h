// Raised cosine from 0 to 1 over one unit about 0; a step at 0 without ramp.
static float weight(float samples, float per_ramp)
{
    if (per_ramp == 0.0f) return samples >= 0.0f ? 1.0f : 0.0f;
    const float x = samples * per_ramp;
    return x <= -0.5f ? 0.0f : x >= 0.5f ? 1.0f : 0.5f + 0.5f * sin(3.14159265f * x);
}
