// Where things are that are neither source nor receiver, and how they are turned, as cubics between knots. Those of scatterers
// stand at even distances and wherever a motion has a corner: twin of `pose_knots` in paths/cubics.py. Those of mirrors
// stand at even distances only, one in each cell: nodes/legs/moving.h.

typedef struct {
    __global const double* knots;  // rows, as wide as the kind of paths says
    __global const int* cells;     // [things][count + 1]: the knot at the beginning of every cell; of scatterers
    int count;
    double first, rate;            // time of the first cell, s, and cells per second
} pose_table;

#if VERTEX >= SCATTERER
// Things at nodes side by side. Of a knot POSE_COLUMNS are given: its time, s, knots per second until the next one, and cubics
// of the position and of two axes.
typedef struct {
    triples place, velocity, axes[3], turning[3];  // turning: by how much the axes change in a second
} pose;

static triples across(triples a, triples b)
{
    const triples out = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    return out;
}
static triples plus(triples a, triples b)
{
    const triples out = {a.x + b.x, a.y + b.y, a.z + b.z};
    return out;
}
static triples scaled(reals by, triples a)
{
    const triples out = {by * a.x, by * a.y, by * a.z};
    return out;
}

// Where a thing is at times of nodes, and, if it is `turned`, how.
static pose pose_at(const pose_table* table, int thing, int turned, reals time)
{
    __global const int* cells = table->cells + (long)thing * (table->count + 1);
    __global const double* c[NODES_AT_ONCE];
    double at[NODES_AT_ONCE], rates[NODES_AT_ONCE];
#pragma unroll
    for (int i = 0; i < NODES_AT_ONCE; i++) {
        const double now = OF_NODE(time, i);
        int cell = (int)((now - table->first) * table->rate);
        cell = cell < 0 ? 0 : cell < table->count ? cell : table->count - 1;
        int knot = cells[cell];
        const int next = cells[cell + 1];
        while (knot + 1 < next && now >= table->knots[(knot + 1) * (long)POSE_COLUMNS]) knot++;
        c[i] = table->knots + knot * (long)POSE_COLUMNS;
        rates[i] = c[i][1];
        const double u = (now - c[i][0]) * rates[i];
        at[i] = u < 0.0 ? 0.0 : u < 1.0 ? u : 1.0;
        c[i] += 2;
    }
    const reals u = SIDE_BY_SIDE(at, ), rate = SIDE_BY_SIDE(rates, );
    pose out;
    out.place = cubics(c, u);
    out.velocity = scaled(rate, cubic_rates(c, u));
    if (!turned) return out;
#pragma unroll
    for (int axis = 0; axis < 2; axis++) {
#pragma unroll
        for (int i = 0; i < NODES_AT_ONCE; i++) c[i] += CUBIC_COLUMNS;
        out.axes[axis] = cubics(c, u);
        out.turning[axis] = scaled(rate, cubic_rates(c, u));
    }
    out.axes[2] = across(out.axes[0], out.axes[1]);
    out.turning[2] = plus(across(out.turning[0], out.axes[1]), across(out.axes[0], out.turning[1]));
    return out;
}
#endif
