// Gains of neighbouring functions of frequency side by side.

#if FUNCTIONS == 1
typedef float gains;
#define GAIN_VECTORS 1
static float sum_of(gains x) { return x; }
#else
typedef float8 gains;
#define GAIN_VECTORS ((FUNCTIONS + 7) / 8)
static float sum_of(gains x) { return ((x.s0 + x.s1) + (x.s2 + x.s3)) + ((x.s4 + x.s5) + (x.s6 + x.s7)); }
#endif
typedef gains __attribute__((aligned(4))) loose_gains;  // may start at any float
