// The delay of a block as polynomial of samples less the whole ones, from nodes in float64.

// Write the delay in samples of the branches, of which a block has twice `half_block`; returns its whole part.
static int write_delay(const window* node, int apart, double rate, double half_block, double delay_samples, __global float* c)
{
#if DELAY_TERMS == 8
    return write_septic(node->delay, node->rate, rate, half_block, delay_samples, c);
#else
    const double p0 = node->delay[1] * rate + delay_samples, p1 = node->delay[2] * rate + delay_samples;
    const double e0 = node->rate[1] * half_block, e1 = node->rate[2] * half_block;
    const double centre = 0.5 * (p0 + p1) - 0.25 * (e1 - e0), whole = (centre + ROUNDING_DOUBLE) - ROUNDING_DOUBLE;
    c[0] = (float)(centre - whole);
    c[apart] = (float)(0.75 * (p1 - p0) - 0.25 * (e0 + e1));
    c[2 * apart] = (float)(0.25 * (e1 - e0));
    c[3 * apart] = (float)(0.25 * (e0 + e1) - 0.25 * (p1 - p0));
    return (int)whole;
#endif
}
