// Nodes of one path side by side: the receiver as the path sees it, and the delay.

// A receiver as seen from the source's own room: where it is, how it moves and turns, and its clock.
typedef struct {
    triple position, velocity, frame[3];
    double ahead, pace;  // how much later its samples are taken, and true seconds in one of its own
} listener;

static listener listener_at(__global const double* image_matrix, int slots, int slot, triple offset,
                            __global const double* row)
{
    listener out;
    out.position = turned_back(image_matrix, slots, slot, difference(at_row(row), offset));
    out.velocity = turned_back(image_matrix, slots, slot, at_row(row + 3));
#if RECEIVER_BEAM != NONE
    out.frame[0] = turned_back(image_matrix, slots, slot, at_row(row + 6));
#endif
#if RECEIVER_BEAM == SPHERICAL
    out.frame[1] = turned_back(image_matrix, slots, slot, at_row(row + 9));
    out.frame[2] = turned_back(image_matrix, slots, slot, cross_product(at_row(row + 6), at_row(row + 9)));
#endif
    out.ahead = row[12];
    out.pace = row[13];
    return out;
}

// Newton steps of several nodes side by side, so that no processor waits for a single one: each until its step is so
// small that the next one, of the order of its square, would be of no use.
static void settle_together(const motion* path, const listener* ear, const double* times, arrival* node)
{
    int open[TOGETHER];
#pragma unroll
    for (int i = 0; i < TOGETHER; i++) open[i] = 1;
    for (int k = 0; k < 8; k++) {
        int any = 0;
#pragma unroll
        for (int i = 0; i < TOGETHER; i++) {
            if (!open[i]) continue;
            const listener* here = ear + (STILL ? 0 : i);
            const double step = newton_step(path, here->position, here->velocity, times[i], node + i);
            open[i] = step * step >= 1e-14;
            any |= open[i];
        }
        if (!any) break;
    }
}
