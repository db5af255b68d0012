// The gain of one path at one node: spreading, air, walls, Mach factor and beams.

// exp(x) for -80 < x < 80 within 2e-7: 2^whole times a polynomial of the rest (Taylor, degree 7).
static float exponential(float x)
{
    const float y = x * 1.44269504f, shifted = y + 12582912.0f;
    const float f = (y - (shifted - 12582912.0f)) * 0.693147181f;
    const float power = as_float((as_int(shifted) - 0x4B400000 + 127) << 23);
    return power * (1.0f + f * (1.0f + f * (0.5f + f * (0.166666667f + f * (0.0416666667f + f * (8.33333333e-3f +
                    f * (1.38888889e-3f + f * 1.98412698e-4f)))))));
}

// Cubics of a beam on CELLS equal cells of the cosine, from -1 to 1.
static float beam(__global const float4* cells, double cosine)
{
    const float place = (float)(cosine + 1.0) * (0.5f * CELLS);
    int cell = (int)place;
    cell = cell < 0 ? 0 : cell < CELLS ? cell : CELLS - 1;
    const float u = place - (float)cell;
    const float4 c = cells[cell];
    return c.x + u * (c.y + u * (c.z + u * c.w));
}

static float path_gain(const arrival* a, double speed_of_sound, float reflection, float nepers, triple receiver_axis,
                       __global const float4* source_beam, __global const float4* receiver_beam)
{
    const float distance = (float)(a->delay * speed_of_sound);
    float loss = nepers * (distance - 1.0f);
    loss = loss < 80.0f ? loss : 80.0f;
    float gain = reflection * exponential(-loss) / distance;
#if MACH_EXPONENT >= 1
    gain *= (float)a->stretch;
#endif
#if MACH_EXPONENT >= 2
    gain *= (float)a->stretch;
#endif
#if SOURCE_BEAM
    gain *= beam(source_beam, inner(cubic(a->knot + 12, a->u), a->departure));
#endif
#if RECEIVER_BEAM
    gain *= beam(receiver_beam, -inner(receiver_axis, a->departure));
#endif
    return gain;
}
