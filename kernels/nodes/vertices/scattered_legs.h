// Ways by a scatterer: the delay equation of each leg, the later one first, together with the specular point. Twin of
// paths/vertices/scatterer_paths.py.

#if VERTEX == SCATTERER
#define ROUNDS 60

// How sound passes a leg: time, s, and by how much it grows with the length and with the wind's share of the leg.
typedef struct {
    reals time, slowness, carried;
} passage;

static passage passing(const trajectory* path, reals squared, reals inverse, reals downwind)
{
    passage out;
#if WIND
    const reals root_squared = downwind * downwind + path->room * squared, inverse_of_root = inverse_root(root_squared);
    out.time = (root_squared * inverse_of_root - downwind) * path->inverse_room;
    out.slowness = squared * inverse * inverse_of_root;
    out.carried = (downwind * inverse_of_root - 1.0) * path->inverse_room;
#else
    out.time = squared * inverse * path->slowness;
    out.slowness = path->slowness;
    out.carried = 0.0;
#endif
    return out;
}

// One Newton step from `a->delay` and what is known in `b`; returns at which nodes another one is of use.
static choices scattered_step(const trajectory* path, const pose_table* poses, __global const view* seen, const listener* receiver,
                              reals time, double small, int first, arrivals* a, scatterer_state* b)
{
    const reals early = a->delay - b->onward, event = RETARDED ? time - b->onward : time;
    b->event = event;
    locate(path, RETARDED ? event - early : time, a);
    const triples at = cubics(a->knot, a->u), rates = cubic_rates(a->knot, a->u), speed = scaled((reals)path->rate, rates);
    const triples from = seen_at(seen->source_turn, seen->source_shift, at);
    const pose p = pose_at(poses, seen->thing, seen->turned, event);
    triples place = p.place, velocity = p.velocity;
    if (seen->shape == POINT) {
        const triples none = {0.0, 0.0, 0.0};
        b->specular = b->source = b->receiver = none;
        b->change = 0.0;
        b->hidden = (choices)0;
    } else {
#if WIND
        const triples start = first > KNOWN ? from : b->start, stop = first > KNOWN ? receiver->position : b->stop;
#else
        const triples start = from, stop = receiver->position;
#endif
        locate_specular(seen, &p, start, stop, first, &place, &velocity, b);
    }
    const triples there = apart(place, from), back = apart(receiver->position, place);
    const reals squared1 = DOT(there, there), inverse1 = inverse_root(squared1);
    const reals squared2 = DOT(back, back), inverse2 = inverse_root(squared2);
    const triples direction1 = scaled(inverse1, there), direction2 = scaled(inverse2, back);
    const triples heading = turned(seen->source_turn, speed);
#if WIND
    const reals downwind1 = DOT(path->wind, place) - DOT(path->wind, at), downwind2 = receiver->downwind - DOT(path->wind, place);
    const passage to = passing(path, squared1, inverse1, downwind1), on = passing(path, squared2, inverse2, downwind2);
    const reals carried = DOT(path->wind, velocity), carried_source = to.carried * DOT(path->wind, speed);
    const reals carried_receiver = on.carried * DOT(receiver->wind, receiver->velocity);
    const triples wind = {path->wind.x, path->wind.y, path->wind.z}, blown = turned(seen->source_turn, wind);
    const triples leaving1 = of_length_one(plus(scaled(to.slowness, direction1), scaled(to.carried, blown)));
    const triples coming2 = of_length_one(plus(scaled(on.slowness, direction2), scaled(on.carried, receiver->wind)));
    // Seen through the air that moves, ends are where their wavefronts come from.
    const triples ray1 = plus(scaled(to.slowness, direction1), scaled(to.carried, wind));
    const triples ray2 = plus(scaled(on.slowness, direction2), scaled(on.carried, wind));
    const reals slow1 = root(DOT(ray1, ray1)), slow2 = root(DOT(ray2, ray2)), faster = slow2 / slow1;
    b->start = apart(place, scaled(to.time / (path->slowness * slow1), ray1));
    b->stop = plus(place, scaled(on.time / (path->slowness * slow2), ray2));
#else
    const passage to = passing(path, squared1, inverse1, 0.0), on = passing(path, squared2, inverse2, 0.0);
    const reals carried = 0.0, carried_source = 0.0, carried_receiver = 0.0;
    const triples leaving1 = direction1, coming2 = direction2;
    const reals faster = 1.0;
#endif
    const reals coming = to.slowness * DOT(direction1, velocity) + to.carried * carried;
    const reals leaving = on.slowness * DOT(direction2, velocity) + on.carried * carried;
    const reals mach = to.slowness * DOT(direction1, heading) + carried_source;
    const reals receding = STATIC_RECEIVERS ? (reals)0.0 : on.slowness * DOT(direction2, receiver->velocity) + carried_receiver;
    a->departure = turned_back(seen->source_turn, 1, 0, leaving1);
    b->arrival = turned_back(seen->receiver_turn, 1, 0, coming2);
    b->spread = squared1 * inverse1 * DOT(leaving1, direction1) * squared2 * inverse2 * DOT(coming2, direction2);
    b->leaving = leaving;
    if (seen->modes > 0) {  // as strong as a mirror: behind it as what it takes away
        b->leaving = (leaving - coming) / (1.0 - coming);
        b->spread = to.time / path->slowness * squared2 * inverse2 * DOT(coming2, direction2);
    }
    const choices unsettled = WIND && first > KNOWN && seen->shape != POINT ? b->weight == b->weight : b->change > SETTLED;
#if RETARDED
    const reals later = (on.time - b->onward) / (1.0 - leaving);
    const reals more = (to.time - early + later * (mach - coming)) / (1.0 - mach);
    b->weight = (1.0 - coming) / (1.0 - leaving) * faster;
    b->onward += later;
    b->onward_rate = (receding - leaving) / (1.0 - leaving);
    a->delay = b->onward + early + more;
    a->mach_factor = 1.0 / (1.0 - mach);
    a->rate = (receding * (1.0 - coming) + coming - mach - leaving * (1.0 - mach)) * a->mach_factor / (1.0 - leaving);
    return later * later >= small | more * more >= small | unsettled;
#else
    b->weight = faster;
    b->onward = on.time;
    b->onward_rate = receding - leaving;
    a->delay = to.time + on.time;
    a->mach_factor = 1.0;
    a->rate = receding - leaving + coming - mach;
    return unsettled;
#endif
}

