// Sum of all paths of one receiver as a complex envelope: each path's envelope, delayed, and turned by the carrier's
// phase of the exact delay. Work-item: dimension 0 counts spans of GROUPS groups of WIDTH = VECTORS * LANES samples,
// dimension 1 receivers, dimension 2 the receivers' CHANNELS channels, whose gains of a function stand side by side.
// Delays of BATCH paths are rounded together. A function of a path whose gain is small has a coarser bank, or none.

#define WIDTH (VECTORS * LANES)  // samples that share the whole part of a path's delay
#define ABS(x) AS_VEC(AS_IVEC(x) & 0x7fffffff)

typedef struct {
    int whole[BATCH];            // samples of the delay
    float rest[BATCH];           // constant term of the delay less these
    int bank[FUNCTIONS][BATCH];  // 0 for none
} batch;

// Round the delays at `middle` of a block, and choose banks by the largest gains in it.
static void choose(__global const int* delay, __global const float* polynomials, __global const float* least, float middle,
                   int channel, batch* out)
{
    for (int p = 0; p < BATCH; p += LANES) {
        __global const float* c = polynomials + place_of(0, p, FUNCTIONS * CHANNELS, 0);
        vec moved = LOAD(c + (DELAY_TERMS - 1) * BESIDE);  // from the block's middle to that of these samples
#pragma unroll
        for (int i = DELAY_TERMS - 2; i >= 0; i--) moved = moved * middle + LOAD(c + i * BESIDE);
        const vec whole = rounded(moved);
        *(loose_ivec*)(out->whole + p) = *(__global const loose_ivec*)(delay + p) + nearest(moved);
        *(loose_vec*)(out->rest + p) = LOAD(c) - whole;
        for (int k = 0; k < FUNCTIONS; k++) {
            __global const float* g = c + (DELAY_TERMS + k * CHANNELS + channel) * BESIDE;
            vec most = 0.0f;
#pragma unroll
            for (int i = 0; i < 4; i++) most += ABS(LOAD(g + i * FUNCTIONS * CHANNELS * BESIDE));
            const ivec more = (most > least[k]) + (most > least[k] * MIDDLE_BANK) + (most > least[k] * FINEST_BANK);
            *(loose_ivec*)(out->bank[k] + p) = LANES > 1 ? -more : more;  // of vectors "true" is -1
        }
    }
}

// Add one path of a batch; `here` points at these samples without delay, in the first of all branches.
static void add_path(__global const float* here, int stride, __constant int* banks, const batch* paths, int p,
                     __global const float* c, int channel, const vec* t, ulong turn_per_sample, float half_turns_per_sample,
                     vec* real_sum, vec* imaginary_sum)
{
    vec mu[VECTORS], real[VECTORS], imaginary[VECTORS];
#pragma unroll
    for (int j = 0; j < VECTORS; j++) {
        mu[j] = c[(DELAY_TERMS - 1) * BESIDE];
        real[j] = imaginary[j] = 0.0f;
    }
#pragma unroll
    for (int i = DELAY_TERMS - 2; i >= 0; i--) {
        const float term = i > 0 ? c[i * BESIDE] : paths->rest[p];
#pragma unroll
        for (int j = 0; j < VECTORS; j++) mu[j] = mu[j] * t[j] + term;
    }
#if FUNCTIONS <= 8
#pragma unroll
#endif
    for (int k = 0; k < FUNCTIONS; k++) {
        if (paths->bank[k][p] == 0) continue;
        __constant int* bank = banks + 2 * (3 * k + paths->bank[k][p] - 1);
        __global const float* x = here + (bank[0] + bank[1] - 1) * (long)stride - paths->whole[p];
        __global const float* y = x + bank[1] * (long)stride;
        vec a[VECTORS], b[VECTORS];
#pragma unroll
        for (int j = 0; j < VECTORS; j++) {
            a[j] = LOAD(x + j * LANES);
            b[j] = LOAD(y + j * LANES);
        }
        for (int q = 1; q < bank[1]; q++) {
            x -= stride;
            y -= stride;
#pragma unroll
            for (int j = 0; j < VECTORS; j++) {
                a[j] = a[j] * mu[j] + LOAD(x + j * LANES);
                b[j] = b[j] * mu[j] + LOAD(y + j * LANES);
            }
        }
        const int power = FUNCTIONS * CHANNELS * BESIDE;
        __global const float* g = c + (DELAY_TERMS + k * CHANNELS + channel) * BESIDE;
#pragma unroll
        for (int j = 0; j < VECTORS; j++) {
            const vec gain = CUBIC(g[0], g[power], g[2 * power], g[3 * power], t[j]);
            real[j] += gain * a[j];
            imaginary[j] += gain * b[j];
        }
    }
    const float begin = whole_turn(paths->whole[p], turn_per_sample);
#pragma unroll
    for (int j = 0; j < VECTORS; j++) {
        vec cosine, sine;
        half_turns(mu[j] * half_turns_per_sample + begin, &cosine, &sine);
        real_sum[j] += real[j] * cosine + imaginary[j] * sine;
        imaginary_sum[j] += imaginary[j] * cosine - real[j] * sine;
    }
}

