// Rays of energy: a work-item follows one through its reflections. Twin of `trace` in tail/host_rays.py.

#define OCTETS ((BANDS + 7) / 8)
typedef float8 __attribute__((aligned(4))) loose_float8;

typedef struct {
    float radius, off, scale, escape_scale, rain, floor_share, bins_per_metre, windows_per_metre, origin[3];
    int count, first_ray, groups, bands, zone_count, bins, early_bins;
    int window_count, arrival_count, departure_count, walls, max_order;
    uint stream, key[2];
} ray_numbers;

// Whether what a wall scatters at a place reaches a zone directly by the closed form: the mean of cos/(pi d²) over a
// sphere is its value in the middle, for it is harmonic, where all of the sphere is before the wall.
static int is_rained_on(float far, float height, float radius, float length, float until)
{
    return far > radius && height >= radius && length + far < until;
}

// Energies that a wall sends back, eight bands side by side, and the largest of them. Those behind a group's bands are 0.
static float reflected(float* energy, __global const float* returned)
{
    loose_float8* at = (loose_float8*)energy;
    float8 most = 0.0f;
    for (int i = 0; i < OCTETS; i++) {
        const float8 left = at[i] * ((__global const loose_float8*)returned)[i];
        most = left > most ? left : most;
        at[i] = left > FAINT ? left : (float8)(0.0f);
    }
    const float4 four = most.lo > most.hi ? most.lo : most.hi;
    const float2 two = four.lo > four.hi ? four.lo : four.hi;
    return two.x > two.y ? two.x : two.y;
}

