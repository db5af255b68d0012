// The fractional delay as a Farrow bank: Horner's scheme in mu over the branch signals; `first_row` says where those of
// each function of frequency begin. Where signals pause, each path takes all functions one after the other, and a jump to
// code for as many rows costs less than a loop; else a single function is summed over many paths, and on CPUs a loop takes
// no longer, and less time to build. GPUs, which wait for what they read, have rows one after the other in code.

// Add one path's share of one function to every channel; `branches` points at the subblock's first sample in the first
// of its `rows` rows, and `first` is the first of its gains.
static void add_function(__global const float* branches, int stride, const int rows, const vec* sample, const vec* mu,
                         const EXPANDED batch* paths, int p, int first, int worker, vec sum[CHANNELS][VECTORS])
{
    __global const float* row = branches + (rows - 1) * (long)stride;
    vec value[VECTORS];
#pragma unroll
    for (int j = 0; j < VECTORS; j++) value[j] = LOAD(row + (worker * VECTORS + j) * LANES);
    for (int q = 1; q < rows; q++) {
        row -= stride;
#pragma unroll
        for (int j = 0; j < VECTORS; j++) value[j] = value[j] * mu[j] + LOAD(row + (worker * VECTORS + j) * LANES);
    }
    for (int c = 0; c < CHANNELS; c++) {
        const float gain = paths->gain[first + c][p], slope = paths->slope[first + c][p];
#if FINE
        const float bend = paths->bend[first + c][p], flex = paths->flex[first + c][p];
#endif
#pragma unroll
        for (int j = 0; j < VECTORS; j++) {
#if FINE
            sum[c][j] += (((sample[j] * flex + bend) * sample[j] + slope) * sample[j] + gain) * value[j];
#else
            sum[c][j] += (sample[j] * slope + gain) * value[j];
#endif
        }
    }
}

// Add one of the expanded paths; `branches` points at the subblock's first sample in the first row of all.
static void add_path(__global const float* branches, int stride, __global const int* first_row, int functions,
                     const EXPANDED batch* paths, int p, int worker, vec sum[FUNCTIONS][VECTORS])
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
#define ADD(k, rows) add_function(row + first_row[k] * (long)stride, stride, rows, sample, mu, paths, p, (k) * CHANNELS, \
                                  worker, sum + (k) * CHANNELS)
#if SPARSE || LANES == 1
    for (int k = 0; k < functions; k++) {
        switch (first_row[k + 1] - first_row[k]) {
        case 2: ADD(k, 2); break;
        case 3: ADD(k, 3); break;
        case 4: ADD(k, 4); break;
        case 5: ADD(k, 5); break;
        case 6: ADD(k, 6); break;
        case 7: ADD(k, 7); break;
        case 8: ADD(k, 8); break;
        default: ADD(k, first_row[k + 1] - first_row[k]);
        }
    }
#else
    ADD(0, first_row[1] - first_row[0]);
#endif
}

#if CHANNELS > 1 && LANES == 8 && VECTORS == 4 && !SPARSE && !FINE
#define MANY_CHANNELS 1
#define WIDE 2  // vectors of 16 samples in a subblock
typedef float16 wide;
typedef float16 __attribute__((aligned(4))) loose_wide;  // may start at any float

// One product and sum; vectors as arguments let compilers use registers as wide as these.
static wide plus(wide sum, float factor, wide value) { return sum + factor * value; }

// Add a batch of paths to channels from c to c + `count`, whose sums stay in registers; `value` and `tilted` are the paths' signals,
// and the same times the sample.
static void add_channels(const wide value[BATCH][WIDE], const wide tilted[BATCH][WIDE], const batch* paths, int c, const int count,
                         vec sum[CHANNELS][VECTORS])
{
    wide total[4][WIDE];
#pragma unroll
    for (int k = 0; k < count; k++) total[k][0] = total[k][1] = 0.0f;
    for (int p = 0; p < BATCH; p++) {
#pragma unroll
        for (int k = 0; k < count; k++) {
            const float gain = paths->gain[c + k][p], slope = paths->slope[c + k][p];
#pragma unroll
            for (int j = 0; j < WIDE; j++) total[k][j] = plus(plus(total[k][j], gain, value[p][j]), slope, tilted[p][j]);
        }
    }
#pragma unroll
    for (int k = 0; k < count; k++) {
        loose_wide* at = (loose_wide*)sum[c + k];
        at[0] += total[k][0];
        at[1] += total[k][1];
    }
}

// Add a batch of expanded paths; `branches` points at the subblock's first sample in the first of `rows` rows.
static void add_paths(__global const float* branches, int stride, const int rows, const batch* paths, vec sum[CHANNELS][VECTORS])
{
    wide value[BATCH][WIDE], tilted[BATCH][WIDE];
    for (int p = 0; p < BATCH; p++) {
#pragma unroll
        for (int j = 0; j < WIDE; j++) {
            wide sample;
            sample.lo = RAMP + (16.0f * j - 0.5f * (SUBBLOCK - 1));
            sample.hi = sample.lo + 8.0f;
            const wide mu = (sample * paths->curve[p] + paths->rate[p]) * sample + paths->fraction[p];
            __global const float* row = branches + PLACE(-paths->whole[p], stride) + 16 * j + (rows - 1) * (long)stride;
            wide sound = *(__global const loose_wide*)row;
            for (int q = 1; q < rows; q++) {
                row -= stride;
                sound = sound * mu + *(__global const loose_wide*)row;
            }
            value[p][j] = sound;
            tilted[p][j] = sample * sound;
        }
    }
    int c = 0;
    for (; c + 4 <= CHANNELS; c += 4) add_channels(value, tilted, paths, c, 4, sum);
    for (; c < CHANNELS; c++) add_channels(value, tilted, paths, c, 1, sum);
}
#else
#define MANY_CHANNELS 0
#endif
