// What bodies with outlines let pass of a path that walls reflect: twin of paths/vertices/shade.py.

#if VERTEX == SHADE && PARTS == 2
#define SHADE_ROUNDS 3    // of finding when sound passes a body
#define WIDER 1.05        // zones of bodies that move, of those of bodies at rest
#define CASTER_COLUMNS 8  // thing, CAPSULE or not, whether turned, three axes as of an outline, where its table begins, radius
#define SHADED_PART 12    // matrix and offset of a part of a path, see `ShadeVertex`

// Multiply what is passed by the shade of one body, whose outline sees both ends.
static void shade_by(const vertex_tables* t, const outline* o, int first, double sight, const root_range* roots, response* passed)
{
    const float share = forward_share(o, t->middle);
    if (share == 0.0f) return;
    response own;
    outline_field(t, o, first, sight, roots, &own);
    for (int b = 0; b < BIN_VECTORS; b++) {
        for (int part = 0; part < PARTS; part++) own.part[part][b] *= share;
        own.part[0][b] += 1.0f;
    }
    multiply(passed, &own);
}

// When sound is sent and received, and by what its frequency changes as the source moves.
typedef struct {
    double sent, flight, doppler;
} travel;

// Multiply by the shade of one body on a part of a path with ends `from` and `to`, between which sound goes evenly.
// Lengths are those that the body sees times the change of frequency that it hears: `seen_by` in paths/vertices/shade.py.
static void shade_of(const vertex_tables* t, const pose_table* poses, __global const double* caster, const double* from, const double* to,
                     const travel* of, const root_range* roots, response* passed)
{
    double along[3], away[3], off[3], share = 0.5, late = 0.0;
    for (int i = 0; i < 3; i++) along[i] = to[i] - from[i];
    const double size = fmax(dot_of(along, along), TINY), sight = sqrt(size);
    pose now;
    for (int k = 0; k < SHADE_ROUNDS; k++) {
        late = share * of->flight;
        now = pose_at(poses, (int)caster[0], k == SHADE_ROUNDS - 1 && (int)caster[2], (reals)(of->sent + late));
        const triple place = triple_of(&now.place, 0);
        away[0] = place.x - from[0], away[1] = place.y - from[1], away[2] = place.z - from[2];
        share = fmin(fmax(dot_of(away, along) / size, 0.0), 1.0);
    }
    for (int i = 0; i < 3; i++) off[i] = away[i] - share * along[i];
    const double near = caster[7] + WIDER * 2.0 * WITHIN * sqrt(0.25 * sight / t->middle);
    if (dot_of(off, off) > near * near) return;
    const triple velocity = triple_of(&now.velocity, 0);
    const double moved[3] = {velocity.x, velocity.y, velocity.z};
    const double scale = of->doppler * (1.0 - dot_of(moved, along) * of->flight / size);
    for (int i = 0; i < 3; i++) away[i] = scale * (away[i] - late * moved[i]), along[i] = scale * (along[i] - of->flight * moved[i]);
    outline o;
    o.is_capsule = (int)caster[1];
    for (int axis = 0; axis < 3; axis++) {
        const triple x = (int)caster[2] ? triple_of(now.axes + axis, 0) : (triple){axis == 0, axis == 1, axis == 2};
        const double turned_axis[3] = {x.x, x.y, x.z};
        o.source[axis] = -dot_of(away, turned_axis);
        o.receiver[axis] = o.source[axis] + dot_of(along, turned_axis);
        o.axes[axis] = scale * caster[3 + axis];
    }
    look_along(&o);
    shade_by(t, &o, (int)caster[6], sqrt(dot_of(along, along)), roots, passed);
}

// What shadows add to a path at a node of the group, over its pressure.
static void shade_at(const path_nodes* s, int i, response* field)
{
    const vertex_tables* t = &s->tables;
    const arrivals* a = s->node + VECTOR(i);
    const int lane = LANE(i);
    root_range roots;
    double low = 1e30, high = 0.0;
    for (int f = 0; f < FREQUENCIES; f++) {
        const double root_of_wave = cbrt(HALF_TURN * ((__global const float*)t->waves)[f]);
        ((float*)roots.place)[f] = (float)root_of_wave;
        low = fmin(low, root_of_wave), high = fmax(high, root_of_wave);
    }
    roots.middle = 0.5 * (high + low), roots.reach = 0.5 * (high - low), roots.most = high;
    for (int b = 0; b < BIN_VECTORS; b++) {
        roots.place[b] = (roots.place[b] - (float)roots.middle) / (float)fmax(roots.reach, 1e-9);
        field->part[0][b] = 1.0f, field->part[1][b] = 0.0f;
    }
    const triples source = cubics(a->knot, a->u);
    const triple begin = triple_of(&source, lane), end = triple_of(&RECEIVER_AT(s, i).ear.position, lane);
    const double clock_error = OF_NODE(RECEIVER_AT(s, i).clock_error, lane);
    const double received = s->start + (s->ready * GROUP + i - 1) * s->block_time + clock_error;
    const double flight = RETARDED ? OF_NODE(a->delay, lane) : 0.0;
    const travel of = {received - flight, flight, OF_NODE(a->mach_factor, lane)};
    __global const double* casters = t->modes + 4 * FOCK_COUNT;
    __global const double* part = casters + 1 + (int)casters[0] * CASTER_COLUMNS + SHADED_PART * s->seen->first;
    for (int k = 0; k < s->seen->count; k++, part += SHADED_PART) {
        double from[3], to[3];
        for (int axis = 0; axis < 3; axis++) {
            __global const double* m = part + 3 * axis;
            from[axis] = m[0] * begin.x + m[1] * begin.y + m[2] * begin.z + part[9 + axis];
            to[axis] = m[0] * end.x + m[1] * end.y + m[2] * end.z + part[9 + axis];
        }
        for (int c = 0; c < (int)casters[0]; c++) {
            shade_of(t, s->poses, casters + 1 + CASTER_COLUMNS * c, from, to, &of, &roots, field);
        }
    }
    for (int b = 0; b < BIN_VECTORS; b++) field->part[0][b] -= 1.0f;
}
#endif
