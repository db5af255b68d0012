// Nodes of one path side by side: the receiver as the path sees it, and the delay.

// A receiver as seen from the source's own room: where it is, how it moves and turns, and its clock.
typedef struct {
    triple position, velocity, frame[3];
    double clock_error, clock_rate;  // as of a receiver_node
} receiver_in_image;

static receiver_in_image receiver_at(__global const double* image_matrix, int slots, int slot, triple offset,
                                     __global const receiver_node* node)
{
    receiver_in_image out;
    out.position = turned_back(image_matrix, slots, slot, difference(at_row(node->position), offset));
    out.velocity = turned_back(image_matrix, slots, slot, at_row(node->velocity));
#if RECEIVER_DIRECTIVITY != OMNI
    out.frame[0] = turned_back(image_matrix, slots, slot, at_row(node->axes[0]));
#endif
#if RECEIVER_DIRECTIVITY == SPHERICAL
    out.frame[1] = turned_back(image_matrix, slots, slot, at_row(node->axes[1]));
    out.frame[2] =
        turned_back(image_matrix, slots, slot, cross_product(at_row(node->axes[0]), at_row(node->axes[1])));
#endif
    out.clock_error = node->clock_error;
    out.clock_rate = node->clock_rate;
    return out;
}

// All that the nodes of a path over a walk are solved from, and those that were solved last: GROUP neighbours.
#define GROUP 4

typedef struct {
    const trajectory* path;
    __global const double* image_matrix;
    triple offset;
    int slots, slot;
    __global const receiver_node* rows;  // of the walk's first node on
    double start, block_time;            // time of the walk's first block, s
    const double* predicted;             // delays over the walk, a septic on [-1, 1]
    int ready;                           // the group that is solved
    double times[GROUP];
    receiver_in_image receiver[STATIC_RECEIVERS ? 1 : GROUP];
    arrival node[GROUP];
} path_nodes;

// Newton steps of NODES_AT_ONCE nodes side by side, so that no processor waits for a single one: each until its step is so
// small that the next one, of the order of its square, would be of no use.
static void solve_nodes(path_nodes* s, int first)
{
    int open[NODES_AT_ONCE];
#pragma unroll
    for (int i = 0; i < NODES_AT_ONCE; i++) open[i] = 1;
    for (int k = 0; k < 8; k++) {
        int any = 0;
#pragma unroll
        for (int i = 0; i < NODES_AT_ONCE; i++) {
            if (!open[i]) continue;
            const receiver_in_image* here = s->receiver + (STATIC_RECEIVERS ? 0 : first + i);
            const double step = newton_step(s->path, here->position, here->velocity, s->times[first + i], s->node + first + i);
            open[i] = step * step >= CONVERGED;
            any |= open[i];
        }
        if (!any) break;
    }
}

// Solve a group of the walk's nodes.
static void solve_group(path_nodes* s, int group)
{
    if (s->ready == group) return;
    s->ready = group;
    for (int i = 0; i < GROUP; i++) {
        const int at = group * GROUP + i;
#if !STATIC_RECEIVERS
        s->receiver[i] = receiver_at(s->image_matrix, s->slots, s->slot, s->offset, s->rows + at);
#endif
        const double u = (at - 1) * (2.0 / WALK) - 1.0;
        double expected = s->predicted[7];
#pragma unroll
        for (int k = 6; k >= 0; k--) expected = expected * u + s->predicted[k];
        s->times[i] = s->start + (at - 1) * s->block_time + s->receiver[STATIC_RECEIVERS ? 0 : i].clock_error;
        s->node[i].delay = expected + s->receiver[STATIC_RECEIVERS ? 0 : i].clock_error;
    }
    for (int i = 0; i < GROUP; i += NODES_AT_ONCE) solve_nodes(s, i);
}

// The receiver as a node of the group that is solved sees it; delay and rate by the receiver's own clock.
static const receiver_in_image* receiver_of_node(const path_nodes* s, int i)
{
    return s->receiver + (STATIC_RECEIVERS ? 0 : i);
}
static double delay_of_node(const path_nodes* s, int i)
{
    return s->node[i].delay - receiver_of_node(s, i)->clock_error;
}
static double rate_of_node(const path_nodes* s, int i)
{
    const double clock_rate = receiver_of_node(s, i)->clock_rate;
    return s->node[i].rate * clock_rate - (clock_rate - 1.0);
}
