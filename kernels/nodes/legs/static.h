// Static legs: images of the source by walls at rest, which are isometries, and receivers as these see them. Of a path without a
// vertex one image per slot, as columns: a 3 x 3 matrix and an offset, by which the receiver is mirrored back into the source's own
// room. At an edge or a scatterer (TWO_SIDED, see path.h) both ends are seen from the vertex: rows of a matrix and a shift.

#if TWO_SIDED
static triples turned(__global const double* m, triples v)
{
    const triples out = {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
                         m[6] * v.x + m[7] * v.y + m[8] * v.z};
    return out;
}
static triples seen_at(__global const double* turn, __global const double* shift, triples place)
{
    const triples v = turned(turn, place), out = {v.x + shift[0], v.y + shift[1], v.z + shift[2]};
    return out;
}
#endif

typedef struct {
    double position[3], velocity[3], axes[2][3];  // of the receiver; its third axis is the product of both
    double clock_error, clock_rate;               // how much later its samples are taken, and true seconds in one of its own
} receiver_node;

static triple image_offset_of(__global const double* offset, int slots, int slot)
{
#if TWO_SIDED
    const triple out = {0.0, 0.0, 0.0};
#else
    const triple out = {offset[slot], offset[(long)slots + slot], offset[2 * (long)slots + slot]};
#endif
    return out;
}

static triple triple_of(const triples* x, int i)
{
    const triple out = {OF_NODE(x->x, i), OF_NODE(x->y, i), OF_NODE(x->z, i)};
    return out;
}

// Vectors by the transposed matrix of an image.
static triples turned_back(__global const double* matrix, long slots, int slot, triples v)
{
    __global const double* m = matrix + slot;
    const triples out = {m[0] * v.x + m[3 * slots] * v.y + m[6 * slots] * v.z,
                         m[slots] * v.x + m[4 * slots] * v.y + m[7 * slots] * v.z,
                         m[2 * slots] * v.x + m[5 * slots] * v.y + m[8 * slots] * v.z};
    return out;
}

// Receivers as seen from the source's own room, or by what a path turns round or is scattered by: where they are, how they move and turn, and their clocks.
typedef struct {
    listener ear;
    triples frame[3];
    reals clock_error, clock_rate;  // as of a receiver_node
} receivers_in_image;

// Those of nodes side by side; of receivers at rest there is one row.
#define OF_ROWS(field) SIDE_BY_SIDE(row, ->field)
static receivers_in_image receivers_at(const trajectory* path, __global const double* image_matrix, int slots, int slot,
                                       triple offset, __global const view* seen, __global const receiver_node* node)
{
    receivers_in_image out;
    __global const receiver_node* row[NODES_AT_ONCE];
#pragma unroll
    for (int i = 0; i < NODES_AT_ONCE; i++) row[i] = node + (STATIC_RECEIVERS ? 0 : i);
    const triples at = {OF_ROWS(position[0]), OF_ROWS(position[1]), OF_ROWS(position[2])};
    const triples apart = {at.x - offset.x, at.y - offset.y, at.z - offset.z};
    const triples velocity = {OF_ROWS(velocity[0]), OF_ROWS(velocity[1]), OF_ROWS(velocity[2])};
#if TWO_SIDED
    out.ear.position = seen_at(seen->receiver_turn, seen->receiver_shift, at);
    out.ear.velocity = turned(seen->receiver_turn, velocity);
#else
    out.ear.position = turned_back(image_matrix, slots, slot, apart);
    out.ear.velocity = turned_back(image_matrix, slots, slot, velocity);
#endif
#if WIND
    const triples wind = {path->wind.x, path->wind.y, path->wind.z};
#if TWO_SIDED
    out.ear.wind = turned(seen->receiver_turn, wind);
#else
    out.ear.wind = turned_back(image_matrix, slots, slot, wind);
#endif
    out.ear.downwind = DOT(at, wind);
#endif
#if RECEIVER_DIRECTIVITY != OMNI
    const triples x = {OF_ROWS(axes[0][0]), OF_ROWS(axes[0][1]), OF_ROWS(axes[0][2])};
    out.frame[0] = TWO_SIDED ? x : turned_back(image_matrix, slots, slot, x);
#endif
#if RECEIVER_DIRECTIVITY >= SPHERICAL
    const triples y = {OF_ROWS(axes[1][0]), OF_ROWS(axes[1][1]), OF_ROWS(axes[1][2])};
    const triples z = {x.y * y.z - x.z * y.y, x.z * y.x - x.x * y.z, x.x * y.y - x.y * y.x};
    out.frame[1] = TWO_SIDED ? y : turned_back(image_matrix, slots, slot, y);
    out.frame[2] = TWO_SIDED ? z : turned_back(image_matrix, slots, slot, z);
#endif
    out.clock_error = OF_ROWS(clock_error);
    out.clock_rate = OF_ROWS(clock_rate);
    return out;
}
