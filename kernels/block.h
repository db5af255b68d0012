// From four neighbouring nodes to the cubics of the block between the middle two: Hermite for the delay, whose
// derivatives are exact, Catmull-Rom for the gain. Cubics are in t, -1 at the block's start and 1 at its end.

#define ROUNDING 6755399441055744.0  // 1.5 * 2^52: adding and taking it away rounds to a whole number

typedef struct {
    double delay[4], rate[4];  // s, and by the time of reception
    float gain[4][FUNCTIONS];
    float largest[4];          // response, without sign
} window;

static void write_block(const window* node, int block, int slots, int slot, double sampling_rate, double late,
                        int heard, __global int* delay, __global float* cubics)
{
    __global float* c = cubics + (long)block * COEFFICIENTS * slots + slot;
    const double p0 = node->delay[1] * sampling_rate + late, p1 = node->delay[2] * sampling_rate + late;
    const double e0 = node->rate[1] * (0.5 * BLOCK), e1 = node->rate[2] * (0.5 * BLOCK);
    const double centre = 0.5 * (p0 + p1) - 0.25 * (e1 - e0), whole = (centre + ROUNDING) - ROUNDING;
    delay[block * slots + slot] = (int)whole;
    c[0] = (float)(centre - whole);
    c[slots] = (float)(0.75 * (p1 - p0) - 0.25 * (e0 + e1));
    c[2 * slots] = (float)(0.25 * (e1 - e0));
    c[3 * slots] = (float)(0.25 * (e0 + e1) - 0.25 * (p1 - p0));
    for (int k = 0; k < FUNCTIONS; k++) {
        __global float* g = c + (4 + 4 * k) * slots;
        const float g0 = node->gain[1][k], g1 = node->gain[2][k];
        const float s0 = 0.25f * (g1 - node->gain[0][k]), s1 = 0.25f * (node->gain[3][k] - g0);
        g[0] = heard ? 0.5f * (g0 + g1) - 0.25f * (s1 - s0) : 0.0f;
        g[slots] = heard ? 0.75f * (g1 - g0) - 0.25f * (s0 + s1) : 0.0f;
        g[2 * slots] = heard ? 0.25f * (s1 - s0) : 0.0f;
        g[3 * slots] = heard ? 0.25f * (s0 + s1) - 0.25f * (g1 - g0) : 0.0f;
    }
}

// Square of the largest error of those cubics as pressure at full scale: the Hermite remainder h^4 f''''/384 of the delay turned
// into phase, and 0.02 of the gain's third difference (0.016 is that of Catmull-Rom), both from differences of nodes.
static float block_error_squared(const window* node, float angular_frequency, double block_time)
{
    const double* r = node->rate;
    const float late = (float)((r[3] - r[0] + 3.0 * (r[1] - r[2])) * block_time) / 384.0f;
    float change = 0.0f;
    for (int k = 0; k < FUNCTIONS; k++) {
        const float third = node->gain[3][k] - node->gain[0][k] + 3.0f * (node->gain[1][k] - node->gain[2][k]);
        change += third < 0.0f ? -0.02f * third : 0.02f * third;
    }
    const float phase = angular_frequency * late * node->largest[1];
    return phase * phase + change * change;
}
