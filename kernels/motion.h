// Positions of the source as cubics between evenly spaced knots, and of the receiver at the nodes; float64.

typedef struct {
    double x, y, z;
} triple;

static double inner(triple a, triple b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static triple difference(triple a, triple b)
{
    const triple out = {a.x - b.x, a.y - b.y, a.z - b.z};
    return out;
}
static triple cross_product(triple a, triple b)
{
    const triple out = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    return out;
}
static triple at_row(__global const double* row)
{
    const triple out = {row[0], row[1], row[2]};
    return out;
}

// Value of the cubics whose coefficients stand at `c` as [power][3].
static triple cubic(__global const double* c, double u)
{
    const triple out = {c[0] + u * (c[3] + u * (c[6] + u * c[9])), c[1] + u * (c[4] + u * (c[7] + u * c[10])),
                        c[2] + u * (c[5] + u * (c[8] + u * c[11]))};
    return out;
}
static triple cubic_rate(__global const double* c, double u)
{
    const triple out = {c[3] + u * (2 * c[6] + u * 3 * c[9]), c[4] + u * (2 * c[7] + u * 3 * c[10]),
                        c[5] + u * (2 * c[8] + u * 3 * c[11])};
    return out;
}

// One image per slot, as columns: a 3 x 3 matrix and an offset.
static triple turned_back(__global const double* matrix, int slots, int slot, triple v)
{
    __global const double* m = matrix + slot;
    const triple out = {m[0] * v.x + m[3 * slots] * v.y + m[6 * slots] * v.z,
                        m[slots] * v.x + m[4 * slots] * v.y + m[7 * slots] * v.z,
                        m[2 * slots] * v.x + m[5 * slots] * v.y + m[8 * slots] * v.z};
    return out;
}
