// Walls that segments cross strictly between their ends. Work-item: one segment. Of the convex pieces of walls that it
// crosses it tells the MOST that look largest from where it starts.

__kernel void crossings(double tolerance, double thickness, __global const double4* plane,
                        __global const double4* sphere, __global const int* same, __global const int* first_edge,
                        __global const int* first_piece,
                        __global const int* first_line, __global const int* first_twin, __global const edge_ends* edge,
                        __global const double4* line, __global const int* twin,
                        int box_count, __global const double4* box_middle, __global const double4* box_extent,
                        __global const int* box_wall, __global const int* box_skip,
                        __global const double* start, __global const double* stop,  // [segments][3]
                        int segments, __global int* found)                         // [segments][MOST], -1 for none
{
    const int segment = get_global_id(0);
    if (segment >= segments) return;
    const room walls = {tolerance, thickness, plane, sphere, same, first_edge, first_piece, first_line, first_twin, edge, line, twin,
                        {box_count, box_middle, box_extent, box_wall, box_skip}};
    const triple a = at_row(start + 3 * (long)segment), b = at_row(stop + 3 * (long)segment);
    __global int* mine = found + MOST * (long)segment;
    double looks[MOST];
    for (int i = 0; i < MOST; i++) {
        mine[i] = -1;
        looks[i] = 0.0;
    }
    for (int box = 0; box < box_count;) {
        if (!near_segment(&walls.tree, box, a, b, tolerance)) {
            box = box_skip[box];
            continue;
        }
        const int wall = box_wall[box++];
        if (wall < 0) continue;
        const double first = height(plane[wall], a), last = height(plane[wall], b);
        const double share = first / (first - last);
        if (!(first * last < 0.0 && share > INNER && share < 1.0 - INNER)) continue;
        int piece = piece_at(&walls, wall, sum(a, times(share, difference(b, a))), walls.tolerance);
        double size = sphere[wall].w / share;
        for (int i = 0; i < MOST && piece >= 0; i++) {  // puts it where it belongs, and goes on with what was there
            if (size <= looks[i]) continue;
            const int smaller = mine[i];
            const double look = looks[i];
            mine[i] = piece;
            looks[i] = size;
            piece = smaller;
            size = look;
        }
    }
}
