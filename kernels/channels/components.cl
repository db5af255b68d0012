// Impulse responses of a receiver with ears at nodes (instants), spread over grids as in scatter.cl. Each path is added to the
// components of the responses by its weight for each, which its direction gives: components stand side by side at a point of a
// grid. There is a grid for each function of frequency; functions that add little have few components. Work-item: a node.

#define TILE (FUNCTIONS > 32 ? 64 : 256)  // paths that are evaluated at a time: their results stay in cache

__kernel void components(__global const int* delay, __global const float* polynomials,  // as in render.cl
                         int slots, int functions,
                         __global const int* node_block, __global const float* node_place,  // [nodes], as in scatter.cl
                         __global const float* node_sample, int nodes,
                         __global const float* rise, __global const float* fall,  // [slots], where paths are TAPERED
                         __global const float* terms, float per_half,             // as in taper.h
                         int first_slot, int last_slot,     // of the receiver; multiples of BESIDE
                         __global const float* window,      // [PHASES + 3][2][TAPS]
                         __global const float* weights,     // [nodes][slots of the receiver][room]
                         int room,                          // components, whole vectors
                         __global const int* vectors,       // [functions], of components
                         int first, float shift,            // as in scatter.cl
                         int points,                        // of a grid
                         __global float* grids)             // [nodes][functions][points][components]
{
    const int node = get_global_id(0), power = functions * BESIDE, row = node_block[node];
    const float t = node_place[node];
    int each = 0;
    for (int k = 0; k < functions; k++) each += LANES * vectors[k];
    __global float* made = grids + node * (long)each * points;
    for (long i = 0; i < (long)each * points; i++) made[i] = 0.0f;
    int at[TILE], phase[TILE];
    float between[TILE], gain[FUNCTIONS][TILE];
#if TAPERED
    float weight[TILE];
#endif
    for (int from = first_slot; from < last_slot; from += TILE) {
        const int here = min(last_slot - from, TILE);
        for (int i = 0; i < here; i += LANES) {
            __global const float* c = polynomials + place_of(row, from + i, functions, slots);
            __global const int* whole = delay + row * (long)slots + from + i;
            const vec rest = CUBIC(LOAD(c), LOAD(c + BESIDE), LOAD(c + 2 * BESIDE), LOAD(c + 3 * BESIDE), t);
            find_places(*(__global const loose_ivec*)whole - first, rest + shift, at + i, phase + i, between + i);
#if TAPERED
            const float sample = node_sample[node];
            const vec share = taken(sample - LOAD(rise + from + i), sample - LOAD(fall + from + i), per_half, terms);
            *(loose_vec*)(weight + i) = share;
#endif
            for (int k = 0; k < functions; k++) {
                __global const float* g = c + (DELAY_TERMS + k) * BESIDE;
                vec own = CUBIC(LOAD(g), LOAD(g + power), LOAD(g + 2 * power), LOAD(g + 3 * power), t);
#if TAPERED
                own *= share;
#endif
                *(loose_vec*)(gain[k] + i) = own;
            }
        }
        for (int i = 0; i < here; i++) {
#if TAPERED
            if (weight[i] == 0.0f) continue;  // its place may lie beside the grid
#endif
            float spread[TAPS];
            *(loose_vec*)spread = window_of(window, phase[i], between[i]);
            __global const float* own = weights + (node * (long)(last_slot - first_slot) + from - first_slot + i) * room;
            __global float* grid = made;
            for (int k = 0; k < functions; k++) {
                const int beside = LANES * vectors[k];
                __global float* out = grid + at[i] * (long)beside;
                for (int j = 0; j < TAPS; j++, out += beside) {
                    const float share = spread[j] * gain[k][i];
                    for (int m = 0; m < beside; m += LANES) *(__global loose_vec*)(out + m) = LOAD(out + m) + LOAD(own + m) * share;
                }
                grid += (long)points * beside;
            }
        }
    }
}
