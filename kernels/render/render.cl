// Sum of all paths of one receiver over SUBBLOCKS subblocks of samples, for neighbouring functions of frequency and
// CHANNELS channels, FUNCTIONS gains in all. Gains of a function come for each channel of the receiver side by side.
// Work-item (or work-group of WORKERS): dimension 0 counts spans, dimension 1 receivers. Paths come sorted by delay and
// are walked in tiles, so that the branch signals in play stay in cache. Where paths are to be kept APART, each slot has a
// row of the pressure.

#if FINE
#define SILENT(p) && paths.bend[0][p] == 0.0f && paths.flex[0][p] == 0.0f
#else
#define SILENT(p)
#endif

static void clear(vec sum[FUNCTIONS][VECTORS])
{
    for (int k = 0; k < FUNCTIONS; k++) {
        for (int j = 0; j < VECTORS; j++) sum[k][j] = 0.0f;
    }
}

// Add the sums of a channel to samples of a subblock.
static void put(const vec sum[FUNCTIONS][VECTORS], int channel, int worker, __global float* out)
{
    for (int j = 0; j < VECTORS; j++) {
        __global loose_vec* at = (__global loose_vec*)(out + (worker * VECTORS + j) * LANES);
        for (int k = channel; k < FUNCTIONS; k += CHANNELS) *at = *at + sum[k][j];
    }
}

__kernel __attribute__((reqd_work_group_size(WORKERS, 1, 1)))
void render(__global const float* branches,     // [rows][stride], those of one function after those of another
            int stride,
            int lead,                           // sample of `branches` emitted at the run's first sample
            __global const int* first_row,      // [functions + 1]
            int functions,                      // gains in all, of functions of frequency and channels
            int first_gain,
            int first_function, int functions_here,  // functions of frequency whose branches are read
            __global const int* delay,          // [block][slots], whole samples
            __global const float* polynomials,  // as in polynomials.h, on [-1, 1]
            __global const int* activity,       // [block][slots]: subblocks in which it sounds, see activity.h
            int slots,
            int first_block,                    // of `delay` and `polynomials`, at the run's first sample
            __global const int* first_slot,     // [receivers + 1], multiples of BATCH and of TILE
            int block_subblocks,                // subblocks in a block
            int subblocks,                      // in the run
            __global const int* pressure_row,   // [receivers], of the first channel here
            __global float* pressure,           // [rows][pressure_stride], added to
            int pressure_stride,
            int first_sample)                   // of `pressure`, at the run's first sample
{
    const int worker = get_local_id(0);
    const int first_subblock = get_group_id(0) * SUBBLOCKS;
    const int last_subblock = min(first_subblock + SUBBLOCKS, subblocks);
    const int receiver = get_global_id(1);
    const float per_sample = 2.0f / (float)(block_subblocks * SUBBLOCK);
    __global const float* rows = branches + lead;
    vec sum[SUBBLOCKS][FUNCTIONS][VECTORS];
    EXPANDED batch paths;
#if SPARSE
    SHARED uchar active[SUBBLOCKS][TILE];  // paths of a tile in each group
    SHARED int count[SUBBLOCKS];          // of them
#endif
    for (int g = 0; g < SUBBLOCKS; g++) clear(sum[g]);
    for (int tile = first_slot[receiver]; tile < first_slot[receiver + 1]; tile += TILE) {
        const int tile_end = min(tile + TILE, first_slot[receiver + 1]);
#if SPARSE
        SYNCHRONISE;
        find_active(activity, slots, tile, tile_end, first_block, block_subblocks, first_subblock, last_subblock, worker, active, count);
        SYNCHRONISE;
#endif
        for (int g = first_subblock; g < last_subblock; g++) {
            const int block = g / block_subblocks, row = first_block + block;
            // The middle of the group lies half a sample before the middle of its span.
            const float t = (float)(2 * (g - block * block_subblocks) * SUBBLOCK + SUBBLOCK - 1) * (0.5f * per_sample) - 1.0f;
#if SPARSE
            if (count[g - first_subblock] == 0) continue;
#endif
            vec subblock_sum[FUNCTIONS][VECTORS];
            clear(subblock_sum);
#if SPARSE
            for (int i = 0; i < count[g - first_subblock]; i++) {
                const int slot = tile + active[g - first_subblock][i];
                expand(delay[row * (long)slots + slot], polynomials + place_of(row, slot, functions, slots), functions,
                       first_gain, t, per_sample, &paths);
                add_path(rows + g * SUBBLOCK, stride, first_row + first_function, functions_here, &paths, 0, worker, subblock_sum);
#if APART
                put(subblock_sum, 0, worker, pressure + slot * (long)pressure_stride + first_sample + g * SUBBLOCK);
                clear(subblock_sum);
#endif
            }
#else
            for (int slot = tile; slot < tile_end; slot += BATCH) {
                expand(delay + row * (long)slots + slot, polynomials + place_of(row, slot, functions, slots), functions,
                       first_gain, t, per_sample, worker, &paths);
                SYNCHRONISE;
#if MANY_CHANNELS
                add_paths(rows + g * SUBBLOCK + first_row[first_function] * (long)stride, stride,
                          first_row[first_function + 1] - first_row[first_function], &paths, subblock_sum);
#else
                for (int p = 0; p < BATCH; p++) {
#if FUNCTIONS == 1 || APART
                    if (paths.gain[0][p] == 0.0f && paths.slope[0][p] == 0.0f SILENT(p)) continue;  // or fills up the batch
#endif
                    add_path(rows + g * SUBBLOCK, stride, first_row + first_function, 1, &paths, p, worker, subblock_sum);
#if APART
                    put(subblock_sum, 0, worker, pressure + (slot + p) * (long)pressure_stride + first_sample + g * SUBBLOCK);
                    clear(subblock_sum);
#endif
                }
#endif
                SYNCHRONISE;
            }
#endif
            for (int k = 0; k < FUNCTIONS; k++) {
                for (int j = 0; j < VECTORS; j++) sum[g - first_subblock][k][j] += subblock_sum[k][j];
            }
        }
    }
#if !APART
    for (int g = first_subblock; g < last_subblock; g++) {
        for (int c = 0; c < CHANNELS; c++) {
            put(sum[g - first_subblock], c, worker, pressure + (pressure_row[receiver] + c) * (long)pressure_stride + first_sample + g * SUBBLOCK);
        }
    }
#endif
}
