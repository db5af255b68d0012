// Adds the paths that begin or end within a block, sample by sample, with a weight that rises and falls. Work-item:
// dimension 0 counts the samples of a block, dimension 1 the places: a receiver and one of its blocks each, dimension 2
// the receiver's channels.

__kernel void fades(__global const float* branches,  // [rows][stride]
                    int stride,
                    int lead,                        // sample of `branches` emitted at the run's first sample
                    int functions, __global const int* first_row,  // [functions + 1], of their branches
                    int channels,                    // of the receivers
                    __global const int* delay, __global const float* polynomials, __global const int* activity,
                    int slots,                       // as in render.cl
                    int first_block,                 // of `delay` and `polynomials`, at the run's first sample
                    __global const int* slot_of, __global const float* start, __global const float* end,  // [fades]
                    __global const int* first,       // [places + 1]
                    __global const int* row, __global const int* block,  // [places]
                    float per_ramp,                  // 1 / samples of a transition; 0 for a gate
                    int block_samples,
                    int samples,                     // in the run
                    int subblock,                    // samples; TRIMMED: those without a transition are left to render.cl
                    __global float* pressure, int pressure_stride,
                    int first_sample)                // of `pressure`, at the run's first sample
{
    const int n = get_global_id(0), place = get_global_id(1), channel = get_global_id(2);
    const int at = block[place] * block_samples + n;
    if (at >= samples) return;
    const int apart = BESIDE, gains = functions * channels, power = gains * apart;
    const float t = (float)(2 * n) / (float)block_samples - 1.0f;
    float sum = 0.0f;
    for (int fade = first[place]; fade < first[place + 1]; fade++) {
        const int slot = slot_of[fade];
        const int node = first_block + block[place];
#if SPARSE
        if (activity[node * (long)slots + slot] == 0) continue;
#endif
        __global const float* c = polynomials + place_of(node, slot, gains, slots);
        const float both = weight((float)n - start[fade], per_ramp) - weight((float)n - end[fade], per_ramp);
        if (both == 0.0f) continue;
#if TRIMMED
        if (is_steady(n / subblock, subblock, start[fade], end[fade], per_ramp)) continue;
#endif
        const float delayed = CUBIC(c[0], c[apart], c[2 * apart], c[3 * apart], t);
        const float rest = floor(delayed + 0.5f), mu = delayed - rest;
        const int whole = delay[node * (long)slots + slot] + (int)rest;
        for (int k = 0; k < functions; k++) {
            __global const float* g = c + (DELAY_TERMS + k * channels + channel) * apart;
            __global const float* branch = branches + (first_row[k + 1] - 1) * (long)stride + lead + at + PLACE(-whole, stride);
            float value = *branch;
            for (int q = first_row[k + 1] - 1; q > first_row[k]; q--) {
                branch -= stride;
                value = value * mu + *branch;
            }
            sum += both * CUBIC(g[0], g[power], g[2 * power], g[3 * power], t) * value;
        }
    }
    pressure[(row[place] + channel) * (long)pressure_stride + first_sample + at] += sum;
}
