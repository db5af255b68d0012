// Branch signals times powers of the delay, for a vector of samples.

// Put into a and b what `count` branches make of them, the highest one's rows being x and y.
#if TILTED
// The delay is complex, mu - j nu. Even and odd branches go by its square, so that two sums wait for each other half as often.
#define MULTIPLIED(a, b, x, y, re, im)  \
    {                                   \
        const vec s = a * re + (x);     \
        const vec u = b * re + (y);     \
        const vec was = a;              \
        a = b * im + s;                 \
        b = u - was * im;               \
    }
#define BRANCHES(count)                                                                              \
    vec a = LOAD(x), b = LOAD(y), odd_a = 0.0f, odd_b = 0.0f;                                        \
    if ((count) > 1) {                                                                               \
        odd_a = LOAD(x - (long)stride);                                                              \
        odd_b = LOAD(y - (long)stride);                                                              \
    }                                                                                                \
    _Pragma("unroll") for (int q = 2; q < (count); q++)                                              \
    {                                                                                                \
        const long down = q * (long)stride;                                                          \
        if (q & 1) MULTIPLIED(odd_a, odd_b, LOAD(x - down), LOAD(y - down), mu_squared, nu_squared)  \
        else MULTIPLIED(a, b, LOAD(x - down), LOAD(y - down), mu_squared, nu_squared)                \
    }                                                                                                \
    if ((count) & 1) {                                                                               \
        if ((count) > 1) MULTIPLIED(odd_a, odd_b, a, b, mu, nu)                                      \
        a = (count) > 1 ? odd_a : a;                                                                 \
        b = (count) > 1 ? odd_b : b;                                                                 \
    } else MULTIPLIED(a, b, odd_a, odd_b, mu, nu)
#else
#define BRANCHES(count)                                      \
    vec a = LOAD(x), b = LOAD(y);                            \
    _Pragma("unroll") for (int q = 1; q < (count); q++)      \
    {                                                        \
        a = a * mu + LOAD(x - q * (long)stride);             \
        b = b * mu + LOAD(y - q * (long)stride);             \
    }
#endif
