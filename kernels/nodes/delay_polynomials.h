// The delay of a block as polynomial of samples less the whole ones, from nodes in float64: a cubic, or with DELAY_TERMS == 8, for
// long blocks of few samples, a septic, and the error of that.

#if DELAY_TERMS == 8
// Write the delay of the block between the middle two nodes, in samples less the whole delay, which is returned.
static int write_septic(const double* delay, const double* rate, double sampling_rate, double half_block,
                        double delay_samples, int apart, __global float* c)
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
    for (int i = 1; i < 8; i++) c[i * apart] = (float)exact[i];
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

// The fourth power's coefficient of the septic, s.
static float septic_fourth(const double* delay, const double* rate, double block_time)
{
    const double inner = 0.25 * block_time * (rate[2] - rate[1]), outer = 0.25 * block_time * (rate[3] - rate[0]);
    const double values = 0.5 * (delay[0] + delay[3] - delay[1] - delay[2]);
    return (float)(15.0 / 256.0 * (values - 4.0 * inner) - 11.0 / 384.0 * (outer - 3.0 * inner));
}
#endif

// Write the delay in samples of the branches, of which a block has twice `half_block`; returns its whole part.
static int write_delay(const double* delay, const double* rates, int apart, double rate, double half_block, double delay_samples, __global float* c)
{
#if DELAY_TERMS == 8
    return write_septic(delay, rates, rate, half_block, delay_samples, apart, c);
#else
    const double p0 = delay[1] * rate + delay_samples, p1 = delay[2] * rate + delay_samples;
    const double e0 = rates[1] * half_block, e1 = rates[2] * half_block;
    const double centre = 0.5 * (p0 + p1) - 0.25 * (e1 - e0), whole = (centre + ROUNDING_DOUBLE) - ROUNDING_DOUBLE;
    c[0] = (float)(centre - whole);
    c[apart] = (float)(0.75 * (p1 - p0) - 0.25 * (e0 + e1));
    c[2 * apart] = (float)(0.25 * (e1 - e0));
    c[3 * apart] = (float)(0.25 * (e0 + e1) - 0.25 * (p1 - p0));
    return (int)whole;
#endif
}

// Write all terms of a block without sound, at a delay in samples that stands still; the delay's whole samples are returned.
static int write_silence(double centre, int functions, int apart, __global float* c)
{
    const double whole = (centre + ROUNDING_DOUBLE) - ROUNDING_DOUBLE;
    for (int i = 0; i < DELAY_TERMS + 4 * functions; i++) c[i * apart] = 0.0f;
    return (int)whole;
}
