// Points of the outlines of ellipsoids and capsules as seen along the line of sight, several side by side: twin of
// acoustics/outline.py.

#if VERTEX >= SCATTERER && PARTS == 2
#define POINT_COLUMNS 6  // of the table of points: cosine, sine, sign, whether on a side, place there from -1 to 1, share of the length
#define TINY 1e-30

// Points of an outline and the ellipses in which planes across them cut the body, `OutlinePoints`.
typedef struct {
    reals support, q_nn, q_nz, q_zz, depth, source, receiver, beside, step;
} outline_points;

// The line of sight in the frame of a scatterer, m, and what its outline's points have in common.
typedef struct {
    double source[3], receiver[3], sight[3], one[3], other[3];
    double axes[3];            // of an ellipsoid; of a capsule the radius and, along z, half of the whole length, m
    double straight;           // of a capsule: half of the distance of both half circles along the axis, m
    double first, both, last;  // of an ellipsoid: root of the projection of the squared axes; of a capsule: sine, side, half circle
    double wide[3], slant[2];  // of an ellipsoid: squared axes across the line of sight, and between that and both directions across
    double sharp[6];           // likewise the inverse ones: across, between, and along
    int is_capsule;
} outline;

static double faded(double x, double whole, double none)
{
    const double part = fmin(fmax((x - none) / (whole - none), 0.0), 1.0);
    return part * part * (3.0 - 2.0 * part);
}

