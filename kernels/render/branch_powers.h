// Branch signals times powers of the delay, for a vector of samples.

#if TILTED
// The imaginary part of the delay of path p, -nu, and the square of the delay.
#define TILTED_DELAY                                            \
    const vec nu = mu * tilt_per_sample + paths->nu[p],         \
              mu_squared = mu * mu - nu * nu, nu_squared = 2.0f * mu * nu;

// Multiply a + j b by re - j im, and add x + j y.
static void multiply(vec* a, vec* b, vec x, vec y, vec re, vec im)
{
    const vec was = *a, s = was * re + x, u = *b * re + y;
    *a = *b * im + s;
    *b = u - was * im;
}
#endif

// Put into a and b what `count` branches make of them, the highest one's rows being x and y.
#if TILTED
// The delay is complex, mu - j nu. Even and odd branches go by its square, so that two sums wait for each other half as often.
#define BRANCHES(count)                                                                                      \
    vec a = LOAD(x), b = LOAD(y), odd_a = 0.0f, odd_b = 0.0f;                                                \
    if ((count) > 1) {                                                                                       \
        odd_a = LOAD(x - (long)stride);                                                                      \
        odd_b = LOAD(y - (long)stride);                                                                      \
    }                                                                                                        \
    _Pragma("unroll") for (int q = 2; q < (count); q++)                                                      \
    {                                                                                                        \
        const vec real_branch = LOAD(x - q * (long)stride), imaginary_branch = LOAD(y - q * (long)stride);   \
        if (q & 1) multiply(&odd_a, &odd_b, real_branch, imaginary_branch, mu_squared, nu_squared);          \
        else multiply(&a, &b, real_branch, imaginary_branch, mu_squared, nu_squared);                        \
    }                                                                                                        \
    if ((count) == 1) {                                                                                      \
    } else if ((count) & 1) {                                                                                \
        multiply(&odd_a, &odd_b, a, b, mu, nu);                                                              \
        a = odd_a;                                                                                           \
        b = odd_b;                                                                                           \
    } else {                                                                                                 \
        multiply(&a, &b, odd_a, odd_b, mu, nu);                                                              \
    }
#else
#define BRANCHES(count)                                      \
    vec a = LOAD(x), b = LOAD(y);                            \
    _Pragma("unroll") for (int q = 1; q < (count); q++)      \
    {                                                        \
        a = a * mu + LOAD(x - q * (long)stride);             \
        b = b * mu + LOAD(y - q * (long)stride);             \
    }
#endif
