// Strength of paths by scatterers at nodes.

#if VERTEX == SCATTERER
#define NOTHING_BACK 1e30  // m, over what pressure falls where nothing is sent back

#if PARTS == 2
// The field of the specular reflection over the strength, which is returned, m.
static double ellipsoid_field(const vertex_tables* t, const scatterer_frame* g, triples u, triples place, __global const view* seen,
                              int hidden, int lane, response* field)
{
    reals cosine;
    const reals mirrored = specular_strength(g, u, &cosine);
    const triples normal = {u.x / g->scale.x, u.y / g->scale.y, u.z / g->scale.z}, away = apart(along_axes(g->scale, u), g->source);
    const reals squared = DOT(normal, normal), facing = DOT(normal, away), pressed = facing * facing / squared;
    const triples tangent = apart(away, scaled(facing / squared, normal));
    const triples over = {tangent.x / g->scale.x, tangent.y / g->scale.y, tangent.z / g->scale.z};
    const triples bent = {normal.x / g->scale.x, normal.y / g->scale.y, normal.z / g->scale.z};
    const triples sharp = {1.0 / g->scale.x, 1.0 / g->scale.y, 1.0 / g->scale.z};
    const reals mean = (reals)0.5 * (DOT(sharp, sharp) - DOT(bent, bent) / squared);
    const reals curvature = (DOT(over, over) + mean * pressed) / (root(squared) * larger(DOT(away, away), (reals)LEAST));
    const double3 axes = {seen->semi_axes[0], seen->semi_axes[1], seen->semi_axes[2]};
    const double longest = fmax(axes.x, fmax(axes.y, axes.z)), flattest = fmin(axes.x, fmin(axes.y, axes.z)) / (longest * longest);
    for (int b = 0; b < BIN_VECTORS; b++) field->part[0][b] = 1.0f, field->part[1][b] = 0.0f;
    return silhouette_field(t, g, place, seen, hidden, OF_NODE(mirrored, lane), OF_NODE(cosine, lane),
                            fmax(OF_NODE(curvature, lane), flattest), lane, field);
}
#endif

// Over what pressure falls, m: lengths of both legs over the strength. What is over that of all that has phases is written to `field`.
static double scattered_length(const vertex_tables* tables, __global const view* seen, const scatterer_state* b, int lane,
                               response* field)
{
    double strength = seen->strength, spread = OF_NODE(b->spread, lane);
    const triples scale = {seen->semi_axes[0], seen->semi_axes[1], seen->semi_axes[2]};
    const scatterer_frame g = {scale, b->source, b->receiver, b->weight, seen->shape};
    const int hidden = OF_NODE_LONG(b->hidden, lane) != 0;
    if (seen->shape >= CAPSULE || seen->modes > 0) {
#if PARTS == 2
        triples specular, place = seen->shape == CAPSULE ? b->specular : along_axes(scale, b->specular);
        choices inside;
        choose(b->hidden, nearest_between(&g, &specular, &inside), &place);
        if (seen->shape == CAPSULE) strength = capsule_field(tables, &g, place, seen, hidden, lane, field);
        if (seen->shape == SPHERE) strength = sphere_field(tables, &g, place, seen, lane, field);
        if (seen->shape == ELLIPSOID) strength = ellipsoid_field(tables, &g, b->specular, place, seen, hidden, lane, field);
#endif
    } else if (seen->shape != POINT) {
        reals cosine;
        const reals full = specular_strength(&g, b->specular, &cosine);
        const double steep = OF_NODE(cosine, lane) / PENUMBRA;
        strength = hidden ? 0.0 : OF_NODE(full, lane) * (1.0 - exp(-steep * steep * steep));
    }
    for (int i = 0; i < MACH_EXPONENT; i++) spread *= 1.0 - OF_NODE(b->leaving, lane);
    return strength * NOTHING_BACK > spread ? spread / strength : NOTHING_BACK;
}

static arrival arrival_of(const path_nodes* s, int i, double through, const environment* env, response* field, int* fielded)
{
    const arrivals* a = s->node + VECTOR(i);
    const int lane = LANE(i);
    const scatterer_state* met = s->met + VECTOR(i);
    *fielded = s->seen->shape >= CAPSULE || s->seen->modes > 0;
    const double length = scattered_length(&s->tables, s->seen, met, lane, field);
    const arrival here = {(float)through, (float)length, OF_NODE(a->mach_factor, lane),
                          triple_of(&a->departure, lane), triple_of(&met->arrival, lane), a->knot[lane], OF_NODE(a->u, lane)};
    return here;
}
#endif
