// Whether a path is valid at an instant, and its clearance: how far source and receiver may both move before that can
// change. The twin of visibility.py. With AT_EDGE the last leg ends on an edge of the room: walls that hold this place end
// there, and hide nothing of it, and no wall hides what passes along its outline, as a leg on the plane of a face does.

// The reflections: on their walls, and in order. Returns whether all are; `clear` is that of the surest that is not.
static int reflects(const room* walls, __global const int* sequence, double reach, unfolded* path, double* clear)
{
    int valid = 1, crosses_before = 1;
    double inverse_before = 0.0;
    for (int k = 1; k <= ORDER; k++) {
        const int wall = sequence[k - 1];
        const double4 plane = walls->plane[wall];
        const double before = height(plane, path->from[k]), behind = height(plane, path->to[k]);
        const int crosses = before * behind < 0.0;
        const double inverse = crosses ? 1.0 / fabs(before - behind) : 0.0;
        double sure = -1.0;
        if (!crosses) {
            sure = reach * fmin(ratio(fabs(before), across(path, k, 0.0, plane)), ratio(fabs(behind), across(path, k, 1.0, plane)));
        } else {
            path->tau[k] = before / (before - behind);
            path->slack[k] = reach * inverse;
            const triple hit = along(path, k, path->tau[k]);
            if (!holds(walls, wall, hit)) {
                sure = sqrt(edges_apart(walls, wall, path->from[k], path->to[k], *clear * *clear, EVER));
            }
            for (int i = walls->first_twin[wall]; i < walls->first_twin[wall + 1]; i++) {
                if (sure < 0.0 && holds(walls, walls->twin[i], hit)) {
                    sure = sqrt(edges_apart(walls, walls->twin[i], path->from[k], path->to[k], *clear * *clear, EVER));
                }
            }
            if (k > 1 && crosses_before && path->tau[k - 1] >= path->tau[k]) {
                sure = fmax(sure, (path->tau[k - 1] - path->tau[k]) / (inverse_before + inverse));
            }
        }
        if (sure >= 0.0) {
            valid = 0;
            *clear = fmax(*clear, sure);
            if (*clear > reach) return 0;
        }
        crosses_before = crosses;
        inverse_before = inverse;
    }
    return valid;
}

static int same_plane(const room* walls, __global const int* sequence, int leg, int wall)
{
    return (leg > 0 && walls->same[sequence[leg - 1]] == walls->same[wall]) ||
           (leg < ORDER && walls->same[sequence[leg]] == walls->same[wall]);
}

// Whether a wall, or what is less than `beyond` away from it, m, crosses the segment from a to b strictly between its ends.
static int blocks(const room* walls, int wall, triple a, triple b, double beyond)
{
    const double4 sphere = walls->sphere[wall];
    const triple centre = {sphere.x, sphere.y, sphere.z};
    if (point_apart(centre, a, b) > sphere.w * sphere.w) return 0;
    const double first = height(walls->plane[wall], a), last = height(walls->plane[wall], b);
    if (!(first * last < 0.0)) return 0;
    const double share = first / (first - last);
    return share > INNER && share < 1.0 - INNER && piece_at(walls, wall, sum(a, times(share, difference(b, a))), beyond) >= 0;
}

// How far the ends of a path may move while a leg from a to b still reaches through a plane that it crosses.
static double end_clearance(double4 plane, int leg, triple a, triple b, double reach, const unfolded* path)
{
    const double high = fabs(height(plane, a)), low = fabs(height(plane, b));
    const double slope = (high + low) / (path->tau[leg + 1] - path->tau[leg]);
    const double first = across(path, leg, path->tau[leg], plane) + path->slack[leg] * slope;
    const double last = across(path, leg, path->tau[leg + 1], plane) + path->slack[leg + 1] * slope;
    return reach * fmin(ratio(high, first), ratio(low, last));
}

