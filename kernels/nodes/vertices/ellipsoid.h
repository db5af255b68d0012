// Where ellipsoids reflect, at nodes side by side, and how strongly: twin of acoustics/scattering.py.

#if VERTEX >= SCATTERER
#define LEAST 1e-100  // in divisors: what is divided by it is squared, too

static reals larger(reals a, reals b) { return a > b ? a : b; }
static reals smaller(reals a, reals b) { return a < b ? a : b; }
static reals size_of(reals a) { return a < 0.0 ? -a : a; }
static reals root(reals squared)
{
    const reals x = larger(squared, (reals)LEAST);
    return x * inverse_root(x);
}
static triples along_axes(triples scale, triples u)
{
    const triples out = {scale.x * u.x, scale.y * u.y, scale.z * u.z};
    return out;
}
static triples apart(triples a, triples b)
{
    const triples out = {a.x - b.x, a.y - b.y, a.z - b.z};
    return out;
}
static triples of_length_one(triples v) { return scaled(inverse_root(larger(DOT(v, v), (reals)LEAST)), v); }
#endif

#if VERTEX == SCATTERER

// Both ends in the frame of what reflects, m, and the weight of the leg to the receiver. Of capsules `scale` is the radius
// and, along z, half of the whole length.
typedef struct {
    triples scale, source, receiver;
    reals weight;
    int shape;
} scatterer_frame;

// Slopes and second derivatives of the path by a unit vector, along two vectors across it.
typedef struct {
    triples one, other;
    reals slope_one, slope_other, bend_one, bend_both, bend_other, determinant;
    reals nearest;  // inverse distance of the nearer end, 1/m
} derivatives;

static void add_end(triples place, triples p, triples q, triples end, reals weight, reals* inward, derivatives* b)
{
    const triples away = apart(place, end);
    const reals near = inverse_root(DOT(away, away)), size = weight * near;
    const reals first = DOT(p, away) * near, second = DOT(q, away) * near;
    b->nearest = larger(b->nearest, near);
    b->slope_one += weight * first;
    b->slope_other += weight * second;
    *inward -= size * DOT(place, away);
    b->bend_one += (DOT(p, p) - first * first) * size;
    b->bend_both += (DOT(p, q) - first * second) * size;
    b->bend_other += (DOT(q, q) - second * second) * size;
}

static derivatives derivatives_at(const scatterer_frame* g, triples u, reals weight)
{
    const reals sign = u.z >= 0.0 ? (reals)1.0 : (reals)-1.0, a = -1.0 / (sign + u.z), b = u.x * u.y * a;
    derivatives out = {{1.0 + sign * u.x * u.x * a, sign * b, -sign * u.x}, {b, sign + u.y * u.y * a, -u.y}};
    const triples p = along_axes(g->scale, out.one), q = along_axes(g->scale, out.other), place = along_axes(g->scale, u);
    reals inward = 0.0;
    out.slope_one = out.slope_other = out.bend_one = out.bend_both = out.bend_other = out.nearest = 0.0;
    add_end(place, p, q, g->source, (reals)1.0, &inward, &out);
    add_end(place, p, q, g->receiver, weight, &inward, &out);
    out.bend_one += size_of(inward);
    out.bend_other += size_of(inward);
    out.determinant = out.bend_one * out.bend_other - out.bend_both * out.bend_both;
    return out;
}

// Whether an ellipsoid is so long that what u turns by tells little of how far the place moves.
static int is_long(const scatterer_frame* g)
{
    const double x = OF_NODE(g->scale.x, 0), y = OF_NODE(g->scale.y, 0), z = OF_NODE(g->scale.z, 0);
    return fmax(x, fmax(y, z)) > ELONGATED * fmin(x, fmin(y, z));
}

// Unit vectors of the points of the surface nearest to a place outside, which is a multiple of the axes.
static triples outwards(const scatterer_frame* g, triples place)
{
    const triples squared = along_axes(g->scale, g->scale);
    const triples least = {squared.x * (size_of(place.x) - 1.0), squared.y * (size_of(place.y) - 1.0), squared.z * (size_of(place.z) - 1.0)};
    reals more = larger(larger(least.x, least.y), larger(least.z, (reals)0.0));
    triples u = place;
    for (int i = 0; i <= OUTWARD_STEPS; i++) {
        const triples over = {1.0 / (squared.x + more), 1.0 / (squared.y + more), 1.0 / (squared.z + more)};
        u = along_axes(along_axes(squared, over), place);
        const reals size = larger(DOT(u, u), (reals)LEAST);
        more += larger((root(size) - 1.0) * size / DOT(u, along_axes(u, over)), (reals)0.0);
    }
    return of_length_one(u);
}

// A unit vector one Newton step nearer to the shortest path; `change` is by how much, rad: of u, or as the nearer end sees the place.
static triples specular_step(const scatterer_frame* g, triples u, reals longest, reals* change)
{
    const derivatives b = derivatives_at(g, u, g->weight);
    const reals size = 1.0 / larger(b.determinant, (reals)LEAST);
    const reals first = (b.bend_both * b.slope_other - b.bend_other * b.slope_one) * size;
    const reals second = (b.bend_both * b.slope_one - b.bend_one * b.slope_other) * size;
    const triples shift = along_axes(g->scale, plus(scaled(first, b.one), scaled(second, b.other)));
    const reals length = larger(root(first * first + second * second), b.nearest * root(DOT(shift, shift)));
    const reals damping = smaller((reals)1.0, longest / length);
    *change = length * damping;
    const triples moved = plus(u, plus(scaled(damping * first, b.one), scaled(damping * second, b.other)));
    return is_long(g) ? outwards(g, moved) : of_length_one(moved);
}

// The point between both ends that is nearest to the centre, as a multiple of the axes; whether it lies inside.
static triples between_ends(const scatterer_frame* g, choices* hidden)
{
    const triples s = {g->source.x / g->scale.x, g->source.y / g->scale.y, g->source.z / g->scale.z};
    const triples r = {g->receiver.x / g->scale.x, g->receiver.y / g->scale.y, g->receiver.z / g->scale.z};
    const triples way = apart(r, s);
    const reals share = -DOT(s, way) / larger(DOT(way, way), (reals)LEAST);
    const triples nearest = plus(s, scaled(smaller(larger(share, (reals)0.0), (reals)1.0), way));
    *hidden = DOT(nearest, nearest) < 1.0;
    return nearest;
}

// The strength but for the share that is lit, m, and the cosine of the angle of incidence.
static reals specular_strength(const scatterer_frame* g, triples u, reals* cosine)
{
    const triples normal = {u.x / g->scale.x, u.y / g->scale.y, u.z / g->scale.z};
    const triples away = apart(along_axes(g->scale, u), g->source);
    const reals steep = root(DOT(normal, normal));
    *cosine = larger(-DOT(normal, away) / (steep * root(DOT(away, away))), (reals)0.0);
    const derivatives b = derivatives_at(g, u, (reals)1.0);
    return *cosine * g->scale.x * g->scale.y * g->scale.z * steep * inverse_root(larger(b.determinant, (reals)LEAST));
}
#endif
