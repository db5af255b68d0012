// Images of the source, and receivers as these are heard by them: the receiver, mirrored back into the source's own room.
// One image per slot, as columns: a 3 x 3 matrix and an offset.

typedef struct {
    double position[3], velocity[3], axes[2][3];  // of the receiver; its third axis is the product of both
    double clock_error, clock_rate;               // how much later its samples are taken, and true seconds in one of its own
} receiver_node;

static triple image_offset_of(__global const double* offset, int slots, int slot)
{
    const triple out = {offset[slot], offset[slots + slot], offset[2 * slots + slot]};
    return out;
}

// A vector by the transposed matrix of an image.
static triple turned_back(__global const double* matrix, int slots, int slot, triple v)
{
    __global const double* m = matrix + slot;
    const triple out = {m[0] * v.x + m[3 * slots] * v.y + m[6 * slots] * v.z,
                        m[slots] * v.x + m[4 * slots] * v.y + m[7 * slots] * v.z,
                        m[2 * slots] * v.x + m[5 * slots] * v.y + m[8 * slots] * v.z};
    return out;
}
