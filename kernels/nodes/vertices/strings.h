// Strings from endpoint to endpoint over the ellipses of an outline's points, side by side: twin of `_strings` in
// acoustics/silhouette.py. Angles are those on the unit circles that affine coordinates make of the ellipses.

#if VERTEX == SHADE && PARTS == 2
// `_Strings`: lengths of both sides, twice the inverse of the harmonic mean of the tangents, Fock parameter and m of the arc over (k / 2)^(1/3),
// what stands for the depth of the line of sight, the wavefront's width, and (k / 2)^(2/3) below which the ellipse is too sharp.
typedef struct {
    reals source, receiver, nearness, fock, curve, offset, width, sharp;
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
// Arc tangent between -1 and 1, by half the angle and a polynomial within 5e-10.
static reals arc_tangent(reals x)
{
    const reals t = x / (1.0 + quick_root(1.0 + x * x)), tt = t * t;
    return 2.0 * t * (0.9999999993921002 + tt * (-0.3333330749342851 + tt * (0.19998210797510574 + tt * (-0.14239982917784177 +
           tt * (0.10572814468787198 + tt * -0.060332416841238114)))));
}
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

// Tangents are as long as those of the unit circle times the speed of the ellipse where they touch. Divisions and roots take most of
// the time: what is divided by often is inverted once.
static strings strings_over(const outline_points* p)
{
    const reals inverse_support = 1.0 / p->support, skew = p->q_nz / p->q_zz, bent = p->q_nn - p->q_nz * skew;
    const reals slenderness = quick_inverse_root(bent * p->q_zz);
    const reals over = p->support * bent, ahead = over * p->q_zz * slenderness, x = 1.0 + over * p->depth;
    const reals flat = p->q_zz * slenderness * slenderness * inverse_support, slim = slenderness * inverse_support;
    reals legs[2], steep[2], squared[2], cosine[2], sine[2];
    strings s;
#pragma unroll
    for (int i = 0; i < 2; i++) {
        const reals q = i ? p->receiver : p->source;
        const double sign = i ? 1.0 : -1.0;
        const reals y = sign * ahead * (q + skew * p->depth), far = larger(x * x + y * y, (reals)1.0), inverse = 1.0 / far;
        legs[i] = quick_root(larger(far - 1.0, (reals)TINY));
        cosine[i] = (x + y * legs[i]) * inverse, sine[i] = (y - x * legs[i]) * inverse;
        const reals steep_up = sine[i] * flat, steep_on = cosine[i] * slim + sign * skew * steep_up;
        const reals steep_squared = steep_up * steep_up + steep_on * steep_on;
        steep[i] = quick_root(steep_squared);
        squared[i] = (far - 1.0) * steep_squared;
    }
    const reals source = legs[0] * steep[0], receiver = legs[1] * steep[1], beside = p->beside * p->beside + TINY;
    const reals first = squared[0] + beside, second = squared[1] + beside, both = 1.0 / (first * second);
    s.width = faded_by(squared[0] * second * both, GRAZING, GRAZED) * faded_by(squared[1] * first * both, GRAZING, GRAZED);
    // Half of the arc, by the tangent of half of that.
    const reals twice_sine = sine[0] * cosine[1] + cosine[0] * sine[1], twice_cosine = cosine[0] * cosine[1] - sine[0] * sine[1];
    const reals slope = twice_sine / larger(1.0 + twice_cosine, (reals)1e-12), half_cosine = quick_inverse_root(1.0 + slope * slope);
    const reals half_sine = slope * half_cosine, half_arc = 2.0 * arc_tangent(half_sine / (1.0 + half_cosine));
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
            const reals speed = turned_sine * turned_sine + turned_cosine * turned_cosine, inverse = quick_inverse_root(speed);
            arc += weights[i] * speed * inverse;
            fock += weights[i] * inverse;
        }
    }
    const reals sharpness = over * ahead, size = inverse_cube_root(sharpness), small = size * size * sharpness;  // small: 1 / size
    const reals speeds = steep[0] * steep[1], inverse_speed = quick_inverse_root(larger(speeds, (reals)TINY));
    s.fock = half_arc * fock * size * size;
    s.curve = speeds * inverse_speed * small;
    s.sharp = SHARP * ((1.0 + skew * skew) * flat * flat + slim * slim) * (small * small) * (small * small);
    const reals tangents = source + receiver;
    s.nearness = tangents / larger(source * receiver, (reals)TINY);
    s.source = source + 0.5 * half_arc * arc, s.receiver = receiver + 0.5 * half_arc * arc;
    s.offset = source * receiver / (tangents + TINY) * s.fock * inverse_speed * size;
    s.width *= quick_root(larger(cosine[0] * cosine[1], (reals)TINY));
    return s;
}
#endif
