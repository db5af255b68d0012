// The transpose of render.cl, with the delays as they are: of every path, what arrives of each function of frequency times
// the weights of the received samples, summed over TOGETHER blocks with the powers 0 to 3 of the place t in [-1, 1).
// Work-item: dimension 0 counts slots, dimension 1 groups of blocks.

#define VECTORS (SUBBLOCK / LANES)
#define PIECE 8  // subblocks, of which the places and weights stay in cache while functions take their turns

__kernel void moments(__global const float* branches,     // [rows][stride], those of one function after those of another
                      int stride,
                      int lead,                           // sample of `branches` emitted at the run's first sample
                      __global const int* first_row,      // [FUNCTIONS + 1]
                      __global const int* delay,          // [block][slots], whole samples
                      __global const float* polynomials,  // as in polynomials.h, on [-1, 1], of GAINS that are not used
                      __global const int* activity,       // not used: no silence is skipped
                      int slots,
                      int first_block,                    // of `delay` and `polynomials`, at the run's first sample
                      __global const float* start, __global const float* end,  // [slots], samples from the run's first
                      float per_ramp,                     // 1 / samples of a transition; 0 for a gate
                      int block_subblocks,                // subblocks in a block
                      int blocks,                         // in the run
                      __global const int* row,            // [slots], of the weights
                      __global const float* weights,      // [rows][weight_stride]
                      int weight_stride,
                      int first_sample,                   // of `weights`, at the run's first sample
                      __global float* taken)              // [group][slots][FUNCTIONS][4]
{
    const int slot = get_global_id(0), group = get_global_id(1), samples = block_subblocks * SUBBLOCK;
    const float per_sample = 2.0f / (float)samples, ramp = per_ramp == 0.0f ? 0.0f : 0.5f / per_ramp;
    const float per_group = per_sample / (float)TOGETHER;
    __global const float* weight_of = weights + row[slot] * (long)weight_stride + first_sample;
    vec sum[FUNCTIONS][4];
    for (int k = 0; k < FUNCTIONS; k++) {
        for (int m = 0; m < 4; m++) sum[k][m] = 0.0f;
    }
    for (int block = group * TOGETHER; block < min((group + 1) * TOGETHER, blocks); block++) {
        const int first = block * samples, last = first + samples, node = first_block + block;
        if (start[slot] - ramp >= (float)last || end[slot] + ramp <= (float)first) continue;
        const bool whole_block = start[slot] + ramp <= (float)first && end[slot] - ramp >= (float)last;
        __global const float* c = polynomials + place_of(node, slot, GAINS, slots);
        const float c0 = c[0], c1 = c[BESIDE], c2 = c[2 * BESIDE], c3 = c[3 * BESIDE];
        const int before = delay[node * (long)slots + slot];
        for (int piece = 0; piece < block_subblocks; piece += PIECE) {
            const int here = min(PIECE, block_subblocks - piece);
            int place[PIECE];
            vec rest[PIECE * VECTORS], weight_at[4][PIECE * VECTORS];
            for (int g = 0; g < here; g++) {
                const int from = (piece + g) * SUBBLOCK;
                const float whole = (CUBIC(c0, c1, c2, c3, ((float)from + 0.5f * (float)(SUBBLOCK - 1)) * per_sample - 1.0f) + ROUNDING) - ROUNDING;
                place[g] = -(before + (int)whole);
                for (int j = 0; j < VECTORS; j++) {
                    const vec place_in = RAMP + (float)(from + j * LANES), t = place_in * per_sample - 1.0f;
                    const vec u = (place_in + (float)(first - group * TOGETHER * samples)) * per_group - 1.0f;
                    const int at = first + from + j * LANES;
                    vec w = LOAD(weight_of + at);
                    for (int lane = 0; lane < LANES && !whole_block; lane++) {
                        const float when = (float)(at + lane);
                        ((float*)&w)[lane] *= weight(when - start[slot], per_ramp) - weight(when - end[slot], per_ramp);
                    }
                    rest[g * VECTORS + j] = CUBIC(c0, c1, c2, c3, t) - whole;
                    for (int m = 0; m < 4; m++, w *= u) weight_at[m][g * VECTORS + j] = w;
                }
            }
            for (int k = 0; k < FUNCTIONS; k++) {
                const int least = first_row[k], rows = first_row[k + 1] - least;
                vec s0 = sum[k][0], s1 = sum[k][1], s2 = sum[k][2], s3 = sum[k][3];
                for (int g = 0; g < here; g++) {
                    __global const float* branch = branches + lead + first + (piece + g) * SUBBLOCK + PLACE(place[g], stride) + (least + rows - 1) * (long)stride;
                    vec value[VECTORS];
#pragma unroll
                    for (int j = 0; j < VECTORS; j++) value[j] = LOAD(branch + j * LANES);
                    for (int q = 1; q < rows; q++) {
                        branch -= stride;
#pragma unroll
                        for (int j = 0; j < VECTORS; j++) value[j] = value[j] * rest[g * VECTORS + j] + LOAD(branch + j * LANES);
                    }
#pragma unroll
                    for (int j = 0; j < VECTORS; j++) {
                        const int at = g * VECTORS + j;
                        s0 += value[j] * weight_at[0][at];
                        s1 += value[j] * weight_at[1][at];
                        s2 += value[j] * weight_at[2][at];
                        s3 += value[j] * weight_at[3][at];
                    }
                }
                sum[k][0] = s0;
                sum[k][1] = s1;
                sum[k][2] = s2;
                sum[k][3] = s3;
            }
        }
    }
    __global float* out = taken + (group * (long)slots + slot) * (FUNCTIONS * 4);
    for (int k = 0; k < FUNCTIONS; k++) {
        for (int m = 0; m < 4; m++) {
            float all = 0.0f;
            for (int lane = 0; lane < LANES; lane++) all += ((float*)&sum[k][m])[lane];
            out[4 * k + m] = all;
        }
    }
}
