// Paths over an edge (VERTEX == EDGE): both ends as the edge sees them, and delays. Rolled out, the shortest path over an edge is
// straight, and the change of the place where it meets the edge does not change its length: twin of
// paths/vertices/edge_field.py.

#if VERTEX == EDGE
// One Newton step from `a->delay`, as newton_step of delay.h; directions are not computed.
static reals edge_step(const trajectory* path, __global const edge_view* edge, const listener* receiver, reals time, arrivals* a)
{
    locate(path, RETARDED ? time - a->delay : time, a);
    const triples from = seen_at(edge->source_turn, edge->source_shift, cubics(a->knot, a->u)), to = receiver->position;
    const triples velocity = turned(edge->source_turn, cubic_rates(a->knot, a->u));
    const reals least = (reals)(ON_LINE * ON_LINE);  // see `off_line`
    const reals s2 = fmax(from.x * from.x + from.y * from.y, least), r2 = fmax(to.x * to.x + to.y * to.y, least);
    const reals s = inverse_root(s2), r = inverse_root(r2);  // of the distances from the edge
    reals length, inward, outward, rising, leaving;  // what of the path goes off the edge or towards it, and along it
    if (edge->end_side) {
        const reals up = edge->end - from.z, on = to.z - edge->end, first = s2 + up * up, second = r2 + on * on;
        const reals near = inverse_root(first), far = inverse_root(second);
        length = first * near + second * far;
        inward = s2 * s * near, rising = up * near;
        outward = r2 * r * far, leaving = on * far;
    } else {
        const reals across = s2 * s + r2 * r, along = to.z - from.z, squared = across * across + along * along;
        const reals inverse = inverse_root(squared);
        length = squared * inverse;
        inward = outward = across * inverse, rising = leaving = along * inverse;
    }
    const reals mach = path->rate * path->slowness *
                       (rising * velocity.z - inward * s * (from.x * velocity.x + from.y * velocity.y));
    const triples heading = receiver->velocity;
    const reals receding = STATIC_RECEIVERS ? (reals)0.0
                                            : path->slowness * (leaving * heading.z + outward * r * (to.x * heading.x + to.y * heading.y));
#if RETARDED
    a->mach_factor = 1.0 / (1.0 - mach);
    a->rate = (receding - mach) * a->mach_factor;
    const reals step = (length * path->slowness - a->delay) * a->mach_factor;
    a->delay += step;
    return step;
#else
    a->mach_factor = 1.0;
    a->rate = receding - mach;
    a->delay = length * path->slowness;
    return 0.0;
#endif
}

// As solve_delay of delay.h.
static void solve_edge_delay(const trajectory* path, __global const edge_view* edge, const listener* receiver, reals time,
                             double small, arrivals* a)
{
    reals step = edge_step(path, edge, receiver, time, a);
    for (int k = 1; k < 40; k++) {
        const choices open = step * step >= small;
        if (!ANY(open)) break;
        arrivals next;
        next.delay = a->delay;
        const reals another = edge_step(path, edge, receiver, time, &next);
        step = open ? another : step;
        a->delay = open ? next.delay : a->delay;
        a->rate = open ? next.rate : a->rate;
        a->mach_factor = open ? next.mach_factor : a->mach_factor;
        a->u = open ? next.u : a->u;
#pragma unroll
        for (int i = 0; i < NODES_AT_ONCE; i++) a->knot[i] = OF_NODE_LONG(open, i) ? next.knot[i] : a->knot[i];
    }
}
#define SOLVE_DELAY(path, poses, edge, receiver, time, small, a, b) solve_edge_delay(path, edge, receiver, time, small, a)
#define SOLVE_ANEW SOLVE_DELAY
#endif
