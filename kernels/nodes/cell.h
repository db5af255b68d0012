// The four blocks of a cell side by side: what block.h, write_delay.h and smooth.h make of one at a time, to the last bit.

// The largest of all that is found of a path over a segment; `residual` is of what no function represents.
typedef struct {
    float error, strength, residual, shortest, longest;
} segment_result;

#define CELL_AT_ONCE (DELAY_TERMS == 4 && NODES_AT_ONCE == 4 && !SPARSE)

#if CELL_AT_ONCE
typedef reals __attribute__((aligned(8))) loose_reals;  // may start at any double
#define FOUR_FROM(pointer) (*(const loose_reals*)(pointer))
#define OF_BLOCK(floats, i) (((const float*)&floats)[i])
#define AS_FLOATS(x) ((float4)((float)x.s0, (float)x.s1, (float)x.s2, (float)x.s3))
#define SIZE(x) ((x) < 0.0f ? -(x) : (x))

// What all cells of a path have in common.
typedef struct {
    int slots, slot, functions, block_samples;
    double start, block_time, half_block, branch_rate, delay_samples, emitted_first, emitted_last;
    float angular_frequency, part;  // see `delay_error_squared`
    __global const gains* sizes;
    __global float* polynomials;
    __global int* delay;
} cell_blocks;

// Write the gains' powers in the four blocks, `next` apart; returns the square of what groups leave out.
static float4 write_cell_gains(const smooth_gains* s, const cell_blocks* b, __global float* c, long next)
{
    float4 left_out = 0.0f;
    const float part = b->part;
#if FUNCTIONS == 1
    const float reach = 0.5f / CELL_BLOCKS;
    const float4 y = {-0.375f, -0.125f, 0.125f, 0.375f};
    const float p0 = s->power[0][0], p1 = s->power[1][0], p2 = s->power[2][0], p3 = s->power[3][0], p4 = s->power[4][0];
    const float4 terms[4] = {p0 + y * (p1 + y * (p2 + y * (p3 + y * p4))),
                             reach * (p1 + y * (2.0f * p2 + y * (3.0f * p3 + y * (4.0f * p4)))),
                             reach * reach * (p2 + y * (3.0f * p3 + y * (6.0f * p4))),
                             reach * reach * reach * (p3 + y * (4.0f * p4))};
    const float4 second = part * part * terms[2] * b->sizes[0];
    left_out = second * second;
#pragma unroll
    for (int i = 0; i < CELL_BLOCKS; i++) {
#pragma unroll
        for (int power = 0; power < 4; power++) c[i * next + (DELAY_TERMS + power) * BESIDE] = OF_BLOCK(terms[power], i);
    }
#else
    gains terms[4][GAIN_VECTORS];
    for (int i = 0; i < CELL_BLOCKS; i++) {
        gains_in_cell(s, i, terms);
        ((float*)&left_out)[i] = left_out_squared(terms, b->sizes, part);
        write_terms(terms, 1, b->functions, BESIDE, c + i * next);
    }
#endif
    return left_out;
}

// Write the polynomials of a cell's blocks from `block` on, of a segment from `first` to `last`; whether all of it is there,
// and active from sample `from` to `until`.
static int write_cell(const smooth_gains* s, const cell_blocks* b, int block, int first, int last, int from, int until,
                      segment_result* f)
{
    const int end = block + CELL_BLOCKS, at = block - first - s->stretch * STRETCH;
    if ((block - first) % CELL_BLOCKS != 0 || end > last) return 0;
    if (from >= (block + 1) * b->block_samples || until <= (end - 1) * b->block_samples) return 0;
    __global float* c = b->polynomials + place_of(block, b->slot, b->functions, b->slots);
    const long next = (long)b->slots * terms(b->functions);
    const reals d0 = FOUR_FROM(s->delay + at), d1 = FOUR_FROM(s->delay + at + 1);
    const reals d2 = FOUR_FROM(s->delay + at + 2), d3 = FOUR_FROM(s->delay + at + 3);
    const reals r0 = FOUR_FROM(s->rate + at), r1 = FOUR_FROM(s->rate + at + 1);
    const reals r2 = FOUR_FROM(s->rate + at + 2), r3 = FOUR_FROM(s->rate + at + 3);
    const reals p0 = d1 * b->branch_rate + b->delay_samples, p1 = d2 * b->branch_rate + b->delay_samples;
    const reals e0 = r1 * b->half_block, e1 = r2 * b->half_block;
    const reals centre = 0.5 * (p0 + p1) - 0.25 * (e1 - e0), whole = (centre + ROUNDING_DOUBLE) - ROUNDING_DOUBLE;
    const reals powers[4] = {centre - whole, 0.75 * (p1 - p0) - 0.25 * (e0 + e1), 0.25 * (e1 - e0),
                            0.25 * (e0 + e1) - 0.25 * (p1 - p0)};
    float4 rounded[4];
#pragma unroll
    for (int power = 0; power < 4; power++) rounded[power] = AS_FLOATS(powers[power]);
#pragma unroll
    for (int i = 0; i < CELL_BLOCKS; i++) {
        b->delay[(block + i) * (long)b->slots + b->slot] = (int)OF_NODE(whole, i);
#pragma unroll
        for (int power = 0; power < 4; power++) c[i * next + power * BESIDE] = OF_BLOCK(rounded[power], i);
    }
    const float4 left_out = write_cell_gains(s, b, c, next);
    const reals hermite = (r3 - r0 + 3 * (r1 - r2)) * b->block_time;
    const reals third = 0.125f * b->block_time * (r1 + r2) - 0.25f * (d2 - d1);
    const float4 remainder = AS_FLOATS(hermite) / 384.0f, twist = AS_FLOATS(third) * b->part * b->part * b->part;
    const float4 phase = b->angular_frequency * (SIZE(remainder) + SIZE(twist));
    const double at_block[4] = {block + 2, block + 3, block + 4, block + 5};
    const reals time = b->start + SIDE_BY_SIDE(at_block, ) * b->block_time;
    const float4 squared = phase * phase * s->loudest + left_out + s->error;
    const choices emitted = (time - d3 >= b->emitted_first) & (time - 3.0 * b->block_time - d0 <= b->emitted_last);
#pragma unroll
    for (int i = 0; i <= CELL_BLOCKS; i++) {
        const float now = i < CELL_BLOCKS ? (float)OF_NODE(d1, i) : (float)OF_NODE(d2, CELL_BLOCKS - 1);
        f->shortest = now < f->shortest ? now : f->shortest;
        f->longest = now > f->longest ? now : f->longest;
        if (i == CELL_BLOCKS) break;
        const float residual = residual_where_active(s->largest_residual, (block + i) * b->block_samples,
                                                     GROUP * b->block_samples, from, until);
        f->residual = residual > f->residual ? residual : f->residual;
        if (OF_NODE_LONG(emitted, i)) f->error = OF_BLOCK(squared, i) > f->error ? OF_BLOCK(squared, i) : f->error;
    }
    f->strength = s->loudest > f->strength ? s->loudest : f->strength;
    return 1;
}
#endif
