// The field that an outline adds to the free field, from its points: twin of `outline_field` in acoustics/silhouette.py.

#if VERTEX >= SCATTERER && PARTS == 2
// Real and imaginary parts of a table of Fock's functions at an argument, linear between its rows.
static void from_table(__global const double* table, double clamped, double* real, double* imaginary)
{
    const double place = (clamped - FOCK_FIRST) * ((FOCK_COUNT - 1) / (FOCK_LAST - FOCK_FIRST));
    const int last = FOCK_COUNT - 2, cell = (int)place < last ? (int)place : last;
    const double part = place - cell;
    __global const double* at = table + 2 * cell;
    *real = at[0] + part * (at[2] - at[0]);
    *imaginary = at[1] + part * (at[3] - at[1]);
}

// Fock's function of a hard surface, `fock_hard`, side by side.
static void fock_hard(__global const double* table, reals xi, reals* real, reals* imaginary)
{
    const reals clamped = smaller(larger(xi, (reals)FOCK_FIRST), (reals)FOCK_LAST);
    const double pole = 0.5 / sqrt(HALF_TURN);
#if NODES_AT_ONCE == 4
    double x[4], y[4];
#pragma unroll
    for (int i = 0; i < 4; i++) from_table(table, OF_NODE(clamped, i), x + i, y + i);
    const reals u = {x[0], x[1], x[2], x[3]}, v = {y[0], y[1], y[2], y[3]};  // by way of memory they would wait for each other
#else
    reals u, v;
    from_table(table, clamped, &u, &v);
#endif
    const choices beyond = xi > FOCK_LAST;
    const reals none = 0.0, tail = pole * (beyond ? none + 1.0 : clamped) / (beyond ? xi : 1.0 + clamped * clamped);
    *real = tail + (beyond ? none : u);
    *imaginary = beyond ? none : v;
}

// Reflection near grazing incidence over the mirror's, `lit_reflection`.
static void lit_reflection(__global const double* table, double xi, float* real, float* imaginary)
{
    const double low = fmin(xi, FOCK_FIRST), over = 1.0 / (low * low * low), squared = over * over;
    double x, y;
    from_table(table + 2 * FOCK_COUNT, fmin(fmax(xi, FOCK_FIRST), FOCK_LAST), &x, &y);
    *real = (float)(xi < FOCK_FIRST ? 1.0 - squared * (28.0 - 43120.0 * squared) : x);
    *imaginary = (float)(xi < FOCK_FIRST ? -2.0 * over * (1.0 - 448.0 * squared) : y);
}

#if VERTEX == SHADE
// But for the phase, strengths are Newton's polynomials of the root through KNOWN_AT Chebyshev nodes.
#define OF_CHEBYSHEV (chebyshev_nodes + (KNOWN_AT < 12 ? KNOWN_AT * (KNOWN_AT - 1) / 2 : 21))
__constant const double chebyshev_nodes[33] = {  // of 1 to 6, and of 12 in an order that keeps rounding small
    0.0,
    0.7071067811865476, -0.7071067811865475,
    0.8660254037844387, 0.0, -0.8660254037844387,
    0.9238795325112867, 0.38268343236508984, -0.3826834323650897, -0.9238795325112867,
    0.9510565162951535, 0.5877852522924731, 0.0, -0.587785252292473, -0.9510565162951535,
    0.9659258262890683, 0.7071067811865476, 0.25881904510252074, -0.25881904510252063, -0.7071067811865475, -0.9659258262890682,
    0.9914448613738104, -0.9914448613738104, 0.13052619222005157, -0.6087614290087207, 0.6087614290087207, -0.9238795325112867,
    0.9238795325112867, -0.38268343236508984, 0.38268343236508984, 0.7933533402912352, -0.7933533402912352, -0.13052619222005157};

// (k / 2)^(1/3) at all frequencies, from -1 to 1, and the middle and half of its range.
typedef struct {
    bins place[BIN_VECTORS];
    double middle, reach, most;
} root_range;

