// The gains of one path at one node: its response (spreading, air, walls, Mach factor, directivities) at FREQUENCIES
// frequencies, projected on at most FUNCTIONS functions of frequency. The twin of paths/response.py.

// Where the sizes of gains stand behind the projection, in floats.
#if RECEIVER_DIRECTIVITY == HARMONIC
#define SIZES_AT ((function_count * PARTS * FREQUENCIES + 7) / 8 * 8)
#else
#define SIZES_AT (PARTS * FREQUENCIES * GAIN_VECTORS * (int)(sizeof(gains) / sizeof(float)))
#endif

typedef struct {
    __global const bins* nepers;         // [AIR_TERMS or 1][BIN_VECTORS], of the amplitude, 1/m
    __global const bins* lead;           // [AIR_TERMS][BIN_VECTORS], before the delay's phase, turns in a metre
    __global const gains* projection;    // [PARTS][FREQUENCIES][GAIN_VECTORS]; HARMONIC: [function_count][PARTS][BIN_VECTORS] bins
    __global const bins* functions;      // [function_count][PARTS][BIN_VECTORS], weighted
    __global const bins* weight;         // [BIN_VECTORS]
    __global const gains* sizes;         // [GAIN_VECTORS], most that each adds to a path
    __global const bins* reflection;     // [slots][PARTS][BIN_VECTORS], of walls that are the same at every angle
    __global const bins* walls;          // those that are not: [materials][CELLS][4][PARTS][BIN_VECTORS]
    __global const int* wall_of;         // [angular][slots], -1 for none; -2 less it for walls that are met from the receiver's side
    __global const float* normal;        // [angular][3][slots], unfolded
    __global const bins* source_directivity;    // AXIAL: [CELLS][4][PARTS][BIN_VECTORS]; SPHERICAL: [6][SIDE][SIDE][PARTS][BIN_VECTORS]
    __global const bins* receiver_directivity;  // likewise; HARMONIC: the norm of each component
    int function_count, angular;         // how many, and of how many walls at most the factor depends on the angle
} environment;

static environment environment_of(__global const bins* air_and_functions,  // nepers, lead, weight, functions
                                    __global const gains* projection,        // and then sizes
                                    __global const bins* reflection, __global const bins* walls, __global const int* wall_of,
                                    __global const float* normal, __global const bins* source_directivity,
                                    __global const bins* receiver_directivity, int function_count, int angular)
{
    __global const bins* lead = air_and_functions + (AIR_TERMS > 0 ? AIR_TERMS : 1) * BIN_VECTORS;
    __global const bins* weight = lead + (AIR_TERMS > 0 ? AIR_TERMS : 1) * BIN_VECTORS;
    const environment out = {air_and_functions, lead, projection, weight + BIN_VECTORS, weight,
                              (__global const gains*)((__global const float*)projection + SIZES_AT), reflection, walls, wall_of, normal,
                              source_directivity, receiver_directivity, function_count, angular};
    return out;
}

// What of an arrival gains depend on.
typedef struct {
    float through, length;      // m of air, and over which pressure falls
    real mach_factor;
    triple departure, arrival;  // along the path, both as seen from the source's own room
    __global const real* knot;
    real u;
} arrival;

// What air does to frequencies that are raised by motion: polynomials of AIR_TERMS terms of the ratio less 1. Air that
// does not disperse (AIR_TERMS 0) is that of the emitted frequency.
static bins of_air(__global const bins* terms, int b, float raised)
{
    bins sum = terms[(AIR_TERMS > 0 ? AIR_TERMS - 1 : 0) * BIN_VECTORS + b];
    for (int i = AIR_TERMS - 2; i >= 0; i--) sum = sum * raised + terms[i * BIN_VECTORS + b];
    return sum;
}

// Gains of functions: products with every node. Four sums at a time, so that none waits for the one before.
static void project(const response* r, __global const gains* projection, gains* gain)
{
    const float* at = (const float*)r;
    for (int k = 0; k < GAIN_VECTORS; k++) {
#if FREQUENCIES == 1
        gain[k] = 0.0f;
        for (int m = 0; m < PARTS; m++) gain[k] += projection[m * GAIN_VECTORS + k] * at[m];
#else
        gains sum[4] = {0.0f, 0.0f, 0.0f, 0.0f};
#pragma unroll
        for (int m = 0; m < PARTS * FREQUENCIES; m++) sum[m % 4] += projection[m * GAIN_VECTORS + k] * at[m];
        gain[k] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
#endif
    }
}

