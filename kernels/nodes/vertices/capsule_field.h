// The field of capsules: twin of `capsule_aspects` and `capsule_field` in acoustics/capsule.py.

#if VERTEX == SCATTERER && PARTS == 2
typedef struct {
    reals way, slope, steep, bend, inward;
} capsule_lengths;

static reals positive(reals x) { return larger(x, (reals)0.0); }

static capsule_lengths lengths_by(const scatterer_frame* g, triples place, triples normal, triples around, triples along)
{
    reals way = 0.0, inward = 0.0, g0 = 0.0, g1 = 0.0, h0 = 0.0, h1 = 0.0, h2 = 0.0;
    const triples ends[2] = {g->source, g->receiver};
    for (int i = 0; i < 2; i++) {
        const triples away = apart(place, ends[i]);
        const reals weight = i ? g->weight : (reals)1.0, squared = DOT(away, away), near = inverse_root(squared), size = weight * near;
        const reals a = DOT(around, away) * near, b = DOT(along, away) * near;
        way += squared * size;
        inward -= DOT(normal, away) * size;
        g0 += weight * a;
        g1 += weight * b;
        h0 += (1.0 - a * a) * size;
        h1 -= a * b * size;
        h2 += (1.0 - b * b) * size;
    }
    const reals steep = larger(h0 + positive(inward) / g->scale.x, (reals)FLATTEST), off = g0 / steep;
    const capsule_lengths out = {way - 0.5 * g0 * off, g1 - h1 * off, steep, positive(h2 - h1 * h1 / steep), inward};
    return out;
}

// How much of the surface's pressure counts, by the cosine of the angle of incidence.
static double obliquity(double cosine, int outlined)
{
    const double held = cosine < 0.0 ? 0.0 : cosine, steep = held / PENUMBRA;
    return outlined ? held : held * (1.0 - exp(-steep * steep * steep));
}

// Add a part of an end: a weight times the transition function of a root of a detour, m^(1/2), later by `late`, m.
static void add_part(const vertex_tables* t, double weight, double root_of_detour, double late, response* field)
{
    response one;
    transition_of(t, root_of_detour, (float)weight, &one);
    for (int b = 0; b < BIN_VECTORS; b++) {
        turn(&one, b, t->waves[b] * (float)(-late));
        for (int part = 0; part < PARTS; part++) field->part[part][b] += one.part[part][b];
    }
}

// The field over the strength, which is returned, m.
static double capsule_field(const vertex_tables* t, const scatterer_frame* g, triples place, __global const view* seen, int hidden,
                            int lane, response* field)
{
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) field->part[part][b] = 0.0f;
    }
    const int outlined = seen->modes > 0;
    if (hidden && !outlined) return 0.0;
    triples normal;
    const reals at = split(g, place, &normal), radius = g->scale.x;
    const reals level = normal.x * normal.x + normal.y * normal.y;
    const triples flat = {normal.x, normal.y, level > 0.0 ? (reals)0.0 : (reals)1.0};
    const triples aside = of_length_one(flat), around = {-aside.y, aside.x, (reals)0.0};
    const capsule_lengths here = lengths_by(g, place, normal, around, across(normal, around));
    double on_end = 0.0;
    for (int i = 0; i < 2; i++) {
        const reals sign = i ? (reals)1.0 : (reals)-1.0;
        const triples junction = plus(scaled(radius, aside), on_axis(sign * reach(g)));
        const capsule_lengths there = lengths_by(g, junction, aside, around, on_axis(sign));
        const double slope = OF_NODE(there.slope, lane), flatter = OF_NODE(there.bend, lane), inward = OF_NODE(there.inward, lane);
        const double behind = OF_NODE(there.way, lane) - OF_NODE(here.way, lane), late = behind > 0.0 ? behind : 0.0;
        double sharp = flatter + inward / OF_NODE(radius, lane);
        sharp = sharp > FLATTEST ? sharp : FLATTEST;
        if (slope < 0.0) {
            on_end = 1.0;
            if (late > 0.0) {  // the parabola that is as late at the junction
                const double squared = slope * slope, held = squared / (squared + NEAR_JUNCTION * NEAR_JUNCTION);
                sharp += held * (squared / (2.0 * late) - sharp);
            }
        }
        const double size = slope < 0.0 ? -slope : slope, lit = (slope < 0.0 ? -0.5 : 0.5) * obliquity(0.5 * inward, outlined);
        const double plain = flatter > FLATTEST ? flatter : FLATTEST;
        add_part(t, lit / sqrt(sharp), size / sqrt(2.0 * sharp), late, field);
        add_part(t, -lit / sqrt(plain), size / sqrt(2.0 * plain), late, field);
    }
    const double inward = OF_NODE(here.inward, lane), pressed = inward > 0.0 ? inward : 0.0;
    double bend = OF_NODE(here.bend, lane) + on_end * pressed / OF_NODE(radius, lane);
    bend = bend > FLATTEST ? bend : FLATTEST;
    const float main = (float)(obliquity(0.5 * pressed, outlined) / sqrt(bend));
    for (int b = 0; b < BIN_VECTORS; b++) field->part[0][b] += main;
    if (!outlined) return 1.0 / sqrt(OF_NODE(here.steep, lane));
    const triples away = apart(place, g->source);
    const reals aslant = DOT(around, away), pressed_by = DOT(normal, away);
    const reals around_share = (aslant * aslant + (reals)0.5 * pressed_by * pressed_by) / larger(DOT(away, away), (reals)LEAST);
    const double r = OF_NODE(radius, lane), end = OF_NODE(g->scale.z, lane), z = OF_NODE(place.z, lane);
    const double share = 1.0 - (1.0 - OF_NODE(around_share, lane)) * faded((fabs(z) - end + r) / r, 0.0, CAP_FADE);
    const double curvature = fmax(share / r, r / (end * end));
    const double mirrored = 1.0 / sqrt(OF_NODE(here.steep, lane));
    return silhouette_field(t, g, place, seen, hidden, mirrored, obliquity(0.5 * pressed, 1), curvature, lane, field);
}
#endif
