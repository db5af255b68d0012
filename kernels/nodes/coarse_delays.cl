// Delays and their rates at both ends of every segment, by the receiver's clock, from which those between are predicted.
// Work-item: dimension 0 counts slots (paths), dimension 1 NODES_AT_ONCE ends of segments, the first one segment before the run.

__kernel void coarse_delays(const motion_numbers motion, __global const double* knots, __global const double* poses,  // as in tracks.cl
                            __global const int* pose_cells, __global const double* image_matrix,
                            __global const double* image_offset, __global const int* receiver_of, __global const view* views,
                            __global const receiver_node* receivers,  // [receivers][ends, 1 if STATIC_RECEIVERS]
                            int ends,                                 // a multiple of NODES_AT_ONCE
                            double segment_time,
                            __global double* delays,  // [ends][2][slots]
                            __global double* states)  // [ends][STATE_NUMBERS][slots]: what else there is to predict
{
    const int slot = get_global_id(0), slots = get_global_size(0), end = get_global_id(1) * NODES_AT_ONCE;
    const trajectory path = trajectory_of(knots, motion.knot_count, motion.first_knot, motion.knot_rate,
                                          motion.speed_of_sound, motion.wind);
    const receivers_in_image receiver =
        receivers_at(&path, image_matrix, slots, slot, image_offset_of(image_offset, slots, slot),
                     views + slot,
                     receivers + (STATIC_RECEIVERS ? receiver_of[slot] : receiver_of[slot] * (long)ends + end));
    const double at[4] = {end - 1, end, end + 1, end + 2};
    const reals segment = SIDE_BY_SIDE(at, );
    arrivals a;
    a.delay = 0.0;
    const pose_table poses_of_path = {poses, pose_cells, motion.pose_count, motion.first_pose, motion.pose_rate};
    path_state b[1];
    begin_state(receiver.ear.position, b);
    SOLVE_ANEW(&path, &poses_of_path, views + slot, &receiver.ear, motion.start + segment * segment_time + receiver.clock_error, CONVERGED,
               &a, b);
    const reals late = a.delay - receiver.clock_error, rate = a.rate * receiver.clock_rate - (receiver.clock_rate - 1.0);
    for (int i = 0; i < NODES_AT_ONCE; i++) {
        delays[2 * (end + i) * (long)slots + slot] = OF_NODE(late, i);
        delays[(2 * (end + i) + 1) * (long)slots + slot] = OF_NODE(rate, i);
        write_state(b, i, states + STATE_NUMBERS * (end + i) * (long)slots + slot, slots);
    }
}
