// The fractional delay as a Farrow bank: Horner's scheme in mu over the branch signals, for a batch of paths.
// `branches` points at the group's first sample in the first row of one function of frequency.

static void add_batch(__global const float* branches, int stride, const SHARED batch* paths, int worker, vec* sum)
{
    vec sample[VECTORS];
    for (int j = 0; j < VECTORS; j++) {
        sample[j] = RAMP + ((float)((worker * VECTORS + j) * LANES) - 0.5f * (GROUP - 1));
    }
    for (int p = 0; p < BATCH; p++) {
#if SPARSE
        if (!paths->heard[p]) continue;
#endif
        __global const float* row = branches + (BRANCHES - 1) * stride - paths->whole[p];
        vec mu[VECTORS], value[VECTORS];
#pragma unroll
        for (int j = 0; j < VECTORS; j++) {
            mu[j] = (sample[j] * paths->curve[p] + paths->rate[p]) * sample[j] + paths->fraction[p];
            value[j] = LOAD(row + (worker * VECTORS + j) * LANES);
        }
#pragma unroll
        for (int q = 1; q < BRANCHES; q++) {
            row -= stride;
#pragma unroll
            for (int j = 0; j < VECTORS; j++) {
                value[j] = value[j] * mu[j] + LOAD(row + (worker * VECTORS + j) * LANES);
            }
        }
#pragma unroll
        for (int j = 0; j < VECTORS; j++) {
            sum[j] += (sample[j] * paths->slope[p] + paths->gain[p]) * value[j];
        }
    }
}
