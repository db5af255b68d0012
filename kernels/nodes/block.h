// From four neighbouring nodes to the cubics of the block between the middle two: Hermite for the delay, whose
// derivatives are exact, Catmull-Rom for the gain. Polynomials are in t, -1 at the block's start and 1 at its end.
// With DELAY_TERMS == 8, for long blocks of few samples, the delay is Hermite through all four nodes (delay_polynomials.h), and
// the gain's cubic goes through them.


typedef struct {
    real delay[4], rate[4];  // s, and by the time of reception
    gains gain[4][GAIN_VECTORS];
    float strength[4];         // mean square of the response
} window;

// Write the gains of neighbouring functions; `g` is the place of the first one's term.
static void write_gains(const gains* gain, int functions, int apart, __global float* g)
{
    for (int k = 0; k < functions; k++) g[k * apart] = ((const float*)gain)[k];
}

// Write four powers of the gains, of a path that is active or not.
static void write_terms(gains terms[4][GAIN_VECTORS], int active, int functions, int apart, __global float* c)
{
#pragma unroll
    for (int power = 0; power < 4; power++) {
        if (!active) {
            for (int i = 0; i < GAIN_VECTORS; i++) terms[power][i] = 0.0f;
        }
        write_gains(terms[power], functions, apart, c + (DELAY_TERMS + power * functions) * apart);
    }
}

// The gains' powers from four nodes.
static void terms_between(const window* node, gains terms[4][GAIN_VECTORS])
{
#pragma unroll
    for (int i = 0; i < GAIN_VECTORS; i++) {
        const gains g0 = node->gain[0][i], g1 = node->gain[1][i], g2 = node->gain[2][i], g3 = node->gain[3][i];
#if DELAY_TERMS == 8
        // The cubic through all four nodes, at t = -3, -1, 1 and 3.
        const gains s1 = 0.5f * (g2 + g1), s3 = 0.5f * (g3 + g0), d1 = 0.5f * (g2 - g1), d3 = 0.5f * (g3 - g0);
        terms[0][i] = 1.125f * s1 - 0.125f * s3;
        terms[1][i] = 1.125f * d1 - d3 * (1.0f / 24.0f);
        terms[2][i] = 0.125f * (s3 - s1);
        terms[3][i] = d3 * (1.0f / 24.0f) - 0.125f * d1;
#else
        const gains s0 = 0.25f * (g2 - g0), s1 = 0.25f * (g3 - g1);
        terms[0][i] = 0.5f * (g1 + g2) - 0.25f * (s1 - s0);
        terms[1][i] = 0.75f * (g2 - g1) - 0.25f * (s0 + s1);
        terms[2][i] = 0.25f * (s1 - s0);
        terms[3][i] = 0.25f * (s0 + s1) - 0.25f * (g2 - g1);
#endif
    }
}

#if DELAY_TERMS == 8
// Square of the share that gains' fourth differences have of their third, as if differences went on falling; at most 1.
static gains falling(gains g0, gains g1, gains g2, gains g3, gains third_squared)
{
    const gains first = g2 - g1, second = 0.5f * ((g3 - g2) - (g1 - g0));
    const gains a = third_squared, b = second * second, c = first * first;
    const gains last = a < b ? a / b : (gains)1.0f, before = b < c ? b / c : (gains)1.0f;
    return last < before ? last : before;
}
#endif

// Square of the largest error of those cubics as pressure at full scale: the Hermite remainder h^4 f''''/384 of the delay
// turned into phase, and 0.02 of the gains' third differences (0.016 is that of Catmull-Rom), both from differences of
// nodes; and what groups leave out of the cubics, where subblocks are a `part` of the block: the delay's third power, the
// gains' second one (fine ones leave out nothing: `part` is 0). Of envelopes the septic's, with its fourth power left out, and 0.03 of the gains' fourth differences (3/128 is that of the cubic through nodes).
static float delay_error_squared(const window* node, float angular_frequency, real block_time, float part)
{
    const real* r = node->rate;
#if DELAY_TERMS == 8
    const float fourth = part * part * part * part * septic_fourth(node->delay, r, block_time);
    const float delay_error = septic_error(node->delay, r, block_time) + (fourth < 0.0f ? -fourth : fourth);
#else
    const float remainder = (float)((r[3] - r[0] + 3 * (r[1] - r[2])) * block_time) / 384.0f;
    const float cubed = (float)(0.125f * block_time * (r[1] + r[2]) - 0.25f * (node->delay[2] - node->delay[1]));
    const float twist = cubed * part * part * part;
    const float delay_error = (remainder < 0.0f ? -remainder : remainder) + (twist < 0.0f ? -twist : twist);
#endif
    const float phase = angular_frequency * delay_error;
    return phase * phase * node->strength[1];
}

// Up to when, and from when on, s, what a block receives was emitted, where the last node is received at `time`. By the nodes beside
// it; blocks of envelopes are so long that these may lie beyond a motion's end: there by its own.
static real emitted_by(const window* node, real time, real block_time)
{
    return DELAY_TERMS == 8 ? time - block_time - node->delay[2] : time - node->delay[3];
}

static real emitted_from(const window* node, real time, real block_time)
{
    return DELAY_TERMS == 8 ? time - 2 * block_time - node->delay[1] : time - 3 * block_time - node->delay[0];
}

// The same of what groups leave out of gains.
static float left_out_squared(const gains terms[4][GAIN_VECTORS], __global const gains* sizes, float part)
{
    gains change = 0.0f;
#pragma unroll
    for (int i = 0; i < GAIN_VECTORS; i++) {
        const gains second = part * part * terms[2][i] * sizes[i];
        change += second * second;
    }
    return sum_of(change);
}

// The same of gains between nodes.
static float gain_error_squared(const window* node, __global const gains* sizes)
{
    gains change = 0.0f;
#pragma unroll
    for (int i = 0; i < GAIN_VECTORS; i++) {
        const gains g0 = node->gain[0][i], g1 = node->gain[1][i], g2 = node->gain[2][i], g3 = node->gain[3][i];
        const gains third = g3 - g0 + 3.0f * (g1 - g2);
        gains squared = third * third;
#if DELAY_TERMS == 8
        squared *= falling(g0, g1, g2, g3, squared);
#endif
        change += squared * sizes[i] * sizes[i];
    }
    return GAIN_ERROR * GAIN_ERROR * sum_of(change);
}
