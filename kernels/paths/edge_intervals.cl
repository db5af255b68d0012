// Intervals of time in which one side of paths over edges is there. Work-item: one path.

__kernel void edge_intervals(__global const int* others,  // [paths][counts[0]]
                             __global const int* counts,  // [4]: of others, with GAP of those before and after; side
                             __global const edge_of_room* seen,  // see `search`
                             __global const edge_of_room* edges, __global const int* edge_of,  // [paths][2]
                             __global const int* face_of,      // [paths][2], see `search`; with GAP places in `seen`
                             __global const int* end_of,       // [paths]: which end of it, -1 for none
                             double far,                      // see `search`
                             double tolerance, double thickness, __global const double4* plane,
                             __global const double4* sphere, __global const int* same, __global const int* first_edge,
                             __global const int* first_piece,
                             __global const int* first_line, __global const int* first_twin, __global const edge_ends* edge,
                             __global const double4* line, __global const int* twin,
                             int box_count, __global const double4* box_middle, __global const double4* box_extent,
                             __global const int* box_wall, __global const int* box_skip,
                             __global const table_place* places,    // [ends], the source first
                             __global const table_scale* scales,    // [ends]
                             __global const double* knots, __global const double* speeds,
                             __global const double4* mounts,  // [ends]: normal and offset, see `end_of_path`
                             double speed_of_sound,
                             __global const double* wind,    // [3], m/s
                             double slowest,                 // speed at which sound makes way at least, m/s
                             __global const int* sequences,  // [paths][ORDER]
                             __global const int* receiver_of,  // [paths]
                             __global const int* active, int active_count,  // paths that are not done
                             double resolution,              // s, to which ends are found
                             double smallest_move,                // m, moves that are none
                             double graze,                   // m, clearance below which a path runs along an edge
                             int budget,                     // evaluations of each path in this launch
                             __global progress* states,      // [paths]
                             __global interval* found, __global int* found_count)
{
    if (get_global_id(0) >= active_count) return;
    const int path = active[get_global_id(0)];
    const search s = {{tolerance, thickness, plane, sphere, same, first_edge, first_piece, first_line, first_twin, edge,
                       line, twin, {box_count, box_middle, box_extent, box_wall, box_skip}}, trajectory_at(places, scales, knots, speeds, mounts, speed_of_sound, wind, 0),
                      trajectory_at(places, scales, knots, speeds, mounts, speed_of_sound, wind, 1 + receiver_of[path]),
                      sequences + ORDER * (long)path, others + counts[0] * (long)path, counts[0], counts[1], counts[2], counts[3],
                      seen + (GAP ? face_of[2 * (long)path] : 0),
                      {edges + edge_of[2 * (long)path], edges + edge_of[2 * (long)path + 1]}, {face_of[2 * (long)path], face_of[2 * (long)path + 1]},
                      end_of[path], far, 1.0 / slowest};
    subdivide(&s, states + path, path, resolution, smallest_move, graze, budget, found, found_count);
}
