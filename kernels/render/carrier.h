// The carrier's turn over a delay: exp(-2 pi j cycles), cycles = carrier / sampling rate * delay in samples.

// Turn of whole samples in half turns from -1 to 1: the product is exact modulo one turn, which is 2^64.
static float whole_turn(int whole, ulong turn_per_sample)
{
    return (float)(int)((ulong)(long)whole * turn_per_sample >> 32) * 4.65661287e-10f;  // 2^-31
}

// Cosine and sine of pi x for |x| < 2^20: whole half turns are taken off, then minimax polynomials within 5e-8.
static void half_turns(vec x, vec* cosine, vec* sine)
{
    const ivec odd = (nearest(x) & 1) << 31;
    const vec r = x - rounded(x), s = r * r;
    const vec c = 0.9999999535f + s * (-4.934792859f + s * (4.058411917f + s * (-1.331880173f + s * 0.2196968188f)));
    const vec i = r * (3.14159258f + s * (-5.167706879f + s * (2.550031377f + s * (-0.5980451734f + s * 0.07722012749f))));
    *cosine = AS_VEC(AS_IVEC(c) ^ odd);
    *sine = AS_VEC(AS_IVEC(i) ^ odd);
}

typedef struct {
    float tilt_per_sample, stretch, per_stretch;
    int first_stretch, stretches;
} tilt_numbers;

// The stretch of delays in which one lies that is `beyond` their beginning, samples, and how far from its middle: see `Stretches`
// in render/tilt.py. In the middle an imaginary delay is 0, which stands for air that absorbs evenly more over the band.
static int stretch_of(float beyond, int stretches, float length, float per_length, float* from_middle)
{
    int stretch = (int)(beyond * per_length);
    stretch = stretch < 0 ? 0 : stretch < stretches ? stretch : stretches - 1;
    *from_middle = beyond - ((float)stretch + 0.5f) * length;
    return stretch;
}
