"""Which segments of a run are rendered for paths that begin and end, and at which instants these are looked at."""

from itertools import pairwise

import numpy as np

from clsim.render.opencl.batches import Boundaries
from clsim.tracks.picked import while_active


def test_segments_without_active_paths_are_left_out() -> None:
    """Segments of 100 samples, by 100 draws: those rendered are those that any path's samples lie in."""
    random, left_out = np.random.default_rng(3), 0
    for _ in range(100):
        begin = random.integers(-300, 1300, 3)
        end = begin + random.integers(-50, 400, 3)
        bounds = Boundaries(begin.astype(float), end.astype(float), begin, end, 0.0)
        start, first, last = int(random.integers(0, 3)) * 100, 1, 8
        heard = [
            segment for segment in range(first, last)
            if any(a < start + 100 * (segment + 1) and b > start + 100 * segment for a, b in zip(begin, end, strict=True) if b > a)
        ]  # fmt: skip
        found = bounds.stretches(start, 100, first, last)
        assert [segment for a, b in found for segment in range(a, b)] == heard
        assert all(a[1] < b[0] for a, b in pairwise(found))
        left_out += last - first - len(heard)
    assert left_out > 100


def test_paths_that_are_active_for_a_short_time_are_looked_at_then() -> None:
    """Even times of 10 s become even times of the three seconds in which any of four paths is active."""
    start, end = np.array([7.0, -np.inf, 6.5, 9.0]), np.array([8.0, 0.5, 7.5, np.inf])
    times = while_active(start, end, np.linspace(0.0, 10.0, 3001), 10.0)
    assert np.all(np.diff(times) >= 0.0)
    inside = (times <= 0.5) | ((times >= 6.5) & (times <= 8.0)) | (times >= 9.0)
    assert np.all(inside)
    assert [np.sum(times <= 0.5), np.sum((times >= 6.5) & (times <= 8.0)), np.sum(times >= 9.0)] == [500, 1500, 1001]
    assert times[-1] == 10.0
    never = np.array([11.0]), np.array([12.0])
    np.testing.assert_array_equal(while_active(*never, times, 10.0), times)
