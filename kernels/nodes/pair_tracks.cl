// Delay and gain of every path as cubics on every block, as tracks.cl makes them, on devices without float64. Work-item:
// dimension 0 counts slots (paths), dimension 1 segments of `segment_blocks` blocks. Every node has its gains. Delays are predicted from the
// two nodes before, so that two Newton steps are enough; where signals pause, from that of the segment's first block.

// Places of numbers that are pairs.
#define START 0
#define BLOCK_TIME 1
#define SLOWNESS 2
#define PER_SECOND 3
#define DELAY_SAMPLES 4
#define HALF_BLOCK 5

// Write the delay between the middle two nodes; returns its whole part.
static int write_delay(const pair* delay, const float* rate, __global const pair* numbers, int apart, __global float* c)
{
    const pair p0 = plus(product(delay[1], numbers[PER_SECOND]), numbers[DELAY_SAMPLES]);
    const pair p1 = plus(product(delay[2], numbers[PER_SECOND]), numbers[DELAY_SAMPLES]);
    const float half_block = numbers[HALF_BLOCK].x, e0 = rate[1] * half_block, e1 = rate[2] * half_block;
    const pair centre = plus(scaled(0.5f, plus(p0, p1)), (pair)(-0.25f * (e1 - e0), 0.0f));
    const float whole = floor(centre.x + 0.5f), change = minus(p1, p0).x;
    c[0] = (centre.x - whole) + centre.y;
    c[apart] = 0.75f * change - 0.25f * (e0 + e1);
    c[2 * apart] = 0.25f * (e1 - e0);
    c[3 * apart] = 0.25f * (e0 + e1) - 0.25f * change;
    return (int)whole;
}

typedef struct {
    float knot_rate, speed_of_sound, emitted_first, emitted_last, angular_frequency, origin, max_rate;
    int knot_count;
    float subblock_share;
    int function_count, angular, nodes, blocks, block_samples, segment_blocks, subblock_samples, cells;
} pair_run_numbers;

