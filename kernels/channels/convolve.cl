// What receivers hear by their impulse responses at some nodes: grids (scatter.cl) are transformed, filtered and cut to KEPT of
// LANES parts of their spectra, times that of what is emitted, back at the sampling rate. Work-item: dimension 0 counts units, 1
// receivers, 2 their channels. A unit is two neighbouring nodes of real responses, of which one is the imaginary part of a
// complex number, or a node of envelopes. Point LANES m + l of a grid is in lane l of vector m: after the transform of
// vectors (transform.h), one of LANES numbers over lanes is left, and of KEPT ones at the sampling rate.

#define KEPT 12  // as in render/channel_grid.py, 12 samples of 16 points

// Two vectors of which the elements of a and b alternate: four rounds of this exchange lanes and vectors.
#define MIX(a, i, j, x, y)                                                                                               \
    const vec x = (vec)(a[i].s0, a[j].s0, a[i].s1, a[j].s1, a[i].s2, a[j].s2, a[i].s3, a[j].s3, a[i].s4, a[j].s4,        \
                        a[i].s5, a[j].s5, a[i].s6, a[j].s6, a[i].s7, a[j].s7),                                           \
              y = (vec)(a[i].s8, a[j].s8, a[i].s9, a[j].s9, a[i].sa, a[j].sa, a[i].sb, a[j].sb, a[i].sc, a[j].sc,        \
                        a[i].sd, a[j].sd, a[i].se, a[j].se, a[i].sf, a[j].sf);

INLINE void mix(const vec* from, vec* to)
{
#pragma unroll
    for (int i = 0; i < LANES / 2; i++) {
        MIX(from, i, i + LANES / 2, low, high)
        to[2 * i] = low, to[2 * i + 1] = high;
    }
}

INLINE void transpose(vec* a)
{
    vec b[LANES];
    mix(a, b);
    mix(b, a);
    mix(a, b);
    mix(b, a);
}

// Turn the numbers of LANES vectors, each lane by its own angle.
#define TURN_LANES(a, b, turns)                                                                                          \
    _Pragma("unroll") for (int p = 0; p < LANES; p++)                                                                    \
        TURN(a, b, p, LOAD((turns) + 2 * p * LANES), LOAD((turns) + (2 * p + 1) * LANES))

__kernel void convolve(__global float* grids,              // [units][receivers][functions][channels][2][plane]
                       int functions,
                       int count,                          // vectors of a grid
                       __constant int* radix,              // of the passes of transforms, then 0
                       __global const float* turns,        // [count - 1][2], of the passes: cosines and sines
                       __global const float* lane_turns,   // [vectors of a plane][2][LANES], of the grid's lanes
                       __global const float* back_turns,   // the same, of those at the sampling rate
                       __global const float* inner, int inner_stride,  // [units or 1][functions][groups][KEPT][2][LANES], spectra
                       __global const float* outer, int outer_stride,  // [units or 1][groups][KEPT][2][LANES], of the sum
                       __global const float* window,       // [stride], weights, among zeros from LANES before them
                       int first, int apart,               // sample of the first weight, and later than that in the imaginary part
                       int length, int stride,             // weights, and floats of a row
                       __global float* received)           // [units][receivers][channels][2][stride], likewise
{
    const int unit = get_global_id(0), channel = get_global_id(2), channels = get_global_size(2);
    const int groups = (count + LANES - 1) / LANES, block = LANES * LANES, plane = groups * block;
    const long row = ((long)unit * get_global_size(1) + get_global_id(1)) * channels, each = 2L * channels * plane;
    __global float* grid = grids + (row * functions + channel) * 2 * plane;
    inner += (long)unit * inner_stride;
    outer += (long)unit * outer_stride;
    for (int k = 0; k < functions; k++) passes(grid + k * each, grid + k * each + plane, count, radix, 0, turns);
    for (int q = 0; q < groups; q++) {
        vec real[KEPT], imaginary[KEPT], a[LANES], b[LANES];
        for (int k = 0; k < functions; k++) {
#pragma unroll
            for (int p = 0; p < LANES; p++) {
                a[p] = LOAD(grid + k * each + q * block + p * LANES);
                b[p] = LOAD(grid + k * each + plane + q * block + p * LANES);
            }
            TURN_LANES(a, b, lane_turns + 2 * q * block)
            transpose(a);
            transpose(b);
            dft4r(a, b, 4);
            __global const float* f = inner + (k * (long)groups + q) * 2 * KEPT * LANES;
#pragma unroll
            for (int j = 0; j < KEPT; j++) {
                const int from = PLACED(j < KEPT / 2 ? j : j + LANES - KEPT, 4);
                const vec x = LOAD(f + 2 * j * LANES), y = LOAD(f + (2 * j + 1) * LANES);
                const vec re = minus(a[from], x, b[from], y), im = plus(a[from], y, b[from], x);
                real[j] = k ? real[j] + re : re, imaginary[j] = k ? imaginary[j] + im : im;
            }
        }
        __global const float* f = outer + q * 2 * KEPT * LANES;
#pragma unroll
        for (int j = 0; j < KEPT; j++) {
            const vec x = LOAD(f + 2 * j * LANES), y = LOAD(f + (2 * j + 1) * LANES);
            a[j] = minus(real[j], x, imaginary[j], y), b[j] = plus(real[j], y, imaginary[j], x);
        }
        dft4r(b, a, KEPT / 4);
        vec c[LANES], d[LANES];
#pragma unroll
        for (int j = 0; j < LANES; j++) {
            c[j] = j < KEPT ? a[PLACED(j, KEPT / 4)] : 0.0f;
            d[j] = j < KEPT ? b[PLACED(j, KEPT / 4)] : 0.0f;
        }
        transpose(c);
        transpose(d);
        TURN_LANES(d, c, back_turns + 2 * q * block)
#pragma unroll
        for (int p = 0; p < LANES; p++) {
            *(__global loose_vec*)(grid + q * block + p * LANES) = c[p];
            *(__global loose_vec*)(grid + plane + q * block + p * LANES) = d[p];
        }
    }
    passes(grid + plane, grid, count, radix, 1, turns);
    __global float* out = received + (row + channel) * 2 * stride;
    for (int part = 0; part < 2; part++, first += apart, out += stride) {
        for (int m = first / KEPT; m < count && m * KEPT < first + length; m++) {
            const int at = m * KEPT - first + LANES;
            *(__global loose_vec*)(out + at) = LOAD(grid + part * plane + m * LANES) * LOAD(window + at);
        }
    }
}
