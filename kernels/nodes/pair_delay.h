// The delay of a node without float64: positions, times and delays are pairs, all else floats. Times count from the first
// knot. The equation is that of paths/delay.h, and so are its Newton steps.

typedef struct {
    pair x, y, z;
} pair_triple;

typedef struct {
    pair position[3], clock_error;  // as of a receiver_node
    float velocity[3], axes[2][3], clock_drift;  // seconds that its clock gains or loses in one
} pair_receiver;

typedef struct {
    __global const float* knots;  // [knot][KNOT_COLUMNS]: cubics of the source's position and axes
    __global const float* rests;  // [knot][CUBIC_COLUMNS]: what floats leave of those of the position
    int count;
    float rate;                   // knots per second
    pair slowness;                // 1 / speed of sound
} pair_trajectory;

typedef struct {
    pair delay;
    float rate, mach_factor;
    triple departure;
    __global const float* knot;
    float u;
} pair_arrival;

// A receiver as seen from the source's own room.
typedef struct {
    pair_triple position;
    triple velocity, frame[3];
    pair clock_error;
    float clock_drift;
} pair_receiver_in_image;

static triple turned_back(__global const pair* m, long slots, const float* v)
{
    const triple out = {m[0].x * v[0] + m[3 * slots].x * v[1] + m[6 * slots].x * v[2],
                        m[slots].x * v[0] + m[4 * slots].x * v[1] + m[7 * slots].x * v[2],
                        m[2 * slots].x * v[0] + m[5 * slots].x * v[1] + m[8 * slots].x * v[2]};
    return out;
}

static pair turned_back_in_pairs(__global const pair* m, long slots, const pair* v)
{
    return plus(plus(product(m[0], v[0]), product(m[3 * slots], v[1])), product(m[6 * slots], v[2]));
}

static pair_receiver_in_image pair_receiver_at(__global const pair* image_matrix, __global const pair* image_offset, long slots,
                                               int slot, __global const pair_receiver* node)
{
    const pair_receiver here = *node;
    __global const pair* m = image_matrix + slot;
    pair apart[3];
    for (int i = 0; i < 3; i++) apart[i] = minus(here.position[i], image_offset[i * slots + slot]);
    pair_receiver_in_image out;
    out.position.x = turned_back_in_pairs(m, slots, apart);
    out.position.y = turned_back_in_pairs(m + slots, slots, apart);
    out.position.z = turned_back_in_pairs(m + 2 * slots, slots, apart);
    out.velocity = turned_back(m, slots, here.velocity);
#if RECEIVER_DIRECTIVITY != OMNI
    const triple x = {here.axes[0][0], here.axes[0][1], here.axes[0][2]}, y = {here.axes[1][0], here.axes[1][1], here.axes[1][2]};
    const triple z = cross_product(x, y);
    const float third[3] = {z.x, z.y, z.z};
    out.frame[0] = turned_back(m, slots, here.axes[0]);
    out.frame[1] = turned_back(m, slots, here.axes[1]);
    out.frame[2] = turned_back(m, slots, third);
#endif
    out.clock_error = here.clock_error;
    out.clock_drift = here.clock_drift;
    return out;
}

static pair cubic_in_pairs(const pair_arrival* a, __global const float* rest, int axis, pair u)
{
    pair value = (pair)(a->knot[9 + axis], rest[9 + axis]);
    for (int i = 6 + axis; i >= 0; i -= 3) value = plus((pair)(a->knot[i], rest[i]), product(value, u));
    return value;
}

static float cubic_rate(__global const float* c, float u) { return c[3] + u * (2.0f * c[6] + u * 3.0f * c[9]); }

// One Newton step from `a->delay`; returns it. All else is that of the emission time before the step.
static float newton_step(const pair_trajectory* path, const pair_receiver_in_image* receiver, pair time, pair_arrival* a)
{
    const pair place = scaled(path->rate, RETARDED ? minus(time, a->delay) : time);
    int knot = (int)floor(place.x);
    knot = knot < 0 ? 0 : knot < path->count ? knot : path->count - 1;
    a->knot = path->knots + (long)knot * KNOT_COLUMNS;
    __global const float* rest = path->rests + (long)knot * CUBIC_COLUMNS;
    pair u = plus(place, (pair)(-(float)knot, 0.0f));
    u = u.x < -0.01f ? (pair)(0.0f, 0.0f) : u.x > 1.01f ? (pair)(1.0f, 0.0f) : u;
    a->u = u.x;
    const pair x = minus(receiver->position.x, cubic_in_pairs(a, rest, 0, u));
    const pair y = minus(receiver->position.y, cubic_in_pairs(a, rest, 1, u));
    const pair z = minus(receiver->position.z, cubic_in_pairs(a, rest, 2, u));
    const pair distance = root(plus(plus(product(x, x), product(y, y)), product(z, z)));
    const float inverse = 1.0f / (distance.x > NEAREST ? distance.x : NEAREST), slowness = path->slowness.x;
    const triple departure = {x.x * inverse, y.x * inverse, z.x * inverse};
    const triple velocity = {cubic_rate(a->knot, u.x), cubic_rate(a->knot + 1, u.x), cubic_rate(a->knot + 2, u.x)};
    const float mach = path->rate * slowness * inner(departure, velocity);
    const float receding = slowness * inner(departure, receiver->velocity);
    const pair quasi_static = product(distance, path->slowness);
    a->departure = departure;
    a->mach_factor = RETARDED ? 1.0f / (1.0f - mach) : 1.0f;
    a->rate = (receding - mach) * a->mach_factor;
    const float step = RETARDED ? minus(quasi_static, a->delay).x * a->mach_factor : 0.0f;
    a->delay = RETARDED ? plus(a->delay, (pair)(step, 0.0f)) : quasi_static;
    return step;
}

#define CONVERGED 1e-14f  // s^2, as in paths/delay.h

static void solve_delay(const pair_trajectory* path, const pair_receiver_in_image* receiver, pair time, pair_arrival* a)
{
    for (int k = 0; k < 40; k++) {
        const float step = newton_step(path, receiver, time, a);
        if (step * step < CONVERGED) break;
    }
}
