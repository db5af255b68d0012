// The delay of one path at one node: |x_r(t) - A x_s(t - delay) - b| = c delay, by Newton steps from a predicted delay.
// Seen from the source's own room the receiver stands at A^T (x_r - b).

// Comparisons instead of clamp() and min(): some runtimes call, rather than inline, built-in functions.

typedef struct {
    double delay;       // s
    double rate;        // its derivative by the time of reception
    double mach_factor;  // 1 / (1 - Mach number of the source towards the receiver at emission)
    triple departure;   // unit vector in the source's own room
    __global const double* knot;
    double u;           // place of the emission time within the knot
} arrival;

static void locate(const trajectory* path, double emitted, arrival* a)
{
    const double place = (emitted - path->first) * path->rate;
    int knot = (int)place;
    knot = knot < 0 ? 0 : knot;
    knot = knot < path->count ? knot : path->count - 1;
    const double u = place - (double)knot;
    a->knot = path->knots + knot * KNOT_COLUMNS;
    a->u = u < 0.0 ? 0.0 : u < 1.0 ? u : 1.0;
}

#define CONVERGED 1e-14  // s^2, of a Newton step: the next one, of the order of its square, is of no use

// One Newton step from `a->delay`; returns it. All else is that of the emission time before the step.
static double newton_step(const trajectory* path, triple receiver, triple receiver_velocity, double time, arrival* a)
{
    locate(path, RETARDED ? time - a->delay : time, a);
    const triple apart = difference(receiver, cubic(a->knot, a->u));
    const double squared = inner(apart, apart), inverse = 1.0 / sqrt(squared);
    const triple departure = {apart.x * inverse, apart.y * inverse, apart.z * inverse};
    const double mach = path->rate * path->slowness * inner(departure, cubic_rate(a->knot, a->u));
    const double receding = STATIC_RECEIVERS ? 0.0 : path->slowness * inner(departure, receiver_velocity);
    const double quasi_static = squared * inverse * path->slowness;
    a->departure = departure;
#if RETARDED
    a->mach_factor = 1.0 / (1.0 - mach);
    a->rate = (receding - mach) * a->mach_factor;
    const double step = (quasi_static - a->delay) * a->mach_factor;
    a->delay += step;
    return step;
#else
    a->mach_factor = 1.0;
    a->rate = receding - mach;
    a->delay = quasi_static;
    return 0.0;
#endif
}

// From anywhere: Newton steps until one whose square, of the order of the next one, is as small as asked, s^2.
static void solve_delay(const trajectory* path, triple receiver, triple receiver_velocity, double time, double small, arrival* a)
{
    a->delay = 0.0;
    for (int i = 0; i < 40; i++) {
        const double step = newton_step(path, receiver, receiver_velocity, time, a);
        if (step * step < small) break;
    }
}
