// Events on paths by bodies: rounds until they are found.

#if LEG == MOVING
static void choose_events(choices chosen, const events* from, events* to)
{
    for (int i = 0; i < EVENT_NUMBERS; i++) ((reals*)to)[i] = chosen ? ((const reals*)from)[i] : ((const reals*)to)[i];
}

// One round from guesses to the next ones; returns where guesses that are `open` are wrong.
static choices event_round(const trajectory* path, const pose_table* poses, __global const view* seen, int count, const listener* ear,
                           reals time, choices open, arrivals* a, mirror_state* b, events* next)
{
    const double slowness = path->slowness;
    const events* about = &b->about;
    mirror met[MIRRORS];
    for (int k = 0; k < count; k++) met[k] = mirror_at(path, poses, seen->mirror + k, time, about->time[k], about->place[k]);
    locate(path, RETARDED ? time - about->delay : time, a);
    triples image[MIRRORS + 1], moved = {0.0, 0.0, 0.0};
    reals at[MIRRORS + 1], late = 0.0;
    image[0] = cubics(a->knot, a->u), at[0] = -about->delay;
    triples velocity = cubic_rates(a->knot, a->u);
    velocity.x *= path->rate, velocity.y *= path->rate, velocity.z *= path->rate;
    if (RETARDED) moved = velocity;
#if WIND
    const triples wind = {path->wind.x, path->wind.y, path->wind.z};
    image[0] = plus_scaled(image[0], about->delay, wind);
    moved = plus_scaled(moved, -1.0, wind);
#endif
    for (int k = 0; k < count; k++) {
        const mirror* m = met + k;
        const reals mach = m->speed * slowness, twice = 2.0 / (1.0 - mach * mach);
        const reals height = height_of(m, at[k], image[k]) * twice;
        const reals rise = (DOT(m->normal, moved) - m->speed * (1.0 + late)) * twice;
        image[k + 1] = plus_scaled(image[k], -height, m->normal);
        at[k + 1] = at[k] - height * mach * slowness;
        moved = plus_scaled(moved, -rise, m->normal);
        late -= rise * mach * slowness;
    }
    const triples apart = plus_scaled(ear->position, -1.0, image[count]);
    const reals squared = DOT(apart, apart), inverse = inverse_root(squared);
    const triples onwards = {apart.x * inverse, apart.y * inverse, apart.z * inverse};
    b->through = squared * inverse;
    const reals beyond = late - slowness * DOT(onwards, moved), step = (at[count] + b->through * slowness) / (1.0 + beyond);
    a->delay = about->delay + step;
    b->direction[count] = onwards;
    directions(path, met, count, ear, velocity, beyond, a, b);
    *next = *about;
    next->delay = a->delay;
    reals changed = step * step, met_at = 0.0;
    triples place = ear->position;
    for (int k = count - 1; k >= 0; k--) {
        const reals near = height_of(met + k, met_at, place), far = height_of(met + k, at[k + 1], image[k + 1]);
        const reals across = near - far, share = near / (across == 0.0 ? (reals)1.0 : across);
        const reals low = -BEYOND_LEG, high = 1.0 + BEYOND_LEG, part = share < low ? low : share > high ? high : share;
        met_at += part * (at[k + 1] - met_at);
        place = plus_scaled(place, part, plus_scaled(image[k + 1], -1.0, place));
        next->time[k] = met_at, next->place[k] = place;
#if WIND
        next->place[k] = plus_scaled(place, met_at, wind);
#endif
        const reals later = met_at - about->time[k];
        const triples off = plus_scaled(next->place[k], -1.0, about->place[k]);
        changed += later * later + slowness * slowness * DOT(off, off);
    }
    return open & ((changed >= EVENT_ERROR) | (changed != changed));
}

// Anderson's method of the first order, as in paths/legs/events.py: guesses go on to where the line through the last two rounds ends.
// `last`, the round before, is written: what it was from its guesses, and where it led.
static void mix_events(const events* about, events* next, events* last, int first, double slowness)
{
    const reals* before = (const reals*)about;
    reals* after = (reals*)next;
    reals *residual = (reals*)last, *led = (reals*)(last + 1), along = 0.0, squared = 1e-300;
    for (int i = 0; i < EVENT_NUMBERS; i++) {
        const double weight = i <= MIRRORS ? 1.0 : slowness;
        const reals off = (after[i] - before[i]) * weight, change = off - residual[i];
        along += off * change, squared += change * change;
        residual[i] = off;
    }
    const reals share = along / squared, most = MOST_SHARE;
    const reals part = first ? (reals)0.0 : share > most ? most : share < -most ? -most : share;
    for (int i = 0; i < EVENT_NUMBERS; i++) {
        const reals found = after[i];
        after[i] = found - (first ? (reals)0.0 : part * (found - led[i]));
        led[i] = found;
    }
}

// Rounds from guesses on, then mixed ones from the start. What is not found even then, no path is there: the last round counts. What a
// node comes to does not depend on those beside it: guesses that are found stay the same.
static void solve_events(const trajectory* path, const pose_table* poses, __global const view* seen, const listener* ear,
                         reals time, arrivals* a, mirror_state* b)
{
    const int count = mirrors_of(seen);
    const reals expected = b->about.delay = a->delay;
    const events start = b->about;
    events next, last[2] = {start, start};
    choices open = expected == expected;
    for (int round = 0; round < MOST_ROUNDS + MOST_MIXED; round++) {
        if (round == MOST_ROUNDS) choose_events(open, &start, &b->about);
        open = event_round(path, poses, seen, count, ear, time, open, a, b, &next);
        if (!ANY(open)) return;
        if (round > MOST_ROUNDS) mix_events(&b->about, &next, last, round == MOST_ROUNDS + 1, path->slowness);
        choose_events(open, &next, &b->about);
    }
    const choices lost = a->delay != a->delay;
    a->delay = lost ? expected : a->delay;
    a->rate = lost ? (reals)0.0 : a->rate;
}
#define SOLVE_DELAY(path, poses, seen, receiver, time, small, a, b) solve_events(path, poses, seen, receiver, time, a, b)
#define SOLVE_ANEW SOLVE_DELAY

typedef mirror_state path_state;
static void begin_state(triples ear, path_state* b)
{
    for (int k = 0; k < MIRRORS; k++) {
        b->about.time[k] = 0.0;
        b->about.place[k] = ear;
    }
}
static void write_state(const path_state* b, int node, __global double* told, int slots)
{
    for (int k = 0; k < MIRRORS; k++, told += 4 * (long)slots) {
        const triples* place = b->about.place + k;
        const double numbers[4] = {OF_NODE(b->about.time[k], node), OF_NODE(place->x, node), OF_NODE(place->y, node),
                                   OF_NODE(place->z, node)};
        for (int i = 0; i < 4; i++) told[i * (long)slots] = numbers[i];
    }
}
#endif
