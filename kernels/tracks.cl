// Delay and gain of every path as cubics on every block, in float64. Work-item: dimension 0 counts slots (paths),
// dimension 1 walks of WALK blocks. A walk solves the delay at its nodes in order, each predicted from the last two.
// Node n is at the start of block n; blocks need one node before and one after theirs for the slope of the gain.

__kernel void tracks(__global const double* image_matrix,  // [9][slots]
                     __global const double* image_offset,  // [3][slots]
                     __global const int* receiver_of,      // [slots]
                     __global const band* reflection, __global const int* wall_of, __global const float* normal,
                     __global const int* heard_from, __global const int* heard_until,  // [slots], samples of the run
                     __global const double* receivers,     // [receivers][nodes][14]: position, velocity, axes, clock
                     int nodes,                            // blocks + 3, the first one before the run
                     __global const double* knots, int knot_count, double knot_first, double knot_rate,
                     double start,                         // time of the run's first sample, s
                     double sampling_rate, double speed_of_sound,
                     __global const band* nepers, __global const chunk* projection, __global const band* functions,
                     __global const band* weight, __global const float* sizes,
                     double late,                          // added to the delay, samples
                     double emitted_first, double emitted_last,  // s, outside of which nothing sounds
                     float angular_frequency,              // largest of the signal, rad/s
                     __global const band* walls, __global const band* source_beam,
                     __global const band* receiver_beams,  // of every kind that is there
                     __global const int* beam_of,          // [receivers], bands from the first
                     int blocks,
                     __global int* delay,                  // [blocks][slots]
                     __global float* cubics,               // as in nodes.h
                     __global float4* found,               // [walks][slots]: error squared, strength, delays
                     __global float* unheld)               // [walks][slots]: mean square of what no function holds
{
    const int slot = get_global_id(0), slots = get_global_size(0), walk = get_global_id(1);
    const int first = walk * WALK, last = first + WALK < blocks ? first + WALK : blocks;
    const motion path = {knots, knot_count, knot_first, knot_rate, 1.0 / speed_of_sound};
    const triple offset = {image_offset[slot], image_offset[slots + slot], image_offset[2 * slots + slot]};
    __global const double* row = receivers + ((long)receiver_of[slot] * nodes + first) * 14;
    const surroundings around = {nepers,  projection, functions, weight,      sizes,
                                 reflection, walls,   wall_of,   normal,      source_beam,
                                 receiver_beams + beam_of[receiver_of[slot]]};
    const double block_time = (double)BLOCK / sampling_rate;
    const int from = heard_from[slot], until = heard_until[slot];
    window w;
    float error = 0.0f, strength = 0.0f, rest = 0.0f, shortest = 1e30f, longest = -1e30f;
    for (int n = first; n < last + 3; n++, row += 14) {
        const triple position = turned_back(image_matrix, slots, slot, difference(at_row(row), offset));
        const triple velocity = turned_back(image_matrix, slots, slot, at_row(row + 3));
        triple frame[3];
#if RECEIVER_BEAM != NONE
        frame[0] = turned_back(image_matrix, slots, slot, at_row(row + 6));
#endif
#if RECEIVER_BEAM == SPHERICAL
        frame[1] = turned_back(image_matrix, slots, slot, at_row(row + 9));
        frame[2] = turned_back(image_matrix, slots, slot, cross_product(at_row(row + 6), at_row(row + 9)));
#endif
        // The receiver's clock: its own time, how much later its samples are taken, and true seconds in one of its own.
        const double time = start + (double)(n - 1) * block_time, ahead = row[12], pace = row[13];
        arrival a;
        if (n == first) {
            settle(&path, position, velocity, time + ahead, &a);
        } else {
            const double rate = n == first + 1 ? w.rate[3] : 1.5 * w.rate[3] - 0.5 * w.rate[2];
            a.delay = w.delay[3] + block_time * rate + ahead;
            newton_step(&path, position, velocity, time + ahead, &a);
        }
        for (int i = 0; i < 3; i++) {
            w.delay[i] = w.delay[i + 1];
            w.rate[i] = w.rate[i + 1];
            for (int k = 0; k < CHUNKS; k++) w.gain[i][k] = w.gain[i + 1][k];
            w.strength[i] = w.strength[i + 1];
        }
        float left;
        w.delay[3] = a.delay - ahead;
        w.rate[3] = a.rate * pace - (pace - 1.0);
        w.strength[3] = path_gains(&a, speed_of_sound, &around, slots, slot, frame, w.gain[3], &left);
        const float delay_now = (float)w.delay[3];
        shortest = delay_now < shortest ? delay_now : shortest;
        longest = delay_now > longest ? delay_now : longest;
        if (n < first + 3) continue;
        const int heard = from < (n - 2) * BLOCK && until > (n - 3) * BLOCK;
        write_block(&w, n - 3, slots, slot, sampling_rate, late, heard, delay, cubics);
        if (!heard) continue;
        strength = w.strength[3] > strength ? w.strength[3] : strength;
        rest = left > rest ? left : rest;
        if (time - w.delay[3] >= emitted_first && time - 3.0 * block_time - w.delay[0] <= emitted_last) {
            const float squared = block_error_squared(&w, sizes, angular_frequency, block_time);
            error = squared > error ? squared : error;
        }
    }
    found[walk * slots + slot] = (float4)(error, strength, shortest, longest);
    unheld[walk * slots + slot] = rest;
}
