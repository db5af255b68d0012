"""Gain of transducers by direction; the cosine is that of the angle off the axis."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import Floats

# Which neighbours a round compares, in frequency (f) or direction (d): either may be too far apart at first, or always.
_ROUNDS = (("f", "fd", "fd"), ("d", "fd", "fd"), ("d", "d"))
_ENOUGH = 50_000  # values to find a handful of numbers from


def piston_gain(cosine: ArrayLike, frequency: ArrayLike, radius: float, speed_of_sound: float) -> Floats:
    """Return the far-field gain of a round piston in a baffle, 1 on the axis.

    ``2 J1(k a sin θ) / (k a sin θ)``: P. M. Morse and K. U. Ingard, "Theoretical Acoustics", 1968, section 7.4. The
    formula holds in front of the baffle, well beyond ``a² / λ``. Behind it (negative cosine) the value at 90° is kept,
    so that the gain has no step where a path crosses the plane of the baffle.
    """
    cosine = np.clip(np.asarray(cosine, dtype=np.float64), 0.0, 1.0)
    wavenumber = 2.0 * np.pi * np.asarray(frequency, dtype=np.float64) / speed_of_sound
    x = wavenumber * radius * np.sqrt((1.0 - cosine) * (1.0 + cosine))
    near_axis = x < 1e-4  # where 2 J1(x)/x = 1 - x²/8 to 1e-17
    safe = np.where(near_axis, 1.0, x)
    gain: Floats = np.where(near_axis, 1.0 - x**2 / 8.0, 2.0 * scipy.special.j1(safe) / safe)
    return gain


def first_order_gain(cosine: ArrayLike, weight: float) -> Floats:
    """Return the gain of a first-order transducer, 1 on the axis.

    weight: share of the omnidirectional part: 1 omnidirectional, 0.5 cardioid, 0.25 hypercardioid, 0 figure of eight.

    result: gain, 1; negative where the pressure-gradient part outweighs the other from behind.

    ``w + (1 - w) cos θ``: J. Eargle, "The Microphone Book", 2nd ed. 2005, chapter 5, "First-order directional
    microphones". For plane waves on capsules much smaller than the wavelength.

    >>> first_order_gain([1.0, 0.0, -1.0], 0.5).tolist()
    [1.0, 0.5, 0.0]
    """
    gain: Floats = weight + (1.0 - weight) * np.asarray(cosine, dtype=np.float64)
    return gain


def fit_delay(
    points: Floats, frequencies: Floats, values: NDArray[np.complex128], neighbours: NDArray[np.intp]
) -> Floats:
    """Return the delay, linear in the direction, without which complex responses turn the least.

    Shapes: points (n, k); frequencies (F,) Hz; values (n, F); neighbours (m, 2). points: directions: unit vectors (k =
    3), or cosines of the angle from the axis (k = 1). result: ``t``, s: ``values * exp(+2j pi f (t[0] + points @
    t[1:]))`` has the slowest phase. A point source that stands at p (3,) m of the transducer's own frame has ``t[1:] =
    -p / c``.

    Our own derivation: with ``conj(a) b = |a b| exp(-2j pi scale (step @ t))`` for each pair of neighbours, t is linear
    in their phases. Weighted least squares on the phases of products of neighbours, ``conj(a) b``, in frequency and in
    direction, with the products' magnitudes as weights: what is loud decides, and a zero between two lobes does not
    count. Neighbours must differ by less than half a turn.
    """
    some = slice(None, None, -(-values.size // _ENOUGH))
    a, b = neighbours[:: -(-len(neighbours) * len(frequencies) // _ENOUGH)].T
    steps = np.column_stack([np.ones(len(points[some])), points[some]])
    apart = np.column_stack([np.zeros(len(a)), points[b] - points[a]])
    gaps = np.diff(frequencies)

    def products(t: Floats) -> tuple[Any, Any]:
        """Return neighbours' products in frequency and in direction, without the delay t."""
        turn = 2j * np.pi * (t[0] + points @ t[1:])[:, None]
        here, one, other = (values[k] * np.exp(turn[k] * frequencies) for k in (some, a, b))
        return np.conj(here[:, :-1]) * here[:, 1:], np.conj(one) * other

    def stillness(t: Floats) -> float:
        """Return the coherence of neighbours' phases: 1 if they are equal."""
        both = [(p.real.sum(), np.abs(p).sum()) for p in products(t) if p.size]
        return float(np.mean([level / max(total, 1e-300) for level, total in both]))

    nothing = np.zeros(1 + points.shape[1])
    starts = [nothing]
    if len(gaps):  # what all directions turn by between two frequencies
        starts.append(
            nothing - np.eye(len(nothing))[0] * np.angle(products(nothing)[0].sum()) / (2 * np.pi * gaps.mean())
        )
    found = list(starts)
    for start in starts:
        for rounds in _ROUNDS:
            t = start
            for kinds in rounds:
                over_frequency, over_direction = products(t)
                matrix, right = np.zeros((len(t), len(t))), np.zeros(len(t))
                if "f" in kinds:
                    _add(matrix, right, steps, gaps, over_frequency)
                if "d" in kinds:
                    _add(matrix, right, apart, frequencies, over_direction)
                t = t + np.linalg.lstsq(matrix, right)[0]
            found.append(t)
    return max(found, key=stillness)


def _add(matrix: Floats, right: Floats, steps: Floats, scale: Floats, product: Any) -> None:
    """Add the normal equations of ``phase(product) = -2 pi scale (steps @ t)``, product (m, F)."""
    weight = np.abs(product)
    matrix += np.einsum("mi,m,mj->ij", steps, weight @ scale**2, steps)
    right -= steps.T @ ((weight * np.angle(product)) @ scale) / (2.0 * np.pi)
