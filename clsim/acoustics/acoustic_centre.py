"""The delay that a directivity's phases have in common with a point that lies elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_ROUNDS = 2  # the second finds what the first left
_ENOUGH = 500_000  # values to find a handful of numbers from


def fit_delay(
    points: Floats, frequencies: Floats, values: NDArray[np.complex128], neighbours: NDArray[np.intp]
) -> Floats:
    """Return the delay, linear in the direction, without which complex responses turn the least.

    Parameters
    ----------
    points : ndarray (n, k)
        Directions: unit vectors (k = 3), or cosines of the angle from the axis (k = 1).
    frequencies : ndarray (F,)
        Increasing, Hz.
    values : ndarray (n, F)
        Responses; the time convention is ``exp(+j 2 pi f t)``.
    neighbours : ndarray (m, 2)
        Pairs of points that lie beside each other.

    Returns
    -------
    ndarray (1 + k,)
        ``t``, s: ``values * exp(+2j pi f (t[0] + points @ t[1:]))`` has the slowest phase. A point source that stands
        at p (3,) m of the transducer's own frame has ``t[1:] = -p / c``.

    Notes
    -----
    Weighted least squares on the phases of products of neighbours, ``conj(a) b``, in frequency and in direction, with
    the products' magnitudes as weights: what is loud decides, and a zero between two lobes does not count. Neighbours
    must differ by less than half a turn.

    Examples
    --------
    >>> cosine = np.cos(np.radians(np.arange(0.0, 181.0, 5.0)))[:, None]
    >>> f = np.array([30e3, 40e3, 50e3])
    >>> pairs = np.column_stack([np.arange(36), np.arange(1, 37)])
    >>> ahead = np.exp(2j * np.pi * f / 343.0 * 0.01 * cosine)  # a centre 10 mm in front
    >>> (343.0 * fit_delay(cosine, f, ahead, pairs)).round(6).tolist()
    [0.0, -0.01]
    """
    found = np.zeros(1 + points.shape[1])
    every = -(-values.size // _ENOUGH)
    some, (a, b) = slice(None, None, every), neighbours[::every].T
    steps = np.column_stack([np.ones(len(points[some])), points[some]])
    apart = np.column_stack([np.zeros(len(a)), points[b] - points[a]])
    for _ in range(_ROUNDS):
        turn = 2j * np.pi * (found[0] + points @ found[1:])[:, None]
        here, one, other = (values[k] * np.exp(turn[k] * frequencies) for k in (some, a, b))
        matrix, right = np.zeros((len(found), len(found))), np.zeros(len(found))
        _add(matrix, right, steps, np.diff(frequencies), here[:, :-1], here[:, 1:])
        _add(matrix, right, apart, frequencies, one, other)
        found += np.linalg.lstsq(matrix, right)[0]
    return found


def _add(matrix: Floats, right: Floats, steps: Floats, scale: Floats, a: Any, b: Any) -> None:
    """Add the normal equations of ``phase(conj(a) b) = -2 pi scale (steps @ t)``, a and b (m, F)."""
    product = np.conj(a) * b
    weight = np.abs(product)
    matrix += np.einsum("mi,m,mj->ij", steps, weight @ scale**2, steps)
    right -= steps.T @ ((weight * np.angle(product)) @ scale) / (2.0 * np.pi)
