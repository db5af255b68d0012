// A walk past the walls that may be near a segment: through their boxes, where there are groups of these.

// The next wall that may be as near to a segment as `slack`, or -1 where a group is passed; boxes of walls are not tested.
static int next_wall(const wall_tree* tree, int* box, triple a, triple b, double slack)
{
#if GROUPED
    const int here = *box, wall = tree->wall[here];
    *box = wall >= 0 || near_segment(tree, here, a, b, slack) ? here + 1 : tree->skip[here];
    return wall;
#else  // boxes are walls in their order: without a look at them, all of the search takes 0.8 of the time
    return (*box)++;
#endif
}
