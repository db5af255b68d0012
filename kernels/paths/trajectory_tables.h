// Trajectories of a source and its receivers, as visibility/intervals.py makes them: how fast they can be, and walls that they sit in.

typedef struct {
    long first_knot, first_speed, knots;
} table_place;

typedef struct {
    double first_knot, knot_rate, fastest;  // time of the first knot, s; knots per second; m/s
} table_scale;

// A trajectory: cubics between knots, and the largest speed in each, in pairs of them, and so on.
typedef struct {
    trajectory path;
    __global const double* speeds;
    double fastest;  // m/s
    double4 mount;   // unit normal of the wall that it sits in, and offset of the plane a step in front; 0 in the open
} end_of_path;

// Where validity takes an end to be: one in a wall a step in front of it.
static triple lifted(const end_of_path* end, triple x)
{
    const triple normal = {end->mount.x, end->mount.y, end->mount.z};
    return difference(x, times(height(end->mount, x), normal));
}

static double speed_over(const end_of_path* end, double begin, double until)
{
    const int last = end->path.count - 1;
    int a = (int)fmin(fmax((begin - end->path.first) * end->path.rate, 0.0), (double)last);
    int b = (int)fmin(fmax((until - end->path.first) * end->path.rate, 0.0), (double)last);
    __global const double* level = end->speeds;
    for (int count = last + 1; b - a > 1; count = (count + 1) / 2, a /= 2, b /= 2) level += count;
    return fmax(level[a], level[b]);
}

static end_of_path trajectory_at(__global const table_place* places, __global const table_scale* scales,
                                 __global const double* knots, __global const double* speeds,
                                 __global const double4* mounts, double speed_of_sound,
                                 __global const double* wind, int row)
{
    const table_place at = places[row];
    const table_scale scale = scales[row];
    const double flow[3] = {WIND ? wind[0] : 0.0, WIND ? wind[1] : 0.0, WIND ? wind[2] : 0.0};
    const trajectory path = trajectory_of(knots + at.first_knot * KNOT_COLUMNS, (int)at.knots, scale.first_knot,
                                          scale.knot_rate, speed_of_sound, flow);
    const end_of_path out = {path, speeds + at.first_speed, scale.fastest, mounts[row]};
    return out;
}
