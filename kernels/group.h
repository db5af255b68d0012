// A group is GROUP = WORKERS * VECTORS * LANES neighbouring samples that share the whole part of a path's delay.
// A batch is BATCH paths whose polynomials are expanded at a group's centre before any of them is summed.

#if WORKERS == 1
#define SHARED __private
#define SYNCHRONISE
#else
#define SHARED __local
#define SYNCHRONISE barrier(CLK_LOCAL_MEM_FENCE)
#endif

#define GROUP (WORKERS * VECTORS * LANES)

typedef struct {
    int whole[BATCH];      // whole delay, samples
    float fraction[BATCH]; // rest of the delay at the group's centre, samples
    float rate[BATCH];     // its change per sample
    float curve[BATCH];    // its change per sample squared
    float gain[BATCH];
    float slope[BATCH];    // of the gain per sample
#if SPARSE
    int heard[BATCH];      // whether anything sounds
#endif
} batch;

#if SPARSE
// Note in which batches of a tile any path is heard, for each of some groups; returns whether there are any.
static int find_heard(__global const int* spans, int slots, int tile, int tile_end, int first_block, int block_groups,
                      int first_group, int last_group, int worker, SHARED int* batches)
{
    int any = 0;
    SYNCHRONISE;
    for (int g = first_group + worker; g < last_group; g += WORKERS) batches[g - first_group] = 0;
    SYNCHRONISE;
    for (int block = first_group / block_groups; block * block_groups < last_group; block++) {
        __global const int* row = spans + (long)(first_block + block) * slots;
        for (int slot = tile; slot < tile_end; slot += BATCH) {
            int heard = 0;
            for (int p = 0; p < BATCH; p++) heard |= row[slot + p];
            if (!heard) continue;
            any = 1;
            int from = last_group, until = first_group;
            for (int p = 0; p < BATCH; p++) {
                const int begin = block * block_groups + (row[slot + p] & 0xffff);
                const int end = block * block_groups + (row[slot + p] >> 16);
                from = row[slot + p] && begin < from ? begin : from;
                until = row[slot + p] && end > until ? end : until;
            }
            from = from > first_group ? from : first_group;
            until = until < last_group ? until : last_group;
            for (int g = from + worker; g < until; g += WORKERS) batches[g - first_group] |= 1 << (slot - tile) / BATCH;
        }
    }
    SYNCHRONISE;
    return any;
}

// Note which paths of a batch are heard in a group of a block.
static void note_heard(__global const int* spans, int group, int worker, SHARED batch* out)
{
    for (int p = worker * LANES; p < BATCH; p += WORKERS * LANES) {
        const ivec span = *(__global const loose_ivec*)(spans + p);
        *(SHARED loose_ivec*)(out->heard + p) = group >= (span & 0xffff) && group < span >> 16;
    }
}
#endif

// Expand a batch about the group's centre t in [-1, 1] of its block, with the gains of one function of frequency.
static void expand(__global const int* delay, __global const float* node, int slots, int function, float t,
                   float per_sample, int worker, SHARED batch* out)
{
    for (int p = worker * LANES; p < BATCH; p += WORKERS * LANES) {
        __global const float* c = node + p;
        const vec c1 = LOAD(c + slots), c2 = LOAD(c + 2 * slots), c3 = LOAD(c + 3 * slots);
        const vec at = LOAD(c) + t * (c1 + t * (c2 + t * c3));
        const vec whole = rounded(at);
        *(SHARED loose_ivec*)(out->whole + p) = *(__global const loose_ivec*)(delay + p) + nearest(at);
        *(SHARED loose_vec*)(out->fraction + p) = at - whole;
        *(SHARED loose_vec*)(out->rate + p) = per_sample * (c1 + t * (2.0f * c2 + t * (3.0f * c3)));
        *(SHARED loose_vec*)(out->curve + p) = per_sample * per_sample * (c2 + t * (3.0f * c3));
        __global const float* g = c + coefficients(function) * slots;
        const vec g1 = LOAD(g + slots), g2 = LOAD(g + 2 * slots), g3 = LOAD(g + 3 * slots);
        *(SHARED loose_vec*)(out->gain + p) = LOAD(g) + t * (g1 + t * (g2 + t * g3));
        *(SHARED loose_vec*)(out->slope + p) = per_sample * (g1 + t * (2.0f * g2 + t * (3.0f * g3)));
    }
}
