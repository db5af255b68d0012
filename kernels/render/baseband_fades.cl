// Adds the envelopes of paths that begin or end within a block, sample by sample, with a weight that rises and falls.
// Work-item: dimension 0 counts the samples of a block, dimension 1 the places: a receiver and one of its blocks each, dimension
// 2 the receiver's CHANNELS channels.

__kernel void baseband_fades(
    __global const float* branches, int stride, int lead, __constant int* first_row,  // as in baseband.cl
    __global const int* delay, __global const float* polynomials, __global const int* activity, int slots, int first_block,
    __global const int* slot_of, __global const float* start, __global const float* end,  // [fades], as in fades.cl
    __global const int* first,                           // [places + 1]
    __global const int* row, __global const int* block,  // [places]
    float per_ramp, int block_samples, int samples,
    __global float* envelope, int envelope_stride, int first_sample, ulong turn_per_sample, float half_turns_per_sample,
    tilt_numbers tilt)
{
    const int n = get_global_id(0), place = get_global_id(1), channel = get_global_id(2);
    const int at = block[place] * block_samples + n;
    if (at >= samples) return;
    const float t = (float)(2 * n) / (float)block_samples - 1.0f;
    float real_sum = 0.0f, imaginary_sum = 0.0f;
    for (int fade = first[place]; fade < first[place + 1]; fade++) {
        const int slot = slot_of[fade];
        const int node = first_block + block[place];
#if SPARSE
        if (activity[node * (long)slots + slot] == 0) continue;
#endif
        __global const float* c = polynomials + place_of(node, slot, FUNCTIONS * CHANNELS, slots);
        const float both = weight((float)n - start[fade], per_ramp) - weight((float)n - end[fade], per_ramp);
        if (both == 0.0f) continue;
        float delayed = 0.0f, real = 0.0f, imaginary = 0.0f, cosine, sine;
        for (int i = DELAY_TERMS - 1; i >= 0; i--) delayed = delayed * t + c[i * BESIDE];
        const float rest = rounded(delayed), mu = delayed - rest;
        const int whole = delay[node * (long)slots + slot] + (int)rest;
        float from_middle;
        const int stretch = stretch_of((float)(whole - tilt.first_stretch), tilt.stretches, tilt.stretch, tilt.per_stretch, &from_middle);
        const int from = 2 * first_row[FUNCTIONS] * stretch;
        const float nu = (mu + from_middle) * tilt.tilt_per_sample;
        for (int k = 0; k < FUNCTIONS; k += 1 + PAIRED) {
            const int count = first_row[k + 1] - first_row[k];
            __global const float* x = branches + (from + 2 * first_row[k + 1] - count - 1) * (long)stride + lead + at - whole;
            __global const float* y = x + count * (long)stride;
            __global const float* g = c + (DELAY_TERMS + k * CHANNELS + channel) * BESIDE;
            const int power = FUNCTIONS * CHANNELS * BESIDE;
            const float gain = CUBIC(g[0], g[power], g[2 * power], g[3 * power], t);
            float a = *x, b = *y;
            for (int q = 1; q < count; q++) {
                const float was = a;
                a = b * nu + (a * mu + *(x -= stride));
                b = (b * mu + *(y -= stride)) - was * nu;
            }
            real += gain * a;
            imaginary += gain * b;
#if PAIRED  // see baseband.cl
            g += CHANNELS * BESIDE;
            const float turned = CUBIC(g[0], g[power], g[2 * power], g[3 * power], t);
            real -= turned * b;
            imaginary += turned * a;
#endif
        }
        half_turns(mu * half_turns_per_sample + whole_turn(whole, turn_per_sample), &cosine, &sine);
        real_sum += both * (real * cosine + imaginary * sine);
        imaginary_sum += both * (imaginary * cosine - real * sine);
    }
    __global float* out = envelope + 2 * (row[place] + channel) * (long)envelope_stride + first_sample + at;
    out[0] += real_sum;
    out[envelope_stride] += imaginary_sum;
}
