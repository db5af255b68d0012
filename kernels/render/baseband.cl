// Sum of all paths of one receiver as a complex envelope: each path's envelope, delayed, and turned by the carrier's
// phase of the exact delay. Work-item: dimension 0 counts spans of GROUPS groups of LANES samples, dimension 1 receivers,
// dimension 2 the receivers' CHANNELS channels, whose gains of a function stand side by side. Samples of a group share the
// whole part of a path's delay, which is found for BATCH paths together. Where functions are PAIRED, the second of two is the first
// one times j: both are one complex gain of the same envelope.

#if FINE
#define SILENT(p) (c[AT(0)] == 0.0f && c[AT(0) + POWER] == 0.0f && c[AT(0) + 2 * POWER] == 0.0f && \
                   c[AT(0) + 3 * POWER] == 0.0f)  // or fills up the batch
#define GAIN(k) CUBIC(c[AT(k)], c[AT(k) + POWER], c[AT(k) + 2 * POWER], c[AT(k) + 3 * POWER], t)
#define AT(k) ((DELAY_TERMS + (k) * CHANNELS + channel) * BESIDE)
#define POWER (FUNCTIONS * CHANNELS * BESIDE)
#else
#define SILENT(p) (paths->gain[0][0][p] == 0.0f && paths->gain[0][1][p] == 0.0f)
#define GAIN(k) (paths->gain[k][1][p] * t + paths->gain[k][0][p])
#endif

// The gain of function k + 1, which is function k times j.
#if PAIRED
#define ADD_TURNED(k)                  \
    const vec turned = GAIN((k) + 1);  \
    real -= turned * b;                \
    imaginary += turned * a;
#else
#define ADD_TURNED(k)
#endif

// Add what a path brings of function k through `count` branches, the highest one's real row being `x`.
#define ADD(k, count)                                            \
    {                                                            \
        __global const float* y = x + (count) * (long)stride;    \
        BRANCHES(count)                                          \
        const vec gain = GAIN(k);                                \
        real += gain * a;                                        \
        imaginary += gain * b;                                   \
        ADD_TURNED(k)                                            \
    }

// The same where counts are constants, four bits each; `x` goes on to the next function with branches of its own.
#define ADD_NEXT(i)                                        \
    if (FUNCTIONS > (i) << PAIRED) {                       \
        ADD((i) << PAIRED, COUNT(i))                       \
        x += (COUNT(i) + COUNT((i) + 1)) * (long)stride;   \
    }

// Add path p of a batch at samples `t` of its block, or from the group's middle; `branches` points at the first of these without delay.
static void add_path(__global const float* branches, int stride, __constant int* first_row, const batch* paths, int p,
                     __global const float* c, int channel, vec t, ulong turn_per_sample, float half_turns_per_sample,
                     float tilt_per_sample, vec* real_sum, vec* imaginary_sum)
{
    if (SILENT(p)) return;
    const int whole = paths->whole[p];
    vec mu = paths->delay[TERMS - 1][p], real = 0.0f, imaginary = 0.0f, cosine, sine;
#pragma unroll
    for (int i = TERMS - 2; i >= 0; i--) mu = mu * t + paths->delay[i][p];
#if TILTED
    branches += paths->beyond[p];
    TILTED_DELAY
#endif
#if COUNTS && !JOINED
    __global const float* x = branches - whole + (2 * first_row[0] + COUNT(0) - 1) * (long)stride;
    ADD_NEXT(0)
    ADD_NEXT(1)
    ADD_NEXT(2)
    ADD_NEXT(3)
    ADD_NEXT(4)
    ADD_NEXT(5)
    ADD_NEXT(6)
#else
    for (int k = 0; k < FUNCTIONS; k += 1 + PAIRED) {
        const int count = first_row[k + 1] - first_row[k];
        __global const float* x = branches - whole + (first_row[k] + first_row[k + 1] - 1) * (long)stride;
        ADD(k, count)
    }
#endif
    half_turns(mu * half_turns_per_sample + whole_turn(whole, turn_per_sample), &cosine, &sine);
    *real_sum += real * cosine + imaginary * sine;
    *imaginary_sum += imaginary * cosine - real * sine;
}

__kernel void baseband(__global const float* branches,  // [rows][stride], real rows of a function before imaginary ones
                       int stride,
                       int lead,                        // sample of `branches` emitted at the run's first sample
                       __constant int* first_row,       // [FUNCTIONS + 1], of their branches; a real and an imaginary row each
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
                       float half_turns_per_sample,
                       tilt_numbers tilt)
{
    const int first = get_global_id(0) * GROUPS, receiver = get_global_id(1), channel = get_global_id(2);
    const int last = first + GROUPS < groups ? first + GROUPS : groups;
    vec real_sum[GROUPS], imaginary_sum[GROUPS];
    for (int g = 0; g < GROUPS; g++) real_sum[g] = imaginary_sum[g] = 0.0f;
    batch paths;
    for (int slot = first_slot[receiver]; slot < first_slot[receiver + 1]; slot += BATCH) {
        for (int g = first; g < last; g++) {
            const int at = g * LANES, block = at / block_samples, inside = at - block * block_samples, row = first_block + block;
            const float middle = ((float)inside + 0.5f * (LANES - 1)) * (2.0f / (float)block_samples) - 1.0f;
#if FINE
            const vec t = (RAMP + (float)inside) * (2.0f / (float)block_samples) - 1.0f;
#else
            const vec t = RAMP - 0.5f * (LANES - 1);
#endif
            __global const float* c = polynomials + place_of(row, slot, FUNCTIONS * CHANNELS, slots);
            expand(delay + row * (long)slots + slot, c, middle, 2.0f / (float)block_samples, channel, &paths);
#if TILTED
            find_stretches(&paths, 2 * first_row[FUNCTIONS] * (long)stride, tilt.first_stretch, tilt.stretches, tilt.stretch,
                           tilt.per_stretch, tilt.tilt_per_sample);
#endif
            __global const float* here = branches + lead + at;
            vec real = 0.0f, imaginary = 0.0f;
            for (int p = 0; p < BATCH; p++) {
#if SPARSE
                const int mask = activity[row * (long)slots + slot + p];
                if ((inside + LANES - 1) / SUBBLOCK < MASK_FIRST(mask) || inside / SUBBLOCK >= MASK_END(mask)) continue;
#elif JOINED
                if (paths.joined[p]) {
                    add_joined(here, stride, &paths, p, t, turn_per_sample, half_turns_per_sample, tilt.tilt_per_sample, &real, &imaginary);
                    continue;
                }
#endif
                add_path(here, stride, first_row, &paths, p,
                         c + place_of(0, p, FUNCTIONS * CHANNELS, 0), channel, t, turn_per_sample, half_turns_per_sample, tilt.tilt_per_sample, &real,
                         &imaginary);
            }
            real_sum[g - first] += real;
            imaginary_sum[g - first] += imaginary;
        }
    }
    for (int g = first; g < last; g++) {
        __global float* out = envelope + 2 * (envelope_row[receiver] + channel) * (long)envelope_stride + first_sample + g * LANES;
        __global loose_vec* re = (__global loose_vec*)out;
        __global loose_vec* im = (__global loose_vec*)(out + envelope_stride);
        *re = *re + real_sum[g - first];
        *im = *im + imaginary_sum[g - first];
    }
}
