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

// Delays over a walk as a septic on [-1, 1], from `coarse` ones (see coarse_delays.cl) at both of its ends and one beside
// each, which are told in `ends`.
static void predict(__global const double* coarse, long slots, double walk_time, double* ends, double* predicted)
{
    double slopes[4];
    for (int i = 0; i < 4; i++) {
        ends[i] = coarse[2 * i * slots];
        slopes[i] = coarse[(2 * i + 1) * slots] * (0.5 * walk_time);
    }
    septic(ends, slopes, predicted);
}

#if MORE
// Predict another number, `apart` from one end of walks to the next: a cubic on [-1, 1] between the middle ones, as above.
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

#if DELAY_TERMS == 8
// Write the delay of the block between the middle two nodes, in samples less the whole delay, which is returned.
static int write_septic(const double* delay, const double* rate, double sampling_rate, double half_block,
                        double delay_samples, __global float* c)
{
    const double first = delay[1] * sampling_rate + delay_samples, whole = (first + ROUNDING_DOUBLE) - ROUNDING_DOUBLE;
    double p[4], e[4], exact[8];
    for (int i = 0; i < 4; i++) {
        p[i] = delay[i] * sampling_rate + delay_samples - whole;
        e[i] = rate[i] * half_block;
    }
    septic(p, e, exact);
    const double more = (exact[0] + ROUNDING_DOUBLE) - ROUNDING_DOUBLE;  // whole samples from the block's start to its middle
    c[0] = (float)(exact[0] - more);
    for (int i = 1; i < 8; i++) c[i] = (float)exact[i];
    return (int)(whole + more);
}

// Error of the delay at the block's middle, s: by how much the quintic through the middle nodes and all four rates
// differs, times how much better it is than the cubic, where it is; motion without higher derivatives gains nothing.
static float septic_error(const double* delay, const double* rate, double block_time)
{
    const double e0 = rate[0] * (0.5 * block_time), e1 = rate[1] * (0.5 * block_time);
    const double e2 = rate[2] * (0.5 * block_time), e3 = rate[3] * (0.5 * block_time);
    const double third = (e3 - e0 + 3.0 * (e1 - e2)) / 192.0;
    const double quintic = 0.5 * (delay[1] + delay[2]) + 17.0 / 64.0 * (e1 - e2) - (e0 - e3) / 192.0;
    const double centre = (243.0 * (delay[1] + delay[2]) + 13.0 * (delay[0] + delay[3]) - 162.0 * (e2 - e1) -
                           6.0 * (e3 - e0)) / 512.0;
    const double rest = centre - quintic, ratio = rest * rest / (third * third + 1e-40);
    return (float)(ratio < 1.0 ? rest * sqrt(ratio) : rest);
}
#endif
