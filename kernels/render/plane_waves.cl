// What listeners that move among streams hear of them: each stream is read ahead of the clock by as much as its wave
// reaches the listener earlier, between its samples by filters whose taps are polynomials of the distance to the nearest
// one. Work-item: dimension 0 counts LANES samples, dimension 1 listeners.

// Values beyond LANES samples, each by as much as `rest` says.
static vec passing(__global const float* sample, __global const float* bank, vec rest)
{
    vec part[POWERS];
#pragma unroll
    for (int q = 0; q < POWERS; q++) part[q] = 0.0f;
    for (int t = 0; t < TAPS; t++) {
        const vec x = LOAD(sample + t);
#pragma unroll
        for (int q = 0; q < POWERS; q++) part[q] += bank[q * TAPS + t] * x;
    }
    vec value = part[POWERS - 1];
#pragma unroll
    for (int q = POWERS - 2; q >= 0; q--) value = value * rest + part[q];
    return value;
}

// The same where all are beyond their sample by as much: they share their taps.
static vec at_rest(__global const float* sample, __global const float* bank, float rest)
{
    float taps[TAPS + LANES];
    for (int t = 0; t < TAPS; t += LANES) {
        vec tap = LOAD(bank + (POWERS - 1) * TAPS + t);
#pragma unroll
        for (int q = POWERS - 2; q >= 0; q--) tap = tap * rest + LOAD(bank + q * TAPS + t);
        *(loose_vec*)(taps + t) = tap;
    }
    vec value = 0.0f;
    for (int t = 0; t < TAPS; t++) value += taps[t] * LOAD(sample + t);
    return value;
}

__kernel void plane_waves(__global const float* streams,  // [total][stride]
                          int count, int total,           // streams of a listener, in turn, and of all
                          int stride,
                          int lead,                       // of `streams`, at the first node
                          __global const int* whole,      // [listeners][nodes][count], samples ahead
                          __global const float4* motion,  // likewise: the rest of them and its slope, gain and its slope
                          int nodes,                      // NODE samples behind each
                          __global const float* bank,     // [POWERS][TAPS], of places beyond a sample; LANES more
                          __global float* received)          // [listeners][nodes * NODE]
{
    const int first = get_global_id(0) * LANES, listener = get_global_id(1);
    if (first >= nodes * NODE) return;
    const int node = first / NODE, inside = first % NODE;
    const float middle = (float)inside + 0.5f * (LANES - 1);
    const vec beside = RAMP - 0.5f * (LANES - 1);
    const long own = listener * (long)count % total * (long)stride;
    vec sum = 0.0f;
    for (int m = 0; m < count; m++) {
        const long at = (listener * (long)nodes + node) * count + m;
        const float4 now = motion[at];
        if (now.z == 0.0f && now.w == 0.0f) continue;
        const float ahead = now.x + now.y * middle, near = floor(ahead + 0.5f);
        const vec rest = beside * now.y + (ahead - near);
        __global const float* sample = streams + own + m * (long)stride + lead + first + whole[at] + (int)near - TAPS / 2;
        const vec value = now.y == 0.0f ? at_rest(sample, bank, ahead - near) : passing(sample, bank, rest);
        sum += (beside * now.w + (now.z + now.w * middle)) * value;
    }
    *(__global loose_vec*)(received + listener * (long)nodes * NODE + first) = sum;
}
