// A subblock is SUBBLOCK = WORKERS * VECTORS * LANES neighbouring samples that share the whole part of a path's delay.
// A batch is BATCH paths whose polynomials are expanded at a subblock's centre before any of them is summed: neighbours
// side by side; where signals pause a single one, the terms of its functions side by side. About the centre a delay goes
// on with two more terms and a gain with one; where blocks are short because motion is near (FINE), with their cubics.
// Gains of a function come for each of CHANNELS channels of the receiver side by side; FUNCTIONS counts all of these.

#if WORKERS == 1
#define SHARED __private
#define SYNCHRONISE
#else
#define SHARED __local
#define SYNCHRONISE barrier(CLK_LOCAL_MEM_FENCE)
#endif

#if SPARSE
#define EXPANDED __private
#else
#define EXPANDED SHARED
#endif

#define SUBBLOCK (WORKERS * VECTORS * LANES)

typedef struct {
    int whole[BATCH];               // whole delay, samples
    float fraction[BATCH];          // rest of the delay at the subblock's centre, samples
    float rate[BATCH];              // its change per sample
    float curve[BATCH];             // its change per sample squared
    float gain[FUNCTIONS][BATCH];
    float slope[FUNCTIONS][BATCH];  // of the gain per sample
#if FINE
    float twist[BATCH];             // of the delay per sample cubed
    float bend[FUNCTIONS][BATCH];   // of the gain per sample squared
    float flex[FUNCTIONS][BATCH];   // and cubed
#endif
} batch;

#if SPARSE
// List the paths of a tile that are heard in each of some subblocks. Every worker has subblocks of its own.
static void find_active(__global const int* activity, int slots, int tile, int tile_end, int first_block, int block_subblocks,
                       int first_subblock, int last_subblock, int worker, SHARED uchar active[SUBBLOCKS][TILE], SHARED int* count)
{
    for (int g = first_subblock + worker; g < last_subblock; g += WORKERS) count[g - first_subblock] = 0;
    for (int block = first_subblock / block_subblocks; block * block_subblocks < last_subblock; block++) {
        __global const int* row = activity + (first_block + block) * (long)slots;
        for (int slot = tile; slot < tile_end; slot++) {
            const int mask = row[slot];
            if (!mask) continue;
            const int begin = block * block_subblocks + MASK_FIRST(mask), end = block * block_subblocks + MASK_END(mask);
            const int from = begin > first_subblock ? begin : first_subblock, until = end < last_subblock ? end : last_subblock;
            for (int g = from + ((first_subblock + worker - from) & (WORKERS - 1)); g < until; g += WORKERS) {
                active[g - first_subblock][count[g - first_subblock]++] = slot - tile;
            }
        }
    }
}

// Expand one path about the subblock's centre t in [-1, 1] of its block, with the gains of `functions` from a first one on.
static void expand(int delay, __global const float* c, int functions, int first, float t, float per_sample,
                   EXPANDED batch* out)
{
    const float at = CUBIC(c[0], c[1], c[2], c[3], t), whole = (at + ROUNDING) - ROUNDING;
    out->whole[0] = delay + (int)whole;
    out->fraction[0] = at - whole;
    out->rate[0] = per_sample * CUBIC_SLOPE(c[1], c[2], c[3], t);
    out->curve[0] = per_sample * per_sample * CUBIC_CURVE(c[2], c[3], t);
#if FINE
    out->twist[0] = per_sample * per_sample * per_sample * c[3];
#endif
    for (int first_beside = 0; first_beside < FUNCTIONS; first_beside += 8) {
        const int beside = FUNCTIONS - first_beside < 8 ? FUNCTIONS - first_beside : 8;
        gains g[4];
        for (int i = 0; i < 4; i++) g[i] = *(__global const loose_gains*)(c + DELAY_TERMS + i * functions + first + first_beside);
        const gains gain = CUBIC(g[0], g[1], g[2], g[3], t), slope = per_sample * CUBIC_SLOPE(g[1], g[2], g[3], t);
#pragma unroll
        for (int k = 0; k < beside; k++) {
            out->gain[first_beside + k][0] = ((const float*)&gain)[k];
            out->slope[first_beside + k][0] = ((const float*)&slope)[k];
        }
#if FINE
        const gains bend = per_sample * per_sample * CUBIC_CURVE(g[2], g[3], t);
        const gains flex = per_sample * per_sample * per_sample * g[3];
#pragma unroll
        for (int k = 0; k < beside; k++) {
            out->bend[first_beside + k][0] = ((const float*)&bend)[k];
            out->flex[first_beside + k][0] = ((const float*)&flex)[k];
        }
#endif
    }
}
#else
// Expand a batch about the subblock's centre t in [-1, 1] of its block, with the gains of `functions` from a first one on.
static void expand(__global const int* delay, __global const float* polynomials, int functions, int first, float t,
                   float per_sample, int worker, SHARED batch* out)
{
    for (int p = worker * LANES; p < BATCH; p += WORKERS * LANES) {
        __global const float* c = polynomials + place_of(0, p, functions, 0);
        const vec c1 = LOAD(c + BESIDE), c2 = LOAD(c + 2 * BESIDE), c3 = LOAD(c + 3 * BESIDE);
        const vec at = CUBIC(LOAD(c), c1, c2, c3, t), whole = rounded(at);
        *(SHARED loose_ivec*)(out->whole + p) = *(__global const loose_ivec*)(delay + p) + nearest(at);
        *(SHARED loose_vec*)(out->fraction + p) = at - whole;
        *(SHARED loose_vec*)(out->rate + p) = per_sample * CUBIC_SLOPE(c1, c2, c3, t);
        *(SHARED loose_vec*)(out->curve + p) = per_sample * per_sample * CUBIC_CURVE(c2, c3, t);
#if FINE
        *(SHARED loose_vec*)(out->twist + p) = per_sample * per_sample * per_sample * c3;
#endif
#pragma unroll
        for (int k = 0; k < FUNCTIONS; k++) {
            __global const float* g = c + (DELAY_TERMS + first + k) * BESIDE;
            const int power = functions * BESIDE;
            const vec g1 = LOAD(g + power), g2 = LOAD(g + 2 * power), g3 = LOAD(g + 3 * power);
            *(SHARED loose_vec*)(out->gain[k] + p) = CUBIC(LOAD(g), g1, g2, g3, t);
            *(SHARED loose_vec*)(out->slope[k] + p) = per_sample * CUBIC_SLOPE(g1, g2, g3, t);
#if FINE
            *(SHARED loose_vec*)(out->bend[k] + p) = per_sample * per_sample * CUBIC_CURVE(g2, g3, t);
            *(SHARED loose_vec*)(out->flex[k] + p) = per_sample * per_sample * per_sample * g3;
#endif
        }
    }
}
#endif
