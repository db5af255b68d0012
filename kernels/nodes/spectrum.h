// A path's response at FREQUENCIES frequencies, in PARTS parts: real, and imaginary too where a wall or a directivity has a phase.

#if FREQUENCIES == 1
typedef float bins;  // neighbouring frequencies side by side
#define BIN_VECTORS 1
#define AS_BINS as_float
#define AS_WHOLE as_int
#else
typedef float8 bins;
#define BIN_VECTORS (FREQUENCIES / 8)
#define AS_BINS as_float8
#define AS_WHOLE as_int8
#endif

typedef struct {
    bins part[PARTS][BIN_VECTORS];
} response;

// exp(x) for -80 < x < 80 within 2e-7: 2^whole times a polynomial of the rest (Taylor, degree 7).
static bins exponential(bins x)
{
    const bins y = x * 1.44269504f, shifted = y + ROUNDING;
    const bins f = (y - (shifted - ROUNDING)) * 0.693147181f;
    const bins power = AS_BINS((AS_WHOLE(shifted) - ROUNDING_BITS + 127) << 23);
    return power * (1.0f + f * (1.0f + f * (0.5f + f * (0.166666667f + f * (0.0416666667f + f * (8.33333333e-3f +
                    f * (1.38888889e-3f + f * 1.98412698e-4f)))))));
}

static void multiply(response* r, const response* by)
{
    for (int b = 0; b < BIN_VECTORS; b++) {
#if PARTS == 2
        const bins real = r->part[0][b];
        r->part[0][b] = real * by->part[0][b] - r->part[1][b] * by->part[1][b];
        r->part[1][b] = real * by->part[1][b] + r->part[1][b] * by->part[0][b];
#else
        r->part[0][b] *= by->part[0][b];
#endif
    }
}

#if PARTS == 2
// Turn the phases of neighbouring frequencies by so many turns. Sine and cosine of half of what is left of a turn are
// Taylor's of degree 11 and 12, within 6e-8.
static void turn(response* r, int b, bins turns)
{
    const bins shifted = turns + ROUNDING, f = turns - (shifted - ROUNDING), ff = f * f;
    const bins sine = f * (3.14159265f + ff * (-5.16771278f + ff * (2.55016404f + ff * (-0.599264529f + ff *
                      (0.0821458866f + ff * -7.37043095e-3f)))));
    const bins cosine = 1.0f + ff * (-4.93480220f + ff * (4.05871213f + ff * (-1.33526277f + ff * (0.235330630f + ff *
                        (-0.0258068913f + ff * 1.92957431e-3f)))));
    const bins across = 2.0f * sine * cosine, along = 1.0f - 2.0f * sine * sine, real = r->part[0][b];
    r->part[0][b] = real * along - r->part[1][b] * across;
    r->part[1][b] = real * across + r->part[1][b] * along;
}
#endif

// Sum of the values at eight frequencies, or of one.
static float total(bins x)
{
#if FREQUENCIES == 1
    return x;
#else
    return ((x.s0 + x.s1) + (x.s2 + x.s3)) + ((x.s4 + x.s5) + (x.s6 + x.s7));
#endif
}
