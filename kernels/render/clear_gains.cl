// Clears the gains of paths that are added sample by sample from their blocks. Work-item: one slot and block.

__kernel void clear_gains(int count, __global const int* slot, __global const int* block, int functions,
                          __global float* polynomials, int slots)
{
    const int i = get_global_id(0);
    if (i >= count) return;
    __global float* c = polynomials + place_of(block[i], slot[i], functions, slots);
    for (int term = DELAY_TERMS; term < terms(functions); term++) c[term * BESIDE] = 0.0f;
}
