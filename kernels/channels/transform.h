// Fourier transforms of vectors in place, WIDE side by side, real and imaginary parts apart. What is left is in the order of
// `digit_reversed` in render/channel_grid.py, and so inverse transforms begin. These are forward ones with real and imaginary
// parts exchanged, and with their passes in the opposite order.

#define WIDE 16
typedef float16 wide;
typedef float16 __attribute__((aligned(4))) loose_wide;  // may start at any float
#define LOAD_WIDE(pointer) (*(__global const loose_wide*)(pointer))
#define INLINE static __attribute__((always_inline))

// Sums and differences of products; vectors as arguments let compilers use registers as wide as these.
static wide plus(wide x, wide c, wide y, wide s) { return x * c + y * s; }
static wide minus(wide x, wide c, wide y, wide s) { return x * c - y * s; }

// Turn number i back by the angle of a cosine and a sine.
#define TURN(a, b, i, c, s)                                \
    {                                                      \
        const wide x = a[i], y = b[i];                      \
        a[i] = plus(x, c, y, s), b[i] = minus(y, c, x, s); \
    }

// Transforms of R numbers from number i on.
INLINE void dft2(wide* a, wide* b, int i, int step)
{
    const wide x = a[i + step], y = b[i + step];
    a[i + step] = a[i] - x, b[i + step] = b[i] - y;
    a[i] += x, b[i] += y;
}

INLINE void dft3(wide* a, wide* b, int i, int step)
{
    const int j = i + step, k = j + step;
    const wide x = a[j] + a[k], y = b[j] + b[k], s = 0.866025404f * (a[j] - a[k]), u = 0.866025404f * (b[j] - b[k]);
    const wide p = a[i] - 0.5f * x, q = b[i] - 0.5f * y;
    a[i] += x, b[i] += y;
    a[j] = p + u, b[j] = q - s;
    a[k] = p - u, b[k] = q + s;
}

INLINE void dft4(wide* a, wide* b, int i, int step)
{
    const int j = i + step, k = j + step, l = k + step;
    const wide p = a[i] + a[k], q = b[i] + b[k], r = a[i] - a[k], s = b[i] - b[k];
    const wide t = a[j] + a[l], u = b[j] + b[l], v = a[j] - a[l], w = b[j] - b[l];
    a[i] = p + t, b[i] = q + u;
    a[j] = r + w, b[j] = s - v;
    a[k] = p - t, b[k] = q - u;
    a[l] = r - w, b[l] = s + v;
}

INLINE void dft5(wide* a, wide* b)
{
    const float c = 0.309016994f, d = -0.809016994f, s = 0.951056516f, u = 0.587785252f;
    const wide p = a[1] + a[4], q = b[1] + b[4], r = a[2] + a[3], t = b[2] + b[3];
    const wide v = a[1] - a[4], w = b[1] - b[4], x = a[2] - a[3], y = b[2] - b[3];
    const wide e = a[0] + c * p + d * r, f = b[0] + c * q + d * t, g = a[0] + d * p + c * r, h = b[0] + d * q + c * t;
    const wide k = s * v + u * x, l = s * w + u * y, m = u * v - s * x, n = u * w - s * y;
    a[0] += p + r, b[0] += q + t;
    a[1] = e + l, b[1] = f - k;
    a[2] = g + n, b[2] = h - m;
    a[3] = g - n, b[3] = h + m;
    a[4] = e - l, b[4] = f + k;
}

// Cosines and sines of 12ths and 16ths of a turn.
__constant float cosines[2][10] = {{1.0f, 0.866025404f, 0.5f, 0.0f, -0.5f, -0.866025404f, -1.0f},
    {1.0f, 0.923879533f, 0.707106781f, 0.382683432f, 0.0f, -0.382683432f, -0.707106781f, -0.923879533f, -1.0f, -0.923879533f}};
__constant float sines[2][10] = {{0.0f, 0.5f, 0.866025404f, 1.0f, 0.866025404f, 0.5f, 0.0f},
    {0.0f, 0.382683432f, 0.707106781f, 0.923879533f, 1.0f, 0.923879533f, 0.707106781f, 0.382683432f, 0.0f, -0.382683432f}};

// Transform of 4 R numbers, R from 2 to 4. Number k is left at PLACED(k, R).
#define PLACED(k, R) ((R) * ((k) % 4) + (k) / 4)
INLINE void dft4r(wide* a, wide* b, const int R)
{
#pragma unroll
    for (int i = 0; i < R; i++) dft4(a, b, i, R);
#pragma unroll
    for (int c = 0; c < 4; c++) {
#pragma unroll
        for (int i = 1; c && i < R; i++) {
            const int turn = R == 2 ? 2 * c * i : c * i;
            TURN(a, b, R * c + i, cosines[R != 3][turn], sines[R != 3][turn])
        }
        if (R == 2) dft2(a, b, R * c, 1);
        else if (R == 3) dft3(a, b, R * c, 1);
        else dft4(a, b, R * c, 1);
    }
}

// One pass over `count` vectors, in blocks of `length`, each of R parts, whose numbers are turned by `turns`.
INLINE void pass(__global float* re, __global float* im, int count, int length, const int R, int inverse,
                 __global const float* turns)
{
    const int step = length / R;
    for (int i = 0; i < step; i++, turns += 2 * (R - 1)) {
        for (int at = i; at < count; at += length) {
            wide a[16], b[16];
#pragma unroll
            for (int k = 0; k < R; k++) {
                a[k] = LOAD_WIDE(re + (at + k * step) * WIDE), b[k] = LOAD_WIDE(im + (at + k * step) * WIDE);
                if (inverse && k) TURN(a, b, k, turns[2 * k - 2], turns[2 * k - 1])
            }
            if (R == 2) dft2(a, b, 0, 1);
            else if (R == 3) dft3(a, b, 0, 1);
            else if (R == 4) dft4(a, b, 0, 1);
            else if (R == 5) dft5(a, b);
            else dft4r(a, b, R / 4);
#pragma unroll
            for (int k = 0; k < R; k++) {
                const int from = R > 5 ? PLACED(k, R / 4) : k;
                if (!inverse && k) TURN(a, b, from, turns[2 * k - 2], turns[2 * k - 1])
                *(__global loose_wide*)(re + (at + k * step) * WIDE) = a[from];
                *(__global loose_wide*)(im + (at + k * step) * WIDE) = b[from];
            }
        }
    }
}

// All passes of a transform of `count` vectors: their numbers of parts are those of `radix`, then a 0.
static void passes(__global float* re, __global float* im, int count, __constant int* radix, int inverse,
                   __global const float* turns)
{
    int at = 0, length = count;
    for (; inverse && radix[at]; at++) length /= radix[at];
    while (inverse ? at > 0 : radix[at]) {
        const int parts = radix[inverse ? --at : at++];
        if (inverse) length *= parts;
        __global const float* own = turns + 2 * (count - length);
        switch (parts) {
        case 2: pass(re, im, count, length, 2, inverse, own); break;
        case 3: pass(re, im, count, length, 3, inverse, own); break;
        case 4: pass(re, im, count, length, 4, inverse, own); break;
        case 5: pass(re, im, count, length, 5, inverse, own); break;
        case 8: pass(re, im, count, length, 8, inverse, own); break;
        default: pass(re, im, count, length, 12, inverse, own);
        }
        if (!inverse) length /= parts;
    }
}
