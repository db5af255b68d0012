// How the polynomials of a block and a path are laid out, lowest power first: one of the delay with DELAY_TERMS terms,
// and cubics of the gains of all functions of frequency, the terms of equal power side by side. Where neighbouring paths
// are expanded together they are [block][slots / BESIDE][terms][BESIDE]: a vector of paths reads them side by side, and
// a path's own lie near each other when they are written. Where one path is at a time, because signals pause (SPARSE), BESIDE
// is 1; for envelopes (DELAY_TERMS == 8) it is that of the widest vectors.

#if DELAY_TERMS == 8
#define BESIDE 16
#elif SPARSE
#define BESIDE 1
#else
#define BESIDE 8
#endif

static int terms(int functions) { return DELAY_TERMS + 4 * functions; }

// Where the polynomials of a block and a path begin; their terms are BESIDE from each other.
static long place_of(int block, int slot, int functions, int slots)
{
    return (block * (long)slots + slot / BESIDE * BESIDE) * terms(functions) + slot % BESIDE;
}

// Value at t in [-1, 1] of a cubic with coefficients a to d, its derivative, and half of its second one. So written that
// there is one way only to fuse products with sums: vectors and single numbers give the same to the last bit.
#define CUBIC(a, b, c, d, t) ((a) + (t) * ((b) + (t) * ((c) + (t) * (d))))
#define CUBIC_SLOPE(b, c, d, t) ((b) + (t) * (((c) + (c)) + (t) * (3.0f * (d))))
#define CUBIC_CURVE(c, d, t) ((c) + (t) * (3.0f * (d)))
