// The gains of one path at one node: its response (spreading, air, walls, Mach factor, beams) at FREQUENCIES frequencies, in
// PARTS parts (real; imaginary too where a wall or a beam has a phase), projected on FUNCTIONS functions of frequency.

#if FREQUENCIES == 1
typedef float band;  // neighbouring frequencies side by side
#define BANDS 1
#define AS_BAND as_float
#define AS_WHOLE as_int
#else
typedef float8 band;
#define BANDS (FREQUENCIES / 8)
#define AS_BAND as_float8
#define AS_WHOLE as_int8
#endif

#if FUNCTIONS == 1
typedef float chunk;  // gains of neighbouring functions side by side
#define CHUNKS 1
static float sum_of(chunk x) { return x; }
#else
typedef float8 chunk;
#define CHUNKS ((FUNCTIONS + 7) / 8)
static float sum_of(chunk x) { return ((x.s0 + x.s1) + (x.s2 + x.s3)) + ((x.s4 + x.s5) + (x.s6 + x.s7)); }
#endif

typedef struct {
    __global const band* nepers;         // [BANDS], of the amplitude, 1/m
    __global const chunk* projection;    // [PARTS][FREQUENCIES][CHUNKS]
    __global const band* functions;      // [FUNCTIONS][PARTS][BANDS], weighted
    __global const band* weight;         // [BANDS]
    __global const chunk* sizes;         // [CHUNKS], most that each adds to a path
    __global const band* reflection;     // [slots][PARTS][BANDS], of walls that are the same at every angle
    __global const band* walls;          // those that are not: [materials][CELLS][4][PARTS][BANDS]
    __global const int* wall_of;         // [ANGULAR][slots], -1 for none
    __global const float* normal;        // [ANGULAR][3][slots], unfolded
    __global const band* source_directivity;    // AXIAL: [CELLS][4][PARTS][BANDS]; SPHERICAL: [6][SIDE][SIDE][PARTS][BANDS]
    __global const band* receiver_directivity;  // likewise
} surroundings;

typedef struct {
    band part[PARTS][BANDS];
} response;

// exp(x) for -80 < x < 80 within 2e-7: 2^whole times a polynomial of the rest (Taylor, degree 7).
static band exponential(band x)
{
    const band y = x * 1.44269504f, shifted = y + ROUNDING;
    const band f = (y - (shifted - ROUNDING)) * 0.693147181f;
    const band power = AS_BAND((AS_WHOLE(shifted) - ROUNDING_BITS + 127) << 23);
    return power * (1.0f + f * (1.0f + f * (0.5f + f * (0.166666667f + f * (0.0416666667f + f * (8.33333333e-3f +
                    f * (1.38888889e-3f + f * 1.98412698e-4f)))))));
}

static void multiply(response* r, const response* by)
{
    for (int b = 0; b < BANDS; b++) {
#if PARTS == 2
        const band real = r->part[0][b];
        r->part[0][b] = real * by->part[0][b] - r->part[1][b] * by->part[1][b];
        r->part[1][b] = real * by->part[1][b] + r->part[1][b] * by->part[0][b];
#else
        r->part[0][b] *= by->part[0][b];
#endif
    }
}

// Multiply by cubics on CELLS equal cells of a place from 0 to 1.
static void apply_cubics(__global const band* cells, float place, response* r)
{
    const float at = place * CELLS;
    int cell = (int)at;
    cell = cell < 0 ? 0 : cell < CELLS ? cell : CELLS - 1;
    const float u = at - (float)cell;
    __global const band* c = cells + cell * 4 * PARTS * BANDS;
    response factor;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BANDS; b++, c++) {
            factor.part[part][b] =
                c[0] + u * (c[PARTS * BANDS] + u * (c[2 * PARTS * BANDS] + u * c[3 * PARTS * BANDS]));
        }
    }
    multiply(r, &factor);
}

// Multiply by a cubic B-spline on the faces of a cube about the transducer, SIDE points along each, two beyond an edge.
static void apply_sphere(__global const band* points, float x, float y, float z, response* r)
{
    const float ax = x < 0.0f ? -x : x, ay = y < 0.0f ? -y : y, az = z < 0.0f ? -z : z;
    const int axis = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
    const float along = axis == 0 ? x : axis == 1 ? y : z, scale = 1.0f / (along < 0.0f ? -along : along);
    const float p = (axis == 0 ? y : axis == 1 ? z : x) * scale, q = (axis == 0 ? z : axis == 1 ? x : y) * scale;
    const float cells = 0.5f * (SIDE - 5), at_p = (p + 1.0f) * cells, at_q = (q + 1.0f) * cells;
    int i = (int)at_p, j = (int)at_q;
    i = i < SIDE - 6 ? i : SIDE - 6;
    j = j < SIDE - 6 ? j : SIDE - 6;
    const float u[2] = {at_p - (float)i, at_q - (float)j};
    float weight[2][4];
    for (int d = 0; d < 2; d++) {
        const float t = u[d], s = 1.0f - t;
        weight[d][0] = s * s * s / 6.0f;
        weight[d][1] = (4.0f - 3.0f * t * t * (1.0f + s)) / 6.0f;
        weight[d][2] = (4.0f - 3.0f * s * s * (1.0f + t)) / 6.0f;
        weight[d][3] = t * t * t / 6.0f;
    }
    __global const band* corner =
        points + (((long)(2 * axis + (along < 0.0f)) * SIDE + i + 1) * SIDE + j + 1) * PARTS * BANDS;
    response factor;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BANDS; b++) factor.part[part][b] = 0.0f;
    }
    for (int m = 0; m < 4; m++) {
        for (int n = 0; n < 4; n++) {
            const float share = weight[0][m] * weight[1][n];
            __global const band* c = corner + (m * SIDE + n) * PARTS * BANDS;
            for (int part = 0; part < PARTS; part++) {
                for (int b = 0; b < BANDS; b++, c++) factor.part[part][b] += share * c[0];
            }
        }
    }
    multiply(r, &factor);
}

