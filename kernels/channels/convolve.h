// Responses over a grid times spectra, and back at the sampling rate: grids are transformed and cut to KEPT of WIDE parts of their
// spectra. Point WIDE m + l of a grid is in lane l of vector m: after the transform of vectors (transform.h), one of WIDE numbers
// over lanes is left, and of KEPT ones at the sampling rate.

#define KEPT 12  // as in render/channel_grid.py, 12 samples of 16 points

// Two vectors of which the elements of a and b alternate: four rounds of this exchange lanes and vectors.
#define MIX(a, i, j, x, y)                                                                                               \
    const wide x = (wide)(a[i].s0, a[j].s0, a[i].s1, a[j].s1, a[i].s2, a[j].s2, a[i].s3, a[j].s3, a[i].s4, a[j].s4,        \
                        a[i].s5, a[j].s5, a[i].s6, a[j].s6, a[i].s7, a[j].s7),                                           \
              y = (wide)(a[i].s8, a[j].s8, a[i].s9, a[j].s9, a[i].sa, a[j].sa, a[i].sb, a[j].sb, a[i].sc, a[j].sc,        \
                        a[i].sd, a[j].sd, a[i].se, a[j].se, a[i].sf, a[j].sf);

INLINE void mix(const wide* from, wide* to)
{
#pragma unroll
    for (int i = 0; i < WIDE / 2; i++) {
        MIX(from, i, i + WIDE / 2, low, high)
        to[2 * i] = low, to[2 * i + 1] = high;
    }
}

INLINE void transpose(wide* a)
{
    wide b[WIDE];
    mix(a, b);
    mix(b, a);
    mix(a, b);
    mix(b, a);
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
