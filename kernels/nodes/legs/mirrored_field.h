// Length and factors of paths by bodies at nodes, of mirrors that depend on the angle: twin of
// `Chain.response` in paths/chain.py.

#if LEG == MOVING
// Over what pressure falls besides by the source's Mach factor, m.
static double length_by_mirrors(const mirror_state* met, int lane)
{
    double length = OF_NODE(met->length, lane);
    for (int i = 0; i < MACH_EXPONENT; i++) length /= OF_NODE(met->raised, lane);
    return length;
}

// The factors of all of them, if there are any; `bounce` of a wall is its table, behind which stand how many mirrors that move
// are met before it, and whether it is one itself.
static int by_mirrors(const environment* env, const mirror_state* met, int lane, int slots, int slot,
                      response* field)
{
    if (!env->angular) return 0;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) field->part[part][b] = part ? 0.0f : 1.0f;
    }
    for (int i = 0; i < env->angular; i++) {
        const int bounce = env->wall_of[i * (long)slots + slot];
        if (bounce == -1) break;
        const int before = (bounce >> 1) % (MIRRORS + 1), table = (bounce >> 1) / (MIRRORS + 1);
        const triple way = triple_of(met->direction + before, lane);
        __global const float* n = env->normal + 3 * i * (long)slots + slot;
        const triple of_wall = {n[0], n[slots], n[2 * (long)slots]};
        const double cosine = inner(way, bounce & 1 ? triple_of(met->normal + before, lane) : of_wall);
        apply_cubics(env->walls + (long)table * CELLS * 4 * PARTS * BIN_VECTORS, sqrt((float)(cosine < 0.0 ? -cosine : cosine)),
                     field);
    }
    return 1;
}

static arrival arrival_of(const path_nodes* s, int i, double through, const environment* env, response* field, int* fielded)
{
    const arrivals* a = s->node + VECTOR(i);
    const int lane = LANE(i);
    const mirror_state* met = s->met + VECTOR(i);
    *fielded = by_mirrors(env, met, lane, s->slots, s->slot, field);
    const arrival here = {(float)OF_NODE(met->through, lane), (float)length_by_mirrors(met, lane), OF_NODE(a->mach_factor, lane),
                          triple_of(met->direction, lane), triple_of(met->direction + MIRRORS, lane), a->knot[lane], OF_NODE(a->u, lane)};
    return here;
}
#endif
