"""Resonators and minimum-phase filters."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from clsim.arrays import Floats


def resonance_response(frequency: ArrayLike, centre: float, width: float) -> NDArray[np.complex128]:
    """Return the response of a second-order band-pass, 1 at its centre.

    Our own derivation, from ``H = 1 / (1 + j Q (f/f0 - f0/f))``: where ``|H| = 1/2``, ``Q |f/f0 - f0/f| = sqrt(3)``;
    these two frequencies have the product f0² and the difference ``sqrt(3) f0 / Q``, so that ``Q = sqrt(3) f0 /
    width``. Oscillations decay as ``exp(-pi f0 t / Q)``: with the time constant ``sqrt(3) / (pi width)``.
    """
    f = np.asarray(frequency, dtype=np.float64)
    quality = math.sqrt(3.0) * centre / width
    with np.errstate(divide="ignore"):
        detuning = f / centre - centre / f
    return np.where(f > 0.0, 1.0 / (1.0 + 1j * quality * np.where(f > 0.0, detuning, 0.0)), 0.0)


def resonance_taps(centre: float, width: float, sampling_rate: float) -> Floats:
    """Return the impulse response of `resonance_response` at a sampling rate, until it is -130 dB.

    Our own derivation: a recursive filter with the band-pass's poles, ``exp(s / sampling_rate)``, so that it rings
    exactly as long, and five zeros: one at 0 Hz, and the others such that the complex response is right at both
    frequencies where its magnitude is 1/2. With five samples in a period it is right within 0.7 dB and 8 degrees from
    0.25 to 1.5 times the centre, and within 2.5 dB below 0.95 of half the sampling rate.
    """
    from scipy.signal import lfilter

    decay = math.pi * width / math.sqrt(3.0)  # 1/s
    pole = np.exp((-decay + 1j * math.sqrt((2.0 * math.pi * centre) ** 2 - decay**2)) / sampling_rate)
    recursion = np.array([1.0, -2.0 * pole.real, abs(pole) ** 2])
    middle = math.hypot(centre, 0.5 * width)
    sides = np.array([middle - 0.5 * width, middle + 0.5 * width])
    z = np.exp(-2j * math.pi * sides / sampling_rate)
    wanted = (z[:, None] ** np.arange(3) @ recursion) * resonance_response(sides, centre, width)
    powers = (1.0 - z[:, None]) * z[:, None] ** np.arange(4)
    rest = np.linalg.solve(np.concatenate([powers.real, powers.imag]), np.concatenate([wanted.real, wanted.imag]))
    impulse = np.zeros(math.ceil(15.0 * sampling_rate / decay) + 8)
    impulse[0] = 1.0
    return np.asarray(lfilter(np.convolve([1.0, -1.0], rest), recursion, impulse), dtype=np.float64)


def minimum_phase(magnitude: Floats) -> Floats:
    """Return the minimum-phase impulse response with given magnitudes; magnitude (n / 2 + 1,).

    magnitude: above 0, from 0 Hz to half the sampling rate, evenly spaced; n a power of two.

    result: its spectrum has exactly these magnitudes; it is causal as far as n is long enough.

    The cepstrum is folded: A. V. Oppenheim and R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed. 2010, chapter
    13.
    """
    from scipy.fft import irfft, rfft

    cepstrum = irfft(np.log(magnitude))
    half = len(cepstrum) // 2
    cepstrum[1:half] *= 2.0
    cepstrum[half + 1 :] = 0.0
    return np.asarray(irfft(np.exp(rfft(cepstrum)), len(cepstrum)), dtype=np.float64)
