"""Speech transmission index of an impulse response, by IEC 60268-16:2020, male speech."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats

SPEECH_BANDS = 125.0 * 2.0 ** np.arange(7)  # Hz, centres of octaves
SPEECH_DB = np.array([2.9, 2.9, -0.8, -6.8, -12.8, -18.8, -24.8])  # of male speech re its A-weighted level
_MODULATIONS = 0.63 * 2.0 ** (np.arange(14) / 3.0)  # Hz
_WEIGHTS = np.array([0.085, 0.127, 0.230, 0.233, 0.309, 0.224, 0.173])
_SHARED = np.array([0.085, 0.078, 0.065, 0.011, 0.047, 0.095])  # redundancy of neighbouring bands
_THRESHOLD_DB = np.array([46.0, 27.0, 12.0, 6.5, 7.5, 8.0, 12.0])  # of reception
_LARGEST_DB = 15.0  # of the apparent ratio of signal to noise


def modulation_transfer(power: Floats, sampling_rate: float) -> Floats:
    """Modulation transfer (14,) of a squared response (n,) in a band, at 0.63 to 12.5 Hz.

    ``|∫ h² exp(-2 π j F t)| / ∫ h²`` (M. R. Schroeder, "Modulation transfer functions: definition and measurement",
    Acustica 49, 1981; IEC 60268-16:2020, section 6.1).
    """
    times = np.arange(len(power)) / sampling_rate
    turned = np.exp(-2j * np.pi * np.multiply.outer(_MODULATIONS, times))
    return np.asarray(np.abs(turned @ power) / max(float(power.sum()), np.finfo(float).tiny))


def transmission_index(
    transfer: Floats, speech_db: Floats | None = None, noise_db: Floats | None = None
) -> tuple[float, Floats]:
    """Speech transmission index, 0 to 1, and the transfer indices of the octaves (7,).

    transfer: modulation transfer (7, 14) of the room by octave of `SPEECH_BANDS`. speech_db, noise_db: levels (7,) by
    octave at the listener, dB SPL; without those of speech neither masking nor the threshold of hearing counts.

    IEC 60268-16:2020, annex A (weights of its table A.1, index A.2.1, noise A.2.3, masking A.4.2, threshold A.4.3).
    """
    shares = np.ones(7)
    if speech_db is not None:
        noise = np.full(7, -np.inf) if noise_db is None else noise_db
        intensity, disturbing = 10.0 ** (0.1 * speech_db), 10.0 ** (0.1 * noise)
        total = intensity + disturbing
        level = 10.0 * np.log10(total[:-1])
        ranges = [level < 63.0, level < 67.0, level < 100.0]
        masked_db = np.select(ranges, [0.5 * level - 65.0, 1.8 * level - 146.9, 0.5 * level - 59.8], -10.0)
        masking = np.append(0.0, total[:-1] * 10.0 ** (0.1 * masked_db))
        shares = intensity / (total + masking + 10.0 ** (0.1 * _THRESHOLD_DB))
    known = np.clip(transfer * shares[:, None], 1e-9, 1.0 - 1e-9)
    ratio = np.clip(10.0 * np.log10(known / (1.0 - known)), -_LARGEST_DB, _LARGEST_DB)
    by_band = np.mean((ratio + _LARGEST_DB) / (2.0 * _LARGEST_DB), axis=1)
    index = _WEIGHTS @ by_band - _SHARED @ np.sqrt(by_band[:-1] * by_band[1:])
    return min(float(index), 1.0), np.asarray(by_band)
