// Energies of rays in zones, added up as whole numbers of 64 bits: sums do not depend on their order.
// Twin of `Histograms` in tail/host_rays.py.

typedef struct {
    int zones, bins, early, windows, directions, departures, bands;
    float bins_per_metre, windows_per_metre;
    __global const float4* arrivals;  // directions
    __global uint2* of_early;         // zones, early, directions, bands
    __global uint2* of_late;          // rows, bins - early, directions, bands
    __global uint2* of_images;        // zones, bins, bands
    __global uint2* of_windows;       // slots, zones, windows, bands
    __global uint2* of_departures;    // zones, departures
} histograms;

// Low and high word, for want of atomics of 64 bits on many devices.
static void add(__global uint2* cell, float energy)
{
    const ulong whole = (ulong)energy;
    const uint low = (uint)whole, before = atomic_add((volatile __global uint*)cell, low);
    const uint high = (uint)(whole >> 32) + (before + low < before ? 1 : 0);
    if (high) atomic_add((volatile __global uint*)cell + 1, high);
}

typedef struct {
    int zone, row, slot, departure;  // row: where late energies of the zone go
    int of_images;                   // whether images hold it
    float3 direction;                // in which it goes
    float length, weight;            // way from the source, m, and what energies are multiplied by
} passage;

static void record(const histograms* to, const passage* p, const float* energies, int first_band, int band_count)
{
    if (p->length < 0.0f || p->weight <= 0.0f) return;
    const int bin = (int)(p->length * to->bins_per_metre), window = (int)(p->length * to->windows_per_metre);
    if (p->of_images) {
        if (bin >= to->bins) return;
        __global uint2* cell = to->of_images + ((size_t)p->zone * to->bins + bin) * to->bands + first_band;
        for (int b = 0; b < band_count; b++) add(cell + b, energies[b] * p->weight);
        return;
    }
    if (window < to->windows) {
        const size_t place = ((size_t)p->slot * to->zones + p->zone) * to->windows + window;
        __global uint2* cell = to->of_windows + place * to->bands + first_band;
        for (int b = 0; b < band_count; b++) add(cell + b, energies[b] * p->weight);
    }
    if (bin >= to->bins) return;
    int arrival = 0;
    float most = -2.0f;
    for (int m = 0; m < to->directions; m++) {
        const float along = -dot3(p->direction, to->arrivals[m].xyz);
        if (along > most) {
            most = along;
            arrival = m;
        }
    }
    const int late = bin >= to->early;
    const size_t time = late ? (size_t)p->row * (to->bins - to->early) + bin - to->early : (size_t)p->zone * to->early + bin;
    __global uint2* cell = (late ? to->of_late : to->of_early) + (time * to->directions + arrival) * to->bands + first_band;
    float sum = 0.0f;
    for (int b = 0; b < band_count; b++) {
        add(cell + b, energies[b] * p->weight);
        sum += energies[b] * p->weight;
    }
    add(to->of_departures + (size_t)p->zone * to->departures + p->departure, sum);
}
