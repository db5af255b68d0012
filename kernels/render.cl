// Sum of all paths of one receiver over SPAN groups of samples, for FUNCTIONS neighbouring functions of frequency.
// Work-item (or work-group of WORKERS): dimension 0 counts spans, dimension 1 receivers. Paths come sorted by delay and
// are walked in tiles, so that the branch signals in play stay in cache.

__kernel __attribute__((reqd_work_group_size(WORKERS, 1, 1)))
void render(__global const float* branches,     // [rows][stride], those of one function after those of another
            int stride,
            int first_row,                      // of the first function here
            int functions,                      // in all
            int first_function,
            int lead,                           // sample of `branches` emitted at the run's first sample
            __global const int* delay,          // [block][slots], whole samples
            __global const float* nodes,        // as in nodes.h, on [-1, 1]
            __global const int* first_slot,     // [receivers + 1], multiples of BATCH and of TILE
            int slots,
            int block_groups,                   // groups in a block
            int first_block,                    // of `delay` and `nodes`, at the run's first sample
            int groups,                         // groups in the run
            __global const int* pressure_row,   // [receivers]
            __global float* pressure,           // [rows][pressure_stride], added to
            int pressure_stride,
            int first_sample,                   // of `pressure`, at the run's first sample
            __global const int* spans)          // [block][slots]: groups that are heard, as in silence.h
{
    const int worker = get_local_id(0);
    const int first_group = get_group_id(0) * SPAN;
    const int last_group = min(first_group + SPAN, groups);
    const int receiver = get_global_id(1);
    const float per_sample = 2.0f / (float)(block_groups * GROUP);
    __global const float* rows = branches + first_row * (long)stride + lead;
    vec sum[SPAN][FUNCTIONS][VECTORS];
    EXPANDED batch paths;
#if SPARSE
    SHARED uchar heard[SPAN][TILE];  // paths of a tile in each group
    SHARED int count[SPAN];          // of them
#endif
    for (int g = 0; g < SPAN; g++) {
        for (int k = 0; k < FUNCTIONS; k++) {
            for (int j = 0; j < VECTORS; j++) sum[g][k][j] = 0.0f;
        }
    }
    for (int tile = first_slot[receiver]; tile < first_slot[receiver + 1]; tile += TILE) {
        const int tile_end = min(tile + TILE, first_slot[receiver + 1]);
#if SPARSE
        SYNCHRONISE;
        find_heard(spans, slots, tile, tile_end, first_block, block_groups, first_group, last_group, worker, heard, count);
        SYNCHRONISE;
#endif
        for (int g = first_group; g < last_group; g++) {
            const int block = g / block_groups, row = first_block + block;
            // The middle of the group lies half a sample before the middle of its span.
            const float t = (float)(2 * (g - block * block_groups) * GROUP + GROUP - 1) * (0.5f * per_sample) - 1.0f;
#if SPARSE
            if (count[g - first_group] == 0) continue;
#endif
            vec group_sum[FUNCTIONS][VECTORS];
            for (int k = 0; k < FUNCTIONS; k++) {
                for (int j = 0; j < VECTORS; j++) group_sum[k][j] = 0.0f;
            }
#if SPARSE
            for (int i = 0; i < count[g - first_group]; i++) {
                const int slot = tile + heard[g - first_group][i];
                expand(delay[row * slots + slot], nodes + place_of(row, slot, functions, slots), functions,
                       first_function, t, per_sample, &paths);
                add_path(rows + g * GROUP, stride, &paths, 0, worker, group_sum);
            }
#else
            for (int slot = tile; slot < tile_end; slot += BATCH) {
                expand(delay + row * slots + slot, nodes + place_of(row, slot, functions, slots), slots, functions,
                       first_function, t, per_sample, worker, &paths);
                SYNCHRONISE;
                for (int p = 0; p < BATCH; p++) add_path(rows + g * GROUP, stride, &paths, p, worker, group_sum);
                SYNCHRONISE;
            }
#endif
            for (int k = 0; k < FUNCTIONS; k++) {
                for (int j = 0; j < VECTORS; j++) sum[g - first_group][k][j] += group_sum[k][j];
            }
        }
    }
    for (int g = first_group; g < last_group; g++) {
        __global float* out = pressure + (long)pressure_row[receiver] * pressure_stride + first_sample + g * GROUP;
        for (int j = 0; j < VECTORS; j++) {
            __global loose_vec* at = (__global loose_vec*)(out + (worker * VECTORS + j) * LANES);
            for (int k = 0; k < FUNCTIONS; k++) *at = *at + sum[g - first_group][k][j];
        }
    }
}
