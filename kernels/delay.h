// The delay of one path at one node: |x_r(t) - A x_s(t - delay) - b| = c delay, by Newton steps from a predicted delay.
// Seen from the source's own room the receiver stands at A^T (x_r - b).

typedef struct {
    __global const double* knots;  // [knot][KNOT_COLUMNS]: cubics of the source's position (12) and axis (12)
    int count;
    double first;                  // time of the first knot, s
    double rate;                   // knots per second
    double speed_of_sound;
} motion;

typedef struct {
    double delay;       // s
    double rate;        // its derivative by the time of reception
    double mach;        // of the source towards the receiver at emission
    triple departure;   // unit vector in the source's own room
    __global const double* knot;
    double u;           // place of the emission time within the knot
} arrival;

static void locate(const motion* path, double emitted, arrival* a)
{
    const double place = (emitted - path->first) * path->rate;
    const int knot = clamp((int)place, 0, path->count - 1);
    a->knot = path->knots + knot * KNOT_COLUMNS;
    a->u = clamp(place - (double)knot, 0.0, 1.0);
}

static void solve_delay(const motion* path, triple receiver, triple receiver_velocity, double time, double predicted,
                        int steps, arrival* a)
{
    triple apart;
    double delay = predicted, receding;
#if RETARDED
    for (int i = 0; i < steps; i++) {
        locate(path, time - delay, a);
        apart = difference(receiver, cubic(a->knot, a->u));
        const triple velocity = cubic_rate(a->knot, a->u);
        const double distance = sqrt(inner(apart, apart));
        a->mach = path->rate * inner(apart, velocity) / (distance * path->speed_of_sound);
        delay += (distance / path->speed_of_sound - delay) / (1.0 - a->mach);
    }
#endif
    locate(path, RETARDED ? time - delay : time, a);
    apart = difference(receiver, cubic(a->knot, a->u));
    const double inverse = 1.0 / sqrt(inner(apart, apart));
    a->departure.x = apart.x * inverse;
    a->departure.y = apart.y * inverse;
    a->departure.z = apart.z * inverse;
    a->mach = path->rate * inner(a->departure, cubic_rate(a->knot, a->u)) / path->speed_of_sound;
    receding = inner(a->departure, receiver_velocity) / path->speed_of_sound;
#if RETARDED
    a->rate = (receding - a->mach) / (1.0 - a->mach);
    a->delay = delay + (inner(apart, apart) * inverse / path->speed_of_sound - delay) / (1.0 - a->mach);
#else
    a->rate = receding - a->mach;
    a->delay = inner(apart, apart) * inverse / path->speed_of_sound;
#endif
}
