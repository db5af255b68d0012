// A path whose functions of frequency are joined before they are multiplied by powers of the delay: to each branch signal of the
// first function those of the others are added, times the ratio of their gains to its own. The first one has most branches.

#if JOINED
#define ROWS_BEFORE(k) \
    ((k > 0) * COUNT(0) + (k > 1) * COUNT(1) + (k > 2) * COUNT(2) + (k > 3) * COUNT(3) + (k > 4) * COUNT(4) + (k > 5) * COUNT(5))

// Branch q of all functions together, its real and imaginary part; rows of branch signals from `x` on.
#define BRANCH(q, re, im)                                                                 \
    vec re = LOAD(x + (q) * (long)stride), im = LOAD(x + ((q) + COUNT(0)) * (long)stride); \
    _Pragma("unroll") for (int k = 1; k < FUNCTIONS; k++)                                 \
    {                                                                                     \
        if ((q) >= COUNT(k)) continue;                                                    \
        re += ratio[k] * LOAD(x + (2 * ROWS_BEFORE(k) + (q)) * (long)stride);             \
        im += ratio[k] * LOAD(x + (2 * ROWS_BEFORE(k) + COUNT(k) + (q)) * (long)stride);  \
    }

// Add path p of a batch as `add_path` does.
static void add_joined(__global const float* branches, int stride, const batch* paths, int p, vec t, ulong turn_per_sample,
                       float half_turns_per_sample, float tilt_per_sample, vec* real_sum, vec* imaginary_sum)
{
    const int whole = paths->whole[p];
    __global const float* x = branches - whole;
    vec mu = paths->delay[TERMS - 1][p], ratio[FUNCTIONS], cosine, sine;
#pragma unroll
    for (int i = TERMS - 2; i >= 0; i--) mu = mu * t + paths->delay[i][p];
#pragma unroll
    for (int k = 1; k < FUNCTIONS; k++) ratio[k] = paths->gain[k][1][p] * t + paths->gain[k][0][p];
#if TILTED
    x += paths->beyond[p];
    TILTED_DELAY
#endif
    BRANCH(COUNT(0) - 1, a, b)
#if TILTED  // even and odd branches: see branch_powers.h
    if (COUNT(0) > 1) {
        BRANCH(COUNT(0) - 2, odd_a, odd_b)
#pragma unroll
        for (int q = COUNT(0) - 3; q >= 0; q--) {
            BRANCH(q, re, im)
            if (COUNT(0) - q & 1) multiply(&a, &b, re, im, mu_squared, nu_squared);
            else multiply(&odd_a, &odd_b, re, im, mu_squared, nu_squared);
        }
        if (COUNT(0) & 1) {
            multiply(&odd_a, &odd_b, a, b, mu, nu);
            a = odd_a;
            b = odd_b;
        } else {
            multiply(&a, &b, odd_a, odd_b, mu, nu);
        }
    }
#else
#pragma unroll
    for (int q = COUNT(0) - 2; q >= 0; q--) {
        BRANCH(q, re, im)
        a = a * mu + re;
        b = b * mu + im;
    }
#endif
    const vec gain = paths->gain[0][1][p] * t + paths->gain[0][0][p];
    half_turns(mu * half_turns_per_sample + whole_turn(whole, turn_per_sample), &cosine, &sine);
    cosine *= gain;
    sine *= gain;
    *real_sum += a * cosine + b * sine;
    *imaginary_sum += b * cosine - a * sine;
}
#endif