__kernel void baseband(__global const float* branches,  // [rows][stride], real rows of a bank before imaginary ones
                       int stride,
                       int lead,                        // sample of `branches` emitted at the run's first sample
                       __constant int* banks,           // [FUNCTIONS][3][2], first row and rows of each part, the finest last
                       __global const float* least,     // [blocks][receivers][FUNCTIONS], gains from which on there is a bank
                       __global const int* delay,       // [block][slots], whole samples
                       __global const float* polynomials,  // as in polynomials.h, on [-1, 1]
                       __global const int* activity,    // [block][slots]: subblocks in which it sounds, see activity.h
                       int slots,
                       int first_block,                 // of `delay` and `polynomials`, at the run's first sample
                       __global const int* first_slot,  // [receivers + 1], multiples of BATCH
                       int block_samples, int groups,   // in the run
                       __global const int* envelope_row,  // [receivers]
                       __global float* envelope,        // [2 rows][envelope_stride], real and imaginary, added to
                       int envelope_stride,
                       int first_sample,                // of `envelope`, at the run's first sample
                       ulong turn_per_sample,           // of the carrier; one turn is 2^64
                       float half_turns_per_sample)
{
    const int first = get_global_id(0) * GROUPS, receiver = get_global_id(1), channel = get_global_id(2);
    const int receivers = get_global_size(1), last = first + GROUPS < groups ? first + GROUPS : groups;
    vec real_sum[GROUPS][VECTORS], imaginary_sum[GROUPS][VECTORS];
    for (int g = 0; g < GROUPS; g++) {
        for (int j = 0; j < VECTORS; j++) real_sum[g][j] = imaginary_sum[g][j] = 0.0f;
    }
    batch paths;
    for (int slot = first_slot[receiver]; slot < first_slot[receiver + 1]; slot += BATCH) {
        for (int g = first; g < last; g++) {
            const int at = g * WIDTH, block = at / block_samples, inside = at - block * block_samples, row = first_block + block;
            const float middle = ((float)inside + 0.5f * (WIDTH - 1)) * (2.0f / (float)block_samples) - 1.0f;
            vec t[VECTORS];
            for (int j = 0; j < VECTORS; j++) t[j] = (RAMP + (float)(inside + j * LANES)) * (2.0f / (float)block_samples) - 1.0f;
            __global const float* c = polynomials + place_of(row, slot, FUNCTIONS * CHANNELS, slots);
            choose(delay + row * (long)slots + slot, c, least + (block * (long)receivers + receiver) * FUNCTIONS, middle,
                   channel, &paths);
            for (int p = 0; p < BATCH; p++) {
#if SPARSE
                const int mask = activity[row * (long)slots + slot + p];
                if ((inside + WIDTH - 1) / SUBBLOCK < MASK_FIRST(mask) || inside / SUBBLOCK >= MASK_END(mask)) continue;
#endif
                add_path(branches + lead + at, stride, banks, &paths, p, c + place_of(0, p, FUNCTIONS * CHANNELS, 0), channel, t,
                         turn_per_sample, half_turns_per_sample, real_sum[g - first], imaginary_sum[g - first]);
            }
        }
    }
    for (int g = first; g < last; g++) {
        __global float* out = envelope + 2 * (envelope_row[receiver] + channel) * (long)envelope_stride + first_sample + g * WIDTH;
        for (int j = 0; j < VECTORS; j++) {
            __global loose_vec* re = (__global loose_vec*)(out + j * LANES);
            __global loose_vec* im = (__global loose_vec*)(out + envelope_stride + j * LANES);
            *re = *re + real_sum[g - first][j];
            *im = *im + imaginary_sum[g - first][j];
        }
    }
}
