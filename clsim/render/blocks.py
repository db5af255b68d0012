"""From nodes to the cubics of every block, in NumPy: the twin of ``block.h``.

For devices without float64, and for tracks that were computed elsewhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats


def block_cubics(
    delay: Floats, rate: Floats, gain: Floats, block: int, sampling_rate: float, late: float
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return whole delays and cubics on [-1, 1] of the rest and of the gain.

    Parameters
    ----------
    delay, rate : ndarray (paths, blocks + 3)
        At the nodes: one before the first block, its start, ..., two after the last block's start.
    gain : ndarray (K, paths, blocks + 3)
        There too.
    block : int
        Samples in a block.
    sampling_rate : float
        Hz.
    late : float
        Added to the delay, samples.

    Returns
    -------
    whole : ndarray (blocks, paths) int32
        Samples.
    cubics : ndarray (blocks, 4 + 4 K, paths) float32
        Lowest power first: four for the delay in samples, four for each gain.
    """
    p0, p1 = delay[:, 1:-2] * sampling_rate + late, delay[:, 2:-1] * sampling_rate + late
    e0, e1 = rate[:, 1:-2] * (0.5 * block), rate[:, 2:-1] * (0.5 * block)
    delay_cubic = _centred(p0, p1, e0, e1)
    gain_cubic = []
    for g in gain:
        s0, s1 = 0.25 * (g[:, 2:-1] - g[:, :-3]), 0.25 * (g[:, 3:] - g[:, 1:-2])
        gain_cubic += _centred(g[:, 1:-2], g[:, 2:-1], s0, s1)
    whole = np.rint(delay_cubic[0])
    delay_cubic[0] = delay_cubic[0] - whole
    cubics = np.stack([*delay_cubic, *gain_cubic]).astype(np.float32)
    return whole.T.astype(np.int32), np.ascontiguousarray(cubics.transpose(2, 0, 1))


def block_error(rate: Floats, gain: Floats, angular_frequency: float, block_time: float) -> Floats:
    """Return the largest error of the cubics of every path and block (paths, blocks), as pressure at full scale.

    Notes
    -----
    The remainder of cubic Hermite interpolation is ``h^4 f'''' / 384``, with ``h^3 f''''`` the third difference of the
    rate; that of Catmull-Rom is at most 0.016 of the gain's third difference (0.02 is used).
    """
    late = np.abs(np.diff(rate, 3, axis=1)) * block_time / 384.0
    change = 0.02 * np.abs(np.diff(gain, 3, axis=2)).sum(axis=0)
    return np.asarray(np.hypot(angular_frequency * late * np.abs(gain[:, :, 1:-2]).sum(axis=0), change))


def _centred(v0: Floats, v1: Floats, s0: Floats, s1: Floats) -> list[Floats]:
    """Return the cubic on [-1, 1] with values v0, v1 and slopes s0, s1 at its ends."""
    return [
        0.5 * (v0 + v1) - 0.25 * (s1 - s0),
        0.75 * (v1 - v0) - 0.25 * (s0 + s1),
        0.25 * (s1 - s0),
        0.25 * (s0 + s1) - 0.25 * (v1 - v0),
    ]
