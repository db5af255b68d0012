// Adding a constant and taking it away rounds to a whole number; needs strict (not fast-math) arithmetic.

#define ROUNDING 12582912.0f                 // 1.5 * 2^23, for |x| < 2^22
#define ROUNDING_BITS 0x4B400000             // of that float: those of a sum less these are the whole number
#define ROUNDING_DOUBLE 6755399441055744.0   // 1.5 * 2^52