__kernel void pair_tracks(const pair_run_numbers run,         // as in tracks.cl, times from the first knot
                          __global const float2* image_matrix,  // [9][slots]
                          __global const float2* image_offset,  // [3][slots]
                          __global const int* receiver_of,    // [slots]
                          __global const bins* reflection, __global const int* wall_of, __global const float* normal,
                          __global const int* active_from, __global const int* active_until,  // [slots], samples of the run
                          __global const pair_receiver* receivers,  // [receivers][nodes, 1 if STATIC_RECEIVERS]
                          __global const float* knots, __global const float* rests,
                          __global const float2* numbers,  // [6], see above; s from the first knot, s, s/m, 1/s, samples, samples
                          __global const bins* air_and_functions, __global const gains* projection,
                          __global const bins* wall_tables, __global const bins* source_directivity,
                          __global const bins* receiver_directivities, __global const int* directivity_of,
                          __global int* delay, __global float* polynomials, __global float4* found, __global float* residual,
                          __global const int* active_cells, __global int* activity)  // as in tracks.cl
{
    const int slot = get_global_id(0), slots = get_global_size(0), segment = get_global_id(1);
    const int first = segment * run.segment_blocks, apart = BESIDE;
    const int last = first + run.segment_blocks < run.blocks ? first + run.segment_blocks : run.blocks;
    const pair_trajectory path = {knots, rests, run.knot_count, run.knot_rate, numbers[SLOWNESS]};
    __global const pair_receiver* rows = receivers + (long)receiver_of[slot] * (STATIC_RECEIVERS ? 1 : run.nodes);
    const environment env = environment_of(air_and_functions, projection, reflection, wall_tables, wall_of, normal,
                                                source_directivity, receiver_directivities + directivity_of[receiver_of[slot]],
                                                run.function_count / CHANNELS, run.angular);
    const float block_time = numbers[BLOCK_TIME].x;
    const int from = active_from[slot], until = active_until[slot];
    pair_receiver_in_image receiver;
    gains powers[4][GAIN_VECTORS];
    window w;
    pair_arrival a;
    pair late[4];
    float error = 0.0f, strength = 0.0f, rest = 0.0f, largest_residual = 0.0f, shortest = 1e30f, longest = -1e30f;
    a.delay = (pair)(0.0f, 0.0f);
#define TIME_OF(n) plus(numbers[START], scaled((float)((n) - 1), numbers[BLOCK_TIME]))
#define SOLVE(n) \
    receiver = pair_receiver_at(image_matrix, image_offset, slots, slot, rows + (STATIC_RECEIVERS ? 0 : (n))); \
    solve_delay(&path, &receiver, plus(TIME_OF(n), receiver.clock_error), &a)
    SOLVE(first + 1);
    const pair begin = minus(a.delay, receiver.clock_error);
#if SPARSE
    const activity_mask mask = {active_cells, active_cells + run.cells, run.cells, run.origin, run.block_samples, run.subblock_samples};
    SOLVE(last + 1);
    const float per_second = numbers[PER_SECOND].x, drift = run.max_rate * per_second, added = numbers[DELAY_SAMPLES].x;
    const float late0 = begin.x * per_second + added, late1 = (a.delay.x - receiver.clock_error.x) * per_second + added;
#endif
    int solved = first - 1, in_row = 0;  // last node in the window, and how many up to it follow each other
    for (int block = first; block < last; block++) {
        const int heard = from < (block + 1) * run.block_samples && until > block * run.block_samples;
#if SPARSE
        if (!heard) continue;
        const float since = (block - first) * block_time, left = (last - block) * block_time;
        const float until_end = drift * left, of_block = drift * block_time;
        const float low = late0 - drift * since, low_of_end = late1 - until_end, high = late0 + drift * since;
        const float high_of_end = late1 + until_end, low_here = low > low_of_end ? low : low_of_end;
        const float high_here = high < high_of_end ? high : high_of_end;
        if (!is_active(&mask, block, low_here - of_block - 4.0f, high_here + of_block + 4.0f)) continue;
#endif
        if (solved < block) {
            solved = block - 1;
            in_row = 0;
        }
        for (int n = solved + 1; n <= block + 3; n++, in_row++) {
            const float bend = in_row > 1 ? 0.5f * (w.rate[3] - w.rate[2]) : 0.0f;
            const pair near = in_row > 0 ? plus(late[3], (pair)(block_time * (w.rate[3] + bend), 0.0f)) : begin;
            a.delay = plus(near, receiver.clock_error);
            SOLVE(n);
            for (int i = 0; i < 3; i++) {
                late[i] = late[i + 1];
                w.delay[i] = w.delay[i + 1];
                w.rate[i] = w.rate[i + 1];
                for (int k = 0; k < GAIN_VECTORS; k++) w.gain[i][k] = w.gain[i + 1][k];
                w.strength[i] = w.strength[i + 1];
            }
            late[3] = minus(a.delay, receiver.clock_error);
            w.delay[3] = minus(late[3], begin).x;  // what is looked at are differences
            w.rate[3] = a.rate + (a.rate - 1.0f) * receiver.clock_drift;
            const float length = a.delay.x * run.speed_of_sound;
            const arrival here = {length, length, a.mach_factor, a.departure, a.departure, a.knot, a.u};
            response shared;
            shared_response(&here, &env, run.angular, slots, slot, &shared);
            w.strength[3] = channel_gains(&shared, &here, &env, receiver.frame, 0, w.gain[3], &largest_residual);
        }
        solved = block + 3;
        terms_between(&w, powers);
        for (int i = 1; i < 3; i++) {
            shortest = late[i].x < shortest ? late[i].x : shortest;
            longest = late[i].x > longest ? late[i].x : longest;
        }
        __global float* c = polynomials + place_of(block, slot, run.function_count, slots);
        delay[block * (long)slots + slot] = write_delay(late, w.rate, numbers, apart, c);
        write_terms(powers, heard, run.function_count, apart, c);
        if (!heard) continue;
#if SPARSE
        const float p1 = late[1].x * per_second + added, p2 = late[2].x * per_second + added;
        const float r1 = w.rate[1] - (p2 - p1) / run.block_samples, r2 = w.rate[2] - (p2 - p1) / run.block_samples;
        const float bulge = 0.25f * run.block_samples * ((r1 < 0.0f ? -r1 : r1) + (r2 < 0.0f ? -r2 : r2)) + 4.0f;  // of the cubic
        activity[block * (long)slots + slot] =
            active_subblocks(&mask, block, (p1 < p2 ? p1 : p2) - bulge, (p1 < p2 ? p2 : p1) + bulge);
#endif
        strength = w.strength[3] > strength ? w.strength[3] : strength;
        rest = largest_residual > rest ? largest_residual : rest;
        const float time = TIME_OF(block + 3).x;
        if (time - late[3].x >= run.emitted_first && time - 3.0f * block_time - late[0].x <= run.emitted_last) {
            const float squared = delay_error_squared(&w, run.angular_frequency, block_time, run.subblock_share) +
                                  left_out_squared(powers, env.sizes, run.subblock_share) + gain_error_squared(&w, env.sizes);
            error = squared > error ? squared : error;
        }
    }
    found[segment * (long)slots + slot] = (float4)(error, strength, shortest, longest);
    residual[segment * (long)slots + slot] = rest;
}
