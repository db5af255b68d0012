// The straight line from the source mirrored k times to the receiver mirrored back, in the real space of each leg. Leg k
// runs from wall k to wall k + 1 (0 is the source, ORDER + 1 the receiver); the line meets wall k at the share tau[k].

typedef struct {
    triple from[ORDER + 1], to[ORDER + 1];  // ends of the unfolded line in the real space of each leg
    double tau[ORDER + 2];
    double slack[ORDER + 2];                // how far tau can move while the ends move by `reach`
    double source_reach, receiver_reach;
    triple from_facing[ORDER + 1], to_facing[ORDER + 1];  // mirrored normals of walls that the ends sit in, or 0
} unfolded;

static triple along(const unfolded* path, int leg, double tau)
{
    return sum(path->from[leg], times(tau, difference(path->to[leg], path->from[leg])));
}

// How far a point at a share of a leg's line may move across planes of a normal: ends in a wall slide along it.
static double across(const unfolded* path, int leg, double tau, double4 plane)
{
    const triple normal = {plane.x, plane.y, plane.z};
    const double start = inner(path->from_facing[leg], normal), stop = inner(path->to_facing[leg], normal);
    return (1.0 - tau) * path->source_reach * sqrt(fmax(1.0 - start * start, 0.0)) +
           tau * path->receiver_reach * sqrt(fmax(1.0 - stop * stop, 0.0));
}

static double ratio(double height, double move) { return move > 0.0 ? height / move : EVER; }

static triple turned(double4 plane, triple direction)
{
    plane.w = 0.0;
    return mirrored(plane, direction);
}

// Ends are a step in front of the walls that they sit in, whose planes are `source_mount` and `receiver_mount`, or 0.
// Shares and slacks of walls are left to `reflects`.
static void unfold(const room* walls, __global const int* sequence, triple source, triple receiver,
                   double source_reach, double receiver_reach, double4 source_mount, double4 receiver_mount,
                   unfolded* path)
{
    const triple source_facing = {source_mount.x, source_mount.y, source_mount.z};
    const triple receiver_facing = {receiver_mount.x, receiver_mount.y, receiver_mount.z};
    path->from[0] = source;
    path->to[ORDER] = receiver;
    path->from_facing[0] = source_facing;
    path->to_facing[ORDER] = receiver_facing;
    path->source_reach = source_reach;
    path->receiver_reach = receiver_reach;
    for (int k = 0; k < ORDER; k++) {
        path->from[k + 1] = mirrored(walls->plane[sequence[k]], path->from[k]);
        path->from_facing[k + 1] = turned(walls->plane[sequence[k]], path->from_facing[k]);
    }
    for (int k = ORDER; k > 0; k--) {
        path->to[k - 1] = mirrored(walls->plane[sequence[k - 1]], path->to[k]);
        path->to_facing[k - 1] = turned(walls->plane[sequence[k - 1]], path->to_facing[k]);
    }
    path->tau[0] = path->slack[0] = path->slack[ORDER + 1] = 0.0;
    path->tau[ORDER + 1] = 1.0;
}
