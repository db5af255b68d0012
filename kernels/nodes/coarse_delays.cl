// Delays and their rates at both ends of every walk, by the receiver's clock, from which those between are predicted.
// Work-item: dimension 0 counts slots (paths), dimension 1 ends of walks, the first of them one walk before the run.

__kernel void coarse_delays(__global const double* image_matrix, __global const double* image_offset,  // as in tracks.cl
                            __global const int* receiver_of, __global const receiver_node* receivers, int ends,
                            __global const double* knots, int knot_count, double first_knot, double knot_rate, double start,
                            double walk_time, double speed_of_sound, __global double* delays)  // [ends][2][slots]
{
    const int slot = get_global_id(0), slots = get_global_size(0), end = get_global_id(1);
    const trajectory path = {knots, knot_count, first_knot, knot_rate, 1.0 / speed_of_sound};
    const triple offset = image_offset_of(image_offset, slots, slot);
    __global const receiver_node* node =
        receivers + (STATIC_RECEIVERS ? receiver_of[slot] : (long)receiver_of[slot] * ends + end);
    arrival a;
    solve_delay(&path, turned_back(image_matrix, slots, slot, difference(at_row(node->position), offset)),
           turned_back(image_matrix, slots, slot, at_row(node->velocity)), start + (end - 1) * walk_time + node->clock_error,
           CONVERGED, &a);
    delays[2 * end * (long)slots + slot] = a.delay - node->clock_error;
    delays[(2 * end + 1) * (long)slots + slot] = a.rate * node->clock_rate - (node->clock_rate - 1.0);
}
