// Validity of one side of a path over one or two edges: from the source to its edge, or from the receiver to its own, with
// the room there is for both images and for the places on the edges. The twin of diffraction/visibility.py.

typedef struct {
    room walls;
    end_of_path source, receiver;
    __global const int* sequence;     // [ORDER] walls of this side, from its end
    __global const int* other;        // [other_count] walls of the other side, from its own
    int other_count, from_receiver;
    __global const edge_of_room* edge[2];  // of the source and of the receiver, the same one for a path over one
    int face[2];                      // of each that both share, 0 or 1; -1 for a path over one edge
    int end;                          // 0 for its start, 1 for its stop, -1 for the edge itself
    double far;                       // m, more than anything in the room
    double most_slowness;             // 1 / least speed at which sound makes way, s/m
} search;

static triple image_of(const search* s, int of_receiver, triple place)
{
    const int mine = of_receiver == s->from_receiver, count = mine ? ORDER : s->other_count;
    __global const int* walls = mine ? s->sequence : s->other;
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

// An end of a path as the edge of the other end sees it.
static cylindrical seen_by(const search* s, int edge, cylindrical at)
{
    return s->face[0] < 0 ? at : beyond(s->edge[edge], s->face[edge], s->edge[1 - edge], s->face[1 - edge], at);
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

// How far the place on an edge may slide while ends move by `reach`, from how far both are off the edge together.
static double sliding(const search* s, double reach, double across, double length)
{
    const double left = across - 2.0 * reach;
    return left > 0.0 ? reach * (length + 2.0 * reach) / left : s->far;
}

// Status at an instant, while both ends move as they can for `within` before and after (s); `reach` is how far that is.
static int evaluate(const search* s, double time, double within, double* clear, double* reach)
{
    const triple source_perturbation = SOURCE_PERTURBATION, receiver_perturbation = RECEIVER_PERTURBATION;
    const triple heard_at = end_at(&s->receiver, time, receiver_perturbation);
    const cylindrical receiver = about(s->edge[1], image_of(s, 1, heard_at)), heard = seen_by(s, 0, receiver);
    const double slowness = s->most_slowness;
    cylindrical source = {0.0, 0.0, 0.0};
    triple emitted_at = heard_at;
    double delay = 0.0;
    for (int k = 0; k < CONTRACTIONS; k++) {  // each step by the Mach number of the source
        emitted_at = end_at(&s->source, time - delay, source_perturbation);
        source = about(s->edge[0], image_of(s, 0, emitted_at));
        const double length = s->end < 0 ? way_length(source, heard) : way_by(s->end * s->edge[0]->length, source, receiver);
        const double later = passage(&s->source.path, length, emitted_at, heard_at) - delay;
        delay += later;
        if (fabs(later) <= CONTRACTED) break;
    }
    const double emitted = time - delay;
    const double late = within * (1.0 + s->receiver.fastest * slowness) / (1.0 - s->source.fastest * slowness);
    *reach = fmax(late * speed_over(&s->source, emitted - late, emitted + late),
                  within * speed_over(&s->receiver, time - within, time + within));
    const cylindrical sent = seen_by(s, 1, source);
    double places[2] = {s->end * s->edge[0]->length, s->end * s->edge[1]->length}, moves[2] = {0.0, 0.0};
    if (s->end < 0) {
        const double length = way_length(source, heard);
        places[0] = way_apex(source, heard);
        places[1] = way_apex(receiver, sent);
        moves[0] = sliding(s, *reach, source.r + heard.r, length);
        moves[1] = sliding(s, *reach, receiver.r + sent.r, length);
    }
    const double most = fmax(*reach, fmax(moves[0], moves[1]));
    const double off = fmin(fmin(in_air(s->edge[0], source), in_air(s->edge[1], receiver)), fmin(heard.r, sent.r));
    double least = off;
    for (int edge = 0; edge < 2 && s->end < 0; edge++) {
        least = fmin(least, fmin(places[edge], s->edge[edge]->length - places[edge]));
    }
    *clear = *reach * ratio(fabs(least), most);
    if (off < 0.0) *clear = fmax(*clear, *reach * ratio(-off, *reach));  // wherever the places on the edges slide to
    if (least < 0.0) return 0;
    const int mine = s->from_receiver;
    const triple apex = sum(at_row(s->edge[mine]->start), times(places[mine], at_row(s->edge[mine]->along)));
    const double4 nowhere = {0.0, 0.0, 0.0, 0.0};
    double apart;
    const int valid = path_status(&s->walls, s->sequence, mine ? heard_at : emitted_at, apex, *reach, moves[mine], nowhere,
                                  nowhere, &apart);
    apart = *reach * ratio(apart, fmax(*reach, moves[mine]));
    *clear = valid ? fmin(*clear, apart) : apart;
    return valid;
}
