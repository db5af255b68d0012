// How the polynomials of a block and a path are laid out, lowest power first: a polynomial of the delay, and a cubic of
// the gain of every function of frequency. Of sound they are [block][4 + 4 functions][slots], for neighbouring paths are
// expanded together; of envelopes (DELAY_TERMS == 8) [block][slots][8 + 4 functions], for one path is at a time.

#ifndef DELAY_TERMS
#define DELAY_TERMS 4
#endif

static int coefficients(int functions) { return DELAY_TERMS + 4 * functions; }

#if DELAY_TERMS == 8
#define APART(slots) 1
#else
#define APART(slots) (slots)
#endif

// Where the polynomials of a block and a path begin; their terms are APART(slots) from each other.
static long place_of(int block, int slot, int functions, int slots)
{
#if DELAY_TERMS == 8
    return ((long)block * slots + slot) * coefficients(functions);
#else
    return (long)block * coefficients(functions) * slots + slot;
#endif
}
