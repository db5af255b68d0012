// Takes the paths that were added sample by sample out of their blocks. Work-item: one slot and block.

__kernel void mute(__global const int* slot, __global const int* block, __global float* nodes, int slots)
{
    const int e = get_global_id(0);
    for (int i = 4; i < COEFFICIENTS; i++) nodes[((long)block[e] * COEFFICIENTS + i) * slots + slot[e]] = 0.0f;
}
