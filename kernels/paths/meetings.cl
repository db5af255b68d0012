// Walls that beams may meet. Work-item: one beam. A beam is an intersection of half-spaces, on the far side of its last
// wall, from a ball. A wall in the plane of the last one is none, nor is one whose side that paths can be on the ball
// does not reach. Where receivers are given, only walls by which the beam may reach one of them: it touches the
// receiver's sphere mirrored by the wall, and what the receiver sees in the wall touches the ball. The twin of
// paths/visibility/occlusion.py.

static int touches(__global const double4* half_spaces, int count, triple centre, double radius)
{
    for (int i = 0; i < count; i++) {
        if (height(half_spaces[i], centre) < -radius) return 0;
    }
    return 1;
}

__kernel void meetings(double tolerance, double thickness, __global const double4* plane,
                       __global const double4* sphere, __global const int* same, __global const int* first_edge,
                       __global const int* first_piece,
                       __global const int* first_line, __global const int* first_twin, __global const edge_ends* edge,
                       __global const double4* line, __global const int* twin,
                       int box_count, __global const double4* box_middle, __global const double4* box_extent,
                       __global const int* box_wall, __global const int* box_skip,
                       __global const double4* half_spaces,  // [beams][half_space_count], x is inside if inner(.xyz, x) >= .w
                       int half_space_count, int beams,
                       __global const double* centre,          // [beams][3], m
                       double radius,                        // m, of all balls
                       double slack,                         // m, by which boxes are taken to be larger
                       __global const int* last_wall,        // [beams]
                       __global const int* side,             // [walls], 1 that of the normal, -1 the other, 0 both
                       __global const double4* receivers,    // [receiver_count], centres and radii, m
                       __global const double4* seen,         // half-spaces of what receivers see in walls, and where
                       __global const int* first_seen,       // those of [receiver_count][wall_count] begin, and the end
                       int receiver_count, int wall_count, int capacity, __global int2* found, __global int* found_count)
{
    const int beam = get_global_id(0);
    if (beam >= beams) return;
    const room walls = {tolerance, thickness, plane, sphere, same, first_edge, first_piece, first_line, first_twin, edge, line, twin,
                        {box_count, box_middle, box_extent, box_wall, box_skip}};
    __global const double4* mine = half_spaces + half_space_count * (long)beam;
    const triple ball = at_row(centre + 3 * (long)beam);
    for (int box = 0; box < box_count;) {
        const double4 middle = box_middle[box], extent = box_extent[box];
        const triple at = {middle.x, middle.y, middle.z};
        int meets = 1;
        for (int i = 0; i < half_space_count && meets; i++) {
            const double reach = fabs(mine[i].x) * extent.x + fabs(mine[i].y) * extent.y + fabs(mine[i].z) * extent.z;
            meets = height(mine[i], at) + reach >= -slack;
        }
        const int wall = box_wall[box];
        box = meets ? box + 1 : box_skip[box];
        if (!meets || wall < 0 || same[wall] == same[last_wall[beam]]) continue;
        if (side[wall] * height(plane[wall], ball) < -radius) continue;
        int wanted = receiver_count == 0;
        for (int i = 0; i < receiver_count && !wanted; i++) {
            __global const int* here = first_seen + i * (long)wall_count + wall;
            const int first = here[0], sides = here[1] - first;
            const triple ear = {receivers[i].x, receivers[i].y, receivers[i].z};
            wanted = sides > 0 && touches(mine, half_space_count, mirrored(plane[wall], ear), receivers[i].w) &&
                     touches(seen + first, sides, mirrored(plane[wall], ball), radius);
        }
        if (!wanted) continue;
        const int place = atomic_inc(found_count);
        if (place < capacity) found[place] = (int2)(beam, wall);
    }
}
