"""Band-limited impulses between samples, one for each Chebyshev polynomial over the band."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.nufft import band_taper, ringing

if TYPE_CHECKING:
    from clsim.arrays import Complexes, Floats

_STEPS = 64  # of a sample, at which impulses are tabulated
_NODES = 4  # steps between which they are cubic


class BandKernels:
    """Impulses ``w_k(x) = 1/2 ∫ W(u) T_k(u) exp(j pi u x) du`` over u from -1 to 1, x in samples.

    W is 1 in the band and falls smoothly to 0 at half the sampling rate, as `band_taper` does.

    Each is tabulated at 64 steps of a sample, by the trapezoidal rule, which is exact for what falls smoothly to 0 (L.
    N. Trefethen, J. A. C. Weideman, "The exponentially convergent trapezoidal rule", SIAM Rev. 56(3), 2014, theorem
    3.2), and cubic through four steps: within 2e-7 of the impulse of a whole band.

    Examples
    --------
    >>> out = np.zeros((1, 200), dtype=complex)
    >>> BandKernels(0.5).add(out, np.array([100.25]), np.array([[1.0 + 0j]]))
    >>> tone = np.exp(2j * np.pi * 0.2 * np.arange(200))
    >>> bool(abs(out[0] @ tone - np.exp(2j * np.pi * 0.2 * 100.25)) < 1e-6)
    True

    Attributes
    ----------
    reach : int
        Samples to either side over which an impulse is laid.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self.reach = math.ceil(ringing(0.0, 0.5 * (1.0 - share)))
        self._tables = np.empty((_STEPS + _NODES, 0, 2 * self.reach), dtype=np.complex128)

    def add(self, out: Complexes, late: Floats, weights: Complexes) -> None:
        """Add impulses at places (T,), in samples from the first, to rows of samples (T, L), in place.

        `weights` (T, K) are those of the polynomials. What lies beyond the ends is left out.
        """
        self._tabulate(weights.shape[1])
        heard = np.flatnonzero(np.any(weights != 0.0, axis=1))
        whole = np.floor(late[heard]).astype(np.int64)
        place = (late[heard] - whole) * _STEPS
        step = np.minimum(place.astype(np.int64), _STEPS - 1)
        t = place - step
        cubic = np.stack([
            -t * (t - 1.0) * (t - 2.0) / 6.0, (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
            -(t + 1.0) * t * (t - 2.0) / 2.0, (t + 1.0) * t * (t - 1.0) / 6.0,
        ])  # fmt: skip
        made = np.zeros((len(heard), 2 * self.reach), dtype=np.complex128)
        for one in np.unique(step):
            mine = np.flatnonzero(step == one)
            for node in range(_NODES):
                table = self._tables[one + node, : weights.shape[1]]
                made[mine] += (weights[heard[mine]] * cubic[node, mine, None]) @ table
        taps = whole[:, None] + np.arange(1 - self.reach, self.reach + 1)
        inside = (taps >= 0) & (taps < out.shape[1])
        rows = np.broadcast_to(heard[:, None], taps.shape)
        out[rows[inside], taps[inside]] += made[inside]

    def _tabulate(self, count: int) -> None:
        """Make the tables of polynomials up to `count`: [step + 1, k, tap], the tap's distance less step / 64."""
        if count <= self._tables.shape[1]:
            return
        points = 4 * (self.reach + count)
        u = (np.arange(points) + 0.5) * (2.0 / points) - 1.0
        weight = band_taper(np.abs(u), 0.0, self._share, 0.0, 1.0 - self._share)
        chebyshev = np.cos(np.outer(np.arccos(u), np.arange(count)))
        taps = np.arange(1 - self.reach, self.reach + 1)
        turned = np.exp(1j * np.pi * np.outer(taps, u)) * (weight / points)
        back = np.exp(-1j * np.pi * np.outer(np.arange(-1, _STEPS + _NODES - 1) / _STEPS, u))
        made = [turned @ (chebyshev * row[:, None]) for row in back]
        self._tables = np.ascontiguousarray(np.swapaxes(np.array(made), 1, 2))
