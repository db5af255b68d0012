// Where paths are spread over a grid of delays, four points to three samples: twin of `spread` in render/channel_grid.py.

#define FLOATS_OF(x) (AS_VEC((x) + ROUNDING_BITS) - ROUNDING)  // small whole numbers, see rounding.h

// The first of TAPS points of paths that arrive so many samples behind the grid's beginning, the row of the window's table, and
// how far the window is from there to the next row.
static void find_places(ivec samples, vec rest, int* at, int* phase, float* between)
{
    // A third of whole numbers, rounded down: products of floats are right to a sixth.
    const ivec thirds = nearest(FLOATS_OF(samples - 1) * 0.333333333f);
    const vec place = (FLOATS_OF(samples - 3 * thirds) + rest) * 1.33333333f, down = rounded(place - 0.5f);
    const vec fine = (place - down) * (float)PHASES, left = rounded(fine - 0.5f);
    *(loose_ivec*)at = 4 * thirds + nearest(down) - (TAPS / 2 - 1);
    *(loose_ivec*)phase = nearest(left) + 1;
    *(loose_vec*)between = fine - left;
}

// The window at the points about a path, between two rows of its table.
static vec window_of(__global const float* window, int phase, float between)
{
    __global const float* w = window + phase * (2 * TAPS);
    return LOAD(w) + LOAD(w + TAPS) * between;
}
