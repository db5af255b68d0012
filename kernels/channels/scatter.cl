// What receivers hear by their impulse responses at nodes (instants). For each function of frequency every path is spread over
// eight points of a grid, four to three samples, by a Kaiser-Bessel window (render/channel_grid.py); then the grid is transformed
// and filtered (convolve.h), while it is in the cache. So some functions are taken at a time. A unit is a complex grid: that of
// two neighbouring nodes, real and imaginary parts, or of a node of envelopes (DELAY_TERMS == 8), whose responses are turned by
// the carrier. Work-item: dimension 0 counts workers, each of which takes items (nodes TOGETHER of a receiver) in turn. Paths are
// evaluated some at a time, at all nodes of an item, before they are spread: among so many places that are written, polynomials
// would come from memory line by line. Neighbouring slots have delays that lie far apart, so that what one path adds does not
// wait for what the last one wrote.

#define TILE 256  // paths that are evaluated at a time: their results stay in cache
#define ENVELOPE (DELAY_TERMS == 8)
#define NODES_IN_UNIT (2 - ENVELOPE)
#define UNITS (TOGETHER / NODES_IN_UNIT)
// The grid of a node of an item, of one of FUNCTIONS gains.
#define GRID_OF(node, k) \
    (grids + (((node) / NODES_IN_UNIT * FUNCTIONS + (k)) * 2 + (node) % NODES_IN_UNIT) * (long)points)

