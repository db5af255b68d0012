// Paths by bodies at nodes: what is expected of events within a walk, and what mirrors do that depend on the angle: twin of
// `BodyPaths.response` in paths/moving/family.py.

#if BODIES
// Events that are expected within a walk from those at four ends of walks.
static void predict_more(__global const double* coarse, long slots, double walk_time, double* expected)
{
    for (int k = 0; k < MORE; k++) predict_cubic(coarse + k * slots, MORE * slots, expected + 4 * k);
}
static void expect_more(const double* expected, reals u, mirrored* b)
{
    for (int k = 0; k < BODIES; k++, expected += 16) {
        b->about.time[k] = by_cubic(expected, u);
        b->about.place[k].x = by_cubic(expected + 4, u);
        b->about.place[k].y = by_cubic(expected + 8, u);
        b->about.place[k].z = by_cubic(expected + 12, u);
    }
}

// Over what pressure falls besides by the source's Mach factor, m.
static double length_by_mirrors(const mirrored* met, int beside)
{
    double length = OF_NODE(met->length, beside);
#if MACH_EXPONENT >= 1
    length /= OF_NODE(met->raised, beside);
#endif
#if MACH_EXPONENT >= 2
    length /= OF_NODE(met->raised, beside);
#endif
    return length;
}

// The factors of all of them, if there are any; `bounce` of a wall is its table, behind which stand how many mirrors that move
// are met before it, and whether it is one itself.
static int by_mirrors(const surroundings* around, const mirrored* met, int beside, int slots, int slot,
                      response* field)
{
    if (!around->angular) return 0;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) field->part[part][b] = part ? 0.0f : 1.0f;
    }
    for (int i = 0; i < around->angular; i++) {
        const int bounce = around->wall_of[i * (long)slots + slot];
        if (bounce == -1) break;
        const int before = (bounce >> 1) % (BODIES + 1), table = (bounce >> 1) / (BODIES + 1);
        const triple way = triple_of(met->way + before, beside);
        __global const float* n = around->normal + 3 * i * (long)slots + slot;
        const triple of_wall = {n[0], n[slots], n[2 * (long)slots]};
        const double cosine = inner(way, bounce & 1 ? triple_of(met->normal + before, beside) : of_wall);
        apply_cubics(around->walls + (long)table * CELLS * 4 * PARTS * BIN_VECTORS, sqrt((float)(cosine < 0.0 ? -cosine : cosine)),
                     field);
    }
    return 1;
}
#endif
