// The gains of one path at one node: its response (spreading, air, walls, Mach factor, beams) at NODES frequencies,
// projected on FUNCTIONS functions of frequency.

// exp(x) for -80 < x < 80 within 2e-7: 2^whole times a polynomial of the rest (Taylor, degree 7).
static float exponential(float x)
{
    const float y = x * 1.44269504f, shifted = y + 12582912.0f;
    const float f = (y - (shifted - 12582912.0f)) * 0.693147181f;
    const float power = as_float((as_int(shifted) - 0x4B400000 + 127) << 23);
    return power * (1.0f + f * (1.0f + f * (0.5f + f * (0.166666667f + f * (0.0416666667f + f * (8.33333333e-3f +
                    f * (1.38888889e-3f + f * 1.98412698e-4f)))))));
}

// Multiply by a beam: cubics on CELLS equal cells of the cosine, from -1 to 1, for each frequency.
static void apply_beam(__global const float4* cells, double cosine, float* response)
{
    const float place = (float)(cosine + 1.0) * (0.5f * CELLS);
    int cell = (int)place;
    cell = cell < 0 ? 0 : cell < CELLS ? cell : CELLS - 1;
    const float u = place - (float)cell;
    for (int m = 0; m < NODES; m++) {
        const float4 c = cells[cell * NODES + m];
        response[m] *= c.x + u * (c.y + u * (c.z + u * c.w));
    }
}

// Returns the largest response, without sign.
static float path_gains(const arrival* a, double speed_of_sound, __global const float* reflection, int slots,
                        __global const float* nepers, __global const float* projection, triple receiver_axis,
                        __global const float4* source_beam, __global const float4* receiver_beam, float* gain)
{
    const float distance = (float)(a->delay * speed_of_sound);
    float response[NODES];
    float common = 1.0f / distance, largest = 0.0f;
#if MACH_EXPONENT >= 1
    common *= (float)a->stretch;
#endif
#if MACH_EXPONENT >= 2
    common *= (float)a->stretch;
#endif
    for (int m = 0; m < NODES; m++) {
        float loss = nepers[m] * (distance - 1.0f);
        loss = loss < 80.0f ? loss : 80.0f;
        response[m] = reflection[m * slots] * exponential(-loss) * common;
    }
#if SOURCE_BEAM
    apply_beam(source_beam, inner(cubic(a->knot + 12, a->u), a->departure), response);
#endif
#if RECEIVER_BEAM
    apply_beam(receiver_beam, -inner(receiver_axis, a->departure), response);
#endif
    for (int m = 0; m < NODES; m++) {
        const float size = response[m] < 0.0f ? -response[m] : response[m];
        largest = size > largest ? size : largest;
    }
    for (int k = 0; k < FUNCTIONS; k++) {
        gain[k] = 0.0f;
        for (int m = 0; m < NODES; m++) gain[k] += projection[k * NODES + m] * response[m];
    }
    return largest;
}
