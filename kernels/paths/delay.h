// Delays of NODES_AT_ONCE nodes side by side: |x_r(t) - A x_s(t - delay) - b| = c delay, by Newton steps from predicted
// delays. Seen from the source's own room the receiver stands at A^T (x_r - b).

// Comparisons instead of clamp() and min(): some runtimes call, rather than inline, built-in functions.

typedef struct {
    reals delay;        // s
    reals rate;         // its derivative by the time of reception
    reals mach_factor;  // 1 / (1 - Mach number of the source towards the receiver at emission)
    triples departure;  // unit vector in the source's own room
    __global const double* knot[NODES_AT_ONCE];
    reals u;            // place of the emission time within the knot
} arrivals;

static void locate(const trajectory* path, reals emitted, arrivals* a)
{
    const reals place = (emitted - path->first) * path->rate;
    double whole[NODES_AT_ONCE];
#pragma unroll
    for (int i = 0; i < NODES_AT_ONCE; i++) {
        int knot = (int)OF_NODE(place, i);
        knot = knot < 0 ? 0 : knot;
        knot = knot < path->count ? knot : path->count - 1;
        whole[i] = (double)knot;
        a->knot[i] = path->knots + (long)knot * KNOT_COLUMNS;
    }
    const reals u = place - SIDE_BY_SIDE(whole, );
    a->u = u < 0.0 ? (reals)0.0 : u < 1.0 ? u : (reals)1.0;
}

#define CONVERGED 1e-14  // s^2, of a Newton step: the next one, of the order of its square, is of no use

// One Newton step from `a->delay`; returns it. All else is that of the emission time before the step.
static reals newton_step(const trajectory* path, triples receiver, triples receiver_velocity, reals time, arrivals* a)
{
    locate(path, RETARDED ? time - a->delay : time, a);
    const triples from = cubics(a->knot, a->u), velocity = cubic_rates(a->knot, a->u);
    const triples apart = {receiver.x - from.x, receiver.y - from.y, receiver.z - from.z};
    const reals squared = DOT(apart, apart), inverse = inverse_root(squared);
    const triples departure = {apart.x * inverse, apart.y * inverse, apart.z * inverse};
    const reals mach = path->rate * path->slowness * DOT(departure, velocity);
    const reals receding = STATIC_RECEIVERS ? (reals)0.0 : path->slowness * DOT(departure, receiver_velocity);
    const reals quasi_static = squared * inverse * path->slowness;
    a->departure = departure;
#if RETARDED
    a->mach_factor = 1.0 / (1.0 - mach);
    a->rate = (receding - mach) * a->mach_factor;
    const reals step = (quasi_static - a->delay) * a->mach_factor;
    a->delay += step;
    return step;
#else
    a->mach_factor = 1.0;
    a->rate = receding - mach;
    a->delay = quasi_static;
    return 0.0;
#endif
}

// Newton steps until, at each node, one whose square, of the order of the next one, is as small as asked, s^2. What a node
// comes to does not depend on those beside it.
static void solve_delay(const trajectory* path, triples receiver, triples receiver_velocity, reals time, double small, arrivals* a)
{
    reals step = newton_step(path, receiver, receiver_velocity, time, a);
    for (int k = 1; k < 40; k++) {
        const choices open = step * step >= small;
        if (!ANY(open)) break;
        arrivals next = *a;
        const reals another = newton_step(path, receiver, receiver_velocity, time, &next);
        step = open ? another : step;
        a->delay = open ? next.delay : a->delay;
        a->rate = open ? next.rate : a->rate;
        a->mach_factor = open ? next.mach_factor : a->mach_factor;
        a->departure.x = open ? next.departure.x : a->departure.x;
        a->departure.y = open ? next.departure.y : a->departure.y;
        a->departure.z = open ? next.departure.z : a->departure.z;
        a->u = open ? next.u : a->u;
#pragma unroll
        for (int i = 0; i < NODES_AT_ONCE; i++) a->knot[i] = OF_NODE_LONG(open, i) ? next.knot[i] : a->knot[i];
    }
}
