// The branch signals: the emitted signal through the fixed filters of the Farrow bank. Work-item: dimension 0 counts
// spans of CHANNEL samples, dimension 1 ROWS rows of a bank each, dimension 2 streams with the same bank: PARTS of each stretch
// of delays. A sum of zeros is zero, so silence stays exact silence: where nothing is heard (sparse) the rows are left as they
// are, zero. Where branch signals have OVERSAMPLING times the recording's sampling rate, those of equal phase stand side by side,
// so that neighbouring samples of the recording read neighbours.

#define CHANNEL (VECTORS * LANES)

__kernel void branches(__global const float* emitted,
                       long first_emitted,             // tap_count - 1 - centre samples before the first row's, of the first stream
                       long stream, long stretch,      // samples from a stream to the next one, and from stretch to stretch
                       __constant float* taps,         // [row blocks][tap_count][ROWS], last tap first; 0 in rows that there are not
                       int tap_count, int count,       // rows of the bank
                       int width, int stride, int first_row,
                       int stretch_rows,               // from stretch to stretch
                       __global float* rows,
                       int sparse,
                       __global const int* following)   // as in activity.h
{
    const int first = get_global_id(0) * CHANNEL, block = get_global_id(1), part = get_global_id(2) % PARTS;
    const long number = get_global_id(2) / PARTS;
    if (first >= width) return;
    if (sparse && following[first / CELL] > (first + CHANNEL - 1) / CELL) return;
    vec sum[ROWS][VECTORS];
    for (int i = 0; i < ROWS; i++) {
        for (int j = 0; j < VECTORS; j++) sum[i][j] = 0.0f;
    }
    __global const float* at = emitted + first_emitted + number * stretch + part * stream + first;
    __constant float* tap = taps + block * tap_count * ROWS;
    for (int k = 0; k < tap_count; k++, at++, tap += ROWS) {
#pragma unroll
        for (int j = 0; j < VECTORS; j++) {
            const vec x = LOAD(at + j * LANES);
#pragma unroll
            for (int i = 0; i < ROWS; i++) sum[i][j] += tap[i] * x;
        }
    }
    for (int i = 0; i < ROWS && block * ROWS + i < count; i++) {
        __global float* out = rows + (first_row + number * stretch_rows + part * count + block * ROWS + i) * (long)stride;
#if OVERSAMPLING == 1
        for (int j = 0; j < VECTORS; j++) *(__global loose_vec*)(out + first + j * LANES) = sum[i][j];
#else
        for (int n = 0; n < CHANNEL; n++) {
            const int place = first + n;
            out[place / OVERSAMPLING + place % OVERSAMPLING * (stride / OVERSAMPLING)] = ((const float*)sum[i])[n];
        }
#endif
    }
}
