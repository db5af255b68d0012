"""Room measures from impulse responses: decay, clarity, and reverberation by Sabine and Eyring."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats

_NOISE_SHARE = 0.25  # of the energy at the end of a decay, up to which a reverberation time is right within 5 %
_OWN_FALL = 0.75  # of how far a decay falls in a fifth of a response: what falls less is noise


def decay_curve(samples: Floats) -> Floats:
    """Return the level of the energy that is still to come (n,), dB re all of it; samples (n,).

    The backward integral of the squared response (ISO 3382-1:2009, section 5.3.3; M. R. Schroeder, "New method of
    measuring reverberation time", J. Acoust. Soc. Am. 37, 1965, eq. 2).
    """
    energy = np.cumsum(np.square(samples)[::-1])[::-1]
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


def has_decay_range(samples: Floats, sampling_rate: float, last_db: float, found: float) -> bool:
    """Test whether a response decays by a reverberation time, rather than ends in noise; samples (n,).

    result: false where a decay of that time does not fall to `last_db` within the response, or where the response ends
    in steady noise that makes up a quarter of the energy that is still to come at `last_db`.

    Our own test, for ISO 3382-1:2009, section 5.3.3, which asks for noise at least 10 dB below `last_db`. The last
    tenth is taken for noise where it is below a fifth of the response earlier by less than 3/4 of such a decay's fall.

    Examples
    --------
    >>> decay = 10.0 ** (-3.0 * np.arange(2000) / 1e3)  # 60 dB in a second
    >>> has_decay_range(decay, 1e3, -35.0, 1.0), has_decay_range(decay + 0.02, 1e3, -35.0, 1.5)
    (True, False)
    """
    power, duration = np.square(samples), len(samples) / sampling_rate
    if -last_db / 60.0 * found > duration:
        return False
    tenth = max(len(power) // 10, 1)
    noise, before = float(np.mean(power[-tenth:])), float(np.mean(power[-3 * tenth : -2 * tenth]))
    if noise < before * 10.0 ** (-_OWN_FALL * 6.0 * 0.2 * duration / found):
        return True
    energy = np.cumsum(power[::-1])[::-1]
    there = int(np.argmax(energy <= energy[0] * 10.0 ** (last_db / 10.0)))
    return noise * (len(power) - there) <= _NOISE_SHARE * float(energy[there])


def clarity(samples: Floats, split: int) -> float:
    """Return the level of early energy over late energy, dB; samples (n,).

    ISO 3382-1:2009, annex A.2.3.
    """
    early, late = float(np.sum(np.square(samples[:split]))), float(np.sum(np.square(samples[split:])))
    if late == 0.0:
        return math.inf
    return 10.0 * math.log10(early / late) if early > 0.0 else -math.inf


def definition(samples: Floats, split: int) -> float:
    """Return the share of early energy in all energy; samples (n,).

    ISO 3382-1:2009, annex A.2.3.
    """
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
