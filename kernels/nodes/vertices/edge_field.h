// The field beyond an edge: twin of `EdgeVertex._field` in paths/vertices/edge_field.py and of acoustics/diffraction.py.

#if VERTEX == EDGE
// Coordinates of a place along the axes of an edge, and a vector of these in the room.
static triple place_by_edge(__global const double* turn, __global const double* shift, triple v)
{
    const triple out = {turn[0] * v.x + turn[1] * v.y + turn[2] * v.z + shift[0],
                        turn[3] * v.x + turn[4] * v.y + turn[5] * v.z + shift[1],
                        turn[6] * v.x + turn[7] * v.y + turn[8] * v.z + shift[2]};
    return out;
}
static triple into_room(__global const double* m, triple v)
{
    const triple out = {m[0] * v.x + m[3] * v.y + m[6] * v.z, m[1] * v.x + m[4] * v.y + m[7] * v.z,
                        m[2] * v.x + m[5] * v.y + m[8] * v.z};
    return out;
}

// Distance of an end from the edge, and its angle from the 0-face: see `off_line`.
static double off_edge(triple at) { return fmax(sqrt(at.x * at.x + at.y * at.y), ON_LINE); }
static double angle_about(triple at, double angle, double low, double n)
{
    if (at.x * at.x + at.y * at.y < ON_LINE * ON_LINE) return 0.5 * HALF_TURN * n;
    return angle < low ? angle + 2.0 * HALF_TURN : angle;
}

// Unit vector from an end to a place on the edge, along the edge's axes.
static triple towards_edge(triple at, double place)
{
    const triple apart = {-at.x, -at.y, place - at.z};
    return times(1.0 / sqrt(inner(apart, apart)), apart);
}

// Multiply by the factor of a face, at the cosine of the angle of incidence of a reflection by it.
static void by_face(const environment* env, const vertex_tables* t, __global const edge_view* edge, int slot, int face,
                    double cosine, response* r)
{
    const int table = edge->face[face];
    if (table >= 0) {
        apply_cubics(env->walls + (long)table * CELLS * 4 * PARTS * BIN_VECTORS,
                     sqrt((float)(cosine < 0.0 ? -cosine : cosine)), r);
        return;
    }
    response factor;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) {
            factor.part[part][b] = t->faces[((2 * (long)slot + face) * PARTS + part) * BIN_VECTORS + b];
        }
    }
    multiply(r, &factor);
}

// The same for all reflections of a term's partner in turn, as `adjacent_factors`: by half the sum or the difference of angles.
static void by_faces(const environment* env, const vertex_tables* t, __global const edge_view* edge, int slot, int first,
                     int count, double angle, double slope, response* r)
{
    for (int bounce = 0; bounce < count; bounce++) {
        const double cosine = cos(angle + (bounce - count / 2) * HALF_TURN * edge->n) * slope;
        by_face(env, t, edge, slot, (first + bounce) & 1, cosine, r);
    }
}

