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

// Newton steps of several nodes side by side, so that no processor waits for a single one: each until its step is so
// small that the next one, of the order of its square, would be of no use.
static void solve_nodes(const trajectory* path, const receiver_in_image* receiver, const double* times, arrival* node)
{
    int open[NODES_AT_ONCE];
#pragma unroll
    for (int i = 0; i < NODES_AT_ONCE; i++) open[i] = 1;
    for (int k = 0; k < 8; k++) {
        int any = 0;
#pragma unroll
        for (int i = 0; i < NODES_AT_ONCE; i++) {
            if (!open[i]) continue;
            const receiver_in_image* here = receiver + (STATIC_RECEIVERS ? 0 : i);
            const double step = newton_step(path, here->position, here->velocity, times[i], node + i);
            open[i] = step * step >= CONVERGED;
            any |= open[i];
        }
        if (!any) break;
    }
}
