"""From nodes to the polynomials of every block, in NumPy: the twin of ``block.h`` and ``smooth.h``.

For devices without float64, and for tracks that were computed elsewhere.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats

GAIN_ERROR = {4: 0.02, 8: 0.03}  # of the last differences of gains, by the terms of delays; see `block_error`
SMOOTH_SHARE = 0.1  # of the square of the error between nodes: what gains of neighbouring blocks may add to it
# Of the fourth differences of gains between cells: the error of the cubic between the middle nodes of five is 0.0234.
SMOOTH_ERROR = 0.03


def block_polynomials(
    delay: Floats, rate: Floats, gain: Floats, block: int, sampling_rate: float, delay_samples: float,
    oversampling: int = 1, terms: int = 4,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:  # fmt: skip
    """Return whole delays (blocks, paths), samples, and polynomials (blocks, terms + 4 K, paths) of rests and gains.

    Delays and rates (paths, blocks + 3) and gains (K, paths, blocks + 3) are those of nodes from one before the first
    block to two after the last block's start. Delays are Hermite's cubics through the block's ends, or septics of 8
    `terms` through all four nodes; gains Catmull-Rom's cubics, or those through all four nodes.
    """
    places = delay * (oversampling * sampling_rate) + delay_samples
    change = rate * (0.5 * oversampling * block)
    if terms == 8:
        delay_terms = _septic(places, change)
    else:
        delay_terms = _centred(places[:, 1:-2], places[:, 2:-1], change[:, 1:-2], change[:, 2:-1])
    g0, g1, g2, g3 = _nodes(gain)
    gain_terms = _through(g0, g1, g2, g3) if terms == 8 else _centred(g1, g2, 0.25 * (g2 - g0), 0.25 * (g3 - g1))
    whole = np.rint(delay_terms[0])
    delay_terms[0] = delay_terms[0] - whole
    polynomials = np.concatenate([delay_terms, *gain_terms]).astype(np.float32)
    return whole.T.astype(np.int32), np.ascontiguousarray(polynomials.transpose(2, 0, 1))


def block_error(
    delay: Floats, rate: Floats, gain: Floats, level: Floats, angular_frequency: float, block_time: float,
    part: float = 0.0, terms: int = 4,
) -> Floats:  # fmt: skip
    """Return the largest error of the polynomials of every path and block (paths, blocks), as pressure at full scale.

    level: of all gains of each path and block, (paths, blocks).

    The remainder of cubic Hermite interpolation is ``h^4 f / 384``, with ``h^3 f`` the third difference of the rate;
    that of Catmull-Rom is at most 0.016 of the gain's third difference (0.02 is used), that of the cubic through all
    four nodes 3/128 of the fourth (0.03 is used). Groups that are a `part` of the block leave out the third power of
    the delay, of septics the fourth, and the second one of the gains; 0 where they do not. With eight terms the
    septic's distance at mid-block from the quintic through the middle nodes and all four rates is taken, times its
    ratio to the cubic's, where that is below 1: as if the terms went on falling like this. Motion without higher
    derivatives gains nothing.
    """
    delay_samples = np.abs(np.diff(rate, 3, axis=1)) * block_time / 384.0
    if terms == 8:
        (d0, d1, d2, d3), (e0, e1, e2, e3) = _nodes(delay), _nodes(rate * (0.5 * block_time))
        quintic = 0.5 * (d1 + d2) + 17.0 / 64.0 * (e1 - e2) - (e0 - e3) / 192.0
        septic = (243.0 * (d1 + d2) + 13.0 * (d0 + d3) - 162.0 * (e2 - e1) - 6.0 * (e3 - e0)) / 512.0
        rest = np.abs(septic - quintic)
        delay_samples = rest * np.minimum(rest / np.maximum(delay_samples, 1e-20), 1.0)
        outer, inner = 0.5 * (d0 + d3 - d1 - d2), 0.5 * (e2 - e1)
        fourth = 15.0 / 256.0 * (outer - 4.0 * inner) - 11.0 / 384.0 * (0.5 * (e3 - e0) - 3.0 * inner)
        delay_samples = np.hypot(delay_samples, part**4 * fourth)
    else:
        cubed = 0.125 * block_time * (rate[:, 1:-2] + rate[:, 2:-1]) - 0.25 * np.diff(delay, axis=1)[:, 1:-1]
        delay_samples = delay_samples + np.abs(cubed) * part**3
    last = _fourth(gain) if terms == 8 else np.abs(np.diff(gain, 3, axis=2))
    change = (GAIN_ERROR[terms] * last).sum(axis=0)
    g0, g1, g2, g3 = _nodes(gain)
    change = np.hypot(change, 0.0625 * part**2 * np.abs((g3 - g2) - (g1 - g0)).sum(axis=0))
    return np.asarray(np.hypot(angular_frequency * delay_samples * level, change))


def between(gain: Floats, every: int) -> tuple[Floats, Floats]:
    """Return gains (..., n) at all nodes by degree 4 from those at every so many, and a bound of their error."""
    weights = _between(gain.shape[-1], every)
    return gain @ weights, SMOOTH_ERROR * np.abs(np.diff(gain, 4, axis=-1)).max(axis=-1)


@cache
def _between(count: int, every: int) -> Floats:
    """Return Lagrange's weights (count, nodes) of every so many nodes at each of them."""
    weights = np.zeros((count, every * (count - 1) + 1))
    for node in range(weights.shape[1]):
        cell = min(node // every, count - 2)
        first = min(max(cell - 1, 0), count - 5)
        for one in range(first, first + 5):
            others = np.setdiff1d(np.arange(first, first + 5), [one])
            weights[one, node] = np.prod((node / every - others) / (one - others))
    return weights


def _nodes(values: Floats) -> list[Floats]:
    """Return the four nodes about every block, each (..., blocks), from (..., blocks + 3)."""
    return [values[..., i : values.shape[-1] - 3 + i] for i in range(4)]


def _through(g0: Floats, g1: Floats, g2: Floats, g3: Floats) -> list[Floats]:
    """Return the cubics on [-1, 1] with the values of nodes at -3, -1, 1 and 3."""
    s1, s3, d1, d3 = 0.5 * (g2 + g1), 0.5 * (g3 + g0), 0.5 * (g2 - g1), 0.5 * (g3 - g0)
    return [(9.0 * s1 - s3) / 8.0, (27.0 * d1 - d3) / 24.0, (s3 - s1) / 8.0, (d3 - 3.0 * d1) / 24.0]


def _fourth(gain: Floats) -> Floats:
    """Estimate the fourth differences of gains (K, paths, blocks) from the third ones and how fast differences fall."""
    g0, g1, g2, g3 = _nodes(gain)
    first, second, third = np.abs(g2 - g1), 0.5 * np.abs(g3 - g2 - g1 + g0), np.abs(np.diff(gain, 3, axis=2))
    last, before = (np.minimum(a / np.maximum(b, 1e-30), 1.0) for a, b in ((third, second), (second, first)))
    return np.asarray(third * np.minimum(last, before))


def _septic(values: Floats, slopes: Floats) -> list[Floats]:
    """Return the septics on [-1, 1] with values and slopes (paths, blocks + 3) at -3, -1, 1 and 3."""
    from numpy.polynomial import polynomial

    place, power = np.array([-3.0, -1.0, 1.0, 3.0]), np.arange(8)
    at = place[:, None] ** power
    change = np.stack([polynomial.polyval(place, polynomial.polyder(one)) for one in np.eye(8)], axis=1)
    inverse = np.linalg.inv(np.concatenate([at, change]))
    whole = np.rint(values[:, 1:-2])
    known = [v - whole for v in _nodes(values)] + _nodes(slopes)
    terms = list(np.einsum("ij,jpb->ipb", inverse, np.stack(known)))
    terms[0] = terms[0] + whole
    return terms


def _centred(v0: Floats, v1: Floats, s0: Floats, s1: Floats) -> list[Floats]:
    """Return the cubic on [-1, 1] with values v0, v1 and slopes s0, s1 at its ends."""
    return [
        0.5 * (v0 + v1) - 0.25 * (s1 - s0),
        0.75 * (v1 - v0) - 0.25 * (s0 + s1),
        0.25 * (s1 - s0),
        0.25 * (s0 + s1) - 0.25 * (v1 - v0),
    ]


class Residual:
    """Residual of one source's paths that no function represents, by segment and receiver, over their level.

    Functions are designed for the sum of a receiver's paths of all kinds, relative to its level over 40 ms. A
    segment with only the last echoes of a pulse is therefore compared with the level of its neighbours too.
    """

    def __init__(self, receivers: int) -> None:
        self._receivers = receivers
        self._squares: dict[int, Floats] = {}  # by segment, (2, receivers): what no function holds, and what is heard
        self._worst = 0.0

    def add(self, first: int, receiver: NDArray[np.int32], squares: Floats) -> None:
        """Add squares (2, segments, n) of residual and level of paths to some receivers (n,), from a segment on."""
        for i in range(squares.shape[1]):
            here = self._squares.setdefault(first + i, np.zeros((2, self._receivers)))
            here[:, receiver] += squares[:, i]

    def level(self, segment: int, receiver: NDArray[np.int32]) -> Floats:
        """Squared level (n,) at some receivers of the paths that were added to a segment."""
        known = self._squares.get(segment)
        return np.zeros(len(receiver)) if known is None else known[1, receiver]

    def settle(self, before: int) -> None:
        """Close the segments before one: take their maximum and drop their sums."""
        self._worst = max(self._worst, self._largest([s for s in self._squares if s < before - 1]))
        self._squares = {s: here for s, here in self._squares.items() if s >= before - 2}

    @property
    def level_db(self) -> float:
        """The largest residual relative to the received level, dB."""
        return 10.0 * math.log10(max(self._worst, self._largest(list(self._squares)), 1e-30))

    def _largest(self, segments: list[int]) -> float:
        largest = 0.0
        for s in segments:
            about = [self._squares[n][1] for n in (s - 1, s, s + 1) if n in self._squares]
            part = self._squares[s][0] / np.maximum(np.max(about, axis=0), 1e-30)
            largest = max(largest, float(part.max()))
        return largest


def block_errors(
    squares: Floats, first_slot: NDArray[np.int32], before: Floats | float, least: float
) -> tuple[Floats, Floats]:
    """Errors (segments,) of paths, of the receiver where they are most, and levels (segments, receivers) about them.

    Squares (2 or more, segments, slots) of errors and levels add up, with squared levels of what was rendered `before`.
    """
    wrong, own, *_ = np.add.reduceat(squares, first_slot[:-1], axis=2)
    received = np.maximum(np.sqrt(own + before, dtype=np.float64), least)
    return (np.sqrt(wrong, dtype=np.float64) / received).max(axis=1), received


def few_paths(squares: Floats, first_slot: NDArray[np.int32], allowed: Floats) -> NDArray[np.bool_]:
    """Return the mask of the fewest slots without which squared errors (slots,) add up to what is `allowed`."""
    mask = np.zeros(len(squares), dtype=np.bool_)
    for most, (first, last) in zip(allowed, pairwise(first_slot.tolist()), strict=True):
        order = first + np.argsort(squares[first:last], kind="stable")
        mask[order] = np.cumsum(squares[order], dtype=np.float64) > most
    return mask


_FALLING = 3.5  # power of a block's length with which errors of gains fall, measured: 3.6 at edges


def promising(blocks: NDArray[np.int64], level: int, excess: Floats) -> NDArray[np.int64]:
    """Return the first lower levels of blocks that may do where errors are so many times (n,) what they may be.

    Gains at edges and by scatterers bend so much that many levels would be made in vain. What is tried depends on the
    segment's own error alone, so that chunks do not matter.
    """
    length = blocks[level] * np.maximum(excess, 1.0) ** (-1.0 / _FALLING)
    return np.asarray(np.clip(np.searchsorted(-blocks, -length), level + 1, len(blocks) - 1))
