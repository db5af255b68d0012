// Mirrors of moving legs (faces of bodies), MIRRORS of them at most, and images of events in these, as the source's own room sees them, where
// walls at rest are isometries. Twin of paths/legs/events.py. In wind, which all is seen from the air's own frame for, walls
// at rest move, too.

#if LEG == MOVING
#define EVENT_ERROR 1e-17  // s^2, of where and when mirrors were met from what was taken for it: delays are wrong by its square
#define MOST_ROUNDS 20
#define MOST_MIXED 40   // rounds after these
#define MOST_SHARE 10.0  // how far one of them goes on from the last two, in their distance
#define EVENT_NUMBERS (1 + 4 * MIRRORS)

// A mirror about the event in which sound meets it: normal x = offset + speed t, with t from reception on.
typedef struct {
    triples normal;
    reals offset, speed;
    reals moving;  // speed in the room, also where all is seen as it is at reception
} mirror;

// About when sound is emitted, and when, s from reception on, and where, m, mirrors are met.
typedef struct {
    reals delay, time[MIRRORS];
    triples place[MIRRORS];
} events;

// What paths by mirrors have besides arrivals.
typedef struct {
    events about;                // what was taken for the events, that were found to be there
    triples direction[MIRRORS + 1];  // directions between mirrors
    triples normal[MIRRORS];
    reals through, length;       // m of air, and over which pressure falls
    reals raised;                // by what mirrors raise frequencies
} mirror_state;

static triples plus_scaled(triples a, reals factor, triples b)
{
    const triples out = {a.x + factor * b.x, a.y + factor * b.y, a.z + factor * b.z};
    return out;
}

// Vectors by the transposed matrix of a view.
static triples turned_back_by(__global const double* m, triples v)
{
    const triples out = {m[0] * v.x + m[3] * v.y + m[6] * v.z, m[1] * v.x + m[4] * v.y + m[7] * v.z,
                         m[2] * v.x + m[5] * v.y + m[8] * v.z};
    return out;
}

// How many mirrors a path meets.
static int mirrors_of(__global const view* seen)
{
    int count = 0;
    while (count < MIRRORS && seen->mirror[count].face >= 0) count++;
    return count;
}

// A mirror at events of paths received at times `now`. Of a knot FACE_COLUMNS are given: cubics [power][xyz] of the normal, and
// [power] of the offset, m.
static mirror mirror_at(const trajectory* path, const pose_table* poses, __global const mirror_view* of, reals now, reals event,
                        triples place)
{
    const reals at = ((RETARDED ? now + event : now) - poses->first) * poses->rate;
    __global const double* c[NODES_AT_ONCE];
    double whole[NODES_AT_ONCE];
#pragma unroll
    for (int i = 0; i < NODES_AT_ONCE; i++) {
        int knot = (int)OF_NODE(at, i);
        knot = knot < 0 ? 0 : knot;
        knot = knot < poses->count ? knot : poses->count - 1;
        whole[i] = (double)knot;
        c[i] = poses->knots + (of->face * (long)poses->count + knot) * FACE_COLUMNS;
    }
    const reals beyond = at - SIDE_BY_SIDE(whole, ), u = beyond < 0.0 ? (reals)0.0 : beyond < 1.0 ? beyond : (reals)1.0;
    const triples normal = cubics(c, u), turning = cubic_rates(c, u);
    __global const double* shift = of->shift;
    const reals height = COLUMN(12) + u * (COLUMN(13) + u * (COLUMN(14) + u * COLUMN(15)));
    const reals rising = COLUMN(13) + u * (2 * COLUMN(14) + u * 3 * COLUMN(15));
    mirror m;
    m.normal = turned_back_by(of->turn, normal);
    const triples turns = turned_back_by(of->turn, turning);
    const reals rise = rising - (turning.x * shift[0] + turning.y * shift[1] + turning.z * shift[2]);
    const reals speed = poses->rate * (rise - DOT(turns, place)), most = of->most;
    m.moving = speed > most ? most : speed < -most ? -most : speed;
    m.speed = RETARDED ? m.moving : (reals)0.0;
    m.offset = height - (normal.x * shift[0] + normal.y * shift[1] + normal.z * shift[2]) - (RETARDED ? m.speed * event : (reals)0.0);
#if WIND
    m.speed -= path->wind.x * m.normal.x + path->wind.y * m.normal.y + path->wind.z * m.normal.z;
#endif
    return m;
}

// How far events are in front of a mirror, m.
static reals height_of(const mirror* m, reals time, triples place) { return DOT(m->normal, place) - m->speed * time - m->offset; }

// The direction in which sound comes to a mirror that leaves it in a given one.
static triples before_mirror(const mirror* m, triples leaving, double slowness)
{
    const reals mach = m->speed * slowness, rise = 2.0 * (DOT(m->normal, leaving) - mach) / (1.0 - mach * mach);
    const triples before = plus_scaled(leaving, -rise, m->normal);
    const reals longer = 1.0 / (1.0 - rise * mach);
    const triples out = {before.x * longer, before.y * longer, before.z * longer};
    return out;
}

// Directions between mirrors, from the last one back, and what the delay's rate and the pressure follow.
static void directions(const trajectory* path, const mirror* met, int count, const listener* ear, triples velocity, reals beyond,
                       arrivals* a, mirror_state* b)
{
    const double slowness = path->slowness;
    triples way = b->direction[count];
    const triples onwards = way;
    reals growth = 0.0, carried = 1.0;
#if WIND
    const triples wind = {path->wind.x, path->wind.y, path->wind.z};
    carried = 1.0 + slowness * DOT(onwards, wind);
#endif
    for (int k = count - 1; k >= 0; k--) {
        const triples before = before_mirror(met + k, way, slowness);
#if !RETARDED
        reals arriving = slowness, leaving = slowness;
#if WIND
        arriving /= 1.0 + slowness * DOT(before, wind), leaving /= 1.0 + slowness * DOT(way, wind);
#endif
        growth += met[k].moving * (arriving * DOT(before, met[k].normal) - leaving * DOT(way, met[k].normal));
#endif
        b->normal[k] = met[k].normal;
        b->direction[k] = way = before;
    }
    for (int k = count + 1; k <= MIRRORS; k++) b->direction[k] = onwards;
    reals mach = slowness * DOT(way, velocity);
#if WIND
    mach /= 1.0 + slowness * DOT(way, wind);
#endif
    const triples heading = ear->velocity;
    const reals receding = STATIC_RECEIVERS ? (reals)0.0 : slowness * DOT(onwards, heading);
    b->length = b->through * carried;
#if RETARDED
#if WIND
    const reals drift = slowness * DOT(onwards, wind);
#else
    const reals drift = 0.0;
#endif
    const reals pace = 1.0 / (1.0 + beyond);
    a->mach_factor = 1.0 / (1.0 - mach);
    a->rate = (beyond + receding - drift) * pace;
    b->raised = (1.0 - mach) * carried * pace;
#else
    b->raised = 1.0;
    a->mach_factor = 1.0;
    a->rate = growth - mach + receding / carried;
#endif
}
#endif
