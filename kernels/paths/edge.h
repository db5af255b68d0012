// An edge of the room, and the shortest way over it: twin of `Edges` and of acoustics/diffraction.py.

typedef struct {
    double start[3], across[3], out[3], along[3];  // start, m, and unit vectors
    double length, n;                              // m; exterior angle over pi
} edge_of_room;

typedef struct {
    double r, angle, z;
} cylindrical;

static cylindrical about(__global const edge_of_room* edge, triple place)
{
    const triple away = difference(place, at_row(edge->start));
    const double x = inner(away, at_row(edge->across)), y = inner(away, at_row(edge->out));
    const double r = sqrt(x * x + y * y), angle = atan2(y, x), low = HALF_TURN * (0.5 * edge->n - 1.0);
    const double turned = angle < low ? angle + 2.0 * HALF_TURN : angle;  // from half of the wedge below its 0-face on
    const cylindrical out = {fmax(r, ON_LINE), r < ON_LINE ? 0.5 * HALF_TURN * edge->n : turned,
                             inner(away, at_row(edge->along))};
    return out;
}

// Direction from an edge into one of its faces: 0 or n.
static triple inward(__global const edge_of_room* edge, int face)
{
    const double angle = face ? HALF_TURN * edge->n : 0.0;
    return sum(times(cos(angle), at_row(edge->across)), times(sin(angle), at_row(edge->out)));
}

// What stands beyond another edge, about which it is at `at`, as an edge sees it that shares a face: both are rolled out
// into the plane of that face.
static cylindrical beyond(__global const edge_of_room* edge, int face, __global const edge_of_room* other, int other_face,
                          cylindrical at)
{
    const triple place = sum(sum(at_row(other->start), times(at.z, at_row(other->along))),
                             times(-at.r, inward(other, other_face)));
    const triple away = difference(place, at_row(edge->start));
    const cylindrical out = {inner(away, inward(edge, face)), 0.0, inner(away, at_row(edge->along))};
    return out;
}

static double way_length(cylindrical a, cylindrical b)
{
    const double across = a.r + b.r, along = a.z - b.z;
    return sqrt(across * across + along * along);
}

// The way over a place on the edge.
static double way_by(double place, cylindrical a, cylindrical b)
{
    return sqrt(a.r * a.r + (place - a.z) * (place - a.z)) + sqrt(b.r * b.r + (place - b.z) * (place - b.z));
}

static double way_apex(cylindrical a, cylindrical b) { return (a.z * b.r + b.z * a.r) / (a.r + b.r); }

// How far a place is inside the air of a wedge, m; negative within the wedge.
static double in_air(__global const edge_of_room* edge, cylindrical at)
{
    const double whole = HALF_TURN * edge->n;
    const double beside = fmin(fabs(at.angle), fabs(whole - at.angle));
    const double away = beside < 0.5 * HALF_TURN ? at.r * sin(beside) : at.r;
    return at.angle >= 0.0 && at.angle <= whole ? away : -away;
}
