// Trajectories as cubics between evenly spaced knots: of the source, and in rooms of walls of receivers too.

typedef struct {
    __global const double* knots;  // [knot][KNOT_COLUMNS]: cubics of the source's position (12) and axes (12 or 24)
    int count;
    double first;                  // time of the first knot, s
    double rate;                   // knots per second
    double slowness;               // 1 / speed of sound
#if WIND
    triple wind;                   // m/s
    double room, inverse_room;     // square of the speed of sound less that of the wind, m^2/s^2
#endif
} trajectory;

static trajectory trajectory_of(__global const double* knots, int count, double first, double rate, double speed_of_sound,
                                const double* wind)
{
    trajectory out = {knots, count, first, rate, 1.0 / speed_of_sound};
#if WIND
    const triple flow = {wind[0], wind[1], wind[2]};
    out.wind = flow;
    out.room = speed_of_sound * speed_of_sound - inner(out.wind, out.wind);
    out.inverse_room = 1.0 / out.room;
#endif
    return out;
}

// Value of cubics at nodes side by side (see `cubic`), and the derivative.
#define COLUMN(i) SIDE_BY_SIDE(c, [i])
static triples cubics(__global const double* const* c, reals u)
{
    const triples out = {COLUMN(0) + u * (COLUMN(3) + u * (COLUMN(6) + u * COLUMN(9))),
                         COLUMN(1) + u * (COLUMN(4) + u * (COLUMN(7) + u * COLUMN(10))),
                         COLUMN(2) + u * (COLUMN(5) + u * (COLUMN(8) + u * COLUMN(11)))};
    return out;
}
static triples cubic_rates(__global const double* const* c, reals u)
{
    const triples out = {COLUMN(3) + u * (2 * COLUMN(6) + u * 3 * COLUMN(9)),
                         COLUMN(4) + u * (2 * COLUMN(7) + u * 3 * COLUMN(10)),
                         COLUMN(5) + u * (2 * COLUMN(8) + u * 3 * COLUMN(11))};
    return out;
}
