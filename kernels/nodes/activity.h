// Which samples of the branch signals sound, in cells of CELL samples.

#define NEVER 0x7fffffff

typedef struct {
    __global const int* following;  // [cells], the next active cell, or `cells`; itself if it does
    __global const int* preceding;  // [cells], the one before, or -1
    int cells;
    real origin;                    // sample of the branches at the run's first sample, without delay
    int block_samples, subblock_samples;
} activity_mask;

static int cell_at(const activity_mask* s, real sample)
{
    const real cell = sample * (1.0f / CELL);
    return cell < 0 ? 0 : cell < (real)s->cells ? (int)cell : s->cells - 1;
}

// Whether anything is active in a block, for delays between two bounds, samples.
static int is_active(const activity_mask* s, int block, real shortest, real longest)
{
    const real start = s->origin + (real)block * s->block_samples;
    return s->following[cell_at(s, start - longest)] <= cell_at(s, start + s->block_samples - shortest);
}

// First block, from a given one on, in which anything may be active, for delays between two bounds, samples.
static int next_active(const activity_mask* s, int block, real shortest, real longest)
{
    const real start = s->origin + (real)block * s->block_samples;
    const int cell = s->following[cell_at(s, start - longest)];
    const real begin = (real)cell * CELL - start + shortest;
    return cell == s->cells ? NEVER : begin > 0 ? block + (int)(begin * ((real)1 / s->block_samples)) : block;
}

// First block of a segment, from a given one on, in which something may be active, as far as its ends say: all times are in
// blocks, delays in samples. They are `late0` at the first block and `late1` after the last one, and drift so fast at most.
static int next_active_block(const activity_mask* s, int block, int first, int last, int segment, real late0, real late1, real drift)
{
    const real before = drift * (real)(block - first), until_end = drift * (real)(segment - (block - first));
    const real low0 = late0 - before, low1 = late1 - until_end, high0 = late0 + before, high1 = late1 + until_end;
    const real low = low0 > low1 ? low0 : low1, high = high0 < high1 ? high0 : high1;
    const int ahead_of = next_active(s, block, low - until_end - 2, high + until_end + 2);
    if (ahead_of > block) return ahead_of < last ? ahead_of : last;
    return is_active(s, block, low - drift - 2, high + drift + 2) ? block : block + 1;
}

// The mask of a block, see mask.h.
static int active_subblocks(const activity_mask* s, int block, real shortest, real longest)
{
    const real start = s->origin + (real)block * s->block_samples;
    const real begin = (real)s->following[cell_at(s, start - longest)] * CELL - start + shortest;
    const real end = (real)(s->preceding[cell_at(s, start + s->block_samples - shortest)] + 1) * CELL - start + longest;
    const int first = begin > 0 ? (int)(begin / s->subblock_samples) : 0;
    const int count = s->block_samples / s->subblock_samples;
    const int last = end < (real)s->block_samples ? (int)(end / s->subblock_samples) + 1 : count;
    return first < last && end > 0 ? MASK(first, last) : 0;
}
