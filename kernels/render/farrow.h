// The fractional delay as a Farrow bank: Horner's scheme in mu over the branch signals. What the runtime gives as
// EACH_FUNCTION is ADD(0, rows) ADD(1, rows) ..., with the number of branches of every function of frequency.

// Add one path's share of one function; `branches` points at the subblock's first sample in the first of its `rows` rows.
static void add_function(__global const float* branches, int stride, const int rows, const vec* sample, const vec* mu,
                         float gain, float slope, float bend, float flex, int worker, vec* sum)
{
    __global const float* row = branches + (rows - 1) * (long)stride;
    vec value[VECTORS];
#pragma unroll
    for (int j = 0; j < VECTORS; j++) value[j] = LOAD(row + (worker * VECTORS + j) * LANES);
#pragma unroll
    for (int q = 1; q < MOST_ROWS; q++) {  // with a bound that is known before functions are put into one another
        if (q >= rows) break;
        row -= stride;
#pragma unroll
        for (int j = 0; j < VECTORS; j++) value[j] = value[j] * mu[j] + LOAD(row + (worker * VECTORS + j) * LANES);
    }
#pragma unroll
    for (int j = 0; j < VECTORS; j++) {
#if FINE
        sum[j] += (((sample[j] * flex + bend) * sample[j] + slope) * sample[j] + gain) * value[j];
#else
        sum[j] += (sample[j] * slope + gain) * value[j];
#endif
    }
}

// Add one of the expanded paths; `branches` points at the subblock's first sample in the first row of the first function.
static void add_path(__global const float* branches, int stride, const EXPANDED batch* paths, int p, int worker,
                     vec sum[FUNCTIONS][VECTORS])
{
    vec sample[VECTORS], mu[VECTORS];
#pragma unroll
    for (int j = 0; j < VECTORS; j++) {
        sample[j] = RAMP + ((float)((worker * VECTORS + j) * LANES) - 0.5f * (SUBBLOCK - 1));
#if FINE
        mu[j] = ((sample[j] * paths->twist[p] + paths->curve[p]) * sample[j] + paths->rate[p]) * sample[j] +
                paths->fraction[p];
#else
        mu[j] = (sample[j] * paths->curve[p] + paths->rate[p]) * sample[j] + paths->fraction[p];
#endif
    }
    __global const float* row = branches + PLACE(-paths->whole[p], stride);
#if FINE
#define GAIN(k) paths->gain[k][p], paths->slope[k][p], paths->bend[k][p], paths->flex[k][p]
#else
#define GAIN(k) paths->gain[k][p], paths->slope[k][p], 0.0f, 0.0f
#endif
#define ADD(k, rows)                                                            \
    add_function(row, stride, rows, sample, mu, GAIN(k), worker, sum[k]); \
    row += rows * (long)stride;
    EACH_FUNCTION
#undef ADD
}