static double dot_of(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static void cross_of(const double* a, const double* b, double* c)
{
    for (int i = 0; i < 3; i++) c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}
static double of_length(double* a)
{
    const double size = sqrt(dot_of(a, a));
    for (int i = 0; i < 3; i++) a[i] /= size + TINY;
    return size;
}

// `o` has both ends, the axes and the kind.
static void look_along(outline* o)
{
    for (int i = 0; i < 3; i++) o->sight[i] = o->receiver[i] - o->source[i];
    of_length(o->sight);
    int least = 0;
    for (int i = 1; i < 3; i++) least = fabs(o->sight[i]) < fabs(o->sight[least]) ? i : least;
    const double from[3] = {least == 0, least == 1, least == 2};
    cross_of(o->sight, from, o->one);
    of_length(o->one);
    if (o->is_capsule) {
        double axis[3] = {-o->sight[2] * o->sight[0], -o->sight[2] * o->sight[1], 1.0 - o->sight[2] * o->sight[2]};
        o->first = of_length(axis);
        for (int i = 0; i < 3; i++) o->one[i] = o->first > 1e-9 ? axis[i] : o->one[i];
        o->straight = (o->axes[2] - o->axes[0]) * faded(o->first, NEAR_AXIS, 0.0);
        o->both = 2.0 * o->straight * o->first;
        o->last = HALF_TURN * o->axes[0];
    }
    cross_of(o->sight, o->one, o->other);
    if (!o->is_capsule) {
        double p[3], q[3];
        for (int i = 0; i < 3; i++) p[i] = o->axes[i] * o->one[i], q[i] = o->axes[i] * o->other[i];
        const double pp = dot_of(p, p), pq = dot_of(p, q), qq = dot_of(q, q), area = sqrt(pp * qq - pq * pq);
        const double over = 1.0 / sqrt(pp + qq + 2.0 * area);
        o->first = (pp + area) * over, o->both = pq * over, o->last = (qq + area) * over;
        double s[3], x[3], y[3], z[3];
        for (int i = 0; i < 3; i++) {
            s[i] = o->axes[i] * o->sight[i], x[i] = o->one[i] / o->axes[i], y[i] = o->other[i] / o->axes[i], z[i] = o->sight[i] / o->axes[i];
        }
        o->wide[0] = pp, o->wide[1] = pq, o->wide[2] = qq, o->slant[0] = dot_of(p, s), o->slant[1] = dot_of(q, s);
        const double inverse[6] = {dot_of(x, x), dot_of(x, y), dot_of(y, y), dot_of(x, z), dot_of(y, z), dot_of(z, z)};
        for (int i = 0; i < 6; i++) o->sharp[i] = inverse[i];
    }
}

// Bound of the largest rate of the phase along the table of points, over the wave number, m: `turning`.
static double turning_of(const outline* o, double largest)
{
    const double* u = o->sight;
    const double along = fabs(dot_of(o->source, o->one)), aside = fabs(dot_of(o->source, o->other));
    double most, reach;
    if (o->is_capsule) {
        const double side = o->both * (0.4625 * o->both + 2.0 * along), off = along + 0.5 * o->both;
        most = (2.0 / HALF_TURN) * fmax(side, 2.0 * o->last * sqrt(aside * aside + off * off));
        reach = o->straight * fabs(u[2]);
    } else {
        const double middle = 0.5 * (o->first + o->last), apart_by = 0.5 * (o->first - o->last);
        const double parted = sqrt(apart_by * apart_by + o->both * o->both);  // of the difference of the outline's semi-axes
        double squared = 0.0, inverse = 0.0;
        for (int i = 0; i < 3; i++) squared += u[i] * u[i] * o->axes[i] * o->axes[i], inverse += u[i] * u[i] / (o->axes[i] * o->axes[i]);
        most = 2.0 * middle * parted + sqrt(along * along + aside * aside) * (middle + parted);
        reach = sqrt(fmax(squared - 1.0 / inverse, 0.0));
    }
    const double behind = -dot_of(o->source, u) - reach, ahead = dot_of(o->receiver, u) - reach, least = NEAREST_END * largest;
    return most * (1.0 / fmax(behind, least) + 1.0 / fmax(ahead, least));
}

// Numbers and place of the points that an outline needs as its ends are now, `counts_of_points`. Its table has how many steps there are,
// fewest points, largest wave number, most points, largest radius; of each step most points asked, points, place.
static __global const double* points_asked(const outline* o, __global const double* tables, int first, int* count)
{
    __global const double* head = tables + first;
    const int steps = (int)head[0];
    const double asked = fmin(head[1] + head[2] * turning_of(o, head[4]), head[3]);
    int step = 0;
    while (step + 1 < steps && asked > head[5 + 3 * step]) step++;
    *count = (int)head[6 + 3 * step];
    return tables + (int)head[7 + 3 * step];
}

// Coordinates of points are sums of those of both directions across the line of sight.
static outline_points points_at(const outline* o, __global const double* table)
{
#if NODES_AT_ONCE == 4
typedef reals __attribute__((aligned(8))) point_reals;  // may start at any double
#define POINT_ROW(i) (*(__global const point_reals*)(table + NODES_AT_ONCE * (i)))
#else
#define POINT_ROW(i) table[i]
#endif
    const reals cosine = POINT_ROW(0), sine = POINT_ROW(1), sign = POINT_ROW(2), on_side = POINT_ROW(3), at = POINT_ROW(4), share = POINT_ROW(5);
    outline_points p;
    const double over = dot_of(o->source, o->one), aside = dot_of(o->source, o->other);
    const double behind = dot_of(o->source, o->sight), ahead = dot_of(o->receiver, o->sight);
    if (o->is_capsule) {
        const double radius = o->axes[0], short_of = radius / o->axes[2];
        const reals u = sign * cosine, v = sign * sine, up = sign * at * o->straight;  // of the half circle, along the axis
        p.depth = u * over + v * aside - radius - up * (u * o->one[2] + v * o->other[2]);
        p.beside = u * aside - v * over - up * (u * o->other[2] - v * o->one[2]);
        p.source = behind - up * o->sight[2], p.receiver = ahead - up * o->sight[2];
        p.support = radius;
        p.q_nn = 1.0 / (radius * radius), p.q_nz = 0.0;
        p.q_zz = p.q_nn * (1.0 + on_side * (fmax(o->first * o->first, short_of * short_of) - 1.0));
        p.step = share * (o->last + on_side * (o->both - o->last));
        return p;
    }
    const reals a = o->last * cosine - o->both * sine, b = o->first * sine - o->both * cosine, size = inverse_root(a * a + b * b);
    const reals c = o->both * cosine - o->first * sine, u = a * size, v = b * size, uu = u * u, uv = u * v, vv = v * v;
    const reals squared = o->wide[0] * uu + 2.0 * o->wide[1] * uv + o->wide[2] * vv, inverse = inverse_root(squared);
    const reals up = (o->slant[0] * u + o->slant[1] * v) * inverse;
    p.support = squared * inverse;
    p.depth = u * over + v * aside - p.support;
    p.beside = u * aside - v * over - ((o->wide[2] - o->wide[0]) * uv + o->wide[1] * (uu - vv)) * inverse;
    p.source = behind - up, p.receiver = ahead - up;
    p.q_nn = o->sharp[0] * uu + 2.0 * o->sharp[1] * uv + o->sharp[2] * vv;
    p.q_nz = o->sharp[3] * u + o->sharp[4] * v, p.q_zz = o->sharp[5];
    p.step = share * root(c * c + a * a);
    return p;
}
#endif
