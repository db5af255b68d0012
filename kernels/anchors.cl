// Delays and their rates at both ends of every walk, by the receiver's clock, from which those between are predicted.
// Work-item: dimension 0 counts slots (paths), dimension 1 ends of walks, the first of them one walk before the run.

__kernel void anchors(__global const double* image_matrix, __global const double* image_offset,
                      __global const int* receiver_of, __global const double* receivers, int ends,  // as in tracks.cl
                      __global const double* knots, int knot_count, double knot_first, double knot_rate, double start,
                      double walk_time, double speed_of_sound, __global double* anchor)  // [ends][2][slots]
{
    const int slot = get_global_id(0), slots = get_global_size(0), end = get_global_id(1);
    const motion path = {knots, knot_count, knot_first, knot_rate, 1.0 / speed_of_sound};
    const triple offset = {image_offset[slot], image_offset[slots + slot], image_offset[2 * slots + slot]};
    __global const double* row = receivers + (STILL ? receiver_of[slot] : (long)receiver_of[slot] * ends + end) * 14;
    arrival a;
    settle(&path, turned_back(image_matrix, slots, slot, difference(at_row(row), offset)),
           turned_back(image_matrix, slots, slot, at_row(row + 3)), start + (end - 1) * walk_time + row[12], 1e-14, &a);
    anchor[2 * end * (long)slots + slot] = a.delay - row[12];
    anchor[(2 * end + 1) * (long)slots + slot] = a.rate * row[13] - (row[13] - 1.0);
}