// The field over that of free air of the length of the shortest path, which is returned, m, and where it meets the edge; ends
// are along the edge's axes.
static double edge_field(const environment* env, const vertex_tables* t, __global const edge_view* edge, int slot, triple s,
                         triple r, double raised, double* place, response* field)
{
    const double r_s = off_edge(s), r_r = off_edge(r), across = r_s + r_r, along = s.z - r.z, n = edge->n;
    const double length = sqrt(across * across + along * along), breadth = sqrt(2.0 * r_s * r_r / length * raised);
    const double2 y = {s.y, r.y}, x = {s.x, r.x}, from_axis = angles_of(y, x);
    const double t_s = angle_about(s, from_axis.x, edge->low[0], n), t_r = angle_about(r, from_axis.y, edge->low[1], n);
    const double between = t_r - t_s, together = t_r + t_s;
    const double even = n * HALF_TURN * edge->bounces[0], odd = n * HALF_TURN * (edge->bounces[1] - 1);
    const double angles[4] = {HALF_TURN + between - even, HALF_TURN - between - even, HALF_TURN - together - odd,
                              together - (2.0 * n - 1.0) * HALF_TURN - odd};
    // Of a term's angle a: sine and cosine of a / 2, and of a / 2n but for half turns.
    double4 c;
    const double4 shares = {0.5, 0.5 / n, 0.5, 0.5 / n}, sums = {between, between, together, together};
    const double4 e = sines(shares * sums, &c);
    const double wide_s = edge->wide[0], wide_c = edge->wide[1], narrow_s = edge->narrow[0], narrow_c = edge->narrow[1];
    const double sine[4] = {c.x, c.x, c.z, c.z * wide_c + e.z * wide_s}, cosine[4] = {-e.x, e.x, e.z, c.z * wide_s - e.z * wide_c};
    const double low[4] = {narrow_s * c.y + narrow_c * e.y, narrow_s * c.y - narrow_c * e.y, narrow_s * c.w - narrow_c * e.w,
                           narrow_s * c.w + narrow_c * e.w};
    const double high[4] = {narrow_c * c.y - narrow_s * e.y, narrow_c * c.y + narrow_s * e.y, narrow_c * c.w + narrow_s * e.w,
                            narrow_c * c.w - narrow_s * e.w};
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) field->part[part][b] = 0.0f;
    }
    const double apex = (s.z * r_r + r.z * r_s) / across;
    const double end = edge->end_side ? root_at_end(edge, r_s, s.z, r_r, r.z, apex, raised) : 0.0;
    response of_end;
    if (edge->end_side) transition_of(t, end < 0.0 ? -end : end, 1.0f, &of_end);
    const double turn = 2.0 * n * HALF_TURN, per_turn = 1.0 / turn, inverse = 1.0 / n;
    for (int term = 0; term < 4; term++) {
        if (!edge->lit[term]) continue;
        const double turns = (angles[term] * per_turn + ROUNDING_DOUBLE) - ROUNDING_DOUBLE;
        const double angle = angles[term] - turn * turns, near = angle < 0.0 ? -angle : angle;
        const double side = turns == 0.0 ? (edge->lit[term] < 0 ? -1.0 : 1.0) : angle < 0.0 ? -1.0 : 1.0;
        __global const double* off = term < 2 ? edge->even : edge->odd;
        const double here_s = sine[term] * off[1] - cosine[term] * off[0], here_c = cosine[term] * off[1] + sine[term] * off[0];
        const double rise = turns == 0.0 ? here_s : here_s * wide_c - here_c * turns * wide_s;
        const double steep = near < ON_BOUNDARY ? 1.0 : rise * high[term] / low[term] * inverse;
        response one;
        const double root = side * rise * breadth, weight = -0.5 * side * steep;
        if (edge->end_side) {
            transition_at_end(t, end, &of_end, root, (float)(-edge->end_side * weight), edge->lit[term], edge->corner, &one);
        } else transition_of(t, root, (float)weight, &one);
        by_faces(env, t, edge, slot, term < 2 ? 0 : term, edge->bounces[term / 2], 0.5 * (term < 2 ? together : -between),
                 across / length, &one);
        for (int part = 0; part < PARTS; part++) {
            for (int b = 0; b < BIN_VECTORS; b++) field->part[part][b] += one.part[part][b];
        }
    }
    *place = edge->end_side ? edge->end : apex;
    return length;
}

// Multiply by the factor of a path of a length, m, that fades at a time of reception, s: twin of `Fades.gain`.
static void fade(__global const edge_view* edge, double time, double length, response* field)
{
    float gain[2] = {1.0f, 0.0f};
    for (int side = 0; side < 2; side++) {
        const double since = (side ? -1.0 : 1.0) * (time - edge->slip[side] * length - edge->moment[side]) / edge->span[side];
        const float x = since < 0.0 ? 0.0f : since < 1.0 ? (float)since : 1.0f;
        const float left = 1.0f - x * x * x * (10.0f - x * (15.0f - 6.0f * x));
        for (int part = 0; part < 2; part++) gain[part] -= edge->share[part][side] * left;
    }
    response factor;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) factor.part[part][b] = gain[part];
    }
    multiply(field, &factor);
}

static arrival arrival_of(const path_nodes* s, int i, double through, const environment* env, response* field, int* fielded)
{
    const arrivals* a = s->node + VECTOR(i);
    const int lane = LANE(i);
    __global const view* edge = s->seen;
    const triple from = place_by_edge(edge->source_turn, edge->source_shift, cubic(a->knot[lane], OF_NODE(a->u, lane)));
    const triple to = triple_of(&RECEIVER_AT(s, i).ear.position, lane);
    double place;
    *fielded = 1;
    const double length = edge_field(env, &s->tables, edge, s->slot, from, to, OF_NODE(a->mach_factor, lane), &place, field);
    if (edge->span[0] > 0.0) {
        const double late = OF_NODE(RECEIVER_AT(s, i).clock_error, lane);
        fade(edge, s->start + (s->ready * GROUP + i - 1) * s->block_time + late, through, field);
    }
    const arrival here = {(float)through, (float)length, OF_NODE(a->mach_factor, lane),
                          into_room(edge->source_turn, towards_edge(from, place)),
                          times(-1.0, into_room(edge->receiver_turn, towards_edge(to, place))), a->knot[lane], OF_NODE(a->u, lane)};
    return here;
}
#endif
