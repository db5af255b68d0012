// The walls of a room in float64, and distances between segments.

typedef struct {
    double from[3], to[3];
} edge_ends;

typedef struct {
    double tolerance;                // m, how far outside its outline a point still is on a wall
    double thickness;                // m, how far edges lie from the planes of their walls
    __global const double4* plane;   // unit normal and offset
    __global const double4* sphere;  // centre and radius
    __global const int* same;        // equal for walls in one plane; below 0 for those that hide nothing
    __global const int* first_edge;  // where the edges, pieces and twins of a wall begin, and the lines of a piece
    __global const int* first_piece;
    __global const int* first_line;
    __global const int* first_twin;
    __global const edge_ends* edge;  // [edges]
    __global const double4* line;    // x is inside if inner(line, x) >= line.w
    __global const int* twin;        // walls of lower index in the same plane
    wall_tree tree;
} room;

static double height(double4 plane, triple x) { return plane.x * x.x + plane.y * x.y + plane.z * x.z - plane.w; }
static triple mirrored(double4 plane, triple x)
{
    const triple normal = {plane.x, plane.y, plane.z};
    return sum(x, times(-2.0 * height(plane, x), normal));
}
static double unit_range(double x) { return x < 0.0 ? 0.0 : x < 1.0 ? x : 1.0; }

// The convex piece of a wall that a point of the wall's plane lies on, or is less than `beyond` away from, m; or -1.
static int piece_at(const room* walls, int wall, triple x, double beyond)
{
    for (int piece = walls->first_piece[wall]; piece < walls->first_piece[wall + 1]; piece++) {
        int inside = 1;
        for (int i = walls->first_line[piece]; i < walls->first_line[piece + 1] && inside; i++) {
            inside = height(walls->line[i], x) >= -beyond;
        }
        if (inside) return piece;
    }
    return -1;
}
static int holds(const room* walls, int wall, triple x) { return piece_at(walls, wall, x, walls->tolerance) >= 0; }

// Square of the distance between the segments a + s u and b + t v, s and t from 0 to 1.
static double segments_apart(triple a, triple u, triple b, triple v)
{
    const triple w = difference(a, b);
    const double uu = inner(u, u), uv = inner(u, v), vv = inner(v, v), uw = inner(u, w), vw = inner(v, w);
    const double determinant = uu * vv - uv * uv;
    double s = determinant > PARALLEL * uu * vv ? unit_range((uv * vw - vv * uw) / determinant) : 0.0;
    const double t = unit_range((uv * s + vw) / vv);
    s = uu > 0.0 ? unit_range((uv * t - uw) / uu) : 0.0;
    const triple apart = sum(w, difference(times(s, u), times(t, v)));
    return inner(apart, apart);
}

// Square of the distance from a segment to the nearest edge of a wall; no less than `enough` is looked for.
static double edges_apart(const room* walls, int wall, triple a, triple b, double enough, double most)
{
    const triple u = difference(b, a);
    double least = most;
    for (int i = walls->first_edge[wall]; i < walls->first_edge[wall + 1] && least > enough; i++) {
        const triple from = at_row(walls->edge[i].from), to = at_row(walls->edge[i].to);
        const double squared = segments_apart(a, u, from, difference(to, from));
        least = squared < least ? squared : least;
    }
    return least;
}

// Square of the distance from a point to a segment.
static double point_apart(triple x, triple a, triple b)
{
    const triple u = difference(b, a), w = difference(x, a);
    const double uu = inner(u, u);
    const triple apart = difference(w, times(uu > 0.0 ? unit_range(inner(u, w) / uu) : 0.0, u));
    return inner(apart, apart);
}
