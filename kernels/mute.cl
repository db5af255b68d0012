// Takes the paths that were added sample by sample out of their blocks. Work-item: one slot and block.

__kernel void mute(int n, __global const int* slot, __global const int* block, int functions, __global float* nodes, int slots)
{
    const int e = get_global_id(0), count = terms(functions);
    if (e >= n) return;
    __global float* c = nodes + place_of(block[e], slot[e], functions, slots);
    for (int i = DELAY_TERMS; i < count; i++) c[i * APART(slots)] = 0.0f;
}
