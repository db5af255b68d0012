// The gain of one path at one node: spreading, air, walls, Mach factor and beams.

// Cubics of a beam on CELLS equal cells of the cosine, from -1 to 1.
static float beam(__global const float4* cells, double cosine)
{
    const float place = (float)(clamp(cosine, -1.0, 1.0) + 1.0) * (0.5f * CELLS);
    const int cell = min((int)place, CELLS - 1);
    const float u = place - (float)cell;
    const float4 c = cells[cell];
    return c.x + u * (c.y + u * (c.z + u * c.w));
}

static float path_gain(const arrival* a, double speed_of_sound, float reflection, float nepers, triple receiver_axis,
                       __global const float4* source_beam, __global const float4* receiver_beam)
{
    const float distance = (float)(a->delay * speed_of_sound);
    float gain = reflection * exp(-nepers * (distance - 1.0f)) / distance;
#if MACH_EXPONENT >= 1
    const float factor = 1.0f / (1.0f - (float)a->mach);
    gain *= factor;
#endif
#if MACH_EXPONENT >= 2
    gain *= factor;
#endif
#if SOURCE_BEAM
    gain *= beam(source_beam, inner(cubic(a->knot + 12, a->u), a->departure));
#endif
#if RECEIVER_BEAM
    gain *= beam(receiver_beam, -inner(receiver_axis, a->departure));
#endif
    return gain;
}
