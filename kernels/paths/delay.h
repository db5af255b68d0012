// Delays of NODES_AT_ONCE nodes side by side: |x_r(t) - A x_s(t - delay) - b| = c delay, by Newton steps from predicted
// delays. Seen from the source's own room the receiver stands at A^T (x_r - b).

// In wind |x_r(t) - x_s(t - delay) - w delay| = c delay, with the length of the path in place of the distance of its ends:
// see `UniformAir` in paths/propagation.py.

// Comparisons instead of clamp() and min(): some runtimes call, rather than inline, built-in functions.

// Where the receiver stands as seen from the source's own room.
typedef struct {
    triples position, velocity;
#if WIND
    triples wind;    // as seen there
    reals downwind;  // component along the wind of its place in the room, times the wind, m^2/s
#endif
} listener;

typedef struct {
    reals delay;        // s
    reals rate;         // its derivative by the time of reception
    reals mach_factor;  // 1 / (1 - Mach number of the source towards the receiver at emission)
    triples departure;  // unit vector in the source's own room
#if WIND
    triples arrival;    // the same at the receiver, as seen there
    reals length;       // m, over which pressure falls
#endif
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

static triples unit(triples v)
{
    const reals inverse = inverse_root(DOT(v, v));
    const triples out = {v.x * inverse, v.y * inverse, v.z * inverse};
    return out;
}

// One Newton step from `a->delay`; returns it. All else is that of the emission time before the step.
static inline __attribute__((always_inline)) reals newton_step(const trajectory* path, const listener* receiver, reals time, arrivals* a)
{
    locate(path, RETARDED ? time - a->delay : time, a);
    const triples from = cubics(a->knot, a->u), velocity = cubic_rates(a->knot, a->u);
    const triples apart = {receiver->position.x - from.x, receiver->position.y - from.y, receiver->position.z - from.z};
    const reals exact = DOT(apart, apart), squared = exact > NEAREST * NEAREST ? exact : (reals)(NEAREST * NEAREST);
    const reals inverse = inverse_root(squared);
    const triples direction = {apart.x * inverse, apart.y * inverse, apart.z * inverse};
#if WIND
    const reals along = receiver->downwind - DOT(path->wind, from);
    const reals root_squared = along * along + path->room * squared, inverse_of_root = inverse_root(root_squared);
    const reals quasi_static = (root_squared * inverse_of_root - along) * path->inverse_room;
    // What the time grows by with the length, and with the wind's share of the way: slownesses at both ends.
    const reals slowness = squared * inverse * inverse_of_root, carried = (along * inverse_of_root - 1.0) * path->inverse_room;
    const triples leaving = {slowness * direction.x + carried * path->wind.x, slowness * direction.y + carried * path->wind.y,
                             slowness * direction.z + carried * path->wind.z};
    const triples coming = {slowness * direction.x + carried * receiver->wind.x, slowness * direction.y + carried * receiver->wind.y,
                            slowness * direction.z + carried * receiver->wind.z};
    const reals mach = path->rate * DOT(leaving, velocity);
    const reals receding = STATIC_RECEIVERS ? (reals)0.0 : DOT(coming, receiver->velocity);
    a->departure = unit(leaving);
    a->arrival = unit(coming);
    a->length = DOT(a->departure, apart);
#else
    const reals mach = path->rate * path->slowness * DOT(direction, velocity);
    const reals receding = STATIC_RECEIVERS ? (reals)0.0 : path->slowness * DOT(direction, receiver->velocity);
    const reals quasi_static = squared * inverse * path->slowness;
    a->departure = direction;
#endif
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

static void choose(choices open, triples other, triples* kept)
{
    kept->x = open ? other.x : kept->x;
    kept->y = open ? other.y : kept->y;
    kept->z = open ? other.z : kept->z;
}

// The same, called, where it is taken again and again; the first step, which is mostly enough, is faster when it is not.
static __attribute__((noinline)) reals another_step(const trajectory* path, const listener* receiver, reals time, arrivals* a)
{
    return newton_step(path, receiver, time, a);
}

// Newton steps until, at each node, one whose square, of the order of the next one, is as small as asked, s^2. What a node
// comes to does not depend on those beside it.
static void solve_delay(const trajectory* path, const listener* receiver, reals time, double small, arrivals* a)
{
    reals step = newton_step(path, receiver, time, a);
    for (int k = 1; k < 40; k++) {
        const choices open = step * step >= small;
        if (!ANY(open)) break;
        arrivals next = *a;
        const reals another = another_step(path, receiver, time, &next);
        step = open ? another : step;
        a->delay = open ? next.delay : a->delay;
        a->rate = open ? next.rate : a->rate;
        a->mach_factor = open ? next.mach_factor : a->mach_factor;
        choose(open, next.departure, &a->departure);
#if WIND
        choose(open, next.arrival, &a->arrival);
        a->length = open ? next.length : a->length;
#endif
        a->u = open ? next.u : a->u;
#pragma unroll
        for (int i = 0; i < NODES_AT_ONCE; i++) a->knot[i] = OF_NODE_LONG(open, i) ? next.knot[i] : a->knot[i];
    }
}
