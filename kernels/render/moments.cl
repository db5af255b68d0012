// The transpose of render.cl, with the delays as they are: of every path and block, what arrives of each function of
// frequency times the weights of the received samples, summed over the block with the powers 0 to 3 of the place t in
// [-1, 1). Work-item: dimension 0 counts slots, dimension 1 blocks.

__kernel void moments(__global const float* branches,     // [rows][stride], those of one function after those of another
                      int stride,
                      int lead,                           // sample of `branches` emitted at the run's first sample
                      __global const int* first_row,      // [FUNCTIONS + 1]
                      __global const int* delay,          // [block][slots], whole samples
                      __global const float* polynomials,  // as in polynomials.h, on [-1, 1]
                      __global const int* activity,       // not used: no silence is skipped
                      int slots,
                      int first_block,                    // of `delay` and `polynomials`, at the run's first sample
                      __global const float* start, __global const float* end,  // [slots], samples from the run's first
                      float per_ramp,                     // 1 / samples of a transition; 0 for a gate
                      int block_subblocks,                // subblocks in a block
                      __global const int* row,            // [slots], of the weights
                      __global const float* weights,      // [rows][weight_stride]
                      int weight_stride,
                      int first_sample,                   // of `weights`, at the run's first sample
                      __global float* taken)              // [block][slots][FUNCTIONS][4]
{
    const int slot = get_global_id(0), block = get_global_id(1), first = block * block_subblocks * SUBBLOCK;
    const int last = first + block_subblocks * SUBBLOCK, node = first_block + block;
    const float per_sample = 2.0f / (float)(last - first), ramp = per_ramp == 0.0f ? 0.0f : 0.5f / per_ramp;
    const bool whole_block = start[slot] + ramp <= (float)first && end[slot] - ramp >= (float)last;
    __global const float* c = polynomials + place_of(node, slot, FUNCTIONS, slots);
    const float c0 = c[0], c1 = c[BESIDE], c2 = c[2 * BESIDE], c3 = c[3 * BESIDE];
    __global const float* weight_of = weights + row[slot] * (long)weight_stride + first_sample;
    vec sum[FUNCTIONS][4];
    for (int k = 0; k < FUNCTIONS; k++) {
        for (int m = 0; m < 4; m++) sum[k][m] = 0.0f;
    }
    const bool silent = start[slot] - ramp >= (float)last || end[slot] + ramp <= (float)first;
    for (int from = first; from < last && !silent; from += SUBBLOCK) {
        const float middle = (float)(from - first) * per_sample + 0.5f * (float)(SUBBLOCK - 1) * per_sample - 1.0f;
        const float whole = (CUBIC(c0, c1, c2, c3, middle) + ROUNDING) - ROUNDING;
        __global const float* heard = branches + lead + from + PLACE(-(delay[node * (long)slots + slot] + (int)whole), stride);
        for (int j = 0; j < SUBBLOCK; j += LANES) {
            const vec t = (RAMP + (float)(from - first + j)) * per_sample - 1.0f;
            const vec mu = CUBIC(c0, c1, c2, c3, t) - whole;
            vec w = LOAD(weight_of + from + j);
            if (!whole_block) {
                for (int lane = 0; lane < LANES; lane++) {
                    const float at = (float)(from + j + lane);
                    ((float*)&w)[lane] *= weight(at - start[slot], per_ramp) - weight(at - end[slot], per_ramp);
                }
            }
            for (int k = 0; k < FUNCTIONS; k++) {
                __global const float* branch = heard + (first_row[k + 1] - 1) * (long)stride + j;
                vec value = LOAD(branch);
                for (int q = first_row[k + 1] - 1; q > first_row[k]; q--) {
                    branch -= stride;
                    value = value * mu + LOAD(branch);
                }
                value *= w;
                sum[k][0] += value;
                sum[k][1] += value * t;
                sum[k][2] += value * (t * t);
                sum[k][3] += value * (t * t * t);
            }
        }
    }
    __global float* out = taken + (block * (long)slots + slot) * (FUNCTIONS * 4);
    for (int k = 0; k < FUNCTIONS; k++) {
        for (int m = 0; m < 4; m++) {
            float all = 0.0f;
            for (int lane = 0; lane < LANES; lane++) all += ((float*)&sum[k][m])[lane];
            out[4 * k + m] = all;
        }
    }
}