__kernel void rays(
    const ray_numbers run, __global const float* directions, __global const float* emitted, __global const int* departure,
    __global const int* first_band, __global const float* until, __global const float* wavelength,
    __global const float4* plane, __global const float4* along, __global const float4* across, __global const int* kind,
    __global const float* returned, __global const float* scattered, __global const float8* boxes,
    __global const int8* children, __global const float8* leaves, __global const int8* wall_of,
    __global const float4* zones, __global const int* late_row, __global const float8* arrivals,
    __global uint2* early, __global uint2* late, __global uint2* images, __global uint2* windows,
    __global uint2* departures, __global uint2* escaped, __global float4* ends)
{
    const int ray = get_global_id(0), group = get_global_id(1);
    if (ray >= run.count) return;
    const ray_walls room = {run.walls, plane, boxes, children, leaves, wall_of};
    const wall_tables walls = {plane, along, across, kind, returned, scattered};
    const histograms to = {
        run.zone_count, run.bins, run.early_bins, run.window_count, run.arrival_count, run.departure_count, run.bands, run.bins_per_metre,
        run.windows_per_metre, arrivals, early, late, images, windows, departures};
    const int first = first_band[group], count = first_band[group + 1] - first;
    float3 o = (float3)(run.origin[0], run.origin[1], run.origin[2]);
    float3 d = (float3)(directions[3 * ray], directions[3 * ray + 1], directions[3 * ray + 2]);
    float energy[8 * OCTETS] = {0.0f}, loudest = 0.0f, travelled = 0.0f;
    for (int b = 0; b < count; b++) energy[b] = emitted[(size_t)ray * run.bands + first + b];
    for (int b = 0; b < count; b++) loudest = energy[b] > loudest ? energy[b] : loudest;
    const float floor_energy = loudest * run.floor_share;
    int was_scattered = 0, fresh = 0, last = -1;
    float3 face = (float3)(0.0f, 0.0f, 0.0f);
    ray_hit hit = next_wall(&room, o, d, NOWHERE);
    __global float4* end_of_ray = ends + 2 * ((size_t)group * run.count + ray);
    end_of_ray[0] = (float4)(0.0f, 0.0f, 0.0f, NOT_ESCAPED);
    for (int order = 0; order < MOST_REFLECTIONS && loudest > floor_energy && travelled < until[group]; order++) {
        for (int z = 0; z < run.zone_count; z++) {
            const float4 zone = zones[z];
            const float3 to_zone = (float3)(zone.x - o.x, zone.y - o.y, zone.z - o.z);
            const float middle = dot3(to_zone, d);
            const float3 off = (float3)(to_zone.x - middle * d.x, to_zone.y - middle * d.y, to_zone.z - middle * d.z);
            const float inside = run.radius * run.radius - dot3(off, off);
            if (inside <= 0.0f) continue;
            if (fresh && is_rained_on(sqrt(dot3(to_zone, to_zone)), dot3(to_zone, face), run.radius, travelled, run.rain)) continue;
            const float half_way = sqrt(inside);
            const float end = middle + half_way < hit.far ? middle + half_way : hit.far;
            const float begin = middle - half_way > 0.0f ? middle - half_way : 0.0f;
            const int of_images = !was_scattered && order <= run.max_order;
            const passage p = {z, late_row[z], ray % SLOTS, departure[ray], of_images, d, travelled + middle, (end - begin) * (zone.w * run.scale)};
            record(&to, &p, energy, first, count);
        }
        if (hit.wall < 0) {
            end_of_ray[0] = (float4)(o.x, o.y, o.z, (float)last);
            end_of_ray[1] = (float4)(d.x, d.y, d.z, 0.0f);
            __global uint2* cell = escaped + (size_t)(last < 0 ? run.walls : last) * run.bands + first;
            for (int b = 0; b < count; b++) add(cell + b, energy[b] * run.escape_scale);
            break;
        }
        const float4 wall = plane[hit.wall];
        const float towards = dot3(d, wall.xyz), cosine = towards < 0.0f ? -towards : towards, side = towards > 0.0f ? -1.0f : 1.0f;
        const int cell = (int)(ANGLES * sqrt(cosine)), angle = kind[hit.wall] * ANGLES + (cell < ANGLES ? cell : ANGLES - 1);
        loudest = reflected(energy, returned + (size_t)angle * run.bands + first);
        const float before = hit.far;
        travelled += before;
        o = onward_by(o, before, d);
        const float height = dot3(wall.xyz, o) - wall.w;
        o = onward_by(o, run.off * side - height, wall.xyz);
        face = (float3)(side * wall.x, side * wall.y, side * wall.z);
        last = hit.wall;
        const float3 onward = mirrored(d, towards, wall.xyz);
        ray_hit next = hit;
        float share = scattered[angle * run.groups + group];
        // Images hold the whole of what they are of: walls are small to the reflections after them.
        const int sized = SIZED && (was_scattered || order >= run.max_order);
        if (sized) {
            next = next_wall(&room, o, onward, NOWHERE);
            const float by_size = share_by_size(&walls, hit.wall, d, cosine, before, next.far, wavelength[group]);
            share = 1.0f - (1.0f - by_size) * (1.0f - share);
        }
        for (int z = 0; z < run.zone_count && share > 0.0f && travelled < run.rain; z++) {
            const float4 zone = zones[z];
            const float3 to_zone = (float3)(zone.x - o.x, zone.y - o.y, zone.z - o.z);
            const float square = dot3(to_zone, to_zone), far = sqrt(square), above = dot3(to_zone, face);
            if (!is_rained_on(far, above, run.radius, travelled, run.rain)) continue;
            const float3 there = (float3)(to_zone.x / far, to_zone.y / far, to_zone.z / far);
            if (is_hidden(&room, o, there, far)) continue;
            const passage p = {z, late_row[z], ray % SLOTS, departure[ray], 0, there, travelled + far, share * above / (PI * square * far) * run.scale};
            record(&to, &p, energy, first, count);
        }
        const uint4 drawn = philox((uint4)((uint)(run.first_ray + ray), (uint)order, (uint)group, run.stream), (uint2)(run.key[0], run.key[1]));
        fresh = uniform24(drawn.x) < share;
        was_scattered |= fresh;
        d = fresh ? lambert(&walls, last, side, drawn.y, drawn.z) : onward;
        hit = sized && !fresh ? next : next_wall(&room, o, d, NOWHERE);
    }
}
