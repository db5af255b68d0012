/* The plain loop against which the OpenCL kernel is measured: the same arithmetic written by hand, one path at a
   time in groups of 32 samples. Path p and block b have a whole delay, a cubic of its rest and a cubic of the gain
   on [-1, 1]; within a group the delay is quadratic and the gain linear. Vectors are AVX-512 registers, or AVX2 ones
   where the processor has no AVX-512. */
#include <math.h>

#define GROUP 32
#ifdef __AVX512F__
#define LANES 16
#else
#define LANES 8
#endif
#define VECTORS (GROUP / LANES)
typedef float vec __attribute__((vector_size(4 * LANES)));
typedef float loose_vec __attribute__((vector_size(4 * LANES), aligned(4)));
#define LOAD(p) (*(const loose_vec *)(p))
#define EACH for (int j = 0; j < VECTORS; j++)

void render(const float *branches, long stride, int count, long lead, const int *delay, const float *nodes, int paths,
            int slots, int block_groups, int first_group, int last_group, float *pressure)
{
    const float per_sample = 2.0f / (float)(block_groups * GROUP);
    vec sample[VECTORS];
    EACH for (int i = 0; i < LANES; i++) sample[j][i] = (float)(j * LANES + i) - 0.5f * (GROUP - 1);
    for (int g = first_group; g < last_group; g++) {
        const int block = g / block_groups;
        const float t = (float)(2 * (g - block * block_groups) * GROUP + GROUP - 1) * (0.5f * per_sample) - 1.0f;
        vec sum[VECTORS], mu[VECTORS], value[VECTORS];
        EACH sum[j] = sample[j] * 0.0f;
        for (int p = 0; p < paths; p++) {
            const float *c = nodes + (long)block * 8 * slots + p;
            const float c0 = c[0], c1 = c[slots], c2 = c[2 * slots], c3 = c[3 * slots];
            const float g0 = c[4 * slots], g1 = c[5 * slots], g2 = c[6 * slots], g3 = c[7 * slots];
            const float at = c0 + t * (c1 + t * (c2 + t * c3)), whole = rintf(at), fraction = at - whole;
            const float rate = per_sample * (c1 + t * (2 * c2 + t * 3 * c3));
            const float curve = per_sample * per_sample * (c2 + t * 3 * c3);
            const float gain = g0 + t * (g1 + t * (g2 + t * g3));
            const float slope = per_sample * (g1 + t * (2 * g2 + t * 3 * g3));
            const float *row = branches + lead + (long)g * GROUP - delay[(long)block * slots + p] - (int)whole;
            row += (count - 1) * stride;
            EACH mu[j] = (sample[j] * curve + rate) * sample[j] + fraction;
            EACH value[j] = LOAD(row + j * LANES);
            for (int q = 1; q < count; q++) {
                row -= stride;
                EACH value[j] = value[j] * mu[j] + LOAD(row + j * LANES);
            }
            EACH sum[j] += (sample[j] * slope + gain) * value[j];
        }
        EACH *(loose_vec *)(pressure + (long)g * GROUP + j * LANES) += sum[j];
    }
}
