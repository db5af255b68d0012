// Delays and states over a segment, predicted from the coarse ones at four ends of segments.

// Hermite's polynomial of degree 7 through four neighbouring nodes, at t = -3, -1, 1 and 3. Even and odd parts are solved
// by themselves.

// Write eight coefficients, lowest power first, for values and slopes at the nodes.
static void septic(const double* value, const double* slope, double* c)
{
    const double s1 = 0.5 * (value[2] + value[1]), s3 = 0.5 * (value[3] + value[0]);
    const double d1 = 0.5 * (value[2] - value[1]), d3 = 0.5 * (value[3] - value[0]);
    const double t1 = 0.5 * (slope[2] - slope[1]), t3 = 0.5 * (slope[3] - slope[0]);
    const double u1 = 0.5 * (slope[2] + slope[1]), u3 = 0.5 * (slope[3] + slope[0]);
    c[0] = (243.0 * s1 + 13.0 * s3 - 162.0 * t1 - 6.0 * t3) / 256.0;
    c[1] = (405.0 * d1 + 5.0 * d3 - 162.0 * u1 - 2.0 * u3) / 256.0;
    c[2] = (27.0 * (s1 - s3) + 198.0 * t1) / 256.0 + 19.0 / 384.0 * t3;
    c[3] = (198.0 * u1 - 171.0 * d1) / 256.0 - 281.0 / 6912.0 * d3 + 19.0 / 1152.0 * u3;
    c[4] = (15.0 * (s3 - s1) - 38.0 * t1) / 256.0 - 11.0 / 384.0 * t3;
    c[5] = (23.0 * d1 - 38.0 * u1) / 256.0 + 157.0 / 6912.0 * d3 - 11.0 / 1152.0 * u3;
    c[6] = (s1 - s3 + 2.0 * t1) / 256.0 + t3 / 384.0;
    c[7] = (2.0 * u1 - d1) / 256.0 - 11.0 / 6912.0 * d3 + u3 / 1152.0;
}

// Delays over a segment as a septic on [-1, 1], from `coarse` ones (see coarse_delays.cl) at both of its ends and one beside
// each, which are written to `ends`.
static void predict(__global const double* coarse, long slots, double segment_time, double* ends, double* predicted)
{
    double slopes[4];
    for (int i = 0; i < 4; i++) {
        ends[i] = coarse[2 * i * slots];
        slopes[i] = coarse[(2 * i + 1) * slots] * (0.5 * segment_time);
    }
    septic(ends, slopes, predicted);
}

#if STATE_NUMBERS
// Predict another number, `apart` from one end of segments to the next: a cubic on [-1, 1] between the middle ones, as above.
static void predict_cubic(__global const double* coarse, long apart, double* c)
{
    const double v0 = coarse[0], v1 = coarse[apart], v2 = coarse[2 * apart], v3 = coarse[3 * apart];
    const double s1 = 0.5 * (v2 + v1), s3 = 0.5 * (v3 + v0), d1 = 0.5 * (v2 - v1), d3 = 0.5 * (v3 - v0);
    c[0] = (9.0 * s1 - s3) / 8.0;
    c[1] = (27.0 * d1 - d3) / 24.0;
    c[2] = (s3 - s1) / 8.0;
    c[3] = (d3 - 3.0 * d1) / 24.0;
}
static reals by_cubic(const double* c, reals u) { return c[0] + u * (c[1] + u * (c[2] + u * c[3])); }
#endif

#if VERTEX == SCATTERER
// From the state at four ends of segments: a septic of the delay behind the scatterer, and cubics of the weight and of the specular
// point, on [-1, 1].
static void predict_state(__global const double* coarse, long slots, double segment_time, double* expected)
{
    double late[4], slopes[4];
    for (int i = 0; i < 4; i++) {
        late[i] = coarse[STATE_NUMBERS * i * slots];
        slopes[i] = coarse[(STATE_NUMBERS * i + 1) * slots] * (0.5 * segment_time);
    }
    septic(late, slopes, expected);
    for (int k = 2; k < STATE_NUMBERS; k++) predict_cubic(coarse + k * slots, STATE_NUMBERS * slots, expected + 8 + 4 * (k - 2));
}

static void expected_state(const double* expected, reals u, scatterer_state* b)
{
    reals late = expected[7];
#pragma unroll
    for (int k = 6; k >= 0; k--) late = late * u + expected[k];
    b->onward = late;
    b->weight = by_cubic(expected + 8, u);
    const triples specular = {by_cubic(expected + 12, u), by_cubic(expected + 16, u), by_cubic(expected + 20, u)};
    b->specular = specular;
}
#elif LEG == MOVING
// Events that are expected within a segment from those at four ends of segments.
static void predict_state(__global const double* coarse, long slots, double segment_time, double* expected)
{
    for (int k = 0; k < STATE_NUMBERS; k++) predict_cubic(coarse + k * slots, STATE_NUMBERS * slots, expected + 4 * k);
}
static void expected_state(const double* expected, reals u, mirror_state* b)
{
    for (int k = 0; k < MIRRORS; k++, expected += 16) {
        b->about.time[k] = by_cubic(expected, u);
        b->about.place[k].x = by_cubic(expected + 4, u);
        b->about.place[k].y = by_cubic(expected + 8, u);
        b->about.place[k].z = by_cubic(expected + 12, u);
    }
}
#endif
