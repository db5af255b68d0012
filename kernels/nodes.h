// How the polynomials of a block and a path are laid out: [block][COEFFICIENTS][slots], lowest power first.

#define COEFFICIENTS (4 + 4 * FUNCTIONS)  // cubics of the delay and of FUNCTIONS gains