// What all channels of a receiver share: spreading, motion, air, walls, of which `angular` depend on the angle, and the source's
// directivity.
static void shared_response(const arrival* a, const environment* s, int angular, int slots, int slot, response* r)
{
    float common = 1.0f / (a->length > NEAREST ? a->length : NEAREST);
    for (int i = 0; i < MACH_EXPONENT; i++) common *= (float)a->mach_factor;
    const float raised = (float)(a->mach_factor - 1);
    for (int b = 0; b < BIN_VECTORS; b++) {
        bins loss = of_air(s->nepers, b, raised) * (a->through - 1.0f);
        loss = loss < 80.0f ? loss : (bins)(80.0f);
        const bins air = exponential(-loss) * common;
        for (int part = 0; part < PARTS; part++) {
            r->part[part][b] = s->reflection[((long)slot * PARTS + part) * BIN_VECTORS + b] * air;
        }
#if AIR_TERMS && PARTS == 2
        turn(r, b, of_air(s->lead, b, raised) * (a->through - 1.0f));
#endif
    }
    for (int i = 0; i < angular; i++) {
        int wall = s->wall_of[i * (long)slots + slot];
        if (wall == -1) break;
        const triple along = wall < 0 ? a->arrival : a->departure;
        wall = wall < 0 ? -2 - wall : wall;
        __global const float* n = s->normal + 3 * i * (long)slots + slot;
        const float cosine = n[0] * (float)along.x + n[slots] * (float)along.y + n[2 * (long)slots] * (float)along.z;
        // Over the root of the cosine: hard walls change within 0.1 degree of grazing.
        apply_cubics(s->walls + (long)wall * CELLS * 4 * PARTS * BIN_VECTORS, sqrt(cosine < 0.0f ? -cosine : cosine), r);
    }
#if SOURCE_DIRECTIVITY == AXIAL
    const real cosine = inner(cubic(a->knot + CUBIC_COLUMNS, a->u), a->departure);
    apply_cubics(s->source_directivity, 0.5f * (float)(1 + cosine), r);
#elif SOURCE_DIRECTIVITY == SPHERICAL
    const triple x = cubic(a->knot + CUBIC_COLUMNS, a->u), y = cubic(a->knot + 2 * CUBIC_COLUMNS, a->u), z = cross_product(x, y);
    apply_sphere(s->source_directivity, (float)inner(x, a->departure), (float)inner(y, a->departure),
                 (float)inner(z, a->departure), r);
#endif
}

// The mean square of a response over the nodes; `residual` is that of what functions with these coefficients do not represent.
static float mean_squares(const response* r, const environment* s, const float* coefficients, float* residual)
{
    bins weighted[PARTS * BIN_VECTORS], remainder[PARTS * BIN_VECTORS], sum_of_squares = 0.0f, sum_of_residuals = 0.0f;
#pragma unroll
    for (int b = 0; b < PARTS * BIN_VECTORS; b++) remainder[b] = weighted[b] = s->weight[b % BIN_VECTORS] * r->part[b / BIN_VECTORS][b % BIN_VECTORS];
    for (int k = 0; k < s->function_count; k++) {
#pragma unroll
        for (int b = 0; b < PARTS * BIN_VECTORS; b++) remainder[b] -= s->functions[k * PARTS * BIN_VECTORS + b] * coefficients[k];
    }
#pragma unroll
    for (int b = 0; b < PARTS * BIN_VECTORS; b++) {
        sum_of_squares += weighted[b] * weighted[b];
        sum_of_residuals += remainder[b] * remainder[b];
    }
    *residual = total(sum_of_residuals) / FREQUENCIES;
    return total(sum_of_squares) / FREQUENCIES;
}

// The gains of a receiver's channels: their directivity, the field of the vertex over free air of its length, where `field` is not 0,
// and the projection. Returns the response's mean square over the nodes; `residual` is that of what the functions do not represent.
static float channel_gains(const response* shared, const arrival* a, const environment* s, const triple* receiver_frame,
                           const response* field, gains* gain, float* residual)
{
    response r = *shared;
#if RECEIVER_DIRECTIVITY == AXIAL
    apply_cubics(s->receiver_directivity, 0.5f * (float)(1 - inner(receiver_frame[0], a->arrival)), &r);
#elif RECEIVER_DIRECTIVITY == SPHERICAL
    apply_sphere(s->receiver_directivity, -(float)inner(receiver_frame[0], a->arrival),
                 -(float)inner(receiver_frame[1], a->arrival), -(float)inner(receiver_frame[2], a->arrival), &r);
#endif
    if (field) multiply(&r, field);
#if RECEIVER_DIRECTIVITY == HARMONIC
    // Components are the same at every frequency: one projection serves all.
    float component[CHANNELS];
    const float loud = harmonics((__global const float*)s->receiver_directivity, -(float)inner(receiver_frame[0], a->arrival),
                                 -(float)inner(receiver_frame[1], a->arrival), -(float)inner(receiver_frame[2], a->arrival), component);
    float* out = (float*)gain;
    for (int k = 0; k < GAIN_VECTORS; k++) gain[k] = 0.0f;  // also where no function is: NaN there would count as an error
    for (int k = 0; k < s->function_count; k++) {
        __global const bins* row = (__global const bins*)s->projection + k * PARTS * BIN_VECTORS;
        bins sum = row[0] * r.part[0][0];
        for (int b = 1; b < PARTS * BIN_VECTORS; b++) sum += row[b] * r.part[b / BIN_VECTORS][b % BIN_VECTORS];
        out[k] = total(sum);
    }
    const float strength = mean_squares(&r, s, out, residual);
    for (int k = s->function_count - 1; k >= 0; k--) {
        for (int c = CHANNELS - 1; c >= 0; c--) out[k * CHANNELS + c] = out[k] * component[c];
    }
    *residual *= loud;
    return strength * loud;
#else
    project(&r, s->projection, gain);
    return mean_squares(&r, s, (const float*)gain, residual);
#endif
}
