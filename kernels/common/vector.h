// Vectors of LANES floats: explicit on CPUs, one lane per work-item on GPUs (LANES == 1).
// Only operators and casts: some runtimes call, rather than inline, built-in functions on vectors.

#if LANES == 16
typedef float16 vec;
typedef float16 __attribute__((aligned(4))) loose_vec;  // may start at any float
typedef int16 ivec;
typedef int16 __attribute__((aligned(4))) loose_ivec;
#define AS_IVEC(x) as_int16(x)
#define AS_VEC(x) as_float16(x)
#define RAMP ((vec)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f, 8.0f, 9.0f, 10.0f, 11.0f, 12.0f, 13.0f, 14.0f, 15.0f))
#elif LANES == 8
typedef float8 vec;
typedef float8 __attribute__((aligned(4))) loose_vec;  // may start at any float
typedef int8 ivec;
typedef int8 __attribute__((aligned(4))) loose_ivec;
#define AS_IVEC(x) as_int8(x)
#define AS_VEC(x) as_float8(x)
#define RAMP ((vec)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f))
#elif LANES == 1
typedef float vec;
typedef float loose_vec;
typedef int ivec;
typedef int loose_ivec;
#define AS_IVEC(x) as_int(x)
#define AS_VEC(x) as_float(x)
#define RAMP 0.0f
#endif

#define LOAD(pointer) (*(__global const loose_vec*)(pointer))

// The nearest whole number, see rounding.h.
static ivec nearest(vec x) { return AS_IVEC(x + ROUNDING) - ROUNDING_BITS; }
static vec rounded(vec x) { return (x + ROUNDING) - ROUNDING; }