// Sum of eight squares, or of one.
static float total(band x)
{
#if FREQUENCIES == 1
    return x;
#else
    return ((x.s0 + x.s1) + (x.s2 + x.s3)) + ((x.s4 + x.s5) + (x.s6 + x.s7));
#endif
}

// Gains of functions: products with every node. Four sums at a time, so that none waits for the one before.
static void project(const response* r, __global const chunk* projection, chunk* gain)
{
    const float* at = (const float*)r;
    for (int k = 0; k < CHUNKS; k++) {
#if FREQUENCIES == 1
        gain[k] = 0.0f;
        for (int m = 0; m < PARTS; m++) gain[k] += projection[m * CHUNKS + k] * at[m];
#else
        chunk sum[4] = {0.0f, 0.0f, 0.0f, 0.0f};
#pragma unroll
        for (int m = 0; m < PARTS * FREQUENCIES; m++) sum[m % 4] += projection[m * CHUNKS + k] * at[m];
        gain[k] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
#endif
    }
}

// Returns the response's mean square over the nodes; `unheld` is that of what the functions do not hold of it.
static float path_gains(const arrival* a, double speed_of_sound, const surroundings* s, int slots, int slot,
                        const triple* receiver_frame, chunk* gain, float* unheld)
{
    const float distance = (float)(a->delay * speed_of_sound);
    float common = 1.0f / distance;
#if MACH_EXPONENT >= 1
    common *= (float)a->stretch;
#endif
#if MACH_EXPONENT >= 2
    common *= (float)a->stretch;
#endif
    response r;
    for (int b = 0; b < BANDS; b++) {
        band loss = s->nepers[b] * (distance - 1.0f);
        loss = loss < 80.0f ? loss : (band)(80.0f);
        const band air = exponential(-loss) * common;
        for (int part = 0; part < PARTS; part++) {
            r.part[part][b] = s->reflection[(slot * PARTS + part) * BANDS + b] * air;
        }
    }
    for (int i = 0; i < ANGULAR; i++) {
        const int wall = s->wall_of[i * slots + slot];
        if (wall < 0) break;
        __global const float* n = s->normal + 3 * i * slots + slot;
        const float cosine = n[0] * (float)a->departure.x + n[slots] * (float)a->departure.y +
                             n[2 * slots] * (float)a->departure.z;
        // Over the root of the cosine: hard walls change within 0.1 degree of grazing.
        apply_cubics(s->walls + (long)wall * CELLS * 4 * PARTS * BANDS, sqrt(cosine < 0.0f ? -cosine : cosine), &r);
    }
#if SOURCE_DIRECTIVITY == AXIAL
    const double cosine = inner(cubic(a->knot + 12, a->u), a->departure);
    apply_cubics(s->source_directivity, 0.5f * (float)(1.0 + cosine), &r);
#elif SOURCE_DIRECTIVITY == SPHERICAL
    const triple x = cubic(a->knot + 12, a->u), y = cubic(a->knot + 24, a->u), z = cross_product(x, y);
    apply_sphere(s->source_directivity, (float)inner(x, a->departure), (float)inner(y, a->departure),
                 (float)inner(z, a->departure), &r);
#endif
#if RECEIVER_DIRECTIVITY == AXIAL
    apply_cubics(s->receiver_directivity, 0.5f * (float)(1.0 - inner(receiver_frame[0], a->departure)), &r);
#elif RECEIVER_DIRECTIVITY == SPHERICAL
    apply_sphere(s->receiver_directivity, -(float)inner(receiver_frame[0], a->departure),
                 -(float)inner(receiver_frame[1], a->departure), -(float)inner(receiver_frame[2], a->departure), &r);
#endif
    project(&r, s->projection, gain);
    // What is heard, and what of it the functions do not hold.
    band heard[PARTS * BANDS], rest[PARTS * BANDS], whole = 0.0f, left = 0.0f;
#pragma unroll
    for (int b = 0; b < PARTS * BANDS; b++) rest[b] = heard[b] = s->weight[b % BANDS] * r.part[b / BANDS][b % BANDS];
    for (int k = 0; k < FUNCTIONS; k++) {
        const float held = ((const float*)gain)[k];
#pragma unroll
        for (int b = 0; b < PARTS * BANDS; b++) rest[b] -= s->functions[k * PARTS * BANDS + b] * held;
    }
#pragma unroll
    for (int b = 0; b < PARTS * BANDS; b++) {
        whole += heard[b] * heard[b];
        left += rest[b] * rest[b];
    }
    *unheld = total(left) / FREQUENCIES;
    return total(whole) / FREQUENCIES;
}
