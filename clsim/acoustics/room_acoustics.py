"""Room measures from impulse responses: decay, clarity, speech transmission, lateral energy; Sabine and Eyring."""

from __future__ import annotations

import math

import numpy as np
import scipy

from clsim.arrays import Floats

_HEADROOM_DB = 10.0  # by which noise is to lie below a part of a decay (ISO 3382-1:2009, section 5.3.3)
_LEAST_DB = 15.0  # by which a response falls to its end
_LOUD = 0.1  # s, over which its loudest part is averaged: of noise in low bands it is some dB above the mean
_OWN_FALL = 0.75  # of how far a decay falls in a fifth of a response: what falls less is noise
_INTERVAL = 0.03  # s, over which the first look at a decay is averaged
_PER_TEN_DB = 3  # intervals of later looks
_ABOVE_DB, _LATE_DB = 10.0, 20.0  # above noise, where its late decay begins to be looked at, and over how much
_EVALUATIONS = 5
_FULL = 0.999  # of full scale, from which on a sample of a sound file may be cut off
_EARLIEST, _EARLY = 0.005, 0.08  # s from the direct sound, of early lateral sound
_EARS = 1e-3  # s, by which one ear may be late
SPEECH_BANDS = 125.0 * 2.0 ** np.arange(7)  # Hz, centres of octaves
SPEECH_DB = np.array([2.9, 2.9, -0.8, -6.8, -12.8, -18.8, -24.8])  # of male speech re its A-weighted level
_MODULATIONS = 0.63 * 2.0 ** (np.arange(14) / 3.0)  # Hz
_WEIGHTS = np.array([0.085, 0.127, 0.230, 0.233, 0.309, 0.224, 0.173])
_SHARED = np.array([0.085, 0.078, 0.065, 0.011, 0.047, 0.095])  # redundancy of neighbouring bands
_THRESHOLD_DB = np.array([46.0, 27.0, 12.0, 6.5, 7.5, 8.0, 12.0])  # of reception
_LARGEST_DB = 15.0  # of the apparent ratio of signal to noise


def decay_curve(samples: Floats, noise: float = 0.0, beyond: float = 0.0) -> Floats:
    """Level of the energy that is still to come (n,), dB re all of it; samples (n,).

    noise, beyond: power of the noise, which is taken off, and energy after the last sample, see `before_noise`.

    The backward integral of the squared response (ISO 3382-1:2009, section 5.3.3; M. R. Schroeder, "New method of
    measuring reverberation time", J. Acoust. Soc. Am. 37, 1965, eq. 2).
    """
    energy = np.maximum(np.cumsum((np.square(samples) - noise)[::-1])[::-1] + beyond, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(energy / max(float(energy[0]), np.finfo(float).tiny)))


def reverberation_time(curve: Floats, sampling_rate: float, first_db: float, last_db: float) -> float:
    """Return the time in which a decay falls by 60 dB, from a part of it; curve (n,) dB.

    first_db, last_db: where the part begins and ends, below 0: -5 and -25 dB for T20, -5 and -35 dB for T30.

    By a line of least squares through the part (ISO 3382-1:2009, section 5.3.3).
    """
    reached = np.flatnonzero(curve <= last_db)
    if not len(reached):
        return math.nan
    part = np.flatnonzero((curve[: reached[0]] <= first_db) & np.isfinite(curve[: reached[0]]))
    if len(part) < 2:
        return math.nan
    slope = float(np.polyfit(part / sampling_rate, curve[part], 1)[0])
    return -60.0 / slope if slope < 0.0 else math.nan


