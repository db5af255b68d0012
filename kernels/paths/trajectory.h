// Trajectories as cubics between evenly spaced knots: of the source, and in rooms of walls of receivers too.

typedef struct {
    __global const double* knots;  // [knot][KNOT_COLUMNS]: cubics of the source's position (12) and axes (12 or 24)
    int count;
    double first;                  // time of the first knot, s
    double rate;                   // knots per second
    double slowness;               // 1 / speed of sound
} trajectory;

// Value of the cubics whose coefficients stand at `c` as [power][3].
static triple cubic(__global const double* c, double u)
{
    const triple out = {c[0] + u * (c[3] + u * (c[6] + u * c[9])), c[1] + u * (c[4] + u * (c[7] + u * c[10])),
                        c[2] + u * (c[5] + u * (c[8] + u * c[11]))};
    return out;
}
static triple cubic_rate(__global const double* c, double u)
{
    const triple out = {c[3] + u * (2 * c[6] + u * 3 * c[9]), c[4] + u * (2 * c[7] + u * 3 * c[10]),
                        c[5] + u * (2 * c[8] + u * 3 * c[11])};
    return out;
}
