// From four neighbouring nodes to the cubics of the block between the middle two: Hermite for the delay, whose
// derivatives are exact, Catmull-Rom for the gain. Polynomials are in t, -1 at the block's start and 1 at its end.
// With DELAY_TERMS == 8, for long blocks of few samples, the delay is Hermite through all four nodes (septic.h), and
// the gain's cubic goes through them.

#if DELAY_TERMS == 8
#define GAIN_ERROR 0.03f
#else
#define GAIN_ERROR 0.02f
#endif
#define ROUNDING 6755399441055744.0  // 1.5 * 2^52: adding and taking it away rounds to a whole number

typedef struct {
    double delay[4], rate[4];  // s, and by the time of reception
    chunk gain[4][CHUNKS];
    float strength[4];         // mean square of the response
} window;

static float gain_of(const window* node, int at, int k) { return ((const float*)node->gain[at])[k]; }

#if DELAY_TERMS == 8
// The cubic of a gain through all four nodes, at t = -3, -1, 1 and 3.
static void write_gain(const window* node, int k, int heard, __global float* g)
{
    const float g0 = gain_of(node, 0, k), g1 = gain_of(node, 1, k), g2 = gain_of(node, 2, k), g3 = gain_of(node, 3, k);
    const float s1 = 0.5f * (g2 + g1), s3 = 0.5f * (g3 + g0), d1 = 0.5f * (g2 - g1), d3 = 0.5f * (g3 - g0);
    g[0] = heard ? 1.125f * s1 - 0.125f * s3 : 0.0f;
    g[1] = heard ? 1.125f * d1 - d3 * (1.0f / 24.0f) : 0.0f;
    g[2] = heard ? 0.125f * (s3 - s1) : 0.0f;
    g[3] = heard ? d3 * (1.0f / 24.0f) - 0.125f * d1 : 0.0f;
}
#endif

static void write_block(const window* node, int block, int slots, int slot, double sampling_rate, double late,
                        int heard, __global int* delay, __global float* cubics)
{
    __global float* c = cubics + place_of(block, slot, FUNCTIONS, slots);
#if DELAY_TERMS == 8
    delay[block * slots + slot] = write_septic(node->delay, node->rate, sampling_rate, late, c);
    for (int k = 0; k < FUNCTIONS; k++) write_gain(node, k, heard, c + coefficients(k));
#else
    const double p0 = node->delay[1] * sampling_rate + late, p1 = node->delay[2] * sampling_rate + late;
    const double e0 = node->rate[1] * (0.5 * BLOCK), e1 = node->rate[2] * (0.5 * BLOCK);
    const double centre = 0.5 * (p0 + p1) - 0.25 * (e1 - e0), whole = (centre + ROUNDING) - ROUNDING;
    delay[block * slots + slot] = (int)whole;
    c[0] = (float)(centre - whole);
    c[slots] = (float)(0.75 * (p1 - p0) - 0.25 * (e0 + e1));
    c[2 * slots] = (float)(0.25 * (e1 - e0));
    c[3 * slots] = (float)(0.25 * (e0 + e1) - 0.25 * (p1 - p0));
    for (int k = 0; k < FUNCTIONS; k++) {
        __global float* g = c + coefficients(k) * slots;
        const float g0 = gain_of(node, 1, k), g1 = gain_of(node, 2, k);
        const float s0 = 0.25f * (g1 - gain_of(node, 0, k)), s1 = 0.25f * (gain_of(node, 3, k) - g0);
        g[0] = heard ? 0.5f * (g0 + g1) - 0.25f * (s1 - s0) : 0.0f;
        g[slots] = heard ? 0.75f * (g1 - g0) - 0.25f * (s0 + s1) : 0.0f;
        g[2 * slots] = heard ? 0.25f * (s1 - s0) : 0.0f;
        g[3 * slots] = heard ? 0.25f * (s0 + s1) - 0.25f * (g1 - g0) : 0.0f;
    }
#endif
}

#if DELAY_TERMS == 8
// Square of the share that a gain's fourth difference has of its third, as if differences went on falling; at most 1.
static float falling(const window* node, int k, float third_squared)
{
    const float first = gain_of(node, 2, k) - gain_of(node, 1, k);
    const float second = 0.5f * ((gain_of(node, 3, k) - gain_of(node, 2, k)) - (gain_of(node, 1, k) - gain_of(node, 0, k)));
    const float a = third_squared, b = second * second, c = first * first;
    const float last = a < b ? a / b : 1.0f, before = b < c ? b / c : 1.0f;
    return last < before ? last : before;
}
#endif

// Square of the largest error of those cubics as pressure at full scale: the Hermite remainder h^4 f''''/384 of the delay
// turned into phase, and 0.02 of the gains' third differences (0.016 is that of Catmull-Rom), both from differences of
// nodes. Of envelopes the septic's, and 0.03 of the gains' fourth differences (3/128 is that of the cubic through nodes).
static float block_error_squared(const window* node, __global const float* sizes, float angular_frequency,
                                 double block_time)
{
    const double* r = node->rate;
#if DELAY_TERMS == 8
    const float late = septic_error(node->delay, r, block_time);
#else
    const float late = (float)((r[3] - r[0] + 3.0 * (r[1] - r[2])) * block_time) / 384.0f;
#endif
    const float phase = angular_frequency * late;
    float change = 0.0f;
    for (int k = 0; k < FUNCTIONS; k++) {
        const float third = gain_of(node, 3, k) - gain_of(node, 0, k) + 3.0f * (gain_of(node, 1, k) - gain_of(node, 2, k));
        float squared = third * third;
#if DELAY_TERMS == 8
        squared *= falling(node, k, squared);
#endif
        change += squared * sizes[k] * sizes[k];
    }
    return phase * phase * node->strength[1] + GAIN_ERROR * GAIN_ERROR * change;
}
