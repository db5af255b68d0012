// Vectors of three numbers in float64.

typedef struct {
    double x, y, z;
} triple;

static double inner(triple a, triple b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
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
static triple times(double factor, triple a)
{
    const triple out = {factor * a.x, factor * a.y, factor * a.z};
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
