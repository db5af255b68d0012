// Numbers in float64 of NODES_AT_ONCE nodes side by side: 4, or a single one.

#if NODES_AT_ONCE == 4
typedef double4 reals;
typedef long4 choices;
#define SIDE_BY_SIDE(of, what) ((reals)(of[0] what, of[1] what, of[2] what, of[3] what))
#define ANY(choices) (choices.s0 | choices.s1 | choices.s2 | choices.s3)
#define OF_NODE_LONG(choices, i) (((const long*)&choices)[i])
#else
typedef double reals;
typedef int choices;
#define SIDE_BY_SIDE(of, what) (of[0] what)
#define ANY(choices) (choices)
#define OF_NODE_LONG(choices, i) (choices)
#endif
#define OF_NODE(reals, i) (((const double*)&reals)[i])

typedef struct {
    reals x, y, z;
} triples;

#define DOT(a, b) (a.x * b.x + a.y * b.y + a.z * b.z)

// 1 / sqrt(x), by operators only where there are several: from the exponent's half, each step squares the error.
static reals inverse_root(reals x)
{
#if NODES_AT_ONCE == 4
    reals y = as_double4(0x5fe6eb50c7b537a9 - (as_long4(x) >> 1));
#pragma unroll
    for (int i = 0; i < 4; i++) y = y * (1.5 - 0.5 * x * y * y);
    return y;
#else
    return 1.0 / sqrt(x);
#endif
}
