// Responses over a grid times spectra, and back at the sampling rate: grids are transformed and cut to KEPT of WIDE parts of their
// spectra. Point WIDE m + l of a grid is in lane l of vector m: after the transform of vectors (transform.h), one of WIDE numbers
// over lanes is left, and of KEPT ones at the sampling rate.

#define KEPT 12  // as in render/channel_grid.py, 12 samples of 16 points

// Exchange lanes and vectors: first within blocks of 4 by 4, by two rounds within 128 bits, then the blocks. Devices with vectors
// of 256 bits take one instruction for each of their vectors and round.
#define LOW(x, y) (wide)(x.s0, y.s0, x.s1, y.s1, x.s4, y.s4, x.s5, y.s5, x.s8, y.s8, x.s9, y.s9, x.sc, y.sc, x.sd, y.sd)
#define HIGH(x, y) (wide)(x.s2, y.s2, x.s3, y.s3, x.s6, y.s6, x.s7, y.s7, x.sa, y.sa, x.sb, y.sb, x.se, y.se, x.sf, y.sf)
#define LOW_PAIRS(x, y) (wide)(x.s01, y.s01, x.s45, y.s45, x.s89, y.s89, x.scd, y.scd)
#define HIGH_PAIRS(x, y) (wide)(x.s23, y.s23, x.s67, y.s67, x.sab, y.sab, x.sef, y.sef)
#define BLOCKS_OF(b, i, lanes) (wide)(b[i].lanes, b[i + 4].lanes, b[i + 8].lanes, b[i + 12].lanes)

INLINE void transpose(wide* a)
{
    wide b[WIDE];
#pragma unroll
    for (int i = 0; i < WIDE; i += 4) {
        const wide p = LOW(a[i], a[i + 1]), q = HIGH(a[i], a[i + 1]), r = LOW(a[i + 2], a[i + 3]), s = HIGH(a[i + 2], a[i + 3]);
        b[i] = LOW_PAIRS(p, r), b[i + 1] = HIGH_PAIRS(p, r), b[i + 2] = LOW_PAIRS(q, s), b[i + 3] = HIGH_PAIRS(q, s);
    }
#pragma unroll
    for (int i = 0; i < 4; i++) {
        a[i] = BLOCKS_OF(b, i, s0123), a[i + 4] = BLOCKS_OF(b, i, s4567);
        a[i + 8] = BLOCKS_OF(b, i, s89ab), a[i + 12] = BLOCKS_OF(b, i, scdef);
    }
}

// Turn the numbers of WIDE vectors, each lane by its own angle.
#define TURN_LANES(a, b, turns)                                                                                          \
    _Pragma("unroll") for (int p = 0; p < WIDE; p++)                                                                    \
        TURN(a, b, p, LOAD_WIDE((turns) + 2 * p * WIDE), LOAD_WIDE((turns) + (2 * p + 1) * WIDE))

// Real and imaginary parts of WIDE complex numbers.
#define COMPLEX(from, x, y)                                                   \
    const wide low = LOAD_WIDE(from), high = LOAD_WIDE((from) + WIDE);        \
    const wide x = (wide)(low.even, high.even), y = (wide)(low.odd, high.odd);

typedef struct {
    int count, groups, plane;             // vectors of a grid, groups of WIDE of them, and floats
    __constant int* radix;                // of the passes of transforms, then 0
    __global const float* turns;          // [count - 1][2], of the passes: cosines and sines
    __global const float* lane_turns;     // [vectors of a plane][2][WIDE], of the grid's lanes
    __global const float* back_turns;     // the same, of those at the sampling rate
} transform;

// Transform a grid of real and imaginary parts, and add it times `factors`, [groups][KEPT][WIDE] complex numbers, to a sum
// [groups][KEPT][2][WIDE].
static void __attribute__((noinline)) add_spectrum(const transform* of, __global float* grid, __global const float* factors,
                                                   __global float* sum, int begins)
{
    passes(grid, grid + of->plane, of->count, of->radix, 0, of->turns);
    for (int q = 0; q < of->groups; q++) {
        wide a[WIDE], b[WIDE];
        __global const float* re = grid + q * WIDE * WIDE;
#pragma unroll
        for (int p = 0; p < WIDE; p++) a[p] = LOAD_WIDE(re + p * WIDE), b[p] = LOAD_WIDE(re + of->plane + p * WIDE);
        TURN_LANES(a, b, of->lane_turns + 2 * q * WIDE * WIDE)
        transpose(a);
        transpose(b);
        dft4r(a, b, 4);
#pragma unroll
        for (int j = 0; j < KEPT; j++) {
            const int from = PLACED(j < KEPT / 2 ? j : j + WIDE - KEPT, 4), at = 2 * (q * KEPT + j) * WIDE;
            COMPLEX(factors + at, x, y)
            const wide u = minus(a[from], x, b[from], y), v = plus(a[from], y, b[from], x);
            *(__global loose_wide*)(sum + at) = begins ? u : LOAD_WIDE(sum + at) + u;
            *(__global loose_wide*)(sum + at + WIDE) = begins ? v : LOAD_WIDE(sum + at + WIDE) + v;
        }
    }
}

// Make of a sum times `factors` samples of real and imaginary parts, by way of `grid`: lanes below KEPT of its vectors.
static void __attribute__((noinline)) transform_back(const transform* of, __global const float* sum,
                                                     __global const float* factors, __global float* grid)
{
    for (int q = 0; q < of->groups; q++) {
        wide a[WIDE], b[WIDE], c[WIDE], d[WIDE];
#pragma unroll
        for (int j = 0; j < KEPT; j++) {
            const int at = 2 * (q * KEPT + j) * WIDE;
            COMPLEX(factors + at, x, y)
            a[j] = minus(LOAD_WIDE(sum + at), x, LOAD_WIDE(sum + at + WIDE), y);
            b[j] = plus(LOAD_WIDE(sum + at), y, LOAD_WIDE(sum + at + WIDE), x);
        }
        dft4r(b, a, KEPT / 4);
#pragma unroll
        for (int j = 0; j < WIDE; j++) {
            c[j] = j < KEPT ? a[PLACED(j, KEPT / 4)] : 0.0f;
            d[j] = j < KEPT ? b[PLACED(j, KEPT / 4)] : 0.0f;
        }
        transpose(c);
        transpose(d);
        TURN_LANES(d, c, of->back_turns + 2 * q * WIDE * WIDE)
        __global float* re = grid + q * WIDE * WIDE;
#pragma unroll
        for (int p = 0; p < WIDE; p++) {
            *(__global loose_wide*)(re + p * WIDE) = c[p];
            *(__global loose_wide*)(re + of->plane + p * WIDE) = d[p];
        }
    }
    passes(grid + of->plane, grid, of->count, of->radix, 1, of->turns);
}

// Write `length` samples of a part of a grid from one on, weighted by a window: it and `out` begin WIDE floats before them.
static void weigh(const transform* of, __global const float* part, int first, int length, __global const float* window,
                  __global float* out)
{
    for (int m = first / KEPT; m < of->count && m * KEPT < first + length; m++) {
        const int at = m * KEPT - first + WIDE;
        *(__global loose_wide*)(out + at) = LOAD_WIDE(part + m * WIDE) * LOAD_WIDE(window + at);
    }
}
