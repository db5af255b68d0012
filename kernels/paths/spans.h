// Certified subdivision of time, from where the last launch stopped. A span is taken from the stack and its middle
// evaluated: if the clearance exceeds what the ends can move within the span, the span is done; else the part that the
// clearance covers is, and the rests on both sides go back on the stack. Spans come off it in the order of time.

typedef struct {
    double begin, end;
    int known, valid;  // whether the span is done, and how
} span;

typedef struct {
    double begin, end;  // of the interval that is being put together; none if begin > end
    int depth, evaluations;   // spans on the stack, and evaluations so far
    span stack[DEPTH];
} progress;

typedef struct {
    double begin, end;
    int path, unused;
} interval;

static void push(__global progress* p, double begin, double end, int known, int valid)
{
    if (!(end > begin)) return;
    const span s = {begin, end, known, valid};
    p->stack[p->depth++] = s;
}

static void put(__global progress* p, double begin, double end, int path, __global interval* found,
                __global int* count)
{
    if (begin == p->end) {
        p->end = end;
        return;
    }
    if (p->begin < p->end) {
        const interval done = {p->begin, p->end, path, 0};
        found[atomic_inc(count)] = done;
    }
    p->begin = begin;
    p->end = end;
}

// Up to `budget` evaluations of a path, which `evaluate` makes.
static void subdivide(const search* s, __global progress* p, int path, double resolution, double smallest_move, double graze,
                      int budget, __global interval* found, __global int* count)
{
    int evaluations = 0;
    while (p->depth > 0 && evaluations < budget) {
        const span now = p->stack[--p->depth];
        if (now.known) {
            if (now.valid) put(p, now.begin, now.end, path, found, count);
            continue;
        }
        const double within = 0.5 * (now.end - now.begin), middle = now.begin + within;
        double clear, reach;
        const int valid = evaluate(s, middle, within, &clear, &reach);
        evaluations++;
        int done = clear > reach || 2.0 * within <= resolution || reach < smallest_move;
        if (!done && clear < graze && within <= 0.5 * GRAZE_TIME) {
            done = 1;
            for (int k = 0; k < 2 && done; k++) {
                double beside, most;
                done = evaluate(s, k ? now.end : now.begin, within, &beside, &most) == valid
                       && beside < fmin(graze, ALONG * most);
                evaluations++;
            }
        }
        if (done) {
            if (valid) put(p, now.begin, now.end, path, found, count);
            continue;
        }
        double share = CERTAIN * clear / reach;
        if (share < LEAST_SHARE || share * within < 0.5 * resolution) share = 0.0;
        const double from = middle - share * within, until = middle + share * within;
        push(p, until, now.end, 0, 0);
        push(p, from, until, 1, valid);
        push(p, now.begin, from, 0, 0);
    }
    p->evaluations += evaluations;
    if (p->depth == 0) put(p, -2.0, -3.0, path, found, count);  // gives out what was put together
}
