// What walls do to rays: the frame of a wall, scattering by its limited size, directions by Lambert's law.

typedef struct {
    __global const float4* plane;   // unit normal and offset
    __global const float4* along;   // a side of the rectangle about the wall, and its length, m
    __global const float4* across;  // the other one
    __global const int* kind;       // of its material
    __global const float* returned; // kinds, ANGLES, bands
    __global const float* scattered; // kinds, ANGLES, groups
} wall_tables;

// Share that leaves the mirror's direction because the wall is small (C. L. Christensen, J. H. Rindel, "A new scattering
// method that combines roughness and diffraction effects", Forum Acusticum 2005): a strip of width w returns the share
// f / f_w of what an endless one does below f_w = c a / (2 (w cos)²), a = 2 d1 d2 / (d1 + d2).
static float share_by_size(const wall_tables* walls, int wall, float3 d, float cosine, float before, float after, float wavelength)
{
    const float4 one = walls->along[wall], other = walls->across[wall];
    const float far = after < FARTHEST ? after : FARTHEST;
    const float a = dot3(one.xyz, d), b = dot3(other.xyz, d), aa = a * a, bb = b * b;
    const float width = aa >= bb ? one.w : other.w, length = aa >= bb ? other.w : one.w;
    const float seen = width * cosine, near = wavelength * (before * far / (before + far));
    const float by_width = seen * seen / near, by_length = length * length / near;
    return 1.0f - (by_width < 1.0f ? by_width : 1.0f) * (by_length < 1.0f ? by_length : 1.0f);
}

static float3 onward_by(float3 o, float way, float3 d)
{
    return (float3)(o.x + way * d.x, o.y + way * d.y, o.z + way * d.z);
}

static float3 scaled_sum(float a, float3 x, float b, float3 y, float c, float3 z)
{
    float3 sum;
    sum.x = a * x.x + b * y.x + c * z.x;
    sum.y = a * x.y + b * y.y + c * z.y;
    sum.z = a * x.z + b * y.z + c * z.z;
    return sum;
}

// One step of Newton's towards the length 1, from which a direction strays by rounding.
static float3 unit(float3 d)
{
    const float share = 1.5f - 0.5f * dot3(d, d);
    return (float3)(d.x * share, d.y * share, d.z * share);
}

static float3 lambert(const wall_tables* walls, int wall, float side, uint height, uint turn)
{
    const float square = uniform24(height) + 0x1p-25f, cosine = sqrt(square), sine = sqrt(1.0f - square);
    const float2 circle = on_circle(turn);
    return unit(scaled_sum(side * cosine, walls->plane[wall].xyz, sine * circle.x, walls->along[wall].xyz, sine * circle.y, walls->across[wall].xyz));
}

static float3 mirrored(float3 d, float towards, float3 normal)
{
    const float twice = 2.0f * towards;
    return unit((float3)(d.x - twice * normal.x, d.y - twice * normal.y, d.z - twice * normal.z));
}