def before_noise(samples: Floats, sampling_rate: float) -> tuple[int, float, float]:
    """Count of samples (n,) before steady noise covers the decay, its power, and the decay's energy after them.

    All samples, 0 and 0 where the response decays to its end. By truncation, subtraction and correction (M. Guski, M.
    Vorländer, "Comparison of noise compensation methods for room acoustic impulse response evaluations", Acta Acustica
    united with Acustica 100, 2014), where a line through the late decay meets the noise, by the
    iteration of A. Lundeby, T. E. Vigran, H. Bietz, M. Vorländer, "Uncertainties of measurements in room acoustics",
    Acustica 81, 1995, section 3. The last tenth is taken for noise unless it lies below a fifth of the response
    earlier by 3/4 of such a decay's fall.

    >>> decay = 10.0 ** (-3.0 * np.arange(2000) / 1e3)  # 60 dB in a second
    >>> before_noise(decay, 1e3), before_noise(decay + 0.01, 1e3)[0] < 900
    ((2000, 0.0, 0.0), True)
    """
    power, count = np.square(samples), len(samples)
    tenth = max(count // 10, 1)
    noise, earlier = float(np.mean(power[-tenth:])), float(np.mean(power[-3 * tenth : -2 * tenth]))
    slope = _late_slope(power, sampling_rate, noise, _INTERVAL, np.inf)
    if noise == 0.0 or slope is None:
        return count, 0.0, 0.0
    if noise < earlier * 10.0 ** (0.1 * _OWN_FALL * slope[0] * 0.2 * count / sampling_rate):
        return count, 0.0, 0.0
    for _ in range(_EVALUATIONS):
        fall, crossing = slope
        steady = min(round((crossing - _ABOVE_DB / fall) * sampling_rate), count - tenth)
        noise = float(np.mean(power[max(steady, 0) :]))
        found = _late_slope(power, sampling_rate, noise, -10.0 / fall / _PER_TEN_DB, _ABOVE_DB + _LATE_DB)
        if found is None:
            break
        slope = found
    fall, crossing = slope
    last = min(max(round(crossing * sampling_rate), 1), count)
    return last, noise, noise * sampling_rate * -10.0 / (math.log(10.0) * fall)


def _late_slope(
    power: Floats, sampling_rate: float, noise: float, interval: float, highest_db: float
) -> tuple[float, float] | None:
    """Slope of a decay's level above noise, dB/s, and when it reaches the noise, s; None where it does not fall."""
    length = max(round(interval * sampling_rate), 1)
    means = power[: len(power) // length * length].reshape(-1, length).mean(axis=1)
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(means / max(noise, np.finfo(float).tiny))
    first = int(np.argmax(level)) if len(level) else 0
    under = np.flatnonzero(level[first:] < _ABOVE_DB)
    last = first + int(under[0]) if len(under) else len(level)
    part = first + np.flatnonzero(level[first:last] <= highest_db)
    if len(part) < 2:
        return None
    times = (part + 0.5) * length / sampling_rate
    fall, start = np.polyfit(times, level[part], 1)
    return (float(fall), float(-start / fall)) if fall < 0.0 else None


def has_decay_range(
    curve: Floats, sampling_rate: float, last_db: float, found: float, *, noisy: bool, fall_db: float
) -> bool:
    """Test whether a decay curve (n,), dB, of a reverberation time, s, reaches so far that the time can be told.

    Where the response ends in noise, this has to lie 10 dB below `last_db` (ISO 3382-1:2009, section 5.3.3). Elsewhere
    the response itself has to fall by as much, and by 15 dB: the curve of steady noise falls as well.
    """
    if noisy:
        return bool(curve[-1] <= last_db - _HEADROOM_DB)
    return -last_db / 60.0 * found <= len(curve) / sampling_rate and fall_db >= max(-last_db, _LEAST_DB)


def level_fall(samples: Floats, sampling_rate: float) -> float:
    """Compute by how much the last tenth of a response (n,) is below the loudest 0.1 s of it, dB.

    Our own derivation.
    """
    power, length = np.square(samples), max(min(round(_LOUD * sampling_rate), len(samples)), 1)
    means = power[: len(power) // length * length].reshape(-1, length).mean(axis=1)
    loudest, last = float(means.max(initial=0.0)), float(np.mean(power[-max(len(power) // 10, 1) :]))
    return 10.0 * math.log10(loudest / last) if loudest > 0.0 and last > 0.0 else math.inf


def is_clipped(samples: Floats) -> bool:
    """Test whether three samples (n,) in a row are at full scale: 1, or the peak of a file of floats beyond 1."""
    full = np.abs(samples) >= _FULL * max(1.0, float(np.abs(samples).max(initial=0.0)))
    return bool(np.any(full[2:] & full[1:-1] & full[:-2]))


def centre_time(samples: Floats, sampling_rate: float, begin: int = 0) -> float:
    """Centre of gravity of the squared response, s from a sample, that of the direct sound; samples (n,).

    ISO 3382-1:2009, annex A.2.4.
    """
    power = np.square(samples)
    whole = float(power.sum())
    return float((np.arange(len(power)) - begin) @ power) / sampling_rate / whole if whole > 0.0 else math.nan


def clarity(samples: Floats, split: int) -> float:
    """Return the level of early energy over late energy, dB; samples (n,). ISO 3382-1:2009, annex A.2.3."""
    early, late = float(np.sum(np.square(samples[:split]))), float(np.sum(np.square(samples[split:])))
    if late == 0.0:
        return math.inf
    return 10.0 * math.log10(early / late) if early > 0.0 else -math.inf


def definition(samples: Floats, split: int) -> float:
    """Return the share of early energy in all energy; samples (n,). ISO 3382-1:2009, annex A.2.3."""
    whole = float(np.sum(np.square(samples)))
    return float(np.sum(np.square(samples[:split]))) / whole if whole > 0.0 else math.nan


def sabine_time(volume: float, absorption_area: Floats, air: Floats, speed_of_sound: float) -> Floats:
    """Return the reverberation time of a diffuse field by Sabine, s; absorption_area (F,) m²; air (F,).

    ``24 ln(10) V / (c (A + 4 m V))`` (H. Kuttruff, "Room Acoustics", 6th edition, 2016, eq. 5.25).
    """
    loss = speed_of_sound * (absorption_area + 4.0 * air * volume)
    with np.errstate(divide="ignore"):
        return np.asarray(24.0 * math.log(10.0) * volume / loss)


def eyring_time(volume: float, surface: float, absorption_area: Floats, air: Floats, speed_of_sound: float) -> Floats:
    """Return the reverberation time of a diffuse field by Eyring, s; absorption_area (F,) m²; air (F,).

    Sabine's with ``-S ln(1 - A / S)`` in place of A (H. Kuttruff, "Room Acoustics", 6th edition, 2016, eq. 5.24).
    """
    with np.errstate(divide="ignore"):
        area = -surface * np.log1p(-np.minimum(absorption_area / surface, 1.0))
    return sabine_time(volume, area, air, speed_of_sound)


def absorption_for(seconds: Floats, volume: float, surface: float, speed_of_sound: float = 343.2) -> Floats:
    """Return the absorption coefficients of walls with which Eyring's time of a room, without its air, is `seconds`.

    ``1 - exp(-24 ln(10) V / (c S T))``, solved for the absorption (H. Kuttruff, "Room Acoustics", 6th edition, 2016,
    eq. 5.24).
    """
    return -np.expm1(-24.0 * math.log(10.0) * volume / (speed_of_sound * surface * np.asarray(seconds)))


def lateral_fractions(omni: Floats, eight: Floats, sampling_rate: float, begin: int = 0) -> tuple[float, float]:
    """Early lateral energy fractions LF and LFC of responses (n,) whose direct sound is at a sample, `begin`.

    omni: of an omnidirectional microphone. eight: of a figure of eight, of the same sensitivity on its axis, whose null
    points at the source.

    ``∫ p_L²`` and ``∫ |p_L p|`` from 5 to 80 ms over ``∫ p²`` up to 80 ms (ISO 3382-1:2009, annex A).
    """
    first, last = (begin + round(seconds * sampling_rate) for seconds in (_EARLIEST, _EARLY))
    whole = float(np.sum(np.square(omni[:last])))
    if whole == 0.0:
        return math.nan, math.nan
    lateral = float(np.sum(np.square(eight[first:last])))
    return lateral / whole, float(np.sum(np.abs(eight[first:last] * omni[first:last]))) / whole


def interaural_correlation(left: Floats, right: Floats, sampling_rate: float) -> float:
    """Interaural cross-correlation coefficient IACC of responses (n,) of both ears, 0 to 1.

    ISO 3382-1:2009, annex B: the largest magnitude of the normalised correlation within 1 ms.
    """
    scale = math.sqrt(float(np.sum(np.square(left))) * float(np.sum(np.square(right))))
    if scale == 0.0:
        return math.nan
    size, most = scipy.fft.next_fast_len(2 * len(left), real=True), int(_EARS * sampling_rate)
    correlation = scipy.fft.irfft(np.conj(scipy.fft.rfft(left, size)) * scipy.fft.rfft(right, size), size)
    return float(np.abs(np.append(correlation[: most + 1], correlation[size - most :])).max()) / scale


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
