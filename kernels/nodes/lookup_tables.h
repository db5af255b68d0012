// Walls and directivities as tables: cubics over an angle, B-splines over a sphere. lookup_tables.py makes them.

// Multiply by cubics of a cell at a place from 0 to 1 in it.
static void apply_cubic(__global const bins* c, float u, response* r)
{
    response factor;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++, c++) {
            factor.part[part][b] =
                c[0] + u * (c[PARTS * BIN_VECTORS] + u * (c[2 * PARTS * BIN_VECTORS] + u * c[3 * PARTS * BIN_VECTORS]));
        }
    }
    multiply(r, &factor);
}

// Multiply by cubics on CELLS equal cells of a place from 0 to 1.
static void apply_cubics(__global const bins* cells, float place, response* r)
{
    const float at = place * CELLS;
    int cell = (int)at;
    cell = cell < 0 ? 0 : cell < CELLS ? cell : CELLS - 1;
    apply_cubic(cells + cell * 4 * PARTS * BIN_VECTORS, at - (float)cell, r);
}

// Multiply by a cubic B-spline on the faces of a cube about the transducer, SIDE points along each, two beyond an edge.
static void apply_sphere(__global const bins* points, float x, float y, float z, response* r)
{
    const float ax = x < 0.0f ? -x : x, ay = y < 0.0f ? -y : y, az = z < 0.0f ? -z : z;
    const int axis = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
    const float along = axis == 0 ? x : axis == 1 ? y : z, scale = 1.0f / (along < 0.0f ? -along : along);
    const float p = (axis == 0 ? y : axis == 1 ? z : x) * scale, q = (axis == 0 ? z : axis == 1 ? x : y) * scale;
    const float cells = 0.5f * FACE_CELLS, at_p = (p + 1.0f) * cells, at_q = (q + 1.0f) * cells;
    int i = (int)at_p, j = (int)at_q;
    i = i < FACE_CELLS - 1 ? i : FACE_CELLS - 1;
    j = j < FACE_CELLS - 1 ? j : FACE_CELLS - 1;
    const float u[2] = {at_p - (float)i, at_q - (float)j};
    float weight[2][4];
    for (int d = 0; d < 2; d++) {
        const float t = u[d], s = 1.0f - t;
        weight[d][0] = s * s * s / 6.0f;
        weight[d][1] = (4.0f - 3.0f * t * t * (1.0f + s)) / 6.0f;
        weight[d][2] = (4.0f - 3.0f * s * s * (1.0f + t)) / 6.0f;
        weight[d][3] = t * t * t / 6.0f;
    }
    __global const bins* corner =
        points + (((long)(2 * axis + (along < 0.0f)) * SIDE + i + 1) * SIDE + j + 1) * PARTS * BIN_VECTORS;
    response factor;
    for (int part = 0; part < PARTS; part++) {
        for (int b = 0; b < BIN_VECTORS; b++) factor.part[part][b] = 0.0f;
    }
    for (int m = 0; m < 4; m++) {
        for (int n = 0; n < 4; n++) {
            const float share = weight[0][m] * weight[1][n];
            __global const bins* c = corner + (m * SIDE + n) * PARTS * BIN_VECTORS;
            for (int part = 0; part < PARTS; part++) {
                for (int b = 0; b < BIN_VECTORS; b++, c++) factor.part[part][b] += share * c[0];
            }
        }
    }
    multiply(r, &factor);
}
