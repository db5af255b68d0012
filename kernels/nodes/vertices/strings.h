// Strings from endpoint to endpoint over the ellipses of an outline's points, side by side: twin of `_strings` in
// acoustics/silhouette.py. Angles are those on the unit circles that affine coordinates make of the ellipses.

#if VERTEX == SCATTERER && PARTS == 2
// `_Strings`: lengths of both sides, half the harmonic mean of the tangents, Fock parameter and m of the arc over (k / 2)^(1/3),
// what stands for the depth of the line of sight, and the wavefront's width.
typedef struct {
    reals source, receiver, apart, fock, curve, offset, width;
} strings;

static reals faded_by(reals x, double whole, double none)
{
    const reals part = smaller(larger((x - none) / (whole - none), (reals)0.0), (reals)1.0);
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

static strings strings_over(const outline_points* p)
{
    const reals skew = p->q_nz / p->q_zz, bent = p->q_nn - p->q_nz * skew;
    const reals over = p->support * bent, ahead = p->support * root(bent * p->q_zz), x = 1.0 + over * p->depth;
    reals tangents[2], cosine[2], sine[2];
    for (int i = 0; i < 2; i++) {
        const reals q = i ? p->receiver : p->source;
        const double sign = i ? 1.0 : -1.0;
        const reals y = sign * ahead * (q + skew * p->depth), squared = larger(x * x + y * y, (reals)1.0), leg = root(larger(squared - 1.0, (reals)TINY));
        cosine[i] = (x + y * leg) / squared, sine[i] = (y - x * leg) / squared;
        const reals lift = (cosine[i] - 1.0) / over, up = p->depth - lift, on = q - sign * sine[i] / ahead + skew * lift;
        tangents[i] = root(up * up + on * on);
    }
    // Half of the arc, by its tangent, that of a half and so on: up to an eighth, where atan's series is within 1e-10.
    const reals twice_sine = sine[0] * cosine[1] + cosine[0] * sine[1], twice_cosine = cosine[0] * cosine[1] - sine[0] * sine[1];
    const reals slope = twice_sine / larger(1.0 + twice_cosine, (reals)1e-12), long_side = root(1.0 + slope * slope);
    const reals half_cosine = 1.0 / long_side, half_sine = slope * half_cosine;
    const reals second = slope / (1.0 + long_side), third = second / (1.0 + root(1.0 + second * second));
    const reals t = third / (1.0 + root(1.0 + third * third)), tt = t * t;
    const reals half_arc = 8.0 * t * (1.0 + tt * (-1.0 / 3.0 + tt * (1.0 / 5.0 + tt * (-1.0 / 7.0 + tt * (1.0 / 9.0 + tt * (-1.0 / 11.0))))));
    const reals middle_cosine = cosine[1] * half_cosine + sine[1] * half_sine, middle_sine = sine[1] * half_cosine - cosine[1] * half_sine;
    const double nodes[2] = {0.8611363115940526, 0.3399810435848563}, weights[2] = {0.3478548451374538, 0.6521451548625461};  // Gauss
    reals arc = 0.0, fock = 0.0;
    for (int i = 0; i < 4; i++) {
        reals c, s;
        cosine_and_sine(half_arc * nodes[i / 2], &c, &s);
        s = i & 1 ? -s : s;
        const reals turned_sine = (middle_sine * c + middle_cosine * s) / over;
        const reals turned_cosine = (middle_cosine * c - middle_sine * s) / ahead + skew * turned_sine;
        const reals steep = root(turned_sine * turned_sine + turned_cosine * turned_cosine), weight = half_arc * weights[i / 2];
        arc += weight * steep;
        fock += weight / steep;
    }
    reals size;
    for (int i = 0; i < NODES_AT_ONCE; i++) ((double*)&size)[i] = cbrt(1.0 / (OF_NODE(over, i) * OF_NODE(ahead, i)));
    reals steeps[2];
    for (int i = 0; i < 2; i++) {
        const reals up = sine[i] / over, on = cosine[i] / ahead + (i ? 1.0 : -1.0) * skew * up;
        steeps[i] = up * up + on * on;
    }
    strings s;
    s.fock = fock * size * size;
    s.curve = root(root(steeps[0] * steeps[1])) / size;
    s.apart = tangents[0] * tangents[1] / (tangents[0] + tangents[1] + TINY);
    s.source = tangents[0] + 0.5 * arc, s.receiver = tangents[1] + 0.5 * arc;
    s.offset = s.apart * s.fock / s.curve;
    s.width = root(larger(cosine[0] * cosine[1], (reals)TINY));
    for (int i = 0; i < 2; i++) {
        const reals squared = tangents[i] * tangents[i];
        s.width *= faded_by(squared / (squared + p->beside * p->beside + TINY), GRAZING, GRAZED);
    }
    return s;
}
#endif
