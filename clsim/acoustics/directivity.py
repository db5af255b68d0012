"""Gain of transducers by direction; the cosine is that of the angle off the axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clsim.arrays import Floats


def piston_gain(cosine: ArrayLike, frequency: ArrayLike, radius: float, speed_of_sound: float) -> Floats:
    """Return the far-field gain of a round piston in a baffle, 1 on the axis.

    Parameters
    ----------
    cosine : array_like (...)
        Cosine of the angle between axis and direction, -1 to 1.
    frequency : array_like (...)
        Frequency, Hz; broadcasts against `cosine`.
    radius : float
        Radius of the piston, m.
    speed_of_sound : float
        Speed of sound, m/s.

    Returns
    -------
    ndarray (...)
        Gain, 1; negative in every other side lobe.

    Notes
    -----
    ``2 J1(k a sin θ) / (k a sin θ)``: P. M. Morse and K. U. Ingard, "Theoretical Acoustics", 1968,
    section 7.4. The formula holds in front of the baffle, well beyond ``a² / λ``. Behind it (negative cosine) the value
    at 90° is kept, so that the gain has no step where a path crosses the plane of the baffle.

    Examples
    --------
    >>> angle = np.radians([0.0, 40.0])  # on the axis, and at -6 dB of a piston of 4.7 mm at 40 kHz
    >>> (20 * np.log10(piston_gain(np.cos(angle), 40e3, 0.0047, 344.0))).round(1).tolist()
    [0.0, -6.0]
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

    Parameters
    ----------
    cosine : array_like (...)
        Cosine of the angle between axis and direction, -1 to 1.
    weight : float
        Share of the omnidirectional part: 1 omnidirectional, 0.5 cardioid, 0.25 hypercardioid, 0 figure
        of eight.

    Returns
    -------
    ndarray (...)
        Gain, 1; negative where the pressure-gradient part outweighs the other from behind.

    Notes
    -----
    ``w + (1 - w) cos θ``: J. Eargle, "The Microphone Book", 2nd ed. 2005, chapter 5,
    "First-order directional microphones". For plane waves on capsules much smaller than the wavelength.

    Examples
    --------
    >>> first_order_gain([1.0, 0.0, -1.0], 0.5).tolist()
    [1.0, 0.5, 0.0]
    """
    gain: Floats = weight + (1.0 - weight) * np.asarray(cosine, dtype=np.float64)
    return gain
