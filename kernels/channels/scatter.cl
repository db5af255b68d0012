// The impulse response of a receiver at one instant, for each function of frequency: every path is spread over eight
// points of a grid, five to four samples, by a Kaiser-Bessel window (render/channel_grid.py). Work-item: dimension 0
// counts nodes (instants), dimension 1 receivers. Neighbouring slots have delays that lie far apart, so that what one
// path adds does not wait for what the last one wrote.

#define OF(lanes, i) (((const int*)&lanes)[i])
#define OF_FLOATS(lanes, i) (((const float*)&lanes)[i])
#define FLOATS_OF(x) (AS_VEC((x) + ROUNDING_BITS) - ROUNDING)  // small whole numbers, see rounding.h

__kernel void scatter(__global const int* delay, __global const float* polynomials,  // as in render.cl
                      int slots, int functions,
                      __global const int* node_block,    // [nodes], of `delay` and `polynomials`
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
                      int points,                        // of a grid
                      __global float* grids)             // [nodes][receivers][functions][points]
{
    const int node = get_global_id(0), receiver = get_global_id(1);
    if (node >= nodes) return;
    __global float* grid = grids + (node * (long)receivers + receiver) * functions * points;
    const float t = node_place[node];
    const int row = node_block[node], power = functions * BESIDE;
    for (int i = 0; i < functions * points; i++) grid[i] = 0.0f;
    for (int slot = first_slot[receiver]; slot < first_slot[receiver + 1]; slot += BESIDE) {
        __global const float* c = polynomials + place_of(row, slot, functions, slots);
        const vec rest = CUBIC(LOAD(c), LOAD(c + BESIDE), LOAD(c + 2 * BESIDE), LOAD(c + 3 * BESIDE), t);
        const ivec quarters = (*(__global const loose_ivec*)(delay + row * (long)slots + slot) - first) * 5;
        const vec place = FLOATS_OF(quarters & 3) * 0.25f + (rest + shift) * 1.25f, down = rounded(place - 0.5f);
        const vec phase = (place - down) * (float)PHASES, left = rounded(phase - 0.5f), between = phase - left;
        const ivec at = (quarters >> 2) + nearest(down) - (TAPS / 2 - 1), whole = nearest(left) + 1;
#if TAPERED
        const vec weight = taken(node_sample[node] - LOAD(rise + slot), node_sample[node] - LOAD(fall + slot), per_half, terms);
#endif
        vec gain[FUNCTIONS];
        for (int k = 0; k < functions; k++) {
            __global const float* g = c + (DELAY_TERMS + k) * BESIDE;
            gain[k] = CUBIC(LOAD(g), LOAD(g + power), LOAD(g + 2 * power), LOAD(g + 3 * power), t);
#if TAPERED
            gain[k] *= weight;
#endif
        }
        for (int i = 0; i < BESIDE; i++) {
#if TAPERED
            if (OF_FLOATS(weight, i) == 0.0f) continue;
#endif
            __global const float* w = window + OF(whole, i) * (2 * TAPS);
            const vec spread = LOAD(w) + LOAD(w + TAPS) * OF_FLOATS(between, i);
            __global float* out = grid + OF(at, i);
            for (int k = 0; k < functions; k++, out += points) {
                *(__global loose_vec*)out = LOAD(out) + spread * OF_FLOATS(gain[k], i);
            }
        }
    }
}
