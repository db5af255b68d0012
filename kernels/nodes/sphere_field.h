// The field of rigid spheres, by tables over the angle of scattering that stand behind that of the transition function: twin
// of `sphere_strength` and `sphere_field` in acoustics/scattering.py.

#if SCATTERERS && PARTS == 2
// The field over the strength, which is returned, m. The place is that of the glint, or between the ends.
static double sphere_field(const edge_tables* t, const glint_of* g, triples place, int first_cell, int cells, int beside,
                           response* field)
{
    const triples both = plus(of_length_one(g->source), of_length_one(g->receiver));
    const triples to = apart(place, g->source), back = apart(place, g->receiver);
    const reals near = inverse_root(DOT(to, to)) + inverse_root(DOT(back, back)), cosines = 0.5 * root(DOT(both, both));
    const double radius = OF_NODE(g->scale.x, beside), cosine = OF_NODE(cosines, beside);
    const double at = 2.0 * asin(cosine < 1.0 ? cosine : 1.0) / HALF_TURN * cells;
    int cell = (int)at;
    cell = cell < cells ? cell : cells - 1;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) field->part[part][b] = part ? 0.0f : 1.0f;
    }
    apply_cubic(t->transition + (CELLS + first_cell + cell) * (long)(4 * PARTS * BIN_VECTORS), (float)(at - cell), field);
    return 0.5 * radius / (1.0 + 0.5 * radius * cosine * OF_NODE(near, beside));
}
#endif
