// What is known of where paths are scattered, at nodes side by side, and the specular point there.

#if VERTEX == SCATTERER
#define PREDICTED 1  // what the first step is made from
#define UNKNOWN 2
#define KNOWN 0      // of a further one
#define LASTING -1   // likewise; what is hidden stays so
#define SPECULAR_STEPS 40
#define ROUNDED 1e-15  // of a length, by which it may be longer and counts as shorter

// What is known of where a path is scattered, at nodes side by side.
typedef struct {
    reals onward, onward_rate;  // delay of the leg to the receiver, s, and its derivative by the time of reception
    reals weight, change;      // of the leg to the receiver, and of the specular point by the last step, rad
    triples specular;             // its unit vector; of capsules its place, m
    triples source, receiver;  // the ends in the frame of the scatterer, m
    triples arrival;           // unit vector along the path at the receiver, in the room
    reals event;               // when sound is there, s
    reals spread, leaving;     // product of the lengths of both legs, m^2; Mach number of the scatterer towards the receiver
#if WIND
    triples start, stop;       // the ends as the air carries their wavefronts, m
#endif
    choices hidden;            // whether it is between both ends
} scatterer_state;

// By what is known of a specular point: its place, m, and a step nearer to the shortest path.
static triples specular_place(const scatterer_frame* g, triples specular) { return g->shape == CAPSULE ? specular : along_axes(g->scale, specular); }
static triples step_closer(const scatterer_frame* g, triples specular, reals longest, reals* change)
{
    return g->shape == CAPSULE ? capsule_step(g, specular, longest, change) : specular_step(g, specular, longest, change);
}
static reals length_by(const scatterer_frame* g, triples specular)
{
    const triples place = specular_place(g, specular), to = apart(place, g->source), back = apart(place, g->receiver);
    return root(DOT(to, to)) + g->weight * root(DOT(back, back));
}

// The place between the ends that is nearest to what reflects, m, and the specular point there; whether it lies inside.
static triples nearest_between(const scatterer_frame* g, triples* specular, choices* hidden)
{
    if (g->shape == CAPSULE) {
        reals at;
        const triples nearest = between_capsule_ends(g, &at, hidden);
        *specular = joined(g, at, of_length_one(apart(nearest, on_axis(at))));
        return nearest;
    }
    const triples nearest = between_ends(g, hidden);
    *specular = is_long(g) ? outwards(g, nearest) : of_length_one(nearest);
    return along_axes(g->scale, nearest);
}

// The specular point of the shortest path by steps that make it shorter, from `specular` or from another one. What a node comes to does
// not depend on those beside it.
static __attribute__((noinline)) triples specular_search(const scatterer_frame* g, triples specular, triples other, reals* change)
{
    const reals from_it = length_by(g, specular), from_other = length_by(g, other);
    choose(from_other < from_it, other, &specular);
    reals length = smaller(from_it, from_other), longest = LONGEST_STEP;
    *change = LONGEST_STEP;
    for (int i = 0; i < SPECULAR_STEPS; i++) {
        const choices open = *change > SPECULAR_FOUND;
        if (!ANY(open)) break;
        reals moved;
        const triples next = step_closer(g, specular, longest, &moved);
        const reals shorter = length_by(g, next);
        const choices better = shorter <= length * (1.0 + ROUNDED);
        const reals longer = better ? smaller(2.0 * longest, (reals)LONGEST_STEP) : 0.25 * smaller(longest, moved);
        longest = open ? longer : longest;
        choose(open & better, next, &specular);
        length = (open & better) ? shorter : length;
        *change = open ? moved : *change;
    }
    return specular;
}

// From what is predicted of the specular point, or from nothing.
static triples begin_from(const scatterer_frame* g, triples predicted, int first)
{
    if (first == UNKNOWN) {
        if (g->shape == CAPSULE) return capsule_guess(g);
        return of_length_one(along_axes(g->scale, plus(of_length_one(g->source), of_length_one(g->receiver))));
    }
    return first == PREDICTED && g->shape != CAPSULE ? of_length_one(predicted) : predicted;
}

// The specular point and its velocity in the place of the centre's; both ends are images.
static void locate_specular(__global const view* seen, const pose* p, triples source, triples receiver, int first, triples* place,
                       triples* velocity, scatterer_state* b)
{
    b->source = apart(source, p->place);
    b->receiver = apart(receiver, p->place);
    if (seen->turned) {
        const triples s = b->source, r = b->receiver;
        b->source.x = DOT(s, p->axes[0]), b->source.y = DOT(s, p->axes[1]), b->source.z = DOT(s, p->axes[2]);
        b->receiver.x = DOT(r, p->axes[0]), b->receiver.y = DOT(r, p->axes[1]), b->receiver.z = DOT(r, p->axes[2]);
    }
    const triples scale = {seen->semi_axes[0], seen->semi_axes[1], seen->semi_axes[2]};
    const scatterer_frame g = {scale, b->source, b->receiver, b->weight, seen->shape};
    triples other;
    choices hidden;
    const triples between = nearest_between(&g, &other, &hidden), before = begin_from(&g, b->specular, first);
    b->hidden = first == LASTING ? hidden | b->hidden : hidden;
    b->specular = step_closer(&g, before, (reals)LONGEST_STEP, &b->change);
    const choices far = b->change > (g.shape != CAPSULE && is_long(&g) ? -1.0 : SPECULAR_FAR);
    if (first > KNOWN && ANY(far)) {
        reals change;
        const triples found = specular_search(&g, before, other, &change);
        choose(far, found, &b->specular);
        b->change = far ? change : b->change;
    }
    triples offset = specular_place(&g, b->specular);
    choose(b->hidden, between, &offset);
    b->change = b->hidden ? (reals)0.0 : b->change;
    if (seen->turned) {
        const triples o = offset;
        offset = plus(scaled(o.x, p->axes[0]), plus(scaled(o.y, p->axes[1]), scaled(o.z, p->axes[2])));
        *velocity = plus(*velocity, plus(scaled(o.x, p->turning[0]), plus(scaled(o.y, p->turning[1]), scaled(o.z, p->turning[2]))));
    }
    *place = plus(*place, offset);
}

static void choose_reals(choices open, reals other, reals* kept) { *kept = open ? other : *kept; }

// Take over what a further step has found at some nodes.
static void keep(choices open, const arrivals* next, const scatterer_state* met, arrivals* a, scatterer_state* b)
{
    choose_reals(open, next->delay, &a->delay);
    choose_reals(open, next->rate, &a->rate);
    choose_reals(open, next->mach_factor, &a->mach_factor);
    choose_reals(open, next->u, &a->u);
    choose(open, next->departure, &a->departure);
    choose_reals(open, met->onward, &b->onward);
    choose_reals(open, met->onward_rate, &b->onward_rate);
    choose_reals(open, met->weight, &b->weight);
    choose_reals(open, met->change, &b->change);
    choose_reals(open, met->event, &b->event);
    choose_reals(open, met->spread, &b->spread);
    choose_reals(open, met->leaving, &b->leaving);
    choose(open, met->specular, &b->specular);
#if WIND
    choose(open, met->start, &b->start);
    choose(open, met->stop, &b->stop);
#endif
    choose(open, met->source, &b->source);
    choose(open, met->receiver, &b->receiver);
    choose(open, met->arrival, &b->arrival);
    b->hidden = open ? met->hidden : b->hidden;
#pragma unroll
    for (int i = 0; i < NODES_AT_ONCE; i++) a->knot[i] = OF_NODE_LONG(open, i) ? next->knot[i] : a->knot[i];
}
#endif
