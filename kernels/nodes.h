// How the polynomials of a block and a path are laid out: [block][4 + 4 functions][slots], lowest power first: a cubic
// of the delay, and one of the gain of every function of frequency.

static int coefficients(int functions) { return 4 + 4 * functions; }
