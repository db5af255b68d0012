// Vectors of three numbers.

#define NEAREST 1e-7f  // m, least length of a way, as in paths/propagation.py: sources that are silent may be met

typedef struct {
    real x, y, z;
} triple;

static real inner(triple a, triple b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static triple difference(triple a, triple b)
{
    const triple out = {a.x - b.x, a.y - b.y, a.z - b.z};
    return out;
}
static triple sum(triple a, triple b)
{
    const triple out = {a.x + b.x, a.y + b.y, a.z + b.z};
    return out;
}
static triple times(real factor, triple a)
{
    const triple out = {factor * a.x, factor * a.y, factor * a.z};
    return out;
}
static triple cross_product(triple a, triple b)
{
    const triple out = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    return out;
}
static triple at_row(__global const real* row)
{
    const triple out = {row[0], row[1], row[2]};
    return out;
}

// Value of the cubics whose coefficients stand at `c` as [power][3].
static triple cubic(__global const real* c, real u)
{
    const triple out = {c[0] + u * (c[3] + u * (c[6] + u * c[9])), c[1] + u * (c[4] + u * (c[7] + u * c[10])),
                        c[2] + u * (c[5] + u * (c[8] + u * c[11]))};
    return out;
}
