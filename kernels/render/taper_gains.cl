// Multiplies the gains of blocks by what tapers leave of paths. Work-item: one slot, of which there is one taper at most.
// Cubics are those through the products at Chebyshev's four points, cos(pi / 8) and cos(3 pi / 8) at either side.

#define OUTER 0.9238795325f
#define INNER 0.3826834324f

// Multiply a cubic by weights at these points; its terms are `power` from each other.
static void weigh(const float weight[4], int power, __global float* c)
{
    const float places[4] = {-OUTER, -INNER, INNER, OUTER}, per_square = 1.0f / (OUTER * OUTER - INNER * INNER);
    float v[4];
    for (int i = 0; i < 4; i++) v[i] = weight[i] * CUBIC(c[0], c[power], c[2 * power], c[3 * power], places[i]);
    const float outer = 0.5f * (v[3] + v[0]), inner = 0.5f * (v[2] + v[1]);
    const float along_outer = 0.5f * (v[3] - v[0]) / OUTER, along_inner = 0.5f * (v[2] - v[1]) / INNER;
    c[2 * power] = (outer - inner) * per_square;
    c[3 * power] = (along_outer - along_inner) * per_square;
    c[0] = inner - INNER * INNER * c[2 * power];
    c[power] = along_inner - INNER * INNER * c[3 * power];
}

__kernel void taper_gains(int functions, __global const int* activity, int slots, int first_block, int blocks,
                          int block_samples, float ramp,                          // samples; of a transition
                          __global const float* rise, __global const float* fall,  // [slots], samples of the run
                          __global const float* terms, float per_half,            // as in taper.h
                          __global float* polynomials)
{
    const int slot = get_global_id(0);
    const float per_block = 1.0f / (float)block_samples, length = 2.0f / per_half;
    const float begin = fall[slot] < FAR ? fall[slot] - length : rise[slot];
    // What is left of a path is active for half of a transition beyond the taper, and computed for whole blocks.
    const float from = (begin - ramp) * per_block - 1.0f, until = (begin + length + ramp) * per_block + 2.0f;
    const int first = from < 0.0f ? 0 : from < (float)blocks ? (int)from : blocks;
    const int last = until < 0.0f ? 0 : until < (float)blocks ? (int)until : blocks;
    for (int block = first; block < last; block++) {
        const int row = first_block + block;
#if SPARSE
        if (activity[row * (long)slots + slot] == 0) continue;
#endif
        float weight[4];
        const float places[4] = {-OUTER, -INNER, INNER, OUTER};
        for (int i = 0; i < 4; i++) {
            const float at = ((float)block + 0.5f + 0.5f * places[i]) * (float)block_samples;
            weight[i] = 1.0f - taken(at - rise[slot], at - fall[slot], per_half, terms);
        }
        __global float* c = polynomials + place_of(row, slot, functions, slots) + DELAY_TERMS * BESIDE;
        for (int k = 0; k < functions; k++) weigh(weight, functions * BESIDE, c + k * BESIDE);
    }
}
