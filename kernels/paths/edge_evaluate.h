// Validity of one side of a path over one or two edges: from the source to its edge, or from the receiver to its own, with
// the room there is for both images and for the places on the edges. The twin of diffraction/visibility.py.

typedef struct {
    room walls;
    end_of_path source, receiver;
    __global const int* sequence;     // [ORDER] walls of this side, from its end
    // [other_count] walls of the other side, from its own; with GAP those before and after both edges and between them
    __global const int* other;
    int other_count, before_count, after_count;
    int side;                         // 0 from the source, 1 from the receiver; with GAP 2 and 3, see gap_evaluate.h
    __global const edge_of_room* seen;  // with GAP: the last edge as the first one sees it by the walls between
    __global const edge_of_room* edge[2];  // of the source and of the receiver, the same one for a path over one
    int face[2];                      // of each that both share, 0 or 1; -1 for a path over one edge
    int end;                          // 0 for its start, 1 for its stop, -1 for the edge itself
    double far;                       // m, more than anything in the room
    double most_slowness;             // 1 / least speed at which sound makes way, s/m
} search;

static triple image_of(const search* s, int of_receiver, triple place)
{
#if GAP
    const int count = of_receiver ? s->after_count : s->before_count;
    __global const int* walls = s->other + (of_receiver ? s->before_count : 0);
#else
    const int mine = of_receiver == s->side, count = mine ? ORDER : s->other_count;
    __global const int* walls = mine ? s->sequence : s->other;
#endif
    for (int k = 0; k < count; k++) place = mirrored(s->walls.plane[walls[k]], place);
    return place;
}

// Place of an end at a time.
static triple end_at(const end_of_path* end, double time, triple perturbation)
{
    arrivals a;
    locate(&end->path, time, &a);
    return lifted(end, sum(cubic(a.knot[0], a.u), perturbation));
}

// Time that sound takes for a way of a length between two places, s.
static double passage(const trajectory* path, double length, triple from, triple to)
{
#if WIND
    const double along = inner(path->wind, difference(to, from));
    return (sqrt(along * along + path->room * length * length) - along) * path->inverse_room;
#else
    return length * path->slowness;
#endif
}

// How far both ends may move within a time about an instant, m.
static double reach_about(const search* s, double time, double emitted, double within)
{
    const double slowness = s->most_slowness;
    const double late = within * (1.0 + s->receiver.fastest * slowness) / (1.0 - s->source.fastest * slowness);
    return fmax(late * speed_over(&s->source, emitted - late, emitted + late),
                within * speed_over(&s->receiver, time - within, time + within));
}

// Where a path runs at an instant.
typedef struct {
    triple emitted_at, received_at;   // its ends
    cylindrical source, receiver;  // their images about the edges
    double delay;
#if GAP
    crossing way;
#else
    cylindrical received;             // the receiver as the first edge sees it
#endif
} stance;

#if GAP
static double way_over(const search* s, stance* at)
{
    at->way = cross_edges(s->edge[0], s->seen, at->source, at->receiver);
    return at->way.legs[0] + at->way.legs[1] + at->way.legs[2];
}
#else
// An end of a path as the edge of the other end sees it.
static cylindrical seen_by(const search* s, int edge, cylindrical at)
{
    return s->face[0] < 0 ? at : beyond(s->edge[edge], s->face[edge], s->edge[1 - edge], s->face[1 - edge], at);
}

static double way_over(const search* s, stance* at)
{
    at->received = seen_by(s, 0, at->receiver);
    if (s->end < 0) return way_length(at->source, at->received);
    return way_by(s->end * s->edge[0]->length, at->source, at->receiver);
}
#endif

static stance stance_at(const search* s, double time)
{
    const triple source_perturbation = SOURCE_PERTURBATION, receiver_perturbation = RECEIVER_PERTURBATION;
    stance at;
    at.received_at = end_at(&s->receiver, time, receiver_perturbation);
    at.receiver = about(s->edge[1], image_of(s, 1, at.received_at));
    at.delay = 0.0;
    for (int k = 0; k < CONTRACTIONS; k++) {  // each step by the Mach number of the source
        at.emitted_at = end_at(&s->source, time - at.delay, source_perturbation);
        at.source = about(s->edge[0], image_of(s, 0, at.emitted_at));
        const double later = passage(&s->source.path, way_over(s, &at), at.emitted_at, at.received_at) - at.delay;
        at.delay += later;
        if (fabs(later) <= CONTRACTED) break;
    }
    return at;
}

#if !GAP
// How far the place on an edge may slide while ends move by `reach`, from how far both are off the edge together.
static double sliding(const search* s, double reach, double across, double length)
{
    const double left = across - 2.0 * reach;
    return left > 0.0 ? reach * (length + 2.0 * reach) / left : s->far;
}

// Status at an instant, while both ends move as they can for `within` before and after (s); `reach` is how far that is.
static int evaluate(const search* s, double time, double within, double* clear, double* reach)
{
    const stance at = stance_at(s, time);
    const cylindrical source = at.source, receiver = at.receiver, received = at.received;
    *reach = reach_about(s, time, time - at.delay, within);
    const cylindrical sent = seen_by(s, 1, source);
    double places[2] = {s->end * s->edge[0]->length, s->end * s->edge[1]->length}, moves[2] = {0.0, 0.0};
    if (s->end < 0) {
        const double length = way_length(source, received);
        places[0] = way_apex(source, received);
        places[1] = way_apex(receiver, sent);
        moves[0] = sliding(s, *reach, source.r + received.r, length);
        moves[1] = sliding(s, *reach, receiver.r + sent.r, length);
    }
    const double most = fmax(*reach, fmax(moves[0], moves[1]));
    const double off = fmin(fmin(in_air(s->edge[0], source), in_air(s->edge[1], receiver)), fmin(received.r, sent.r));
    double least = off;
    for (int edge = 0; edge < 2 && s->end < 0; edge++) {
        least = fmin(least, fmin(places[edge], s->edge[edge]->length - places[edge]));
    }
    *clear = *reach * ratio(fabs(least), most);
    if (off < 0.0) *clear = fmax(*clear, *reach * ratio(-off, *reach));  // wherever the places on the edges slide to
    if (least < 0.0) return 0;
    const int mine = s->side;
    const triple apex = sum(at_row(s->edge[mine]->start), times(places[mine], at_row(s->edge[mine]->along)));
    const double4 nowhere = {0.0, 0.0, 0.0, 0.0};
    double apart;
    const int valid = path_status(&s->walls, s->sequence, mine ? at.received_at : at.emitted_at, apex, *reach, moves[mine], nowhere,
                                  nowhere, &apart);
    apart = *reach * ratio(apart, fmax(*reach, moves[mine]));
    *clear = valid ? fmin(*clear, apart) : apart;
    return valid;
}
#endif
