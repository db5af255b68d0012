// Ends of paths as seen from where these turn at an edge or are scattered: rows of a matrix and a shift.

#define TWO_SIDED (EDGES || SCATTERERS)

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
