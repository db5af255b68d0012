// Strings from endpoint to endpoint over the ellipses of an outline's points, side by side: twin of `_strings` in
// acoustics/silhouette.py. Angles are those on the unit circles that affine coordinates make of the ellipses.

#if VERTEX == SHADE && PARTS == 2
// `_Strings`: lengths of both sides, half the harmonic mean of the tangents, Fock parameter and m of the arc over (k / 2)^(1/3),
// what stands for the depth of the line of sight, the wavefront's width, and (k / 2)^(2/3) below which the ellipse is too sharp.
typedef struct {
    reals source, receiver, apart, fock, curve, offset, width, sharp;
} strings;

static reals faded_by(reals x, double whole, double none)
{
    const reals part = smaller(larger((x - none) * (1.0 / (whole - none)), (reals)0.0), (reals)1.0);
    return part * part * (3.0 - 2.0 * part);
}

// Taylor's series of cosine and sine; up to 1.36 their errors are below 1e-11.
static void cosine_and_sine(reals x, reals* cosine, reals* sine)
{
    const reals y = x * x;
    *cosine = 1.0 + y * (-1.0 / 2.0 + y * (1.0 / 24.0 + y * (-1.0 / 720.0 + y * (1.0 / 40320.0 + y * (-1.0 / 3628800.0 +
              y * (1.0 / 479001600.0 + y * (-1.0 / 87178291200.0)))))));
    *sine = x * (1.0 + y * (-1.0 / 6.0 + y * (1.0 / 120.0 + y * (-1.0 / 5040.0 + y * (1.0 / 362880.0 + y * (-1.0 / 39916800.0 +
            y * (1.0 / 6227020800.0 + y * (-1.0 / 1307674368000.0))))))));
}

// 1 / sqrt(x) within 4e-11, and x^(-1/3) within 4e-10: as `inverse_root`, with fewer steps.
static reals quick_inverse_root(reals x)
{
#if NODES_AT_ONCE == 4
    reals y = as_double4(0x5fe6eb50c7b537a9 - (as_long4(x) >> 1));
#pragma unroll
    for (int i = 0; i < 3; i++) y = y * (1.5 - 0.5 * x * y * y);
    return y;
#else
    return 1.0 / sqrt(x);
#endif
}
static reals quick_root(reals x) { return x * quick_inverse_root(x); }
static reals inverse_cube_root(reals x)
{
#if NODES_AT_ONCE == 4
    const double4 scaled = convert_double4(as_long4(x)) * (-1.0 / 3.0);
    reals y = as_double4(0x553ef0ff289dd796 + convert_long4(scaled));
#pragma unroll
    for (int i = 0; i < 3; i++) y = y * (4.0 / 3.0 - x * y * y * y * (1.0 / 3.0));
    return y;
#else
    return 1.0 / cbrt(x);
#endif
}

static strings strings_over(const outline_points* p)
{
    const reals skew = p->q_nz / p->q_zz, bent = p->q_nn - p->q_nz * skew;
    const reals over = p->support * bent, ahead = p->support * quick_root(bent * p->q_zz), x = 1.0 + over * p->depth;
    const reals flat = 1.0 / over, slim = 1.0 / ahead;
    reals tangents[2], cosine[2], sine[2], both_steep = 1.0;
    strings s;
    s.width = 1.0;
    for (int i = 0; i < 2; i++) {
        const reals q = i ? p->receiver : p->source;
        const double sign = i ? 1.0 : -1.0;
        const reals y = sign * ahead * (q + skew * p->depth), squared = larger(x * x + y * y, (reals)1.0), leg = quick_root(larger(squared - 1.0, (reals)TINY));
        const reals inverse = 1.0 / squared;
        cosine[i] = (x + y * leg) * inverse, sine[i] = (y - x * leg) * inverse;
        const reals lift = (cosine[i] - 1.0) * flat, up = p->depth - lift, on = q - sign * sine[i] * slim + skew * lift;
        const reals tangent = up * up + on * on, steep_up = sine[i] * flat, steep_on = cosine[i] * slim + sign * skew * steep_up;
        tangents[i] = quick_root(tangent);
        both_steep *= steep_up * steep_up + steep_on * steep_on;
        s.width *= faded_by(tangent / (tangent + p->beside * p->beside + TINY), GRAZING, GRAZED);
    }
    // Half of the arc, by its tangent, that of a half and so on: up to an eighth, where atan's series is within 1e-10.
    const reals twice_sine = sine[0] * cosine[1] + cosine[0] * sine[1], twice_cosine = cosine[0] * cosine[1] - sine[0] * sine[1];
    const reals slope = twice_sine / larger(1.0 + twice_cosine, (reals)1e-12), half_cosine = quick_inverse_root(1.0 + slope * slope);
    const reals half_sine = slope * half_cosine, second = half_sine / (1.0 + half_cosine), third = second / (1.0 + quick_root(1.0 + second * second));
    const reals t = third / (1.0 + quick_root(1.0 + third * third)), tt = t * t;
    const reals half_arc = 8.0 * t * (1.0 + tt * (-1.0 / 3.0 + tt * (1.0 / 5.0 + tt * (-1.0 / 7.0 + tt * (1.0 / 9.0 + tt * (-1.0 / 11.0))))));
    const reals middle_cosine = cosine[1] * half_cosine + sine[1] * half_sine, middle_sine = sine[1] * half_cosine - cosine[1] * half_sine;
    const double nodes[2] = {0.8611363115940526, 0.3399810435848563}, weights[2] = {0.3478548451374538, 0.6521451548625461};  // Gauss
    reals arc = 0.0, fock = 0.0;
#pragma unroll
    for (int i = 0; i < 2; i++) {
        reals c, s;
        cosine_and_sine(half_arc * nodes[i], &c, &s);
#pragma unroll
        for (int side = -1; side <= 1; side += 2) {
            const reals turned_sine = (middle_sine * c + side * middle_cosine * s) * flat;
            const reals turned_cosine = (middle_cosine * c - side * middle_sine * s) * slim + skew * turned_sine;
            const reals squared = turned_sine * turned_sine + turned_cosine * turned_cosine, inverse = quick_inverse_root(squared);
            arc += weights[i] * squared * inverse;
            fock += weights[i] * inverse;
        }
    }
    const reals size = inverse_cube_root(over * ahead);
    s.fock = half_arc * fock * size * size;
    s.curve = quick_root(quick_root(both_steep)) / size;
    s.sharp = SHARP * ((1.0 + skew * skew) * flat * flat + slim * slim) / (size * size * size * size);
    s.apart = tangents[0] * tangents[1] / (tangents[0] + tangents[1] + TINY);
    s.source = tangents[0] + 0.5 * half_arc * arc, s.receiver = tangents[1] + 0.5 * half_arc * arc;
    s.offset = s.apart * s.fock / s.curve;
    s.width *= quick_root(larger(cosine[0] * cosine[1], (reals)TINY));
    return s;
}
#endif
