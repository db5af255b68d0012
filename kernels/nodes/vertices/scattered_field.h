// Strength of paths by scatterers at nodes.

#if VERTEX == SCATTERER
#define NOTHING_BACK 1e30  // m, over what pressure falls where nothing is sent back

// Over what pressure falls, m: lengths of both legs over the strength. What of capsules and spheres, which have phases, is over that
// is written to `field`.
static double scattered_length(const vertex_tables* tables, __global const view* seen, const scatterer_state* b, int lane,
                               response* field)
{
    double strength = seen->strength, spread = OF_NODE(b->spread, lane);
    const triples scale = {seen->semi_axes[0], seen->semi_axes[1], seen->semi_axes[2]};
    const scatterer_frame g = {scale, b->source, b->receiver, b->weight, seen->shape};
    if (seen->shape == CAPSULE) {
#if PARTS == 2
        strength = capsule_field(tables, &g, b->specular, OF_NODE_LONG(b->hidden, lane) != 0, lane, field);
#endif
    } else if (seen->shape == SPHERE) {
#if PARTS == 2
        triples place = along_axes(scale, b->specular), specular;
        choices hidden;
        choose(b->hidden, nearest_between(&g, &specular, &hidden), &place);
        strength = sphere_field(tables, &g, place, seen, lane, field);
#endif
    } else if (seen->shape != POINT) {
        reals cosine;
        const reals full = specular_strength(&g, b->specular, &cosine);
        const double steep = OF_NODE(cosine, lane) / PENUMBRA;
        strength = OF_NODE_LONG(b->hidden, lane) ? 0.0 : OF_NODE(full, lane) * (1.0 - exp(-steep * steep * steep));
    }
#if MACH_EXPONENT >= 1
    spread *= 1.0 - OF_NODE(b->leaving, lane);
#endif
#if MACH_EXPONENT >= 2
    spread *= 1.0 - OF_NODE(b->leaving, lane);
#endif
    return strength * NOTHING_BACK > spread ? spread / strength : NOTHING_BACK;
}

static arrival arrival_of(const path_nodes* s, int i, double through, const environment* env, response* field, int* fielded)
{
    const arrivals* a = s->node + VECTOR(i);
    const int lane = LANE(i);
    const scatterer_state* met = s->met + VECTOR(i);
    *fielded = s->seen->shape >= CAPSULE;
    const double length = scattered_length(&s->tables, s->seen, met, lane, field);
    const arrival here = {(float)through, (float)length, OF_NODE(a->mach_factor, lane),
                          triple_of(&a->departure, lane), triple_of(&met->arrival, lane), a->knot[lane], OF_NODE(a->u, lane)};
    return here;
}
#endif
