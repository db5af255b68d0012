// The impulse response of a receiver at one instant, for each function of frequency: every path is spread over eight
// points of a grid, five to four samples, by a Kaiser-Bessel window (render/channel_grid.py). Work-item: dimension 0
// counts groups of nodes (instants), dimension 1 receivers. Paths are evaluated some at a time, at all nodes of a group,
// before they are spread: among so many places that are written, polynomials would come from memory line by line.
// Neighbouring slots have delays that lie far apart, so that what one path adds does not wait for what the last one wrote.
// Responses of envelopes (DELAY_TERMS == 8) are turned by the carrier: of each function, a grid of real parts and one of imaginary ones.
// Where a receiver has COMPONENTS, each path is added to those of its direction, by its weight for each: they stand side by side
// at a point. Functions that add little have few of them.

#define TILE (FUNCTIONS > 32 ? 64 : 256)  // paths that are evaluated at a time: their results stay in cache
#define ENVELOPE (DELAY_TERMS == 8)
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
                      __global const float* weights,     // [nodes][slots of the receiver][room]: of COMPONENTS
                      int room,                          // components, whole vectors
                      __global const int* vectors,       // [functions], of components
                      int first,                         // samples of delay at the grid's beginning
                      float shift,                       // samples that are added to all delays
                      int points,                        // of a grid
                      int reached,                       // of these, now or before: the others are 0
                      ulong turn_per_sample,             // of the carrier; one turn is 2^64
                      float half_turns_per_sample,
                      __global float* grids)             // [nodes][receivers][functions][1 + ENVELOPE][points]([components])
{
    const int receiver = get_global_id(1), first_node = get_global_id(0) * TOGETHER, power = functions * BESIDE;
    const int last_node = first_node + TOGETHER < nodes ? first_node + TOGETHER : nodes;
#if COMPONENTS
    int each = 0;
    for (int k = 0; k < functions; k++) each += LANES * vectors[k];
#else
    const int each = functions * (1 + ENVELOPE);
#endif
    const long of_node = (long)receivers * each * points;
    __global float* made = grids + receiver * (long)each * points;
    for (int node = first_node; node < last_node; node++) {
        __global float* out = made + node * of_node;
        for (int k = 0; k < functions * (1 + ENVELOPE); k++) {
            const int beside = COMPONENTS ? LANES * vectors[k] : 1;
            for (long i = 0; i < (long)reached * beside; i++) out[i] = 0.0f;
            out += (long)points * beside;
        }
    }
    int at[TILE], phase[TILE];
    float between[TILE], gain[FUNCTIONS][TILE];
#if TAPERED
    float weight[TILE];
#endif
    for (int from = first_slot[receiver]; from < first_slot[receiver + 1]; from += TILE) {
        const int count = min(first_slot[receiver + 1] - from, TILE);
        for (int node = first_node; node < last_node; node++) {
            const float t = node_place[node];
            const int row = node_block[node];
            for (int i = 0; i < count; i += LANES) {
                __global const float* c = polynomials + place_of(row, from + i, functions, slots);
                __global const int* whole = delay + row * (long)slots + from + i;
                vec rest = CUBIC(LOAD(c), LOAD(c + BESIDE), LOAD(c + 2 * BESIDE), LOAD(c + 3 * BESIDE), t);
#if ENVELOPE
                rest += t * t * t * t * CUBIC(LOAD(c + 4 * BESIDE), LOAD(c + 5 * BESIDE), LOAD(c + 6 * BESIDE), LOAD(c + 7 * BESIDE), t);
                float turn[LANES];
                for (int j = 0; j < LANES; j++) turn[j] = whole_turn(whole[j], turn_per_sample);
                vec cosine, sine;
                half_turns(rest * half_turns_per_sample + *(loose_vec*)turn, &cosine, &sine);
#endif
                const ivec quarters = (*(__global const loose_ivec*)whole - first) * 5;
                const vec place = FLOATS_OF(quarters & 3) * 0.25f + (rest + shift) * 1.25f, down = rounded(place - 0.5f);
                const vec fine = (place - down) * (float)PHASES, left = rounded(fine - 0.5f);
                *(loose_ivec*)(at + i) = (quarters >> 2) + nearest(down) - (TAPS / 2 - 1);
                *(loose_ivec*)(phase + i) = nearest(left) + 1;
                *(loose_vec*)(between + i) = fine - left;
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
#if ENVELOPE
                    *(loose_vec*)(gain[2 * k] + i) = own * cosine;
                    *(loose_vec*)(gain[2 * k + 1] + i) = -own * sine;
#else
                    *(loose_vec*)(gain[k] + i) = own;
#endif
                }
            }
            for (int i = 0; i < count; i++) {
#if TAPERED
                if (weight[i] == 0.0f) continue;  // its place may lie beside the grid
#endif
                __global const float* w = window + phase[i] * (2 * TAPS);
                const vec spread = LOAD(w) + LOAD(w + TAPS) * between[i];
                __global float* out = made + node * of_node;
#if COMPONENTS
                float share[TAPS];
                *(loose_vec*)share = spread;
                __global const float* own = weights + (node * (long)(first_slot[receiver + 1] - first_slot[receiver]) + from - first_slot[receiver] + i) * room;
                for (int k = 0; k < functions; k++) {
                    const int beside = LANES * vectors[k];
                    __global float* here = out + (long)at[i] * beside;
                    for (int j = 0; j < TAPS; j++, here += beside) {
                        const float times = share[j] * gain[k][i];
                        for (int m = 0; m < beside; m += LANES) *(__global loose_vec*)(here + m) = LOAD(here + m) + LOAD(own + m) * times;
                    }
                    out += (long)points * beside;
                }
#else
                out += at[i];
                for (int k = 0; k < each; k++, out += points) {
                    *(__global loose_vec*)out = LOAD(out) + spread * gain[k][i];
                }
#endif
            }
        }
    }
}
