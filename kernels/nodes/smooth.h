// Gains that change slowly: those of CELL_BLOCKS blocks from the nodes between such cells, by the polynomial of degree 4
// through five of them. Cells lie in stretches of STRETCH blocks of a segment and take nodes of their own stretch only, so
// that it does not matter which others are solved.

#if DELAY_TERMS == 4
#define CELL_BLOCKS 4  // as many as there are nodes in a GROUP: the second one of each stands between two cells
#define STRETCH 24
#define CELLS_EACH (STRETCH / CELL_BLOCKS)
#define AMONG 5

typedef struct {
    int stretch, made;                  // which one, and what of it: groups of nodes, by bits
    double delay[STRETCH + CELL_BLOCKS], rate[STRETCH + CELL_BLOCKS];
    gains gain[CELLS_EACH + 1][GAIN_VECTORS];
    float strength[CELLS_EACH + 1], residual[CELLS_EACH + 1];
    int cell, smooth;                   // of the segment, and whether that cell's polynomials hold
    gains power[AMONG][GAIN_VECTORS];   // of the place in the cell from its middle, in lengths of it
    float loudest, largest_residual;           // strength at the cell's louder end, and most of what no function represents
    float error;                        // squared, of the gains, as in block.h
} smooth_gains;

// Solve a group of nodes of the stretch, if it is not, with the gains between cells.
static void make_group(smooth_gains* s, path_nodes* nodes, int group, double speed_of_sound, const environment* env)
{
    if (s->made >> group & 1) return;
    s->made |= 1 << group;
    solve_group(nodes, s->stretch * CELLS_EACH + group);
#pragma unroll
    for (int i = 0; i < GROUP; i++) {
        s->delay[group * GROUP + i] = delay_of_node(nodes, i);
        s->rate[group * GROUP + i] = rate_of_node(nodes, i);
    }
    s->strength[group] = gains_of_node(nodes, 1, speed_of_sound, env, s->gain[group], s->residual + group);
}

// Whether the delay in a cell's middle is what those of the nodes between cells say: gains follow what delays follow.
static int is_as_expected(const smooth_gains* s, int from, int cell, float largest)
{
    double d[AMONG];
#pragma unroll
    for (int i = 0; i < AMONG; i++) d[i] = s->delay[(from + i) * GROUP + 1];
#pragma unroll
    for (int order = 1; order < AMONG; order++) {
#pragma unroll
        for (int i = AMONG - 1; i >= order; i--) d[i] -= d[i - 1];
    }
    const double place = cell - from + 0.5, now = s->delay[cell * GROUP + 1 + CELL_BLOCKS / 2];
    double expected = d[AMONG - 1];
#pragma unroll
    for (int i = AMONG - 2; i >= 0; i--) expected = d[i] + (place - i) * (1.0 / (i + 1)) * expected;
    const float wrong = (float)(now - expected), delay = (float)now;
    return wrong * wrong <= largest * delay * delay;
}

// Make the polynomials of a cell of the segment; whether their error, squared and relative to the strength, is small enough.
static int make_cell(smooth_gains* s, path_nodes* nodes, int at, float largest, double speed_of_sound,
                     const environment* env)
{
    if (at == s->cell) return s->smooth;
    s->cell = at;
    const int stretch = at / CELLS_EACH, cell = at % CELLS_EACH;
    if (stretch != s->stretch) s->made = 0;
    s->stretch = stretch;
    int from = cell - 1 < CELLS_EACH + 1 - AMONG ? cell - 1 : CELLS_EACH + 1 - AMONG;
    from = from < 0 ? 0 : from;
    for (int i = 0; i < AMONG; i++) make_group(s, nodes, from + i, speed_of_sound, env);
    // At the ends of the cell only: farther nodes may lie where the path is not active.
    s->loudest = s->strength[cell] > s->strength[cell + 1] ? s->strength[cell] : s->strength[cell + 1];
    s->largest_residual = s->residual[cell] > s->residual[cell + 1] ? s->residual[cell] : s->residual[cell + 1];
    gains change = 0.0f;
    const float place = (float)(cell - from) + 0.5f;
    for (int v = 0; v < GAIN_VECTORS; v++) {
        gains d[AMONG], p[AMONG];
#pragma unroll
        for (int i = 0; i < AMONG; i++) d[i] = s->gain[from + i][v];
#pragma unroll
        for (int order = 1; order < AMONG; order++) {
#pragma unroll
            for (int i = AMONG - 1; i >= order; i--) d[i] -= d[i - 1];
        }
        const gains wrong = SMOOTH_ERROR * d[AMONG - 1] * env->sizes[v];
        change += wrong * wrong;
        // Newton's d0 + s (d1 + (s - 1)/2 (d2 + ...)), from the inside out, in powers of the place from the middle.
        p[0] = d[AMONG - 1];
#pragma unroll
        for (int i = AMONG - 2; i >= 0; i--) {
            const float more = 1.0f / (float)(i + 1), here = (place - (float)i) * more;
            p[AMONG - 1 - i] = more * p[AMONG - 2 - i];
#pragma unroll
            for (int m = AMONG - 2 - i; m >= 1; m--) p[m] = here * p[m] + more * p[m - 1];
            p[0] = here * p[0] + d[i];
        }
#pragma unroll
        for (int m = 0; m < AMONG; m++) s->power[m][v] = p[m];
    }
    s->error = sum_of(change);
    s->smooth = s->error <= largest * s->loudest && is_as_expected(s, from, cell, largest);
    return s->smooth;
}

// The gains' powers in the i-th block of the cell.
static void gains_in_cell(const smooth_gains* s, int i, gains terms[4][GAIN_VECTORS])
{
    const float reach = 0.5f / CELL_BLOCKS, y = ((float)i + 0.5f) * (2.0f * reach) - 0.5f;
#pragma unroll
    for (int v = 0; v < GAIN_VECTORS; v++) {
        const gains p1 = s->power[1][v], p2 = s->power[2][v], p3 = s->power[3][v], p4 = s->power[4][v];
        terms[0][v] = s->power[0][v] + y * (p1 + y * (p2 + y * (p3 + y * p4)));
        terms[1][v] = reach * (p1 + y * (2.0f * p2 + y * (3.0f * p3 + y * (4.0f * p4))));
        terms[2][v] = reach * reach * (p2 + y * (3.0f * p3 + y * (6.0f * p4)));
        terms[3][v] = reach * reach * reach * (p3 + y * (4.0f * p4));
    }
}

// The same, and the block's delays; `block` counts from the segment's first.
static void terms_in_cell(const smooth_gains* s, int block, window* w, gains terms[4][GAIN_VECTORS])
{
    const int of_stretch = block - s->stretch * STRETCH;
    for (int i = 0; i < 4; i++) {
        w->delay[i] = s->delay[of_stretch + i];
        w->rate[i] = s->rate[of_stretch + i];
    }
    w->strength[1] = w->strength[3] = s->loudest;
    gains_in_cell(s, block % CELL_BLOCKS, terms);
}
#endif