// The legs: crossed by no other wall. Returns whether all are free; `clear` is that of the surest obstacle.
static int passes(const room* walls, __global const int* sequence, double reach, const unfolded* path, double* clear)
{
    int valid = 1;
    for (int leg = 0; leg <= ORDER; leg++) {
        const triple a = along(path, leg, path->tau[leg]), b = along(path, leg, path->tau[leg + 1]);
        const double first = path->tau[leg] + path->slack[leg], last = path->tau[leg + 1] - path->slack[leg + 1];
        const triple from = along(path, leg, first), to = along(path, leg, last);  // what is always part of the leg
        const int ends = AT_EDGE && leg == ORDER;
        for (int box = 0; box < walls->tree.count;) {
            const int wall = next_wall(&walls->tree, &box, a, b, walls->tolerance);
            if (wall < 0 || same_plane(walls, sequence, leg, wall) || !blocks(walls, wall, a, b, ends ? 0.0 : walls->tolerance)) continue;
            if (walls->same[wall] < 0) continue;  // a panel that lets sound pass
            if (ends && fabs(height(walls->plane[wall], b)) <= TOUCHING * walls->tolerance) continue;
            valid = 0;
            const double before = height(walls->plane[wall], from), behind = height(walls->plane[wall], to);
            if (first < last && before * behind < 0.0) {
                const double apart = sqrt(edges_apart(walls, wall, from, to, *clear * *clear, EVER));
                const double surely = fmin(ratio(fabs(before), across(path, leg, first, walls->plane[wall])),
                                           ratio(fabs(behind), across(path, leg, last, walls->plane[wall])));
                *clear = fmax(*clear, fmin(apart, reach * surely));
                if (*clear > reach) return 0;
            } else {  // nearer to an end of the leg than that can move: sure only while both ends move less
                const double apart = sqrt(edges_apart(walls, wall, a, b, *clear * *clear, EVER));
                *clear = fmax(*clear, fmin(apart, end_clearance(walls->plane[wall], leg, a, b, reach, path)));
            }
        }
    }
    return valid;
}

// As `edges_apart`, of edges that do not touch b.
static double edges_apart_off(const room* walls, int wall, triple a, triple b, double enough, double most)
{
    const triple u = difference(b, a);
    const double on = TOUCHING * walls->tolerance;
    double least = most;
    for (int i = walls->first_edge[wall]; least > enough && i < walls->first_edge[wall + 1]; i++) {
        const triple from = at_row(walls->edge[i].from), to = at_row(walls->edge[i].to);
        const double squared = segments_apart(a, u, from, difference(to, from));
        if (squared < least && point_apart(b, from, to) > on * on) least = squared;
    }
    return least;
}

// Distance from the legs, drawn out at their ends by what these can move, to any edge; looked for up to 2 `reach`.
static double edge_clearance(const room* walls, double reach, const unfolded* path)
{
    double clear = 2.0 * reach;
    for (int leg = 0; leg <= ORDER; leg++) {
        const triple a = along(path, leg, fmax(path->tau[leg] - path->slack[leg], 0.0));
        const triple b = along(path, leg, fmin(path->tau[leg + 1] + path->slack[leg + 1], 1.0));
        for (int box = 0; box < walls->tree.count;) {
            const int wall = next_wall(&walls->tree, &box, a, b, clear);
            if (wall < 0) continue;
            const double4 sphere = walls->sphere[wall];
            const triple centre = {sphere.x, sphere.y, sphere.z};
            if (point_apart(centre, a, b) > (sphere.w + clear) * (sphere.w + clear)) continue;
            // Edges lie in the plane of their wall: a leg that stays on one side of it is no nearer to them.
            const double first = height(walls->plane[wall], a), last = height(walls->plane[wall], b);
            if (first * last > 0.0 && fmin(fabs(first), fabs(last)) > clear + walls->thickness) continue;
            const double enough = 0.0025 * reach * reach;
            clear = sqrt(AT_EDGE && leg == ORDER ? edges_apart_off(walls, wall, a, path->to[leg], enough, clear * clear)
                                                 : edges_apart(walls, wall, a, b, enough, clear * clear));
            if (clear < 0.05 * reach) return clear;
        }
    }
    return clear;
}

// Ends and mounts as in `unfold`.
static int path_status(const room* walls, __global const int* sequence, triple source, triple receiver,
                       double source_reach, double receiver_reach, double4 source_mount, double4 receiver_mount,
                       double* clear)
{
    const double reach = fmax(source_reach, receiver_reach);
    unfolded path;
    unfold(walls, sequence, source, receiver, source_reach, receiver_reach, source_mount, receiver_mount, &path);
    *clear = 0.0;
    if (!reflects(walls, sequence, reach, &path, clear) || !passes(walls, sequence, reach, &path, clear)) return 0;
    *clear = edge_clearance(walls, reach, &path);
    return 1;
}
