// Validity of one side of a path over an edge: from the source to the edge, or from the receiver to it, with the room
// there is for both images and for the place on the edge. The twin of diffraction/visibility.py.

typedef struct {
    room walls;
    end_of_path source, receiver;
    __global const int* sequence;     // [ORDER] walls of this side, from its end
    __global const int* other;        // [other_count] walls of the other side, from its own
    int other_count, from_receiver;
    __global const edge_of_room* edge;
    int end;                          // 0 for its start, 1 for its stop, -1 for the edge itself
    double far;                       // m, more than anything in the room
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

// How often what moves fits into the least of the margins; negative where one is.
static double margins(const search* s, cylindrical source, cylindrical receiver, double place, double moves)
{
    double least = fmin(in_air(s->edge, source), in_air(s->edge, receiver));
    if (s->end < 0) least = fmin(least, fmin(place, s->edge->length - place));
    return least < 0.0 ? -ratio(-least, moves) : ratio(least, moves);
}

// Status at an instant, while both ends move as they can for `within` before and after (s); `reach` is how far that is.
static int evaluate(const search* s, double time, double within, double* clear, double* reach)
{
    const triple source_perturbation = SOURCE_PERTURBATION, receiver_perturbation = RECEIVER_PERTURBATION;
    const triple heard_at = end_at(&s->receiver, time, receiver_perturbation);
    const cylindrical receiver = about(s->edge, image_of(s, 1, heard_at));
    const double slowness = s->source.path.slowness;
    cylindrical source = {0.0, 0.0, 0.0};
    triple emitted_at = heard_at;
    double delay = 0.0;
    for (int k = 0; k < CONTRACTIONS; k++) {  // each step by the Mach number of the source
        emitted_at = end_at(&s->source, time - delay, source_perturbation);
        source = about(s->edge, image_of(s, 0, emitted_at));
        const double later = way_length(source, receiver) * slowness - delay;
        delay += later;
        if (fabs(later) <= CONTRACTED) break;
    }
    const double emitted = time - delay;
    const double late = within * (1.0 + s->receiver.fastest * slowness) / (1.0 - s->source.fastest * slowness);
    *reach = fmax(late * speed_over(&s->source, emitted - late, emitted + late),
                  within * speed_over(&s->receiver, time - within, time + within));
    const double room_across = source.r + receiver.r - 2.0 * *reach;
    const double sliding = room_across > 0.0 ? *reach * (way_length(source, receiver) + 2.0 * *reach) / room_across : s->far;
    const double moves = s->end < 0 ? sliding : 0.0, most = fmax(*reach, moves);
    const double place = s->end < 0 ? way_apex(source, receiver) : s->end * s->edge->length;
    const double sure = margins(s, source, receiver, place, most);
    *clear = fabs(sure) * *reach;
    if (sure < 0.0) return 0;
    const triple apex = sum(at_row(s->edge->start), times(place, at_row(s->edge->along)));
    const double4 nowhere = {0.0, 0.0, 0.0, 0.0};
    double apart;
    const int valid = path_status(&s->walls, s->sequence, s->from_receiver ? heard_at : emitted_at, apex, *reach, moves,
                                  nowhere, nowhere, &apart);
    apart = *reach * ratio(apart, most);
    *clear = valid ? fmin(*clear, apart) : apart;
    return valid;
}
