// Numbers of some 48 bits where there is no float64: unevaluated sums of two floats, the larger one first. Sums after
// Knuth (The Art of Computer Programming 2, 4.2.2, theorem B), products by a fused one, whose rest is exact. Products and
// sums are fused where fma() stands and nowhere else: rests would be lost.
#pragma OPENCL FP_CONTRACT OFF

typedef float2 pair;

// Of numbers the first of which is the larger.
static pair normalised(float large, float small)
{
    const float whole = large + small;
    return (pair)(whole, small - (whole - large));
}

static pair plus(pair a, pair b)
{
    const float whole = a.x + b.x, other = whole - a.x;
    return normalised(whole, ((a.x - (whole - other)) + (b.x - other)) + (a.y + b.y));
}
static pair minus(pair a, pair b) { return plus(a, -b); }

static pair product(pair a, pair b)
{
    const float whole = a.x * b.x;
    return normalised(whole, fma(a.x, b.x, -whole) + (a.x * b.y + a.y * b.x));
}
static pair scaled(float factor, pair a) { return product((pair)(factor, 0.0f), a); }

// By a Newton step from that of the larger part.
static pair root(pair a)
{
    const float near = sqrt(a.x), square = near * near, rest = ((a.x - square) - fma(near, near, -square)) + a.y;
    return normalised(near, rest / (near + near));
}
