// Fields at ends of edges: the transitions of both at once, twin of acoustics/diffraction.py.

#if VERTEX == EDGE
// By how much a leg to a place `off` from the apex is longer than to it, less what cancels over both: see `end_detour`.
static double longer_leg(double r, double along, double off)
{
    const double near = sqrt(r * r + along * along), far = sqrt(r * r + (along + off) * (along + off));
    return off * (off - along * (off * (off + 2.0 * along) / (near + far)) / near) / (near + far);
}

// Root of the detour by the end of an edge, m^(1/2), below 0 beyond the boundary of its side; ends at r and z, m.
static double root_at_end(__global const edge_view* edge, double r_s, double z_s, double r_r, double z_r, double apex, double raised)
{
    const double off = edge->end - apex, longer = longer_leg(r_s, apex - z_s, off) + longer_leg(r_r, apex - z_r, off);
    const double inside = edge->end > 0.0 ? off : apex, root = sqrt(longer > 0.0 ? longer * raised : 0.0);
    return edge->end_side * (inside < 0.0 ? -root : root);
}

// A weight times `end_transition` for roots of detours by the end and by the edge of which neither is negative.
static void transition_of_both(const vertex_tables* t, double end, const response* of_end, double root, float weight, response* r)
{
    const float phi = arc_tangent((float)(root > end ? end / root : root / end));
    const float x = phi * phi * (float)(32.0 / (HALF_TURN * HALF_TURN)) - 1.0f;
    float angle[END_TERMS] = {weight * phi, weight * phi * x};
#pragma unroll
    for (int m = 2; m < END_TERMS; m++) angle[m] = 2.0f * x * angle[m - 1] - angle[m - 2];
    const float at = (float)(t->middle / (t->middle + sqrt(end * end + root * root))) * END_CELLS;
    const int cell = (int)at < END_CELLS ? (int)at : END_CELLS - 1;
    const float u = at - (float)cell;
    __global const bins* c = t->transition + (CELLS + cell * END_TERMS) * 4 * PARTS * BIN_VECTORS;
    response found;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) {
            bins sum = 0.0f;
#pragma unroll
            for (int power = 3; power >= 0; power--) {
                sum *= u;
#pragma unroll
                for (int m = 0; m < END_TERMS; m++) sum += angle[m] * c[((power * PARTS + part) * END_TERMS + m) * BIN_VECTORS + b];
            }
            found.part[part][b] = sum;
        }
    }
    if (root <= end) {
        *r = found;
        return;
    }
    transition_of(t, root, 0.5f * weight, r);
    multiply(r, of_end);
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) r->part[part][b] -= found.part[part][b];
    }
}

// The same for roots that are negative beyond their boundaries; `of_end` is the transition function of the end's alone.
static void transition_at_end(const vertex_tables* t, double end, const response* of_end, double root, float weight, int lit, float corner,
                              response* r)
{
    const double beyond = end < 0.0 ? -end : end;
    if (end * end + root * root < AT_CORNER * AT_CORNER) {
        transition_of_both(t, AT_CORNER * cos((double)corner), of_end, AT_CORNER * sin((double)corner), weight, r);
        return;
    }
    transition_of_both(t, beyond, of_end, root < 0.0 ? -root : root, root < 0.0 ? -weight : weight, r);
#if PARTS == 2
    if (end >= 0.0) return;
    response edge;
    transition_of(t, root, weight, &edge);
    for (int b = 0; b < BIN_VECTORS; b++) {
        if (lit == BOTH || lit == -BOTH) {  // half of either way round the boundary
            response once;
            once.part[0][b] = weight;
            once.part[1][b] = 0.0f;
            turn(&once, b, t->waves[b] * (float)(root * root));
            for (int part = 0; part < PARTS; part++) edge.part[part][b] -= once.part[part][b];
        }
        turn(&edge, b, t->waves[b] * (float)(end * end));
        for (int part = 0; part < PARTS; part++) r->part[part][b] = edge.part[part][b] - r->part[part][b];
    }
#endif
}
#endif
