// Write what sounds of the emitted signal to its places among silence, or clear these again. Work-item: dimension 0
// counts what sounds, dimension 1 rows.

__kernel void emit(int count, __global const int* places, __global const float* values,  // [count], [rows][count]
                   int clear, long stride, __global float* emitted)                      // [rows][stride]
{
    const long i = get_global_id(0), row = get_global_id(1);
    if (i < count) emitted[row * stride + places[i]] = clear ? 0.0f : values[row * count + i];
}
