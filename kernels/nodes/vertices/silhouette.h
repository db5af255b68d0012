// The field about the outline of a body in the forward direction, and its mirror's elsewhere: twin of acoustics/silhouette.py.

#if VERTEX == SCATTERER && PARTS == 2
// Fock's function of a hard surface, `fock_hard`, by its table of real and imaginary parts.
static void fock_hard(__global const double* table, double xi, float* real, float* imaginary)
{
    const double clamped = fmin(fmax(xi, FOCK_FIRST), FOCK_LAST), place = (clamped - FOCK_FIRST) * ((FOCK_COUNT - 1) / (FOCK_LAST - FOCK_FIRST));
    const int cell = (int)fmin(place, FOCK_COUNT - 2.0);
    const double part = place - cell, pole = 0.5 / sqrt(HALF_TURN);
    __global const double* at = table + 2 * cell;
    const int beyond = xi > FOCK_LAST;
    *real = beyond ? (float)(pole / xi) : (float)(at[0] + part * (at[2] - at[0]) + pole * clamped / (1.0 + clamped * clamped));
    *imaginary = beyond ? 0.0f : (float)(at[1] + part * (at[3] - at[1]));
}

#if FREQUENCIES == 1
#define KNOWN_AT 1
#else
#define KNOWN_AT 6  // `FEW`: but for the phase, strengths are Newton's polynomials of the root through Chebyshev's nodes
#endif
__constant const double of_chebyshev[6] = {0.9659258262890683, 0.7071067811865476, 0.25881904510252074, -0.25881904510252063, -0.7071067811865475, -0.9659258262890682};

// (k / 2)^(1/3) at all frequencies, from -1 to 1, and the middle and half of its range.
typedef struct {
    bins place[BIN_VECTORS];
    double middle, reach, most;
} root_range;

static double faded(double x, double whole, double none)
{
    const double part = fmin(fmax((x - none) / (whole - none), 0.0), 1.0);
    return part * part * (3.0 - 2.0 * part);
}

// Add the shares of neighbouring points of one outline to the field.
static void add_points(const vertex_tables* t, const outline_points* p, double sight, const root_range* roots, response* field)
{
    const strings of_points = strings_over(p);
    const reals beside = p->beside * p->beside, once = p->step / (2.0 * HALF_TURN);
    const reals inside = p->source < 0.0 && p->receiver > 0.0 ? -p->depth : (reals)0.0;
    const reals detour = root(of_points.source * of_points.source + beside) + root(of_points.receiver * of_points.receiver + beside) - sight;
    const reals screens = once * inside / (inside * inside + beside + TINY), offset = of_points.offset;
    const reals edges = once * of_points.width * offset / (offset * offset + beside + TINY);
    const reals curves = p->step * of_points.width * of_points.curve / (of_points.apart * sqrt(HALF_TURN));
    float screen = 0.0f;
    for (int i = 0; i < NODES_AT_ONCE; i++) {
        screen += (float)OF_NODE(screens, i);
        if (OF_NODE(of_points.width, i) <= 0.0 || roots->most * OF_NODE(of_points.fock, i) <= NEAR_NONE) continue;
        const float edge = (float)OF_NODE(edges, i), smooth = (float)OF_NODE(curves, i), late = (float)-OF_NODE(detour, i);
        float real[KNOWN_AT], imaginary[KNOWN_AT];
        for (int m = 0; m < KNOWN_AT; m++) {
            const double root_of_wave = roots->middle + roots->reach * of_chebyshev[m], fock = root_of_wave * OF_NODE(of_points.fock, i);
            const float near = (float)faded(fock, NEAR_WHOLE, NEAR_NONE);
            fock_hard(t->modes, fock, real + m, imaginary + m);
            real[m] = near * (edge - smooth * (float)root_of_wave * real[m]);
            imaginary[m] *= -near * smooth * (float)root_of_wave;
        }
        for (int order = 1; order < KNOWN_AT; order++) {  // divided differences
            for (int m = KNOWN_AT - 1; m >= order; m--) {
                const float apart_by = (float)(1.0 / (of_chebyshev[m] - of_chebyshev[m - order]));
                real[m] = (real[m] - real[m - 1]) * apart_by;
                imaginary[m] = (imaginary[m] - imaginary[m - 1]) * apart_by;
            }
        }
        response one;
        for (int b = 0; b < BIN_VECTORS; b++) {
            bins u = real[KNOWN_AT - 1], v = imaginary[KNOWN_AT - 1];
            for (int m = KNOWN_AT - 2; m >= 0; m--) {
                const bins from = roots->place[b] - (float)of_chebyshev[m];
                u = u * from + real[m];
                v = v * from + imaginary[m];
            }
            one.part[0][b] = u, one.part[1][b] = v;
            turn(&one, b, t->waves[b] * late);
            field->part[0][b] += one.part[0][b];
            field->part[1][b] += one.part[1][b];
        }
    }
    for (int b = 0; b < BIN_VECTORS; b++) field->part[0][b] -= screen;
}

// From the field of what is reflected over its strength, m, to the whole field over the strength that is returned.
static double silhouette_field(const vertex_tables* t, const scatterer_frame* g, triples place, __global const view* seen, int hidden,
                               double mirrored, double cosine, double curvature, int lane, response* field)
{
    const triples to = apart(place, g->source), back = apart(place, g->receiver), between = apart(g->receiver, g->source);
    const reals legs[3] = {root(DOT(to, to)), root(DOT(back, back)), root(DOT(between, between))};
    const double l1 = OF_NODE(legs[0], lane), l2 = OF_NODE(legs[1], lane), sight = OF_NODE(legs[2], lane);
    const double held = fmax(sight, SHORTEST * (l1 + l2));
    const double strength = l1 * l2 / held, ratio = hidden ? 0.0 : mirrored / strength;
    const double lit = hidden ? 1.0 : faded(cosine, COSINE_WHOLE, COSINE_NONE);
    bins share[BIN_VECTORS];
    root_range roots;
    double lowest = 1e30, highest = 0.0;
    float most = 0.0f;
    for (int f = 0; f < FREQUENCIES; f++) {
        const double wave = 2.0 * HALF_TURN * ((__global const float*)t->waves)[f];
        const float one = hidden ? 1.0f : (float)(lit * faded(-2.0 * cosine * cbrt(0.5 * wave / curvature), FOCK_WHOLE, FOCK_NONE));
        ((float*)share)[f] = one;
        const double root_of_wave = cbrt(0.5 * wave);
        ((float*)roots.place)[f] = (float)root_of_wave;
        lowest = fmin(lowest, root_of_wave), highest = fmax(highest, root_of_wave);
        most = fmax(most, one);
    }
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
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) about.part[part][b] = 0.0f;
    }
    int count;
    __global const double* table = points_asked(&o, t->modes, seen, &count);
    for (int i = 0; i < count; i += NODES_AT_ONCE, table += POINT_COLUMNS * NODES_AT_ONCE) {
        const outline_points p = points_at(&o, table);
        add_points(t, &p, sight, &roots, &about);
    }
    for (int b = 0; b < BIN_VECTORS; b++) {
        turn(&about, b, t->waves[b] * (float)(l1 + l2 - sight));
        for (int part = 0; part < PARTS; part++) field->part[part][b] += share[b] * (float)(held / sight) * about.part[part][b];
    }
    return strength;
}
#endif
