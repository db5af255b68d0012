// Random numbers by counter: Philox-4x32 with ten rounds (J. K. Salmon et al., "Parallel random numbers: as easy as
// 1, 2, 3", SC 2011). A number depends on key and counter alone, and so neither on threads nor on the order of launches.

#pragma OPENCL FP_CONTRACT OFF  // rounded as on the host

#define PHILOX_ROUNDS 10

// One word at a time: vectors of four are taken apart for the products and put together again in each round.
static uint4 philox(uint4 counter, uint2 key)
{
    uint x = counter.x, y = counter.y, z = counter.z, w = counter.w, first = key.x, second = key.y;
    for (int i = 0; i < PHILOX_ROUNDS; i++) {
        const ulong one = 0xD2511F53UL * x, other = 0xCD9E8D57UL * z;
        x = (uint)(other >> 32) ^ y ^ first;
        y = (uint)other;
        z = (uint)(one >> 32) ^ w ^ second;
        w = (uint)one;
        first += 0x9E3779B9U;
        second += 0xBB67AE85U;
    }
    return (uint4)(x, y, z, w);
}

// Uniform in [0, 1), a multiple of 2^-24.
static float uniform24(uint word) { return (float)(word >> 8) * 0x1p-24f; }

// Cosine and sine of an angle that is uniform on the circle: two bits say the quadrant, 24 the angle in it.
static float2 on_circle(uint word)
{
    const float x = ((float)((word & 0x3FFFFFFFU) >> 6) * 0x1p-24f - 0.5f) * 1.57079637f, square = x * x;
    const float sine = x * (1.0f + square * (-0.166666672f + square * (0.00833333377f + square * -0.000198412701f)));
    const float cosine = 1.0f + square * (-0.5f + square * (0.0416666679f + square * (-0.00138888892f + square * 2.48015876e-05f)));
    const uint quadrant = word >> 30;
    if (quadrant == 0) return (float2)(cosine, sine);
    if (quadrant == 1) return (float2)(-sine, cosine);
    if (quadrant == 2) return (float2)(-cosine, -sine);
    return (float2)(sine, -cosine);
}
