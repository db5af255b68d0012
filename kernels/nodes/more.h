// What is found of nodes besides delays, by the kind of paths: where it begins, not knowing more, and what is told of it at the
// ends of walks, MORE numbers.

#if SCATTERERS
typedef scattering found_more;
static void begin_more(triples ear, found_more* b)
{
    b->late = 0.0;
    b->weight = 1.0;
}
static void tell_more(const found_more* b, int node, __global double* told, int slots)
{
    const double numbers[MORE] = {OF_NODE(b->late, node), OF_NODE(b->late_rate, node), OF_NODE(b->weight, node),
                                  OF_NODE(b->glint.x, node), OF_NODE(b->glint.y, node), OF_NODE(b->glint.z, node)};
    for (int i = 0; i < MORE; i++) told[i * (long)slots] = numbers[i];
}
#define SOLVE_ANEW(path, poses, seen, receiver, time, small, a, b) \
    solve_scattered(path, poses, seen, receiver, time, small, UNKNOWN, a, b)
#elif BODIES
typedef mirrored found_more;
static void begin_more(triples ear, found_more* b)
{
    for (int k = 0; k < BODIES; k++) {
        b->about.time[k] = 0.0;
        b->about.place[k] = ear;
    }
}
static void tell_more(const found_more* b, int node, __global double* told, int slots)
{
    for (int k = 0; k < BODIES; k++, told += 4 * (long)slots) {
        const triples* place = b->about.place + k;
        const double numbers[4] = {OF_NODE(b->about.time[k], node), OF_NODE(place->x, node), OF_NODE(place->y, node),
                                   OF_NODE(place->z, node)};
        for (int i = 0; i < 4; i++) told[i * (long)slots] = numbers[i];
    }
}
#endif
#if !SCATTERERS
#define SOLVE_ANEW SOLVE_DELAY
#endif
