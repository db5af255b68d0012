// Nodes of one path: the receiver as the path sees it, and the delay, GROUP neighbours at a time.

#define GROUP 4
#define AT_ONCE (GROUP / NODES_AT_ONCE)
#define VECTOR(i) ((i) / NODES_AT_ONCE)  // of the group, in which its i-th node is
#define LANE(i) ((i) % NODES_AT_ONCE)
#define RECEIVER_AT(s, i) s->receiver[STATIC_RECEIVERS ? 0 : VECTOR(i)]

// All that the nodes of a path over a segment are solved from, and those that were solved last.
typedef struct {
    const trajectory* path;
    __global const double* image_matrix;
    triple offset;
    int slots, slot;
    __global const view* seen;           // what the path has besides its image, see path.h
    const pose_table* poses;
    __global const receiver_node* rows;  // of the segment's first node on
    double start, block_time;            // time of the segment's first block, s
    double block_share;                  // two blocks over the segment
    const double* predicted;             // delays over the segment, a septic on [-1, 1]
    const double* expected;              // of what goes with them, see `predict_state`
    int ready;                           // the group that is solved
    vertex_tables tables;                  // of paths over edges, or by capsules and spheres
    receivers_in_image receiver[STATIC_RECEIVERS ? 1 : AT_ONCE];
    arrivals node[AT_ONCE];
    path_state met[AT_ONCE];
} path_nodes;

// Solve a group of the segment's nodes.
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
        expected_state(s->expected, u, s->met + part);
        SOLVE_DELAY(s->path, s->poses, s->seen, &receiver->ear, s->start + block * s->block_time + receiver->clock_error,
                    CONVERGED, s->node + part, s->met + part);
    }
}

// Delay and rate at a node of the group, by the receiver's own clock.
static double delay_of_node(const path_nodes* s, int i)
{
    const reals late = s->node[VECTOR(i)].delay - RECEIVER_AT(s, i).clock_error;
    return OF_NODE(late, LANE(i));
}
static double rate_of_node(const path_nodes* s, int i)
{
    const reals pace = RECEIVER_AT(s, i).clock_rate;
    const reals rate = s->node[VECTOR(i)].rate * pace - (pace - 1.0);
    return OF_NODE(rate, LANE(i));
}
