// What fields at edges, along capsules and of spheres are made of: tables, and the transition function of
// acoustics/diffraction.py by one.

typedef struct {
    __global const bins* transition;  // [CELLS][4][PARTS][BIN_VECTORS] over middle / (middle + root)
    __global const bins* faces;       // [slots][2][PARTS][BIN_VECTORS], of edges: where they are the same at every angle
    __global const bins* waves;       // [BIN_VECTORS], waves in a metre
    double middle;                    // root of a detour, m^(1/2)
    __global const double* modes;     // of spheres, see sphere_field.h
} vertex_tables;

#if TWO_SIDED
// A weight times the transition function of the root of a detour, m^(1/2); beyond a boundary the root is below 0.
static void transition_of(const vertex_tables* t, double root, float weight, response* r)
{
    const double size = root < 0.0 ? -root : root;
    for (int b = 0; b < BIN_VECTORS; b++) {
        r->part[PARTS - 1][b] = 0.0f;
        r->part[0][b] = weight;
    }
    apply_cubics(t->transition, (float)(t->middle / (t->middle + size)), r);
#if PARTS == 2  // all responses have phases where there are edges
    if (root >= 0.0) return;
    response beyond;
    for (int b = 0; b < BIN_VECTORS; b++) {
        beyond.part[0][b] = 2.0f * weight;
        beyond.part[1][b] = 0.0f;
        turn(&beyond, b, t->waves[b] * (float)(root * root));
        for (int part = 0; part < PARTS; part++) r->part[part][b] = beyond.part[part][b] - r->part[part][b];
    }
#endif
}
#endif