// Add the shares of neighbouring points of one outline to the field.
static void add_points(const vertex_tables* t, const outline_points* p, double sight, const root_range* roots, response* field)
{
    const strings of_points = strings_over(p);
    const reals beside = p->beside * p->beside, once = p->step / (2.0 * HALF_TURN);
    const reals inside = p->source < 0.0 && p->receiver > 0.0 ? -p->depth : (reals)0.0;
    const reals detour = quick_root(of_points.source * of_points.source + beside) + quick_root(of_points.receiver * of_points.receiver + beside) - sight;
    const reals offset = of_points.offset, far = inside * inside + beside + TINY, off = offset * offset + beside + TINY;
    const reals each = once / (far * off), screens = inside * off * each, edges = of_points.width * offset * far * each;
    const reals curves = p->step * of_points.width * of_points.curve * of_points.nearness * (1.0 / sqrt(HALF_TURN));
    reals real[KNOWN_AT], imaginary[KNOWN_AT];
#pragma unroll
    for (int m = 0; m < KNOWN_AT; m++) {
        const double root_of_wave = roots->middle + roots->reach * OF_CHEBYSHEV[m], squared = root_of_wave * root_of_wave;
        const reals fock = root_of_wave * of_points.fock, near = faded_by(fock, NEAR_WHOLE, NEAR_NONE);
        const reals smooth = root_of_wave * squared * curves / (squared + of_points.sharp);
        reals x, y;
        fock_hard(t->modes, fock, &x, &y);
        real[m] = near * (edges - smooth * x);
        imaginary[m] = -near * smooth * y;
    }
#pragma unroll
    for (int order = 1; order < KNOWN_AT; order++) {  // divided differences, by constants where loops are unrolled
#pragma unroll
        for (int m = KNOWN_AT - 1; m >= order; m--) {
            const double apart_by = 1.0 / (OF_CHEBYSHEV[m] - OF_CHEBYSHEV[m - order]);
            real[m] = (real[m] - real[m - 1]) * apart_by;
            imaginary[m] = (imaginary[m] - imaginary[m - 1]) * apart_by;
        }
    }
    float screen = 0.0f;
    for (int i = 0; i < NODES_AT_ONCE; i++) {
        screen += (float)OF_NODE(screens, i);
        if (OF_NODE(of_points.width, i) <= 0.0 || roots->most * OF_NODE(of_points.fock, i) <= NEAR_NONE) continue;
        const float late = (float)-OF_NODE(detour, i);
        response one;
        for (int b = 0; b < BIN_VECTORS; b++) {
            bins u = (float)OF_NODE(real[KNOWN_AT - 1], i), v = (float)OF_NODE(imaginary[KNOWN_AT - 1], i);
            for (int m = KNOWN_AT - 2; m >= 0; m--) {
                const bins from = roots->place[b] - (float)OF_CHEBYSHEV[m];
                u = u * from + (float)OF_NODE(real[m], i);
                v = v * from + (float)OF_NODE(imaginary[m], i);
            }
            one.part[0][b] = u, one.part[1][b] = v;
            turn(&one, b, t->waves[b] * late);
            field->part[0][b] += one.part[0][b];
            field->part[1][b] += one.part[1][b];
        }
    }
    for (int b = 0; b < BIN_VECTORS; b++) field->part[0][b] -= screen;
}

// The field that an outline adds to the free field, over that, with its table from `first` on.
static void outline_field(const vertex_tables* t, const outline* o, int first, double sight, const root_range* roots, response* about)
{
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) about->part[part][b] = 0.0f;
    }
    int count;
    __global const double* table = points_asked(o, t->modes, first, &count);
    for (int i = 0; i < count; i += NODES_AT_ONCE, table += POINT_COLUMNS * NODES_AT_ONCE) {
        const outline_points p = points_at(o, table);
        add_points(t, &p, sight, roots, about);
    }
}
#endif
#endif