// As solve_delay of delay.h; NO_WAY where none is found.
static void solve_scattered(const trajectory* path, const pose_table* poses, __global const view* seen, const listener* receiver,
                            reals time, double small, int first, arrivals* a, scatterer_state* b)
{
    choices open = scattered_step(path, poses, seen, receiver, time, small, first, a, b);
    for (int k = 1; k < ROUNDS && ANY(open); k++) {
        arrivals next = *a;
        scatterer_state met = *b;
        const choices still = scattered_step(path, poses, seen, receiver, time, small, k < PATIENCE ? KNOWN : LASTING, &next, &met);
        keep(open, &next, &met, a, b);
        open &= still;
    }
    a->delay = open ? (reals)NO_PATH : a->delay;
}
#define SOLVE_DELAY(path, poses, seen, receiver, time, small, a, b) \
    solve_scattered(path, poses, seen, receiver, time, small, PREDICTED, a, b)
#define SOLVE_ANEW(path, poses, seen, receiver, time, small, a, b) \
    solve_scattered(path, poses, seen, receiver, time, small, UNKNOWN, a, b)

typedef scatterer_state path_state;
static void begin_state(triples ear, path_state* b)
{
    b->onward = 0.0;
    b->weight = 1.0;
}
static void write_state(const path_state* b, int node, __global double* told, int slots)
{
    const double numbers[STATE_NUMBERS] = {OF_NODE(b->onward, node), OF_NODE(b->onward_rate, node), OF_NODE(b->weight, node),
                                  OF_NODE(b->specular.x, node), OF_NODE(b->specular.y, node), OF_NODE(b->specular.z, node)};
    for (int i = 0; i < STATE_NUMBERS; i++) told[i * (long)slots] = numbers[i];
}
#endif
