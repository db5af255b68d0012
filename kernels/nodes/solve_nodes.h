// Nodes of one path: the receiver as the path sees it, and the delay, GROUP neighbours at a time.

#define GROUP 4
#define AT_ONCE (GROUP / NODES_AT_ONCE)
#define PART(i) ((i) / NODES_AT_ONCE)  // of the group, in which its i-th node is
#define BESIDE_IT(i) ((i) % NODES_AT_ONCE)

// All that the nodes of a path over a walk are solved from, and those that were solved last.
typedef struct {
    const trajectory* path;
    __global const double* image_matrix;
    triple offset;
    int slots, slot;
    __global const view* seen;           // what the path has besides its image, see views.h
    const pose_table* poses;
    __global const receiver_node* rows;  // of the walk's first node on
    double start, block_time;            // time of the walk's first block, s
    double block_share;                  // two blocks over the walk
    const double* predicted;             // delays over the walk, a septic on [-1, 1]
    const double* expected;              // of what goes with them, see `predict_more`
    int ready;                           // the group that is solved
    edge_tables tables;                  // of paths over edges, or by capsules and spheres
    receivers_in_image receiver[STATIC_RECEIVERS ? 1 : AT_ONCE];
    arrivals node[AT_ONCE];
#if MORE
    found_more met[AT_ONCE];
#endif
} path_nodes;

// Solve a group of the walk's nodes.
static void solve_group(path_nodes* s, int group)
{
    if (s->ready == group) return;
    s->ready = group;
    for (int part = 0; part < AT_ONCE; part++) {
        receivers_in_image* receiver = s->receiver + (STATIC_RECEIVERS ? 0 : part);
        const int first = group * GROUP + part * NODES_AT_ONCE;
#if !STATIC_RECEIVERS
        *receiver = receivers_at(s->path, s->image_matrix, s->slots, s->slot, s->offset, s->seen, s->rows + first);
#endif
        const double at[4] = {first - 1, first, first + 1, first + 2};
        const reals block = SIDE_BY_SIDE(at, ), u = block * s->block_share - 1.0;
        reals expected = s->predicted[7];
#pragma unroll
        for (int k = 6; k >= 0; k--) expected = expected * u + s->predicted[k];
        s->node[part].delay = expected + receiver->clock_error;
#if MORE
        expect_more(s->expected, u, s->met + part);
#endif
        SOLVE_DELAY(s->path, s->poses, s->seen, &receiver->ear, s->start + block * s->block_time + receiver->clock_error,
                    CONVERGED, s->node + part, s->met + part);
    }
}

// Delay and rate at a node of the group, by the receiver's own clock.
static double delay_of_node(const path_nodes* s, int i)
{
    const reals late = s->node[PART(i)].delay - s->receiver[STATIC_RECEIVERS ? 0 : PART(i)].clock_error;
    return OF_NODE(late, BESIDE_IT(i));
}
static double rate_of_node(const path_nodes* s, int i)
{
    const reals pace = s->receiver[STATIC_RECEIVERS ? 0 : PART(i)].clock_rate;
    const reals rate = s->node[PART(i)].rate * pace - (pace - 1.0);
    return OF_NODE(rate, BESIDE_IT(i));
}

// The gains at a node of the group, see response.h.
static float gains_of_node(const path_nodes* s, int i, double speed_of_sound, const surroundings* around, gains* gain,
                           float* unheld)
{
    const arrivals* a = s->node + PART(i);
    const int beside = BESIDE_IT(i);
    const double through = OF_NODE(a->delay, beside) * speed_of_sound;
#if EDGES
    __global const view* edge = s->seen;
    const triple from = place_by_edge(edge->source_turn, edge->source_shift, cubic(a->knot[beside], OF_NODE(a->u, beside)));
    const triple to = triple_of(&s->receiver[STATIC_RECEIVERS ? 0 : PART(i)].ear.position, beside);
    double place;
    response field[1];
    const double length = edge_field(around, &s->tables, edge, s->slot, from, to, OF_NODE(a->mach_factor, beside), &place, field);
    const arrival here = {(float)through, (float)length, OF_NODE(a->mach_factor, beside),
                          into_room(edge->source_turn, towards_edge(from, place)),
                          times(-1.0, into_room(edge->receiver_turn, towards_edge(to, place))), a->knot[beside], OF_NODE(a->u, beside)};
#elif SCATTERERS
    response by_shape;
    const response* field = s->seen->shape >= CAPSULE ? &by_shape : 0;
    const scattering* met = s->met + PART(i);
    const double length = scattered_length(&s->tables, s->seen, met, beside, &by_shape);
    const arrival here = {(float)through, (float)length, OF_NODE(a->mach_factor, beside),
                          triple_of(&a->departure, beside), triple_of(&met->arrival, beside), a->knot[beside], OF_NODE(a->u, beside)};
#elif BODIES
    const mirrored* met = s->met + PART(i);
    const arrival here = {(float)OF_NODE(met->through, beside), (float)length_by_mirrors(met, beside), OF_NODE(a->mach_factor, beside),
                          triple_of(met->way, beside), triple_of(met->way + BODIES, beside), a->knot[beside], OF_NODE(a->u, beside)};
    response of_angles[1];
    const response* field = by_mirrors(around, met, beside, s->slots, s->slot, of_angles) ? of_angles : 0;
    surroundings others = *around;
    others.angular = 0;
    around = &others;
#else
    const response* field = 0;
    const triple departure = triple_of(&a->departure, beside);
#if WIND
    const arrival here = {(float)through, (float)OF_NODE(a->length, beside), OF_NODE(a->mach_factor, beside), departure,
                          triple_of(&a->arrival, beside), a->knot[beside], OF_NODE(a->u, beside)};
#else
    const arrival here = {(float)through, (float)through, OF_NODE(a->mach_factor, beside), departure, departure,
                          a->knot[beside], OF_NODE(a->u, beside)};
#endif
#endif
    triple frame[3];
#if RECEIVER_DIRECTIVITY != OMNI
    for (int k = 0; k < 3; k++) frame[k] = triple_of(s->receiver[STATIC_RECEIVERS ? 0 : PART(i)].frame + k, beside);
#endif
    return path_gains(&here, around, s->slots, s->slot, frame, field, gain, unheld);
}

// What no function holds of a path heard from sample `from` to `until`, at nodes up to `near` from a sample. Nodes of paths
// over edges where these are not heard may lie beyond a boundary, and the functions are not made for such: they do not count.
static float left_where_heard(float left_over, int sample, int near, int from, int until)
{
#if EDGES
    if (from > sample - near || until < sample + near) return 0.0f;
#endif
    return left_over;
}
