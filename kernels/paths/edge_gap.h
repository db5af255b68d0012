// The shortest way over two edges with air between: twin of acoustics/edge_gap.py.

#if GAP
typedef struct {
    double places[2];  // where it meets the edges, m from their starts
    double legs[3];    // lengths before, between and behind them, m
    double slides[2];  // m by which the places go where both ends go 1 m, at most, to first order
} crossing;

typedef struct {
    double square, first, last, cosine;  // of the offset from the start of the last edge to that of the first, and along both
} offset;

static offset offset_of(__global const edge_of_room* first, __global const edge_of_room* last)
{
    const triple away = difference(at_row(first->start), at_row(last->start));
    const triple one = at_row(first->along), other = at_row(last->along);
    const offset out = {inner(away, away), inner(away, one), inner(away, other), inner(one, other)};
    return out;
}

static double off_edge(double square, double along) { return sqrt(fmax(square - along * along, ON_LINE * ON_LINE)); }

// Apex of the way over one edge, from an end to what is `off` it, and `at` along it.
static double apex_of(cylindrical end, double off, double at) { return (end.z * off + at * end.r) / (end.r + off); }

// Places nearer to the shortest way; returns whether they are those of it.
static int nearer(const offset* d, cylindrical a, cylindrical b, crossing* way)
{
    const double u = way->places[0], v = way->places[1];
    const double s = sqrt(a.r * a.r + (u - a.z) * (u - a.z)), t = sqrt(b.r * b.r + (v - b.z) * (v - b.z));
    const double one = d->first + u - v * d->cosine, other = d->last + u * d->cosine - v;
    const double between_squared = d->square + u * u + v * v + 2.0 * (u * d->first - v * d->last - u * v * d->cosine);
    const double apart = fmax(between_squared, ON_LINE * ON_LINE), between = sqrt(apart);
    const double slopes[2] = {(u - a.z) / s + one / between, (v - b.z) / t - other / between};
    const double p = a.r * a.r / (s * s * s) + (1.0 - one * one / apart) / between;
    const double q = b.r * b.r / (t * t * t) + (1.0 - other * other / apart) / between;
    const double mixed = -(d->cosine - one * other / apart) / between;
    const double determinant = fmax(p * q - mixed * mixed, 1e-300);
    const double steps[2] = {(q * slopes[0] - mixed * slopes[1]) / determinant, (p * slopes[1] - mixed * slopes[0]) / determinant};
    const double longest = fmax(fabs(steps[0]), fabs(steps[1])), scale = fmin(fmin(s, t), between);
    const double moves[2] = {a.r / (s * s), b.r / (t * t)};
    way->slides[0] = (q * moves[0] + fabs(mixed) * moves[1]) / determinant;
    way->slides[1] = (p * moves[1] + fabs(mixed) * moves[0]) / determinant;
    if (longest <= NEWTON * scale) {
        way->places[0] = u - steps[0];
        way->places[1] = v - steps[1];
        return longest <= FOUND * scale;
    }
    // Far from it, each in turn with the other one as it is.
    const double place = apex_of(a, off_edge(apart, one), u - one), on = d->last + place * d->cosine - v;
    const double squared = d->square + place * place + v * v + 2.0 * (place * d->first - v * d->last - place * v * d->cosine);
    way->places[0] = place;
    way->places[1] = apex_of(b, off_edge(squared, on), v + on);
    return 0;
}

// The way between ends a and b about the first and the last edge.
static crossing cross_edges(__global const edge_of_room* first, __global const edge_of_room* last, cylindrical a, cylindrical b)
{
    const offset from = offset_of(first, last);
    const offset* d = &from;
    const double sign = d->cosine < 0.0 ? -1.0 : 1.0;
    const double across = a.r + sqrt(fmax(d->square - d->first * d->first, 0.0));
    const double slope = (sign * b.z - d->first - a.z) / (across + b.r);
    crossing way = {{a.z + slope * a.r, sign * (a.z + slope * across + d->first)}, {0.0, 0.0, 0.0}, {0.0, 0.0}};
    for (int k = 0; k < STEPS && !nearer(d, a, b, &way); k++) {}
    const double u = way.places[0], v = way.places[1];
    const double squared = d->square + u * u + v * v + 2.0 * (u * d->first - v * d->last - u * v * d->cosine);
    way.legs[0] = sqrt(a.r * a.r + (u - a.z) * (u - a.z));
    way.legs[1] = fmax(sqrt(fmax(squared, 0.0)), ON_LINE);
    way.legs[2] = sqrt(b.r * b.r + (v - b.z) * (v - b.z));
    return way;
}
#endif
