"""Gain of transducers by direction; the cosine is that of the angle off the axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clsim.arrays import Floats


def piston_gain(cosine: ArrayLike, frequency: ArrayLike, radius: float, speed_of_sound: float) -> Floats:
    """Return the far-field gain of a round piston in a baffle, 1 on the axis.

    ``2 J1(k a sin θ) / (k a sin θ)``: P. M. Morse and K. U. Ingard, "Theoretical Acoustics", 1968, section 7.4. The
    formula holds in front of the baffle, well beyond ``a² / λ``. Behind it (negative cosine) the value at 90° is kept,
    so that the gain has no step where a path crosses the plane of the baffle.
    """
    from scipy.special import j1

    cosine = np.clip(np.asarray(cosine, dtype=np.float64), 0.0, 1.0)
    wavenumber = 2.0 * np.pi * np.asarray(frequency, dtype=np.float64) / speed_of_sound
    x = wavenumber * radius * np.sqrt((1.0 - cosine) * (1.0 + cosine))
    near_axis = x < 1e-4  # where 2 J1(x)/x = 1 - x²/8 to 1e-17
    safe = np.where(near_axis, 1.0, x)
    gain: Floats = np.where(near_axis, 1.0 - x**2 / 8.0, 2.0 * j1(safe) / safe)
    return gain


def first_order_gain(cosine: ArrayLike, weight: float) -> Floats:
    """Return the gain of a first-order transducer, 1 on the axis.

    weight: share of the omnidirectional part: 1 omnidirectional, 0.5 cardioid, 0.25 hypercardioid, 0 figure of eight.

    result: gain, 1; negative where the pressure-gradient part outweighs the other from behind.

    ``w + (1 - w) cos θ``: J. Eargle, "The Microphone Book", 2nd ed. 2005, chapter 5, "First-order directional
    microphones". For plane waves on capsules much smaller than the wavelength.

    Examples
    --------
    >>> first_order_gain([1.0, 0.0, -1.0], 0.5).tolist()
    [1.0, 0.5, 0.0]
    """
    gain: Floats = weight + (1.0 - weight) * np.asarray(cosine, dtype=np.float64)
    return gain
