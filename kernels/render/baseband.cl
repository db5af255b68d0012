// Sum of all paths of one receiver as a complex envelope: each path's envelope, delayed, and turned by the carrier's
// phase of the exact delay. Work-item: dimension 0 counts WIDTH = VECTORS * LANES samples, dimension 1 receivers,
// dimension 2 the receivers' CHANNELS channels, whose gains of a function stand side by side.

#define WIDTH (VECTORS * LANES)  // samples that share the whole part of a path's delay

__kernel void baseband(__global const float* branches,  // [rows][stride], real rows of a function before imaginary ones
                       int stride,
                       int lead,                        // sample of `branches` emitted at the run's first sample
                       __constant int* first_row,       // [FUNCTIONS + 1], of their branches; a real and an imaginary row each
                       __global const int* delay,       // [block][slots], whole samples
                       __global const float* polynomials,  // as in polynomials.h, on [-1, 1]
                       __global const int* activity,    // [block][slots]: subblocks in which it sounds, see activity.h
                       int slots,
                       int first_block,                 // of `delay` and `polynomials`, at the run's first sample
                       __global const int* first_slot,  // [receivers + 1]
                       int block_samples,
                       __global const int* envelope_row,  // [receivers]
                       __global float* envelope,        // [2 rows][envelope_stride], real and imaginary, added to
                       int envelope_stride,
                       int first_sample,                // of `envelope`, at the run's first sample
                       ulong turn_per_sample,           // of the carrier; one turn is 2^64
                       float half_turns_per_sample)
{
    const int at = get_global_id(0) * WIDTH, receiver = get_global_id(1), channel = get_global_id(2);
    const int block = at / block_samples, inside = at - block * block_samples;
    const int row = first_block + block;
    const float middle = ((float)inside + 0.5f * (WIDTH - 1)) * (2.0f / (float)block_samples) - 1.0f;
    vec t[VECTORS], real_sum[VECTORS], imaginary_sum[VECTORS];
    for (int j = 0; j < VECTORS; j++) {
        t[j] = (RAMP + (float)(inside + j * LANES)) * (2.0f / (float)block_samples) - 1.0f;
        real_sum[j] = imaginary_sum[j] = 0.0f;
    }
    for (int slot = first_slot[receiver]; slot < first_slot[receiver + 1]; slot++) {
#if SPARSE
        const int mask = activity[row * (long)slots + slot];
        if ((inside + WIDTH - 1) / SUBBLOCK < MASK_FIRST(mask) || inside / SUBBLOCK >= MASK_END(mask)) continue;
#endif
        __global const float* c = polynomials + place_of(row, slot, FUNCTIONS * CHANNELS, slots);
        float moved = c[DELAY_TERMS - 1];  // whole samples from the block's middle to that of these samples
#pragma unroll
        for (int i = DELAY_TERMS - 2; i >= 0; i--) moved = moved * middle + c[i];
        moved = (moved + ROUNDING) - ROUNDING;
        const int whole = delay[row * (long)slots + slot] + (int)moved;
        const float begin = whole_turn(whole, turn_per_sample);
        vec mu[VECTORS], real[VECTORS], imaginary[VECTORS];
#pragma unroll
        for (int j = 0; j < VECTORS; j++) {
            mu[j] = c[DELAY_TERMS - 1];
            real[j] = imaginary[j] = 0.0f;
        }
#pragma unroll
        for (int i = DELAY_TERMS - 2; i >= 0; i--) {
            const float term = i > 0 ? c[i] : c[0] - moved;
#pragma unroll
            for (int j = 0; j < VECTORS; j++) mu[j] = mu[j] * t[j] + term;
        }
        for (int k = 0; k < FUNCTIONS; k++) {
            const int count = first_row[k + 1] - first_row[k];
            __global const float* x = branches + (2 * first_row[k + 1] - count - 1) * (long)stride + lead + at - whole;
            __global const float* y = x + count * (long)stride;
            __global const float* g = c + DELAY_TERMS + k * CHANNELS + channel;
            const float g0 = g[0], g1 = g[FUNCTIONS * CHANNELS], g2 = g[2 * FUNCTIONS * CHANNELS], g3 = g[3 * FUNCTIONS * CHANNELS];
            vec a[VECTORS], b[VECTORS];
#pragma unroll
            for (int j = 0; j < VECTORS; j++) {
                a[j] = LOAD(x + j * LANES);
                b[j] = LOAD(y + j * LANES);
            }
            for (int q = 1; q < count; q++) {
                x -= stride;
                y -= stride;
#pragma unroll
                for (int j = 0; j < VECTORS; j++) {
                    a[j] = a[j] * mu[j] + LOAD(x + j * LANES);
                    b[j] = b[j] * mu[j] + LOAD(y + j * LANES);
                }
            }
#pragma unroll
            for (int j = 0; j < VECTORS; j++) {
                const vec gain = CUBIC(g0, g1, g2, g3, t[j]);
                real[j] += gain * a[j];
                imaginary[j] += gain * b[j];
            }
        }
#pragma unroll
        for (int j = 0; j < VECTORS; j++) {
            vec cosine, sine;
            half_turns(mu[j] * half_turns_per_sample + begin, &cosine, &sine);
            real_sum[j] += real[j] * cosine + imaginary[j] * sine;
            imaginary_sum[j] += imaginary[j] * cosine - real[j] * sine;
        }
    }
    __global float* out = envelope + 2 * (envelope_row[receiver] + channel) * (long)envelope_stride + first_sample + at;
    for (int j = 0; j < VECTORS; j++) {
        __global loose_vec* re = (__global loose_vec*)(out + j * LANES);
        __global loose_vec* im = (__global loose_vec*)(out + envelope_stride + j * LANES);
        *re = *re + real_sum[j];
        *im = *im + imaginary_sum[j];
    }
}