__kernel void scatter(__global const int* delay, __global const float* polynomials,  // as in render.cl
                      int slots, int functions, int channels,
                      __global const int* node_block,    // [nodes], of `delay` and `polynomials`; -1 where a neighbour is missing
                      __global const float* node_place,  // [nodes], in the block, -1 to 1
                      __global const float* node_sample,  // [nodes], of the run, as `rise` and `fall`
                      int nodes,
                      __global const float* rise, __global const float* fall,  // [slots], where paths are TAPERED
                      __global const float* terms, float per_half,             // as in taper.h
                      __global const int* first_slot,    // [receivers + 1], multiples of BESIDE
                      int receivers,
                      __global const float* window,      // [PHASES + 3][2][TAPS]: values from one phase before the first
                      int first,                         // samples of delay at the grid's beginning
                      float shift,                       // samples that are added to all delays
                      ulong turn_per_sample,             // of the carrier; one turn is 2^64
                      float half_turns_per_sample,
                      int count, __constant int* radix, __global const float* turns,  // as in convolve.h
                      __global const float* lane_turns, __global const float* back_turns,
                      __global const float* inner, int inner_stride,  // [units or 1][functions][groups][KEPT][WIDE][2], spectra
                      __global const float* outer, int outer_stride,  // [units or 1][groups][KEPT][WIDE][2], of the sum
                      __global const float* weights,     // [stride], of samples, among zeros from WIDE before them
                      int first_sample, int apart,              // sample of the first weight, and later than that in imaginary parts
                      int length, int stride,            // weights, and floats of a row
                      __global float* scratch, long of_worker,  // [workers]: grids, then sums of an item
                      __global float* received)          // [units][receivers][channels][2][stride], as `weights`
{
    const int groups = (count + WIDE - 1) / WIDE, points = groups * WIDE * WIDE, spectrum = 2 * groups * KEPT * WIDE;
    const transform of = {count, groups, points, radix, turns, lane_turns, back_turns};
    const int gains = functions * channels, power = gains * BESIDE, items = nodes / TOGETHER * receivers;
    __global float* grids = scratch + get_global_id(0) * of_worker;
    __global float* sums = grids + 2L * UNITS * FUNCTIONS * points;
    int at[TILE], phase[TILE];
    float between[TILE], gain[FUNCTIONS][1 + ENVELOPE][TILE];
#if TAPERED
    float weight[TILE];
#endif
    for (int item = get_global_id(0); item < items; item += get_global_size(0)) {
        const int receiver = item % receivers, first_node = item / receivers * TOGETHER, first_unit = first_node / NODES_IN_UNIT;
        for (int first_gain = 0; first_gain < gains; first_gain += FUNCTIONS) {
            const int some = min(gains - first_gain, FUNCTIONS);
            for (int i = 0; i < UNITS * FUNCTIONS * 2 * groups * WIDE; i++) *(__global loose_wide*)(grids + i * (long)WIDE) = 0.0f;
            for (int from = first_slot[receiver]; from < first_slot[receiver + 1]; from += TILE) {
                const int here = min(first_slot[receiver + 1] - from, TILE);
                for (int node = 0; node < TOGETHER; node++) {
                    const float t = node_place[first_node + node];
                    const int row = node_block[first_node + node];
                    if (row < 0) continue;
                    for (int i = 0; i < here; i += LANES) {
                        __global const float* c = polynomials + place_of(row, from + i, gains, slots);
                        __global const int* whole = delay + row * (long)slots + from + i;
                        vec rest = CUBIC(LOAD(c), LOAD(c + BESIDE), LOAD(c + 2 * BESIDE), LOAD(c + 3 * BESIDE), t);
#if ENVELOPE
                        rest += t * t * t * t * CUBIC(LOAD(c + 4 * BESIDE), LOAD(c + 5 * BESIDE), LOAD(c + 6 * BESIDE), LOAD(c + 7 * BESIDE), t);
                        float turn[LANES];
                        for (int j = 0; j < LANES; j++) turn[j] = whole_turn(whole[j], turn_per_sample);
                        vec cosine, sine;
                        half_turns(rest * half_turns_per_sample + *(loose_vec*)turn, &cosine, &sine);
#endif
                        find_places(*(__global const loose_ivec*)whole - first, rest + shift, at + i, phase + i, between + i);
#if TAPERED
                        const float sample = node_sample[first_node + node];
                        const vec share = taken(sample - LOAD(rise + from + i), sample - LOAD(fall + from + i), per_half, terms);
                        *(loose_vec*)(weight + i) = share;
#endif
                        for (int k = 0; k < some; k++) {
                            __global const float* g = c + (DELAY_TERMS + first_gain + k) * BESIDE;
                            vec own = CUBIC(LOAD(g), LOAD(g + power), LOAD(g + 2 * power), LOAD(g + 3 * power), t);
#if TAPERED
                            own *= share;
#endif
#if ENVELOPE
                            *(loose_vec*)(gain[k][0] + i) = own * cosine;
                            *(loose_vec*)(gain[k][ENVELOPE] + i) = -own * sine;
#else
                            *(loose_vec*)(gain[k][0] + i) = own;
#endif
                        }
                    }
                    for (int i = 0; i < here; i++) {
#if TAPERED
                        if (weight[i] == 0.0f) continue;  // its place may lie beside the grid
#endif
                        const vec spread = window_of(window, phase[i], between[i]);
                        __global float* out = GRID_OF(node, 0) + at[i];
                        for (int k = 0; k < some; k++, out += 2 * points) {
                            for (int part = 0; part <= ENVELOPE; part++) {
                                __global loose_vec* into = (__global loose_vec*)(out + part * points);
                                *into = *into + spread * gain[k][part][i];
                            }
                        }
                    }
                }
            }
            for (int u = 0; u < UNITS; u++) {
                for (int k = 0; k < some; k++) {
                    const int function = (first_gain + k) / channels, channel = (first_gain + k) % channels;
                    __global const float* factors = inner + (first_unit + u) * (long)inner_stride + function * (long)spectrum;
                    __global float* sum = sums + (u * channels + channel) * (long)spectrum;
                    add_spectrum(&of, GRID_OF(u * NODES_IN_UNIT, k), factors, sum, function == 0);
                }
            }
        }
        for (int u = 0; u < UNITS; u++) {
            for (int channel = 0; channel < channels; channel++) {
                __global const float* factors = outer + (first_unit + u) * (long)outer_stride;
                transform_back(&of, sums + (u * channels + channel) * (long)spectrum, factors, grids);
                __global float* out = received + (((first_unit + u) * (long)receivers + receiver) * channels + channel) * 2 * (long)stride;
                weigh(&of, grids, first_sample, length, weights, out);
                weigh(&of, grids + points, first_sample + apart, length, weights, out + stride);
            }
        }
    }
}
