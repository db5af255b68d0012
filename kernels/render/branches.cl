// The branch signals: the emitted signal through the fixed filters of the Farrow bank. Work-item: dimension 0 counts
// spans of CHANNEL samples, dimension 1 rows. A sum of zeros is zero, so silence stays exact silence: where nothing is
// heard (sparse) the rows are left as they are, zero. Where branch signals have OVERSAMPLING times the recording's sampling
// rate, those of equal phase stand side by side, so that neighbouring samples of the recording read neighbours.

#define CHANNEL (VECTORS * LANES)

__kernel void branches(__global const float* emitted,
                       long first_emitted,             // tap_count - 1 - centre samples before the first row's
                       __constant float* taps,         // [rows][tap_count]
                       int tap_count, int width, int stride, int first_row, __global float* rows,
                       int sparse,
                       __global const int* following)   // as in activity.h
{
    const int row = get_global_id(1);
    const int first = get_global_id(0) * CHANNEL;
    if (first >= width) return;
    if (sparse && following[first / CELL] > (first + CHANNEL - 1) / CELL) return;
    vec sum[VECTORS];
    for (int j = 0; j < VECTORS; j++) sum[j] = 0.0f;
    for (int k = 0; k < tap_count; k++) {
        const float tap = taps[(row + 1) * tap_count - 1 - k];
        __global const float* at = emitted + first_emitted + first + k;
#pragma unroll
        for (int j = 0; j < VECTORS; j++) sum[j] += tap * LOAD(at + j * LANES);
    }
    __global float* out = rows + (first_row + row) * (long)stride;
#if OVERSAMPLING == 1
    for (int j = 0; j < VECTORS; j++) *(__global loose_vec*)(out + first + j * LANES) = sum[j];
#else
    for (int i = 0; i < CHANNEL; i++) {
        const int at = first + i;
        out[at / OVERSAMPLING + at % OVERSAMPLING * (stride / OVERSAMPLING)] = ((const float*)sum)[i];
    }
#endif
}
