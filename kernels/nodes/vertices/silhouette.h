// The field about the outline of a body in the forward direction, and its mirror's elsewhere: twin of acoustics/silhouette.py.

#if VERTEX == SCATTERER && PARTS == 2
// From the field of what is reflected over its strength, m, to the whole field over the strength that is returned.
static double silhouette_field(const vertex_tables* t, const moment* now, const scatterer_frame* g, triples place, __global const view* seen,
                               int hidden, double mirrored, double cosine, double curvature, int lane, response* field)
{
    const triples to = apart(place, g->source), back = apart(place, g->receiver), between = apart(g->receiver, g->source);
    const reals legs[3] = {root(DOT(to, to)), root(DOT(back, back)), root(DOT(between, between))};
    const double l1 = OF_NODE(legs[0], lane), l2 = OF_NODE(legs[1], lane), sight = OF_NODE(legs[2], lane);
    const double held = fmax(sight, SHORTEST * (l1 + l2));
    const double strength = l1 * l2 / held, ratio = hidden ? 0.0 : mirrored / strength;
    const double lit = hidden ? 1.0 : faded(cosine, COSINE_WHOLE, COSINE_NONE), detour = fmax(l1 + l2 - sight, 0.0) / HALF_TURN;
    response lit_by;
    bins share[BIN_VECTORS];
    root_range roots;
    double lowest = 1e30, highest = 0.0;
    float most = 0.0f;
    for (int f = 0; f < FREQUENCIES; f++) {
        const double wave = 2.0 * HALF_TURN * ((__global const float*)t->waves)[f];
        const double root_of_wave = cbrt(0.5 * wave), fock = -2.0 * cosine * root_of_wave / cbrt(curvature);
        const double near = lit * faded(fock, FOCK_WHOLE, FOCK_NONE) * faded(sqrt(detour * wave), WITHIN, 2.0 * WITHIN);
        const float one = hidden ? 1.0f : (float)near;
        ((float*)share)[f] = one;
        lit_reflection(t->modes, fock, (float*)lit_by.part[0] + f, (float*)lit_by.part[1] + f);
        ((float*)roots.place)[f] = (float)root_of_wave;
        lowest = fmin(lowest, root_of_wave), highest = fmax(highest, root_of_wave);
        most = fmax(most, one);
    }
    multiply(field, &lit_by);
    for (int b = 0; b < BIN_VECTORS; b++) {
        for (int part = 0; part < PARTS; part++) field->part[part][b] *= (float)ratio * (1.0f - share[b]);
    }
    if (most == 0.0f) return strength;
    roots.middle = 0.5 * (highest + lowest), roots.reach = 0.5 * (highest - lowest), roots.most = highest;
    for (int b = 0; b < BIN_VECTORS; b++) roots.place[b] = (roots.place[b] - (float)roots.middle) / (float)fmax(roots.reach, 1e-9);
    outline o;
    o.is_capsule = seen->shape == CAPSULE;
    const triples ends[2] = {g->source, g->receiver};
    for (int i = 0; i < 3; i++) {
        o.source[i] = OF_NODE(((const reals*)&ends[0])[i], lane), o.receiver[i] = OF_NODE(((const reals*)&ends[1])[i], lane);
        o.axes[i] = seen->semi_axes[i];
    }
    look_along(&o);
    response about;
    outline_field(t, &o, seen->first_mode, sight, &roots, &about);
    shade_by_others(t, now, seen, g, lane, &roots, &about);
    for (int b = 0; b < BIN_VECTORS; b++) {
        turn(&about, b, t->waves[b] * (float)(l1 + l2 - sight));
        for (int part = 0; part < PARTS; part++) field->part[part][b] += share[b] * (float)(held / sight) * about.part[part][b];
    }
    return strength;
}
#endif
