"""Whether two searches found the same intervals."""

import numpy as np

from clsim.paths.visibility.intervals import Intervals


def same(got: Intervals, twin: Intervals, step: float) -> bool:
    """Compare intervals to a step, s; those of a few steps may be missing on either side."""

    def long(found: Intervals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        keep = found.end - found.begin > 3 * step
        return found.path[keep], found.begin[keep], found.end[keep]

    (p, a, b), (q, c, d) = long(got), long(twin)
    if p.tolist() != q.tolist():
        return False
    return bool(np.all(np.abs(a - c) <= 1.01 * step) and np.all(np.abs(b - d) <= 1.01 * step))
