// Validity of one side of a path over two edges with air between: from the source to the first edge, from the receiver to
// the last one, and between both in two parts that overlap, from a place between the last reflection there and the last
// edge. The twin of visibility/edge_ends.py.

#if GAP
// Place at a part of the way from the last edge to the last reflection between both.
static triple before_last(const search* s, triple first, triple last, double part)
{
    triple image = first;
    double share = 1.0;
    __global const int* walls = s->other + s->before_count + s->after_count;
    for (int k = 0; k < s->other_count - s->before_count - s->after_count; k++) {
        const double4 plane = s->walls.plane[walls[k]];
        image = mirrored(plane, image);
        const double from = height(plane, last), apart = from - height(plane, image);
        share = fmin(fmax(from / (apart == 0.0 ? 1.0 : apart), 0.0), 1.0);
    }
    return sum(last, times(part * share, difference(image, last)));
}

// How far the way between is inside the air of an edge, rad, and how far that turns at most while its far end goes `move`.
static double in_its_air(__global const edge_of_room* edge, __global const edge_of_room* other, double own, double place,
                         double move, double* turn)
{
    const triple far = sum(at_row(other->start), times(place, at_row(other->along)));
    const double angle = about(edge, far).angle;
    const triple near = sum(at_row(edge->start), times(own, at_row(edge->along)));
    const triple skew = cross_product(at_row(edge->along), at_row(other->along));
    const triple off = cross_product(difference(far, near), at_row(edge->along));
    const double sine = fmin(move * sqrt(inner(skew, skew)) / fmax(sqrt(inner(off, off)), 1e-300), 1.0);
    *turn = atan2(sine, sqrt(1.0 - sine * sine));
    return fmin(angle, HALF_TURN * edge->n - angle);
}

static int evaluate(const search* s, double time, double within, double* clear, double* reach)
{
    const stance at = stance_at(s, time);
    const cylindrical source = at.source, receiver = at.receiver;
    const crossing way = at.way;
    *reach = reach_about(s, time, time - at.delay, within);
    const double* legs = way.legs;
    const double least_leg = fmin(fmin(fmin(legs[0], legs[1]), legs[2]), fmin(source.r, receiver.r));
    double moves[2], left = EVER;
    triple apex[2];
    for (int edge = 0; edge < 2; edge++) {
        moves[edge] = *reach < SMALL * least_leg ? SPARE * *reach * way.slides[edge] : s->far;
        left = fmin(left, fmin(way.places[edge], s->edge[edge]->length - way.places[edge]));
        apex[edge] = sum(at_row(s->edge[edge]->start), times(way.places[edge], at_row(s->edge[edge]->along)));
    }
    const double most = fmax(moves[0], moves[1]);
    const double4 nowhere = {0.0, 0.0, 0.0, 0.0};
    double apart;
    if (s->side < 2) {
        const double across = fmin(source.r / legs[0] * (legs[1] + legs[2]), receiver.r / legs[2] * (legs[0] + legs[1]));
        const double off = fmin(fmin(in_air(s->edge[0], source), in_air(s->edge[1], receiver)), across);
        left = fmin(left, off);
        *clear = *reach * ratio(fabs(left), fmax(*reach, most));
        if (off < 0.0) *clear = fmax(*reach * ratio(-off, *reach), *clear);  // wherever the places on the edges slide to
        if (left < 0.0) return 0;
        const int valid = path_status(&s->walls, s->sequence, s->side ? at.received_at : at.emitted_at, apex[s->side], *reach,
                                      moves[s->side], nowhere, nowhere, &apart);
        apart = *reach * ratio(apart, fmax(moves[s->side], *reach));
        *clear = valid ? fmin(apart, *clear) : apart;
        return valid;
    }
    const double overlap[2] = OVERLAP;
    double turn[2];
    const double ahead = in_its_air(s->edge[0], s->seen, way.places[0], way.places[1], moves[1], turn);
    const double back = in_its_air(s->seen, s->edge[0], way.places[1], way.places[0], moves[0], turn + 1);
    const int free = fmin(ahead, back) > IN_AIR;
    const double beside = fmin(ratio(fabs(ahead - IN_AIR), turn[0]), ratio(fabs(back - IN_AIR), turn[1]));
    const int clear_way = path_status(&s->walls, s->sequence, before_last(s, apex[0], apex[1], overlap[s->side - 2]),
                                      apex[s->side - 2], most, most, nowhere, nowhere, &apart);
    const double sure = ratio(apart, most);
    *clear = *reach * fmin(free ? (clear_way ? fmin(beside, sure) : sure) : (clear_way ? beside : fmax(beside, sure)), EVER);
    return free && clear_way;
}
#endif
