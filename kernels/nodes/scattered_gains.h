// Paths by scatterers at nodes: what is expected of them from the ends of walks, and how strong they are.

#if SCATTERERS
#define NOTHING_BACK 1e30  // m, over what pressure falls where nothing is sent back

// What is known at four ends of walks, MORE numbers of each: a septic of what comes after the scatterer, and cubics of the
// weight and of the glint, on [-1, 1].
static void predict_more(__global const double* coarse, long slots, double walk_time, double* expected)
{
    double late[4], slopes[4];
    for (int i = 0; i < 4; i++) {
        late[i] = coarse[MORE * i * slots];
        slopes[i] = coarse[(MORE * i + 1) * slots] * (0.5 * walk_time);
    }
    septic(late, slopes, expected);
    for (int k = 2; k < MORE; k++) predict_cubic(coarse + k * slots, MORE * slots, expected + 8 + 4 * (k - 2));
}

static void expect_more(const double* expected, reals u, scattering* b)
{
    reals late = expected[7];
#pragma unroll
    for (int k = 6; k >= 0; k--) late = late * u + expected[k];
    b->late = late;
    b->weight = by_cubic(expected + 8, u);
    const triples glint = {by_cubic(expected + 12, u), by_cubic(expected + 16, u), by_cubic(expected + 20, u)};
    b->glint = glint;
}

// Over what pressure falls, m: lengths of both legs over the strength. What of capsules and spheres, which have phases, is over that
// is told in `field`.
static double scattered_length(const edge_tables* tables, __global const view* seen, const scattering* b, int beside,
                               response* field)
{
    double strength = seen->strength, spread = OF_NODE(b->spread, beside);
    const triples scale = {seen->semi_axes[0], seen->semi_axes[1], seen->semi_axes[2]};
    const glint_of g = {scale, b->source, b->receiver, b->weight, seen->shape};
    if (seen->shape == CAPSULE) {
#if PARTS == 2
        strength = capsule_field(tables, &g, b->glint, OF_NODE_LONG(b->hidden, beside) != 0, beside, field);
#endif
    } else if (seen->shape == SPHERE) {
#if PARTS == 2
        triples place = along_axes(scale, b->glint), glint;
        choices hidden;
        choose(b->hidden, between_them(&g, &glint, &hidden), &place);
        strength = sphere_field(tables, &g, place, seen, beside, field);
#endif
    } else if (seen->shape != POINT) {
        reals cosine;
        const reals full = glint_strength(&g, b->glint, &cosine);
        const double steep = OF_NODE(cosine, beside) / PENUMBRA;
        strength = OF_NODE_LONG(b->hidden, beside) ? 0.0 : OF_NODE(full, beside) * (1.0 - exp(-steep * steep * steep));
    }
#if MACH_EXPONENT >= 1
    spread *= 1.0 - OF_NODE(b->leaving, beside);
#endif
#if MACH_EXPONENT >= 2
    spread *= 1.0 - OF_NODE(b->leaving, beside);
#endif
    return strength * NOTHING_BACK > spread ? spread / strength : NOTHING_BACK;
}
#endif
