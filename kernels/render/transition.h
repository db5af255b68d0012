// Raised cosine from 0 to 1 over one unit about 0; a step at 0 without ramp. The sine is Taylor's of degree 11, within
// 2e-7: that of one OpenCL is not that of another to the last bit.
static float weight(float samples, float per_ramp)
{
    if (per_ramp == 0.0f) return samples >= 0.0f ? 1.0f : 0.0f;
    const float x = samples * per_ramp, xx = x * x;
    const float sine = x * (3.14159265f + xx * (-5.16771278f + xx * (2.55016404f + xx * (-0.599264529f +
                       xx * (0.0821458866f + xx * -7.37043095e-3f)))));
    return x <= -0.5f ? 0.0f : x >= 0.5f ? 1.0f : 0.5f + 0.5f * sine;
}

// Whether a path is active without a transition in all of a subblock, by its number.
static int is_steady(int subblock, int samples, float start, float end, float per_ramp)
{
    const float first = (float)(subblock * samples), last = first + (float)(samples - 1);
    return weight(first - start, per_ramp) - weight(last - end, per_ramp) == 1.0f;
}
