// Energies of rays in zones, added up as whole numbers of 64 bits: sums do not depend on their order.
// Twin of `Histograms` in tail/host_rays.py.

typedef struct {
    int zones, bins, early, windows, directions, departures, bands;
    float bins_per_metre, windows_per_metre;
    __global const float8* arrivals;  // directions by eight: their x, y and z
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

// The direction of arrival nearest to that from which sound comes, the first one of equally near ones.
static int nearest_arrival(const histograms* to, float3 direction)
{
    float8 most = -2.0f;
    int8 arrival = 0, m = (int8)(0, 1, 2, 3, 4, 5, 6, 7);
    for (int i = 0; 8 * i < to->directions; i++, m += 8) {
        __global const float8* at = to->arrivals + 3 * i;
        const float8 along = -(direction.x * at[0] + direction.y * at[1] + direction.z * at[2]);
        const int8 nearer = along > most & m < to->directions;
        most = nearer ? along : most;
        arrival = nearer ? m : arrival;
    }
    int found = 0;
    float largest = -2.0f;
    for (int i = 0; i < 8; i++) {
        const float along = ((const float*)&most)[i];
        const int one = ((const int*)&arrival)[i];
        if (along > largest || (along == largest && one < found)) {
            largest = along;
            found = one;
        }
    }
    return found;
}

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
    const int arrival = nearest_arrival(to, p->direction);
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
