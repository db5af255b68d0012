// Where capsules reflect, at nodes side by side: twin of acoustics/capsule.py. What is known of it is the place, m.

#if VERTEX == SCATTERER
#define PARALLEL 1e-20  // squared sine of the angle to the axis below which the middle between both ends is the nearest point

// A place on the axis of a capsule.
static triples on_axis(reals at)
{
    const triples out = {(reals)0.0, (reals)0.0, at};
    return out;
}
// Half of the cylinder, m.
static reals reach(const scatterer_frame* g) { return g->scale.z - g->scale.x; }

static reals clamped(reals x, reals end) { return smaller(larger(x, -end), end); }

// Where on the axis a place belongs to; the direction in which it is from there.
static reals split(const scatterer_frame* g, triples place, triples* normal)
{
    const reals at = clamped(place.z, reach(g));
    *normal = of_length_one(apart(place, on_axis(at)));
    return at;
}
static triples joined(const scatterer_frame* g, reals at, triples normal) { return plus(scaled(g->scale.x, normal), on_axis(at)); }

// The point between both ends that is nearest to the axis, and where on it; whether it lies inside.
static triples between_capsule_ends(const scatterer_frame* g, reals* at, choices* hidden)
{
    const triples s = g->source, away = apart(g->receiver, s);
    const reals size = larger(DOT(away, away), (reals)LEAST), straight = DOT(s, away), level = PARALLEL * size;
    const reals aside = level + away.x * away.x + away.y * away.y, inwards = 0.5 * level - s.x * away.x - s.y * away.y;
    const reals share = smaller(larger(inwards / aside, (reals)0.0), (reals)1.0);
    *at = clamped(s.z + share * away.z, reach(g));
    const reals step_closer = smaller(larger((*at * away.z - straight) / size, (reals)0.0), (reals)1.0);
    const triples nearest = plus(s, scaled(step_closer, away)), off = apart(nearest, on_axis(*at));
    *hidden = DOT(off, off) < g->scale.x * g->scale.x;
    return nearest;
}

// What a step is made of: slopes and second derivatives along the axis and two vectors across the normal.
typedef struct {
    reals gz, gp, gq, hzz, hzp, hzq, hpp, hpq, hqq, inward;
} capsule_derivatives;

static void add_capsule_end(triples place, triples u, triples one, triples other, triples end, reals w, capsule_derivatives* b)
{
    const triples away = apart(place, end);
    const reals close = inverse_root(DOT(away, away)), size = w * close;
    const reals z = away.z * close, p = DOT(one, away) * close, q = DOT(other, away) * close;
    b->gz += w * z;
    b->gp += w * p;
    b->gq += w * q;
    b->inward -= size * DOT(u, away);
    b->hzz += (1.0 - z * z) * size;
    b->hzp += (one.z - z * p) * size;
    b->hzq += (other.z - z * q) * size;
    b->hpp += (1.0 - p * p) * size;
    b->hpq -= p * q * size;
    b->hqq += (1.0 - q * q) * size;
}

// A place one Newton step nearer to the shortest path; `change` is by how much, rad.
static triples capsule_step(const scatterer_frame* g, triples known, reals longest, reals* change)
{
    triples u;
    const reals at = split(g, known, &u), radius = g->scale.x;
    const reals sign = u.z >= 0.0 ? (reals)1.0 : (reals)-1.0, a = -1.0 / (sign + u.z), mixed = u.x * u.y * a;
    const triples one = {1.0 + sign * u.x * u.x * a, sign * mixed, -sign * u.x}, other = {mixed, sign + u.y * u.y * a, -u.y};
    const triples place = joined(g, at, u);
    capsule_derivatives b;
    b.gz = b.gp = b.gq = b.hzz = b.hzp = b.hzq = b.hpp = b.hpq = b.hqq = b.inward = 0.0;
    add_capsule_end(place, u, one, other, g->source, (reals)1.0, &b);
    add_capsule_end(place, u, one, other, g->receiver, g->weight, &b);
    b.hpp += size_of(b.inward) / radius;
    b.hqq += size_of(b.inward) / radius;
    const reals size = 1.0 / larger(b.hpp * b.hqq - b.hpq * b.hpq, (reals)LEAST);
    const reals by_p = (b.hqq * b.hzp - b.hpq * b.hzq) * size, by_q = (b.hpp * b.hzq - b.hpq * b.hzp) * size;
    const reals bend = larger(b.hzz - b.hzp * by_p - b.hzq * by_q, (reals)FLATTEST);
    const reals moved = clamped(at - (b.gz - b.gp * by_p - b.gq * by_q) / bend, reach(g)), by = moved - at;
    const reals gp = b.gp + b.hzp * by, gq = b.gq + b.hzq * by;
    const reals first = (b.hpq * gq - b.hqq * gp) * size / radius, second = (b.hpq * gp - b.hpp * gq) * size / radius;
    const reals turn = root(first * first + second * second), damping = smaller((reals)1.0, longest / turn);
    *change = turn * damping + size_of(by) / radius;
    return joined(g, moved, of_length_one(plus(u, plus(scaled(damping * first, one), scaled(damping * second, other)))));
}

// Where a search begins: at the mirror point of the axis, towards the bisector from there.
static reals off_axis(triples end, reals radius)
{
    return larger(root(end.x * end.x + end.y * end.y) - radius, 1e-3 * radius);
}
static triples capsule_guess(const scatterer_frame* g)
{
    const reals s = off_axis(g->source, g->scale.x), share = s / (s + off_axis(g->receiver, g->scale.x));
    const reals at = clamped(g->source.z + share * (g->receiver.z - g->source.z), reach(g));
    const triples axis = on_axis(at);
    return joined(g, at, of_length_one(plus(of_length_one(apart(g->source, axis)), of_length_one(apart(g->receiver, axis)))));
}
#endif
