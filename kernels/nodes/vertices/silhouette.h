// How near a body is to the line of sight, and what it reflects where it is no mirror: twin of acoustics/silhouette.py.

#if VERTEX >= SCATTERER && PARTS == 2
// Distance by which the line of sight passes the body, about, m, 0 or less where it meets it; and at which share of its length.
static double clearance_of(const outline* o, double* share)
{
    double along[3], nearest[3];
    for (int i = 0; i < 3; i++) along[i] = o->receiver[i] - o->source[i];
    if (o->is_capsule) {
        const double straight = o->axes[2] - o->axes[0];
        const double level = dot_of(along, along), slope = along[2], length = dot_of(o->source, along);
        const double parted = fmax(level - slope * slope, 1e-12 * level + TINY);
        double height = fmin(fmax((o->source[2] * level - slope * length) / parted, -straight), straight);
        *share = fmin(fmax((height * slope - length) / fmax(level, TINY), 0.0), 1.0);
        height = fmin(fmax(o->source[2] + *share * slope, -straight), straight);
        for (int i = 0; i < 3; i++) nearest[i] = o->source[i] + *share * along[i];
        nearest[2] -= height;
        return sqrt(dot_of(nearest, nearest)) - o->axes[0];
    }
    double lift = 0.0, foot[3] = {0.0, 0.0, 0.0}, passed = 0.0;
    for (int k = 0; k < NEAR_ROUNDS; k++) {
        double level = 0.0, length = 0.0, squared = 0.0, slope = 0.0;
        for (int i = 0; i < 3; i++) {
            const double scale = k ? 1.0 : 1.0 / (o->axes[i] * o->axes[i]);
            level += scale * along[i] * along[i], length += scale * along[i] * (foot[i] - o->source[i]);
        }
        *share = fmin(fmax(length / fmax(level, TINY), 0.0), 1.0);
        for (int i = 0; i < 3; i++) {
            const double axis = o->axes[i] * o->axes[i];
            nearest[i] = o->source[i] + *share * along[i];
            const double bent = nearest[i] / (axis + lift);
            squared += axis * bent * bent, slope += axis * bent * bent / (axis + lift);
        }
        lift = fmax(lift + (sqrt(squared) - 1.0) * squared / fmax(slope, TINY), 0.0);
        passed = 0.0;
        for (int i = 0; i < 3; i++) {
            foot[i] = nearest[i] * o->axes[i] * o->axes[i] / (o->axes[i] * o->axes[i] + lift);
            passed += (nearest[i] - foot[i]) * (nearest[i] - foot[i]);
        }
    }
    return sqrt(passed);
}

// As `faded`, with a second derivative that does not jump: fewer nodes hold it.
static double eased(double x, double whole, double none)
{
    const double part = fmin(fmax((x - none) / (whole - none), 0.0), 1.0);
    return part * part * part * (10.0 + part * (6.0 * part - 15.0));
}

// Share of the field about the outline, `forward_share`, at central waves in a metre.
static float forward_share(const outline* o, double centre)
{
    double place, apart_by[3];
    for (int i = 0; i < 3; i++) apart_by[i] = o->receiver[i] - o->source[i];
    const double beyond = fmax(clearance_of(o, &place), 0.0);
    const double twice = fmax(2.0 * sqrt(dot_of(apart_by, apart_by)) * place * (1.0 - place), TINY);
    const double zones = beyond * sqrt(2.0 * centre / twice);
    return (float)(eased(beyond / twice, COSINE_WHOLE, COSINE_NONE) * eased(zones, WITHIN, 2.0 * WITHIN));
}
#endif

#if VERTEX == SCATTERER && PARTS == 2
// From the field of what is reflected over its strength, m, to what of it counts beside the outline, over the strength that is returned.
static double silhouette_field(const vertex_tables* t, const scatterer_frame* g, triples place, __global const view* seen, int hidden,
                               double mirrored, double cosine, double curvature, int lane, response* field)
{
    const triples to = apart(place, g->source), back = apart(place, g->receiver), between = apart(g->receiver, g->source);
    const reals legs[3] = {root(DOT(to, to)), root(DOT(back, back)), root(DOT(between, between))};
    const double l1 = OF_NODE(legs[0], lane), l2 = OF_NODE(legs[1], lane), sight = OF_NODE(legs[2], lane);
    const double strength = l1 * l2 / fmax(sight, SHORTEST * (l1 + l2)), ratio = hidden ? 0.0 : mirrored / strength;
    outline o;
    o.is_capsule = seen->shape == CAPSULE;
    const triples ends[2] = {g->source, g->receiver};
    for (int i = 0; i < 3; i++) {
        o.source[i] = OF_NODE(((const reals*)&ends[0])[i], lane), o.receiver[i] = OF_NODE(((const reals*)&ends[1])[i], lane);
        o.axes[i] = seen->semi_axes[i];
    }
    response lit_by;
    const float left = (float)ratio * (1.0f - forward_share(&o, seen->strength));
    for (int f = 0; f < FREQUENCIES; f++) {
        const double wave = 2.0 * HALF_TURN * ((__global const float*)t->waves)[f];
        lit_reflection(t->modes, -2.0 * cosine * cbrt(0.5 * wave / curvature), (float*)lit_by.part[0] + f, (float*)lit_by.part[1] + f);
    }
    multiply(field, &lit_by);
    for (int b = 0; b < BIN_VECTORS; b++) {
        for (int part = 0; part < PARTS; part++) field->part[part][b] *= left;
    }
    return strength;
}
#endif
