"""What is heard of a signal by paths whose responses depend on frequency: a sum over its spectrum, term by term."""

from collections.abc import Callable

import numpy as np
from scipy.fft import next_fast_len

import clsim


def heard(
    signal: clsim.Signal, late: np.ndarray, response: Callable[[float], np.ndarray], margin: float = 1e-3
) -> np.ndarray:
    """Return the pressure (T,) from the times since emission `late` (P, T) and responses (P, T) at a frequency.

    Terms of less than 1e-5 of the largest are left out: all of them together are below -90 dB of the signal. Nothing
    is heard `margin` s before and after the signal; the sum is periodic over little more than that.
    """
    rate = signal.sampling_rate
    size = next_fast_len(signal.count + round(3.0 * margin * rate), real=True)
    spectrum = np.fft.rfft(signal.read(0, signal.count), size)
    loud = np.abs(spectrum) > 1e-5 * np.abs(spectrum).max()
    first, last = np.flatnonzero(loud)[[0, -1]]
    sounding = (late > -margin) & (late < signal.duration + margin)
    # From one term to the next each wave turns by the same angle; rounding grows to 1e-12 over 10 000 terms.
    turn = np.exp(2j * np.pi * rate / size * late)
    wave = np.exp(2j * np.pi * rate / size * first * late) * sounding
    out = np.zeros(late.shape[1], complex)
    for k in range(first, last + 1):
        if loud[k]:
            out += spectrum[k] * np.einsum("pt,pt->t", wave, response(k * rate / size))
        wave *= turn
    return 2.0 / size * out.real
