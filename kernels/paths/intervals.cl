// Intervals in which paths are valid, by certified subdivision of time. Work-item: one path (a wall sequence and a
// receiver), which goes on from where its last launch stopped. It takes a span from its stack and evaluates its middle:
// if the clearance exceeds what the ends can move within the span, the span is done; else the part that the clearance
// covers is, and the rests on both sides go back on the stack. Spans come off it in the order of time.

typedef struct {
    double begin, end;
    int known, valid;  // whether the span is done, and how
} span;

typedef struct {
    double begin, end;  // of the interval that is being put together; none if begin > end
    int depth, evaluations;   // spans on the stack, and evaluations so far
    span stack[DEPTH];
} progress;

typedef struct {
    double begin, end;
    int path, unused;
} interval;

typedef struct {
    room walls;
    end_of_path source, receiver;
    __global const int* sequence;
    double most_slowness;  // 1 / least speed at which sound makes way, s/m
} search;

// Status at an instant, while both ends move as they can for `within` before and after (s); `reach` is how far that is.
static int evaluate(const search* s, double time, double within, double* clear, double* reach)
{
    const triple source_perturbation = SOURCE_PERTURBATION, receiver_perturbation = RECEIVER_PERTURBATION;
    arrivals a;
    locate(&s->receiver.path, time, &a);
    const triple receiver = cubic(a.knot[0], a.u);
    triple image = receiver;
    for (int k = ORDER; k > 0; k--) image = mirrored(s->walls.plane[s->sequence[k - 1]], image);
    listener seen = {{image.x, image.y, image.z}, {0.0, 0.0, 0.0}};
#if WIND
    const triples unseen = {0.0, 0.0, 0.0};  // directions at the receiver are not asked for
    seen.wind = unseen;
    seen.downwind = inner(s->source.path.wind, receiver);
#endif
    a.delay = 0.0;
    solve_delay(&s->source.path, &seen, time, 1e-18, &a);
    const double emitted = time - a.delay;
    locate(&s->source.path, emitted, &a);
    const double slowness = s->most_slowness;
    const double time_dilation = (1.0 + s->receiver.fastest * slowness) / (1.0 - s->source.fastest * slowness);
    const double source_reach =
        within * time_dilation * speed_over(&s->source, emitted - time_dilation * within, emitted + time_dilation * within);
    const double receiver_reach = within * speed_over(&s->receiver, time - within, time + within);
    *reach = fmax(source_reach, receiver_reach);
    return path_status(&s->walls, s->sequence, lifted(&s->source, sum(cubic(a.knot[0], a.u), source_perturbation)),
                       lifted(&s->receiver, sum(receiver, receiver_perturbation)), source_reach, receiver_reach, s->source.mount,
                       s->receiver.mount, clear);
}

static void push(__global progress* p, double begin, double end, int known, int valid)
{
    if (!(end > begin)) return;
    const span s = {begin, end, known, valid};
    p->stack[p->depth++] = s;
}

static void put(__global progress* p, double begin, double end, int path, __global interval* found,
                __global int* count)
{
    if (begin == p->end) {
        p->end = end;
        return;
    }
    if (p->begin < p->end) {
        const interval done = {p->begin, p->end, path, 0};
        found[atomic_inc(count)] = done;
    }
    p->begin = begin;
    p->end = end;
}

__kernel void intervals(double tolerance, double thickness, __global const double4* plane,
                        __global const double4* sphere, __global const int* same, __global const int* first_edge,
                        __global const int* first_piece,
                        __global const int* first_line, __global const int* first_twin, __global const edge_ends* edge,
                        __global const double4* line, __global const int* twin,
                        int box_count, __global const double4* box_middle, __global const double4* box_extent,
                        __global const int* box_wall, __global const int* box_skip,
                        __global const table_place* places,    // [ends], the source first
                        __global const table_scale* scales,    // [ends]
                        __global const double* knots, __global const double* speeds,
                        __global const double4* mounts,  // [ends]: normal and offset, see `end_of_path`
                        double speed_of_sound,
                        __global const double* wind,    // [3], m/s
                        double slowest,                 // speed at which sound makes way at least, m/s
                        __global const int* sequences, __global const int* receiver_of,  // [paths][ORDER], [paths]
                        __global const int* active, int active_count,  // paths that are not done
                        double resolution,              // s, to which ends are found
                        double smallest_move,                // m, moves that are none
                        double graze,                   // m, clearance below which a path runs along an edge
                        int budget,                     // evaluations of each path in this launch
                        __global progress* states,      // [paths]
                        __global interval* found, __global int* found_count)
{
    if (get_global_id(0) >= active_count) return;
    const int path = active[get_global_id(0)];
    const search s = {{tolerance, thickness, plane, sphere, same, first_edge, first_piece, first_line, first_twin, edge,
                       line, twin, {box_count, box_middle, box_extent, box_wall, box_skip}}, trajectory_at(places, scales, knots, speeds, mounts, speed_of_sound, wind, 0),
                      trajectory_at(places, scales, knots, speeds, mounts, speed_of_sound, wind, 1 + receiver_of[path]),
                      sequences + ORDER * (long)path, 1.0 / slowest};
    __global progress* p = states + path;
    int evaluations = 0;
    while (p->depth > 0 && evaluations < budget) {
        const span now = p->stack[--p->depth];
        if (now.known) {
            if (now.valid) put(p, now.begin, now.end, path, found, found_count);
            continue;
        }
        const double within = 0.5 * (now.end - now.begin), middle = now.begin + within;
        double clear, reach, unused;
        const int valid = evaluate(&s, middle, within, &clear, &reach);
        evaluations++;
        int done = clear > reach || 2.0 * within <= resolution || reach < smallest_move;
        if (!done && clear < graze && within <= 0.5 * GRAZE_TIME) {
            done = evaluate(&s, now.begin, 0.0, &unused, &unused) == valid && evaluate(&s, now.end, 0.0, &unused, &unused) == valid;
            evaluations += 2;
        }
        if (done) {
            if (valid) put(p, now.begin, now.end, path, found, found_count);
            continue;
        }
        double share = CERTAIN * clear / reach;
        if (share < LEAST_SHARE || share * within < 0.5 * resolution) share = 0.0;
        const double from = middle - share * within, until = middle + share * within;
        push(p, until, now.end, 0, 0);
        push(p, from, until, 1, valid);
        push(p, now.begin, from, 0, 0);
    }
    p->evaluations += evaluations;
    if (p->depth == 0) put(p, -2.0, -3.0, path, found, found_count);  // gives out what was put together
}
