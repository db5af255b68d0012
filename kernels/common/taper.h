// Tapers: slow weights of paths that begin or end. Twin of tracks/splines.py; `terms` are those of odd powers.

#define FAR 8388608.0f  // samples: nothing begins or ends

// Weight of a taper, which rises from 0 at -1 to 1 at 1.
static vec taper(vec x, __global const float* terms)
{
    const vec none = 0.0f, one = 1.0f, square = x * x;
#if LANES == 1
    if (x <= -1.0f || x >= 1.0f) return x >= 1.0f ? one : none;
#endif
    vec sum = terms[TAPER_TERMS - 1];
    for (int i = TAPER_TERMS - 2; i >= 0; i--) sum = sum * square + terms[i];
    const vec weight = 0.5f + 0.5f * x * sum;
    return x <= -one ? none : x >= one ? one : weight;
}

// What of a path is taken between a taper that begins and one that ends so many samples before.
static vec taken(vec since_rise, vec since_fall, float per_half, __global const float* terms)
{
    return taper(since_rise * per_half - 1.0f, terms) - taper(since_fall * per_half + 1.0f, terms);
}
