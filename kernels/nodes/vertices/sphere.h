// The field of rigid spheres, by the sum over their modes in float64: twin of `sphere_aspects` and `sphere_field` in
// acoustics/sphere.py. A sphere has in a table ka at FREQUENCIES, and of each mode the recurrence's two factors and the weight.

#if VERTEX == SCATTERER && PARTS == 2
#if FREQUENCIES == 1
typedef double waves;  // numbers at neighbouring frequencies side by side
#define WAVES 1
#define LARGEST(x) (x)
#else
typedef double4 waves;
#define WAVES 4
#define LARGEST(x) fmax(fmax(x.s0, x.s1), fmax(x.s2, x.s3))
#endif
#define ROWS 4  // of a mode
#define CHECKED 8  // modes after which the series may end

typedef struct {
    double cosine, source, receiver, longer;  // of the angle between the ends; radius over distances; of the path, m
} sphere_aspects;

// The sum of modes at neighbouring frequencies, without the phase of the path by the place.
static void sum_of_modes(__global const double* ka, int modes, int least, const sphere_aspects* s, waves* real, waves* imaginary)
{
    __global const double* mode = ka + FREQUENCIES;
    waves u1 = 0.0, v1 = 1.0, u1_before = 1.0, v1_before = 0.0, u2 = u1, v2 = v1, u2_before = 1.0, v2_before = 0.0;
    waves sum_real = 0.0, sum_imaginary = 0.0;
    double legendre = 1.0, last = 0.0, loudest = LEAST;
    for (int n = 0; n < modes; n++, mode += ROWS * FREQUENCIES) {
        const waves step = *(__global const waves*)mode, back = *(__global const waves*)(mode + FREQUENCIES);
        const waves a = *(__global const waves*)(mode + 2 * FREQUENCIES), b = *(__global const waves*)(mode + 3 * FREQUENCIES);
        const waves p = u1 * u2 - v1 * v2, q = u1 * v2 + v1 * u2, here = a * p - b * q, there = a * q + b * p;
        sum_real += legendre * here;
        sum_imaginary += legendre * there;
        if (n % CHECKED == 0) {
            const waves squared = here * here + there * there;
            const double size = LARGEST(squared);
            if (n >= least && size < LEFT_OUT * LEFT_OUT * loudest) break;
            loudest = size > loudest ? size : loudest;
        }
        const waves step1 = s->source * step, step2 = s->receiver * step;
        const waves next_u1 = step1 * u1 - back * u1_before, next_v1 = step1 * v1 - back * v1_before;
        const waves next_u2 = step2 * u2 - back * u2_before, next_v2 = step2 * v2 - back * v2_before;
        u1_before = u1, v1_before = v1, u2_before = u2, v2_before = v2;
        u1 = next_u1, v1 = next_v1, u2 = next_u2, v2 = next_v2;
        const double next = ((2 * n + 1) * s->cosine * legendre - n * last) / (n + 1);
        last = legendre;
        legendre = next;
    }
    const waves twice = 2.0 * *(__global const waves*)ka;
    *real = -twice * sum_imaginary;
    *imaginary = twice * sum_real;
}

// The field over the strength, which is returned, m. The place is that of the specular point, or between the ends.
static double sphere_field(const vertex_tables* t, const scatterer_frame* g, triples place, __global const view* seen, int lane,
                           response* field)
{
    const triples to = apart(place, g->source), back = apart(place, g->receiver);
    const reals near1 = root(DOT(to, to)), near2 = root(DOT(back, back));
    const reals far1 = root(DOT(g->source, g->source)), far2 = root(DOT(g->receiver, g->receiver));
    const reals cosine = DOT(g->source, g->receiver) / (far1 * far2), longer = (far1 - near1) + (far2 - near2);
    const double radius = OF_NODE(g->scale.x, lane), clamped_cosine = OF_NODE(cosine, lane);
    const sphere_aspects s = {fmin(fmax(clamped_cosine, -1.0), 1.0), radius / OF_NODE(far1, lane), radius / OF_NODE(far2, lane),
                              OF_NODE(longer, lane)};
    __global const double* ka = t->modes + seen->first_mode;
    float* parts[2] = {(float*)field->part[0], (float*)field->part[1]};
    const double turns_of_ka = s.longer / (2.0 * HALF_TURN * radius);
    bins turns[BIN_VECTORS];
    for (int f = 0; f < FREQUENCIES; f += WAVES) {
        waves real, imaginary;
        sum_of_modes(ka + f, seen->modes, seen->least, &s, &real, &imaginary);
        for (int i = 0; i < WAVES; i++) {
            const double late = ka[f + i] * turns_of_ka;
            parts[0][f + i] = (float)((const double*)&real)[i];
            parts[1][f + i] = (float)((const double*)&imaginary)[i];
            ((float*)turns)[f + i] = (float)(rint(late) - late);
        }
    }
    for (int b = 0; b < BIN_VECTORS; b++) turn(field, b, turns[b]);
    return 0.5 * radius * OF_NODE(near1, lane) * OF_NODE(near2, lane) / (OF_NODE(far1, lane) * OF_NODE(far2, lane));
}
#endif
