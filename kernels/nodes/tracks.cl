// Delay and gain of every path as cubics on every block, in float64. Work-item: dimension 0 counts slots (paths),
// dimension 1 segments of `segment_blocks` blocks. Delays at nodes are predicted from those at four ends of segments, so that no node
// depends on which others are solved: where signals pause (SPARSE), blocks in which nothing is active are left out.
// Node n is one block before the start of block n; the slope of a block's gain needs the node before and after its own.

// Numbers come in structures of path.h. Of `motion`: `start` is the time of the run's first
// sample, s. Of `run`: `nodes` are those of whole segments and some more, the first one before the run; `first_segment` is one segment
// before the run's first sample; `delay_samples` are added to the delay; nothing is active outside of `emitted_first` and
// `emitted_last`, s; `angular_frequency` is the largest of the signal, rad/s; `smooth` is the square of the allowed relative
// error of gains of smooth.h; `angular` is the largest number of walls of a path whose factor depends on the angle;
// `function_count` is at most FUNCTIONS; `subblock_share` is a subblock's share of a block, or 0 where subblocks take all terms
// of the cubics; `oversampling` is the number of samples of the branches in one of the run; `max_rate` bounds a delay's rate.

__kernel void tracks(const motion_numbers motion, __global const double* knots, __global const double* poses,
                     __global const int* pose_cells, const run_numbers run,
                     __global const double* image_matrix,  // [9][slots]
                     __global const double* image_offset,  // [3][slots]
                     __global const int* receiver_of, __global const view* views,  // [slots]; as in views.h
                     __global const bins* reflection, __global const int* wall_of, __global const float* normal,
                     __global const int* active_from, __global const int* active_until,  // [slots], samples of the run
                     __global const receiver_node* receivers,  // [receivers][nodes, 1 if STATIC_RECEIVERS]
                     __global const double* coarse_delays, __global const double* coarse_states,  // as in coarse_delays.cl
                     __global const bins* air_and_functions, __global const gains* projection,  // as in response.h
                     __global const bins* wall_tables, __global const bins* source_directivity,
                     __global const bins* receiver_directivities,  // of every kind that is there
                     __global const int* directivity_of,   // [receivers], bands from the first
                     __global int* delay,                  // [blocks][slots]
                     __global float* polynomials,          // as in polynomials.h
                     __global float4* found,               // [segments][slots]: error squared, strength, delays
                     __global float* residual,               // [segments][slots]: mean square of what no function represents
                     __global const int* active_cells,         // [2][cells], in activity.h
                     __global int* activity,               // [blocks][slots]: subblocks in which it is active, see activity.h
                     __global const bins* field_tables, __global const bins* faces, __global const double* modes)
                                                           // these in transition_table.h
{
    const int slot = get_global_id(0), slots = get_global_size(0), segment = get_global_id(1), first = segment * run.segment_blocks;
    const int last = first + run.segment_blocks < run.blocks ? first + run.segment_blocks : run.blocks;
    const trajectory path = trajectory_of(knots, motion.knot_count, motion.first_knot, motion.knot_rate,
                                          motion.speed_of_sound, motion.wind);
    const triple offset = image_offset_of(image_offset, slots, slot);
    __global const receiver_node* rows = receivers + (long)receiver_of[slot] * (STATIC_RECEIVERS ? 1 : run.nodes);
    const environment env = environment_of(air_and_functions, projection, reflection, wall_tables, wall_of, normal,
                                                source_directivity, receiver_directivities + directivity_of[receiver_of[slot]],
                                                run.function_count / CHANNELS, run.angular);
    const double block_time = (double)run.block_samples / run.sampling_rate, segment_time = run.segment_blocks * block_time;
    const double branch_rate = run.oversampling * run.sampling_rate, half_block = 0.5 * run.oversampling * run.block_samples;
    double ends[4], predicted[8];
    predict(coarse_delays + 2 * (run.first_segment + segment) * (long)slots + slot, slots, segment_time, ends, predicted);
    const int from = active_from[slot], until = active_until[slot];
#if !SPARSE
    if (from >= last * run.block_samples || until <= first * run.block_samples) {  // fills up a batch, or sounds at another time
        found[segment * (long)slots + slot] = (float4)(0.0f, 0.0f, 1e30f, -1e30f);
        residual[segment * (long)slots + slot] = 0.0f;
        for (int block = first; block < last; block++) {
            __global float* c = polynomials + place_of(block, slot, run.function_count, slots);
            delay[block * (long)slots + slot] = write_silence(ends[1] * branch_rate + run.delay_samples, run.function_count, BESIDE, c);
        }
        return;
    }
#else
    const activity_mask mask = {active_cells, active_cells + run.cells, run.cells, run.origin, run.block_samples, run.subblock_samples};
#endif
    const pose_table poses_of_path = {poses, pose_cells, motion.pose_count, motion.first_pose, motion.pose_rate};
    double expected[8 + 4 * STATE_NUMBERS];
    predict_state(coarse_states + STATE_NUMBERS * (run.first_segment + segment) * (long)slots + slot, slots, segment_time, expected);
    path_nodes nodes_of_path = {&path, image_matrix, offset, slots, slot, views + slot, &poses_of_path,
                                rows + (STATIC_RECEIVERS ? 0 : first), motion.start + first * block_time, block_time,
                                2.0 / run.segment_blocks, predicted, expected, -1,
                                {field_tables + BIN_VECTORS, faces, field_tables, run.middle, modes}};
#if STATIC_RECEIVERS
    nodes_of_path.receiver[0] = receivers_at(&path, image_matrix, slots, slot, offset, views + slot, rows);
#endif
#if DELAY_TERMS == 4
    smooth_gains slow;
    slow.stretch = slow.cell = -1;
#endif
#if CELL_AT_ONCE
    const cell_blocks of_cells = {slots, slot, run.function_count, run.block_samples, motion.start, block_time, half_block,
                                  branch_rate, run.delay_samples, run.emitted_first, run.emitted_last,
                                  run.angular_frequency, run.subblock_share, env.sizes, polynomials, delay};
#endif
    gains powers[4][GAIN_VECTORS];
    window w;
    int solved = first - 1;  // last node in the window
    float gain_error, largest_residual = 0.0f;
    segment_result f = {0.0f, 0.0f, 0.0f, 1e30f, -1e30f};
    for (int block = first; block < last; block++) {
        const int active = from < (block + 1) * run.block_samples && until > block * run.block_samples;
#if SPARSE
        if (!active) continue;
        const int sounding = next_active_block(&mask, block, first, last, run.segment_blocks,
                                        run.delay_samples + run.sampling_rate * ends[1],
                                        run.delay_samples + run.sampling_rate * ends[2],
                                        run.sampling_rate * run.max_rate * block_time);
        if (sounding > block) {
            block = sounding - 1;
            continue;
        }
#endif
#if DELAY_TERMS == 4
        if (run.smooth > 0.0f && make_cell(&slow, &nodes_of_path, (block - first) / CELL_BLOCKS, run.smooth,
                                           motion.speed_of_sound, &env)) {
            solved = first - 1;
#if CELL_AT_ONCE
            if (write_cell(&slow, &of_cells, block, first, last, from, until, &f)) {
                block += CELL_BLOCKS - 1;
                continue;
            }
#endif
            terms_in_cell(&slow, block - first, &w, powers);
            gain_error = slow.error;
            largest_residual = slow.largest_residual;
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
                w.strength[3] = gains_of_node(&nodes_of_path, at, motion.speed_of_sound, &env, w.gain[3], &largest_residual);
            }
            terms_between(&w, powers);
            gain_error = gain_error_squared(&w, env.sizes);
            solved = block + 3;
        }
        for (int i = 1; i < 3; i++) {
            const float delay_now = (float)w.delay[i];
            f.shortest = delay_now < f.shortest ? delay_now : f.shortest;
            f.longest = delay_now > f.longest ? delay_now : f.longest;
        }
        __global float* c = polynomials + place_of(block, slot, run.function_count, slots);
        delay[block * (long)slots + slot] = write_delay(w.delay, w.rate, BESIDE, branch_rate, half_block, run.delay_samples, c);
        write_terms(powers, active, run.function_count, BESIDE, c);
        if (!active) continue;
#if SPARSE
        const double p1 = w.delay[1] * run.sampling_rate + run.delay_samples, p2 = w.delay[2] * run.sampling_rate + run.delay_samples;
        const double r1 = w.rate[1] - (p2 - p1) / run.block_samples, r2 = w.rate[2] - (p2 - p1) / run.block_samples;
        const double bulge = 0.25 * run.block_samples * ((r1 < 0.0 ? -r1 : r1) + (r2 < 0.0 ? -r2 : r2)) + 2.0;  // of the cubic
        activity[block * (long)slots + slot] =
            active_subblocks(&mask, block, (p1 < p2 ? p1 : p2) - bulge, (p1 < p2 ? p2 : p1) + bulge);
#endif
        f.strength = w.strength[3] > f.strength ? w.strength[3] : f.strength;
        const float residual_here = residual_where_active(largest_residual, block * run.block_samples, GROUP * run.block_samples, from, until);
        f.residual = residual_here > f.residual ? residual_here : f.residual;
        const double time = motion.start + (double)(block + 2) * block_time;
        if (emitted_by(&w, time, block_time) >= run.emitted_first && emitted_from(&w, time, block_time) <= run.emitted_last) {
            const float squared = delay_error_squared(&w, run.angular_frequency, block_time, run.subblock_share) +
                                  left_out_squared(powers, env.sizes, run.subblock_share) + gain_error;
            f.error = squared > f.error ? squared : f.error;
        }
    }
    found[segment * (long)slots + slot] = (float4)(f.error, f.strength, f.shortest, f.longest);
    residual[segment * (long)slots + slot] = f.residual;
}
