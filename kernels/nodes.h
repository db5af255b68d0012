// How the polynomials of a block and a path are laid out: [block][DELAY_TERMS + 4 functions][slots], lowest power first:
// a polynomial of the delay, and a cubic of the gain of every function of frequency.

#ifndef DELAY_TERMS
#define DELAY_TERMS 4
#endif

static int coefficients(int functions) { return DELAY_TERMS + 4 * functions; }
