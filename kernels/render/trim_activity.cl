// Leaves of a path's activity in a block what has no transition: `fades.cl` adds all others. Work-item: one
// slot and block.

__kernel void trim_activity(int count, __global const int* slot_of, __global const int* block,
                            __global const float* start, __global const float* end,  // [count], samples of the block
                            float per_ramp, int subblock,
                            __global int* activity, int slots)
{
    const int i = get_global_id(0);
    if (i >= count) return;
    __global int* mask = activity + block[i] * (long)slots + slot_of[i];
    int first = MASK_FIRST(*mask), last = MASK_END(*mask);
    while (first < last && !is_steady(first, subblock, start[i], end[i], per_ramp)) first++;
    while (first < last && !is_steady(last - 1, subblock, start[i], end[i], per_ramp)) last--;
    *mask = first < last ? MASK(first, last) : 0;
}
