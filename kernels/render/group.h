// Polynomials of BATCH paths about the middle of a group of LANES samples: a delay goes on with a cubic, a gain evenly. In short
// blocks (FINE) all terms of the block's polynomials are taken instead.

// Whether functions of frequency are joined, see joined.h: those of gains that change slowly. The square of a gain is then more
// than JOINED_ABOVE times that of its change per sample, by 1.5 % in 7.5 samples at most, so that ratios are even.
#define COUNT(i) (COUNTS >> 4 * ((i) & 7) & 15)
#define NO_MORE(i) (COUNT(0) >= COUNT(i))
#define JOINED (COUNTS && !FINE && !PAIRED && !SPARSE && NO_MORE(1) && NO_MORE(2) && NO_MORE(3) && NO_MORE(4) && NO_MORE(5) && NO_MORE(6))
#define JOINED_ABOVE 262144.0f

#if FINE
#define TERMS DELAY_TERMS
#else
#define TERMS 4
#endif

typedef struct {
    int whole[BATCH];            // samples of the delay
    float delay[TERMS][BATCH];   // powers of the rest: of samples from the group's middle, or (FINE) as in the block
    float gain[FUNCTIONS][2][BATCH];  // at the group's middle, and its change per sample
#if JOINED
    int joined[BATCH];                // whether the gains of all functions but the first are ratios to that one's
#endif
#if TILTED
    long beyond[BATCH];               // of the stretch's branch signals, from those of the first one
    float nu[BATCH];                  // imaginary delay of the whole samples, about the middle of that stretch
#endif
} batch;

// Expand the polynomials of paths about `middle` of their block, a group's middle.
static void expand(__global const int* delay, __global const float* polynomials, float middle, float per_sample, int channel, batch* out)
{
    for (int p = 0; p < BATCH; p += LANES) {
        __global const float* c = polynomials + place_of(0, p, FUNCTIONS * CHANNELS, 0);
        vec d[DELAY_TERMS];
#pragma unroll
        for (int i = 0; i < DELAY_TERMS; i++) d[i] = LOAD(c + i * BESIDE);
#if FINE
        vec moved = d[DELAY_TERMS - 1];  // from the block's middle to that of these samples
#pragma unroll
        for (int i = DELAY_TERMS - 2; i >= 0; i--) moved = moved * middle + d[i];
#else
        float scale = 1.0f;
#pragma unroll
        for (int k = 0; k < TERMS; k++) {
#pragma unroll
            for (int i = DELAY_TERMS - 2; i >= k; i--) d[i] += d[i + 1] * middle;
            d[k] *= scale;
            scale *= per_sample;
        }
        const vec moved = d[0];
#if JOINED
        vec g0[2], inverse;
        ivec steady;
#endif
#pragma unroll
        for (int k = 0; k < FUNCTIONS; k++) {
            __global const float* g = c + (DELAY_TERMS + k * CHANNELS + channel) * BESIDE;
            const int power = FUNCTIONS * CHANNELS * BESIDE;
            const vec g1 = LOAD(g + power), g2 = LOAD(g + 2 * power), g3 = LOAD(g + 3 * power);
            vec here = CUBIC(LOAD(g), g1, g2, g3, middle), slope = per_sample * CUBIC_SLOPE(g1, g2, g3, middle);
#if JOINED
            if (k == 0) {
                steady = here * here > JOINED_ABOVE * slope * slope;
                inverse = 1.0f / AS_VEC(steady & AS_IVEC(here) | ~steady & 0x3F800000);
                g0[0] = here, g0[1] = slope;
                *(loose_ivec*)(out->joined + p) = steady;
            } else {
                const vec r0 = here * inverse, r1 = (slope - r0 * g0[1]) * inverse;
                here = AS_VEC(steady & AS_IVEC(r0) | ~steady & AS_IVEC(here));
                slope = AS_VEC(steady & AS_IVEC(r1) | ~steady & AS_IVEC(slope));
            }
#endif
            *(loose_vec*)(out->gain[k][0] + p) = here;
            *(loose_vec*)(out->gain[k][1] + p) = slope;
        }
#endif
        *(loose_ivec*)(out->whole + p) = *(__global const loose_ivec*)(delay + p) + nearest(moved);
        d[0] -= rounded(moved);
#pragma unroll
        for (int i = 0; i < TERMS; i++) *(loose_vec*)(out->delay[i] + p) = d[i];
    }
}

#if TILTED
// Find the stretches of paths, whose branch signals are `rows` apart, and the imaginary delays about their middles.
static void find_stretches(batch* paths, long rows, int first, int stretches, float length, float per_length, float per_sample)
{
    for (int p = 0; p < BATCH; p++) {
        float from_middle;
        paths->beyond[p] = stretch_of((float)(paths->whole[p] - first), stretches, length, per_length, &from_middle) * rows;
        paths->nu[p] = from_middle * per_sample;
    }
}
#endif
