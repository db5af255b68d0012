// Delay and gain of every path as cubics on every block, in float64. Work-item: dimension 0 counts slots (paths),
// dimension 1 walks of `walk_blocks` blocks. Delays at nodes are predicted from those at four ends of walks, so that no node
// depends on which others are solved: where signals pause (SPARSE), blocks in which nothing sounds are left out.
// Node n is one block before the start of block n; the slope of a block's gain needs the node before and after its own.

__kernel void tracks(__global const double* image_matrix,  // [9][slots]
                     __global const double* image_offset,  // [3][slots]
                     __global const int* receiver_of, __global const view* views,  // [slots]; as in views.h
                     __global const bins* reflection, __global const int* wall_of, __global const float* normal,
                     __global const int* heard_from, __global const int* heard_until,  // [slots], samples of the run
                     __global const receiver_node* receivers,  // [receivers][nodes, 1 if STATIC_RECEIVERS]
                     int nodes,                            // those of whole walks and some more, the first one before the run
                     __global const double* coarse_delays, __global const double* coarse_more,  // as in coarse_delays.cl
                     int first_walk,                       // one walk before the run's first sample
                     __global const double* knots, int knot_count, double first_knot, double knot_rate,
                     __global const double* poses, __global const int* pose_cells, int pose_count, double first_pose, double pose_rate,
                     double start,                         // time of the run's first sample, s
                     double sampling_rate, double speed_of_sound, __global const double* wind,  // [3], m/s
                     __global const bins* nepers, __global const bins* lead,
                     __global const gains* projection, __global const bins* functions,
                     __global const bins* weight, __global const gains* strengths,
                     int function_count, int angular,      // at most FUNCTIONS; most walls of a path whose factor depends on the angle
                     double delay_samples,                 // added to the delay
                     double emitted_first, double emitted_last,  // s, outside of which nothing sounds
                     float angular_frequency,              // largest of the signal, rad/s
                     float smooth,                         // square of what gains of smooth.h may be wrong by, relative
                     __global const bins* wall_tables, __global const bins* source_directivity,
                     __global const bins* receiver_directivities,  // of every kind that is there
                     __global const int* directivity_of,   // [receivers], bands from the first
                     int blocks, int block_samples, int walk_blocks, int subblock_samples,
                     float subblock_share,                 // of a block; 0 where subblocks take all terms of the cubics
                     int oversampling,                     // samples of the branches in one of the run
                     __global int* delay,                  // [blocks][slots]
                     __global float* polynomials,          // as in polynomials.h
                     __global float4* found,               // [walks][slots]: error squared, strength, delays
                     __global float* unheld,               // [walks][slots]: mean square of what no function holds
                     __global const int* following, __global const int* preceding, int cells, double origin,  // in activity.h
                     double max_rate,                      // bound of how fast a delay changes
                     __global int* activity,               // [blocks][slots]: subblocks in which it sounds, see activity.h
                     __global const bins* transition, __global const bins* faces, __global const bins* waves, double middle, __global const double* modes)
                                                           // these in transition_table.h
{
    const int slot = get_global_id(0), slots = get_global_size(0), walk = get_global_id(1), first = walk * walk_blocks;
    const int last = first + walk_blocks < blocks ? first + walk_blocks : blocks;
    const trajectory path = trajectory_of(knots, knot_count, first_knot, knot_rate, speed_of_sound, wind);
    const triple offset = image_offset_of(image_offset, slots, slot);
    __global const receiver_node* rows = receivers + (long)receiver_of[slot] * (STATIC_RECEIVERS ? 1 : nodes);
    const surroundings around = {nepers, lead, projection, functions, weight, strengths, reflection, wall_tables, wall_of, normal,
                                 source_directivity, receiver_directivities + directivity_of[receiver_of[slot]],
                                 function_count, angular};
    const double block_time = (double)block_samples / sampling_rate, walk_time = walk_blocks * block_time;
    const double branch_rate = oversampling * sampling_rate, half_block = 0.5 * oversampling * block_samples;
    double ends[4], predicted[8];
    predict(coarse_delays + 2 * (first_walk + walk) * (long)slots + slot, slots, walk_time, ends, predicted);
    const int from = heard_from[slot], until = heard_until[slot];
#if SPARSE
    const activity_mask mask = {following, preceding, cells, origin, block_samples, subblock_samples};
#endif
    const pose_table things = {poses, pose_cells, pose_count, first_pose, pose_rate};
    double expected[8 + 4 * MORE];
#if MORE
    predict_more(coarse_more + MORE * (first_walk + walk) * (long)slots + slot, slots, walk_time, expected);
#endif
    path_nodes nodes_of_path = {&path, image_matrix, offset, slots, slot, views + slot, &things,
                                rows + (STATIC_RECEIVERS ? 0 : first), start + first * block_time, block_time,
                                2.0 / walk_blocks, predicted, expected, -1,
                                {transition, faces, waves, middle, modes}};
#if STATIC_RECEIVERS
    nodes_of_path.receiver[0] = receivers_at(&path, image_matrix, slots, slot, offset, views + slot, rows);
#endif
#if DELAY_TERMS == 4
    smooth_gains slow;
    slow.stretch = slow.cell = -1;
#endif
#if CELL_AT_ONCE
    const cell_blocks of_cells = {slots, slot, function_count, block_samples, start, block_time, half_block, branch_rate,
                                  delay_samples, emitted_first, emitted_last, angular_frequency, subblock_share, strengths,
                                  polynomials, delay};
#endif
    gains powers[4][GAIN_VECTORS];
    window w;
    int solved = first - 1;  // last node in the window
    float gain_error, left_over = 0.0f;
    walk_found f = {0.0f, 0.0f, 0.0f, 1e30f, -1e30f};
    for (int block = first; block < last; block++) {
        const int heard = from < (block + 1) * block_samples && until > block * block_samples;
#if SPARSE
        if (!heard) continue;
        const int sounding = next_heard(&mask, block, first, last, walk_blocks, delay_samples + sampling_rate * ends[1],
                                        delay_samples + sampling_rate * ends[2], sampling_rate * max_rate * block_time);
        if (sounding > block) {
            block = sounding - 1;
            continue;
        }
#endif
#if DELAY_TERMS == 4
        if (smooth > 0.0f && make_cell(&slow, &nodes_of_path, (block - first) / CELL_BLOCKS, smooth, speed_of_sound, &around)) {
            solved = first - 1;
#if CELL_AT_ONCE
            if (write_cell(&slow, &of_cells, block, first, last, from, until, &f)) {
                block += CELL_BLOCKS - 1;
                continue;
            }
#endif
            terms_in_cell(&slow, block - first, &w, powers);
            gain_error = slow.error;
            left_over = slow.left_over;
        } else
#endif
        {
            for (int n = solved < block ? block : solved + 1; n <= block + 3; n++) {
                solve_group(&nodes_of_path, (n - first) / GROUP);
                const int at = (n - first) % GROUP;
                for (int i = 0; i < 3; i++) {
                    w.delay[i] = w.delay[i + 1];
                    w.rate[i] = w.rate[i + 1];
                    for (int k = 0; k < GAIN_VECTORS; k++) w.gain[i][k] = w.gain[i + 1][k];
                    w.strength[i] = w.strength[i + 1];
                }
                w.delay[3] = delay_of_node(&nodes_of_path, at);
                w.rate[3] = rate_of_node(&nodes_of_path, at);
                w.strength[3] = gains_of_node(&nodes_of_path, at, speed_of_sound, &around, w.gain[3], &left_over);
            }
            terms_between(&w, powers);
            gain_error = gain_error_squared(&w, strengths);
            solved = block + 3;
        }
        for (int i = 1; i < 3; i++) {
            const float delay_now = (float)w.delay[i];
            f.shortest = delay_now < f.shortest ? delay_now : f.shortest;
            f.longest = delay_now > f.longest ? delay_now : f.longest;
        }
        __global float* c = polynomials + place_of(block, slot, function_count, slots);
        delay[block * (long)slots + slot] = write_delay(&w, BESIDE, branch_rate, half_block, delay_samples, c);
        write_terms(powers, heard, function_count, BESIDE, c);
        if (!heard) continue;
#if SPARSE
        const double p1 = w.delay[1] * sampling_rate + delay_samples, p2 = w.delay[2] * sampling_rate + delay_samples;
        const double r1 = w.rate[1] - (p2 - p1) / block_samples, r2 = w.rate[2] - (p2 - p1) / block_samples;
        const double bulge = 0.25 * block_samples * ((r1 < 0.0 ? -r1 : r1) + (r2 < 0.0 ? -r2 : r2)) + 2.0;  // of the cubic
        activity[block * (long)slots + slot] =
            active_subblocks(&mask, block, (p1 < p2 ? p1 : p2) - bulge, (p1 < p2 ? p2 : p1) + bulge);
#endif
        f.strength = w.strength[3] > f.strength ? w.strength[3] : f.strength;
        const float left_here = left_where_heard(left_over, block * block_samples, GROUP * block_samples, from, until);
        f.rest = left_here > f.rest ? left_here : f.rest;
        const double time = start + (double)(block + 2) * block_time;
        if (time - w.delay[3] >= emitted_first && time - 3.0 * block_time - w.delay[0] <= emitted_last) {
            const float squared = delay_error_squared(&w, angular_frequency, block_time, subblock_share) +
                                  left_out_squared(powers, strengths, subblock_share) + gain_error;
            f.error = squared > f.error ? squared : f.error;
        }
    }
    found[walk * (long)slots + slot] = (float4)(f.error, f.strength, f.shortest, f.longest);
    unheld[walk * (long)slots + slot] = f.rest;
}
