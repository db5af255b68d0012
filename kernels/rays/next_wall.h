// The next wall of a ray. Twin of `PlaneWalls` and `TreeWalls` in tail/host_rays.py.

#define NOWHERE 3.0e38f  // m
#define STACK 128  // groups of boxes that wait: seven of each of the tree's levels at most

typedef struct {
    int walls;                       // planes of a convex room
    __global const float4* plane;    // of each wall: unit normal and offset
    __global const float8* boxes;    // of each node: lowest x, highest x, y, z of its eight children
    __global const int8* children;   // nodes, or ~leaf
    __global const float8* leaves;   // of each leaf: x, y, z of three corners, planes of eight triangles
    __global const int8* wall_of;    // of the triangles of each leaf
} ray_walls;

typedef struct {
    float far;  // m
    int wall;   // -1 for none
} ray_hit;

static float dot3(float3 a, float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

#if CONVEX
// From inside a convex room whose normals point inward; `below` is of no use there, for nothing hides anything.
static ray_hit next_wall(const ray_walls* room, float3 o, float3 d, float below)
{
    ray_hit hit = {below, -1};
    for (int w = 0; w < room->walls; w++) {
        const float4 plane = room->plane[w];
        const float towards = dot3(plane.xyz, d), height = dot3(plane.xyz, o) - plane.w;
        if (towards >= 0.0f) continue;
        const float far = (height > 0.0f ? height : 0.0f) / -towards;
        if (far < hit.far) hit = (ray_hit){far, w};
    }
    return hit;
}
static int is_hidden(const ray_walls* room, float3 o, float3 d, float far) { return 0; }
#else
static int any_lane(int8 x)
{
    const int4 a = x.lo | x.hi;
    const int2 b = a.lo | a.hi;
    return b.x | b.y;
}

// Six times the volumes of tetrahedra of the ray and an edge: neighbours have the same one with the other sign, to the
// last bit, so that nothing passes between them.
static float8 passes(float3 d, float8 ax, float8 ay, float8 az, float8 bx, float8 by, float8 bz)
{
    return d.x * (ay * bz - az * by) + d.y * (az * bx - ax * bz) + d.z * (ax * by - ay * bx);
}

// Triangles of a leaf: the nearest is kept, and of equally near ones that of the lowest number.
static void meet_leaf(const ray_walls* room, int leaf, float3 o, float3 d, float near, ray_hit* hit, int* lowest)
{
    __global const float8* at = room->leaves + 13 * (size_t)leaf;
    const float8 ax = at[0] - o.x, ay = at[1] - o.y, az = at[2] - o.z, bx = at[3] - o.x, by = at[4] - o.y, bz = at[5] - o.z;
    const float8 cx = at[6] - o.x, cy = at[7] - o.y, cz = at[8] - o.z;
    const float8 one = passes(d, ax, ay, az, bx, by, bz), two = passes(d, bx, by, bz, cx, cy, cz);
    const float8 three = passes(d, cx, cy, cz, ax, ay, az);
    const float8 far = (at[12] - (at[9] * o.x + at[10] * o.y + at[11] * o.z)) / (at[9] * d.x + at[10] * d.y + at[11] * d.z);
    const int8 left = (one >= 0.0f) & (two >= 0.0f) & (three >= 0.0f), right = (one <= 0.0f) & (two <= 0.0f) & (three <= 0.0f);
    const int8 met = (left | right) & (far > 0.0f) & (far <= hit->far);
    if (!any_lane(met)) return;
    float fars[8];
    int mets[8];
    *(float8*)fars = far;
    *(int8*)mets = met;
    for (int i = 0; i < 8; i++) {
        if (!mets[i]) continue;
        // Never nearer than the box: what box after box is skipped by is then right to the last bit.
        const float held = fars[i] > near ? fars[i] : near;
        const int number = 8 * leaf + i;
        if (held < hit->far || (held == hit->far && number < *lowest)) {
            *hit = (ray_hit){held, ((__global const int*)(room->wall_of + leaf))[i]};
            *lowest = number;
        }
    }
}

// The nearest triangle below a distance; with `any` the first one that is found.
static ray_hit walk_tree(const ray_walls* room, float3 o, float3 d, float below, int any)
{
    float3 slope;
    slope.x = 1.0f / (d.x == 0.0f ? 1e-18f : d.x);
    slope.y = 1.0f / (d.y == 0.0f ? 1e-18f : d.y);
    slope.z = 1.0f / (d.z == 0.0f ? 1e-18f : d.z);
    const int sx = slope.x < 0.0f, sy = slope.y < 0.0f, sz = slope.z < 0.0f;
    ray_hit hit = {below, -1};
    int lowest = -1, waiting = 1;
    int nodes[STACK];
    float nears[STACK];
    nodes[0] = 0;
    nears[0] = 0.0f;
    while (waiting > 0) {
        const int node = nodes[--waiting];
        if (nears[waiting] > hit.far) continue;
        if (node < 0) {
            meet_leaf(room, ~node, o, d, nears[waiting], &hit, &lowest);
            if (any && hit.wall >= 0) return hit;
            continue;
        }
        __global const float8* box = room->boxes + 6 * (size_t)node;
        const float8 x = (box[sx] - o.x) * slope.x, y = (box[2 + sy] - o.y) * slope.y, z = (box[4 + sz] - o.z) * slope.z;
        const float8 fx = (box[1 - sx] - o.x) * slope.x, fy = (box[3 - sy] - o.y) * slope.y, fz = (box[5 - sz] - o.z) * slope.z;
        const float8 xy = x > y ? x : y, near = xy > z ? xy : z, fxy = fx < fy ? fx : fy, far = fxy < fz ? fxy : fz;
        const int8 met = (near <= far) & (far >= 0.0f) & (near <= hit.far);
        if (!any_lane(met)) continue;
        float of[8];
        int mets[8];
        *(float8*)of = near;
        *(int8*)mets = met;
        __global const int* child = (__global const int*)(room->children + node);
        const int first = waiting;
        for (int i = 0; i < 8; i++) {
            if (!mets[i]) continue;
            const float mine = of[i] > 0.0f ? of[i] : 0.0f;
            int place = waiting++;  // the nearest is taken first
            for (; place > first && nears[place - 1] < mine; place--) {
                nears[place] = nears[place - 1];
                nodes[place] = nodes[place - 1];
            }
            nears[place] = mine;
            nodes[place] = child[i];
        }
    }
    return hit;
}

static ray_hit next_wall(const ray_walls* room, float3 o, float3 d, float below) { return walk_tree(room, o, d, below, 0); }
static int is_hidden(const ray_walls* room, float3 o, float3 d, float far) { return walk_tree(room, o, d, far, 1).wall >= 0; }
#endif
