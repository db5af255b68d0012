// What bodies with outlines that stand in the line of sight before another one let pass: twin of acoustics/shade.py.

#if VERTEX == SCATTERER
// Where all scatterers are while sound is at one, and when that is, s.
typedef struct {
    const pose_table* poses;
    reals event;
} moment;

#if PARTS == 2
#define CASTER_COLUMNS 7  // thing, CAPSULE or not, whether turned, three axes as of an outline, where its table begins

// Distance by which the line of sight passes the body, about, m; below 0 where it meets it.
static double clearance_of(const outline* o)
{
    if (o->is_capsule) {
        const double straight = o->axes[2] - o->axes[0];
        double along[3];
        for (int i = 0; i < 3; i++) along[i] = o->receiver[i] - o->source[i];
        const double level = dot_of(along, along), slope = along[2], length = dot_of(o->source, along);
        const double parted = fmax(level - slope * slope, 1e-12 * level);
        double height = fmin(fmax((o->source[2] * level - slope * length) / parted, -straight), straight);
        const double share = fmin(fmax((height * slope - length) / fmax(level, TINY), 0.0), 1.0);
        height = fmin(fmax(o->source[2] + share * slope, -straight), straight);
        double apart_by[3];
        for (int i = 0; i < 3; i++) apart_by[i] = o->source[i] + share * along[i];
        apart_by[2] -= height;
        return sqrt(dot_of(apart_by, apart_by)) - o->axes[0];
    }
    double begin[3], along[3], nearest[3];
    for (int i = 0; i < 3; i++) begin[i] = o->source[i] / o->axes[i], along[i] = (o->receiver[i] - o->source[i]) / o->axes[i];
    const double share = fmin(fmax(-dot_of(begin, along) / fmax(dot_of(along, along), TINY), 0.0), 1.0);
    for (int i = 0; i < 3; i++) nearest[i] = begin[i] + share * along[i];
    const double out = sqrt(dot_of(nearest, nearest));
    for (int i = 0; i < 3; i++) nearest[i] *= o->axes[i];
    return (1.0 - 1.0 / fmax(out, 0.5)) * sqrt(dot_of(nearest, nearest));
}

// Multiply the field about an outline by the shade of one body, whose outline sees both ends.
static void shade_by(const vertex_tables* t, const outline* o, int first, const root_range* roots, response* about)
{
    const double before = -dot_of(o->source, o->sight), after = dot_of(o->receiver, o->sight), length = before + after;
    const double between = faded(fmin(before, after) / t->modes[first + 4], 1.0, 0.0);
    if (between <= 0.0) return;
    const double passed = clearance_of(o) / sqrt(before * after / length);
    float weight[FREQUENCIES], most = 0.0f;
    for (int f = 0; f < FREQUENCIES; f++) {
        weight[f] = (float)(between * faded(passed * sqrt((double)((__global const float*)t->waves)[f]), WITHIN, 2.0 * WITHIN));
        most = fmax(most, weight[f]);
    }
    if (most == 0.0f) return;
    response own;
    outline_field(t, o, first, length, roots, &own);
    for (int f = 0; f < FREQUENCIES; f++) {
        const float real = 1.0f + weight[f] * ((float*)own.part[0])[f], imaginary = weight[f] * ((float*)own.part[1])[f];
        const float x = ((float*)about->part[0])[f], y = ((float*)about->part[1])[f];
        ((float*)about->part[0])[f] = real * x - imaginary * y;
        ((float*)about->part[1])[f] = real * y + imaginary * x;
    }
}

// Multiply the field about the outline of a scatterer by the shades of all before it in the scene.
static void shade_by_others(const vertex_tables* t, const moment* now, __global const view* seen, const scatterer_frame* g, int lane,
                            const root_range* roots, response* about)
{
    __global const double* caster = t->modes + 4 * FOCK_COUNT;
    const int count = (int)caster[0];
    caster++;
    if ((int)caster[0] >= seen->thing) return;
    const pose own = pose_at(now->poses, seen->thing, seen->turned, now->event);
    triples ends[2] = {g->source, g->receiver};
    for (int e = 0; e < 2; e++) {
        const triples x = ends[e];
        if (seen->turned) ends[e] = plus(scaled(x.x, own.axes[0]), plus(scaled(x.y, own.axes[1]), scaled(x.z, own.axes[2])));
        ends[e] = plus(ends[e], own.place);
    }
    for (int i = 0; i < count && (int)caster[0] < seen->thing; i++, caster += CASTER_COLUMNS) {
        const int is_turned = (int)caster[2];
        const pose other = pose_at(now->poses, (int)caster[0], is_turned, now->event);
        outline o;
        o.is_capsule = (int)caster[1];
        for (int e = 0; e < 2; e++) {
            const triples x = apart(ends[e], other.place);
            const reals from[3] = {is_turned ? DOT(x, other.axes[0]) : x.x, is_turned ? DOT(x, other.axes[1]) : x.y,
                                   is_turned ? DOT(x, other.axes[2]) : x.z};
            for (int axis = 0; axis < 3; axis++) (e ? o.receiver : o.source)[axis] = OF_NODE(from[axis], lane);
        }
        for (int axis = 0; axis < 3; axis++) o.axes[axis] = caster[3 + axis];
        look_along(&o);
        shade_by(t, &o, (int)caster[6], roots, about);
    }
}
#endif
#endif
