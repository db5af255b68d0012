// Boxes around walls and around groups of them, depth first. The twin of scene/room/wall_pairs.py.

typedef struct {
    int count;                       // of boxes
    __global const double4* middle;
    __global const double4* extent;
    __global const int* wall;        // of a box, -1 for a group
    __global const int* skip;        // the next box that is not in this one
} wall_tree;

static int axis_apart(double one, double other, double turn_one, double turn_other, double extent_one, double extent_other)
{
    return fabs(one * turn_other - other * turn_one) > fabs(one) * extent_other + fabs(other) * extent_one;
}

// Whether a box may be as near to the segment from a to b as `slack`: no face of either lies between, nor an edge of both.
static int near_segment(const wall_tree* tree, int box, triple a, triple b, double slack)
{
    const double4 middle = tree->middle[box], extent = tree->extent[box];
    const triple along = times(0.5, difference(b, a)), centre = times(0.5, sum(a, b));
    const double x = middle.x - centre.x, y = middle.y - centre.y, z = middle.z - centre.z;
    const double dx = extent.x + slack, dy = extent.y + slack, dz = extent.z + slack;
    if (fabs(x) > dx + fabs(along.x) || fabs(y) > dy + fabs(along.y) || fabs(z) > dz + fabs(along.z)) return 0;
    return !axis_apart(along.y, along.z, y, z, dy, dz) && !axis_apart(along.z, along.x, z, x, dz, dx) &&
           !axis_apart(along.x, along.y, x, y, dx, dy);
}
