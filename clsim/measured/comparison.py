"""A measured impulse response against that of a scene: delay and gain between them, and reflections one by one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clsim.arrays import Floats, read_only
from clsim.errors import InputError
from clsim.impulse_responses import ImpulseResponses
from clsim.numerics.convolution import band_taper
from clsim.paths.path_table import PathTable

_ALIKE = 0.2  # correlation coefficient with the images, below which responses are aligned by their beginnings
_ONSET_DB = -20.0  # re the largest sample, at which a measured response begins (ISO 3382-1:2009, annex A.2.1)
_ABOUT = 0.25e-3  # s, on either side of a path's delay within which its sound is looked for
_BEFORE = 0.01  # s, of silence that is kept before the first arrival


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """A measured response on the time axis of a simulated one."""

    responses: ImpulseResponses  # (1, 1, n) the measured one, moved and scaled
    delay: float  # by which time 0 comes after the first sample of the measured one, s
    gain: float  # of the measured one over the simulated one; negative if its polarity is the other
    correlation: float  # coefficient of both over the images
    by_onset: bool  # whether the delay is that of the beginnings, as the responses are not alike


@dataclass(frozen=True, slots=True, eq=False)
class Reflection:
    """A path and the sound about its delay."""

    delay: float  # s
    order: int
    objects: str  # what it is reflected by
    simulated_db: float  # energy about its delay re that about the first path's
    measured_db: float


def align(measured: Floats, simulated: ImpulseResponses, images: ImpulseResponses) -> Aligned:
    """Move a measured response (n,) to the time axis of a simulated one (1, 1, m), and scale it.

    The delay is where the correlation with the images is largest in magnitude, between samples by a parabola; the gain
    is by least squares there. Where the coefficient is below 0.2, both are by the beginnings and the energies.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    rate, known = simulated.sampling_rate, images.samples[0, 0]
    size = next_fast_len(len(measured) + len(known), real=True)
    frequencies = np.arange(size // 2 + 1, dtype=np.float64) * (rate / size)
    low, high = simulated.band
    taper = band_taper(frequencies, low, high, min(low, 0.5 * (high - low)), min(0.5 * rate - high, 0.5 * (high - low)))
    spectrum = rfft(measured, size) * taper
    found = irfft(spectrum * np.conj(rfft(known, size)), size)
    # Both have their own sample of time 0; all is moved to that of the simulated one.
    apart, energy = simulated.lead - images.lead, float(np.sum(np.square(known)))
    at = _peak(found)
    shift = at - apart
    kept = irfft(spectrum * np.exp(2j * np.pi * frequencies * shift / rate), size)
    alike = np.roll(kept, -apart)[: len(known)]
    correlation = float(found[round(at) % size]) / np.sqrt(energy * max(float(alike @ alike), 1e-300))
    gain = float(alike @ known) / energy
    by_onset = abs(correlation) < _ALIKE
    if by_onset:
        loud = np.abs(measured) >= np.abs(measured).max() * 10.0 ** (_ONSET_DB / 20.0)
        first = simulated.lead + float(simulated.first_arrivals[0, 0]) * rate
        shift = float(np.argmax(loud)) - first
        kept = irfft(spectrum * np.exp(2j * np.pi * frequencies * shift / rate), size)
        whole = float(np.sum(np.square(simulated.samples)))
        gain = float(np.sqrt(np.sum(np.square(kept)) / whole))
    count = max(1, min(size, len(measured) - int(np.floor(shift))))
    before = max(0, simulated.lead + int(float(simulated.first_arrivals[0, 0]) * rate) - int(_BEFORE * rate))
    kept[:before] = 0.0
    taps = read_only((kept[:count] / gain)[None, None])
    return Aligned(replace(simulated, samples=taps), (shift + simulated.lead) / rate, gain, correlation, by_onset)


def reflections(
    table: PathTable, simulated: ImpulseResponses, measured: ImpulseResponses, until: float
) -> list[Reflection]:
    """List paths up to a delay, s, by time, with the energies about their delays in both responses, dB re the first.

    Paths that arrive within 0.5 ms of each other share their sound.
    """
    rows = [int(p) for p in np.argsort(table.delay[:, 0]) if table.audible[p, 0] and table.delay[p, 0] <= until]
    found: list[Reflection] = []
    first = np.ones(2)
    for row in rows:
        delay = float(table.delay[row, 0])
        energies = np.array([_about(response, delay) for response in (simulated, measured)])
        if not found:
            first = np.maximum(energies, 1e-300)
        levels = 10.0 * np.log10(np.maximum(energies / first, 1e-30))
        found.append(
            Reflection(delay, int(table.order[row]), table.name_objects(row), float(levels[0]), float(levels[1]))
        )
    return found


def _peak(found: Floats) -> float:
    """Place of the largest magnitude of a cyclic correlation (n,), between samples; negative in its second half."""
    size, at = len(found), int(np.abs(found).argmax())
    before, here, after = (abs(float(found[(at + i) % size])) for i in (-1, 0, 1))
    bent = before - 2.0 * here + after
    place = at + (0.5 * (before - after) / bent if bent < 0.0 else 0.0)
    return place if place < size / 2 else place - size


def _about(response: ImpulseResponses, delay: float) -> float:
    """Energy of a response about a delay, s."""
    middle = response.lead + delay * response.sampling_rate
    half = _ABOUT * response.sampling_rate
    first, last = max(0, round(middle - half)), round(middle + half) + 1
    return float(np.sum(np.square(response.samples[0, 0, first:last])))


def checked(samples: Floats, rate: float, path: object) -> Floats:
    """Check a measured response (n,): not silent, 50 ms at least."""
    if not np.any(samples):
        raise InputError(str(path), "must hold a response, but is silent")
    if len(samples) < 0.05 * rate:
        raise InputError(str(path), f"must hold 50 ms at least, but holds {1e3 * len(samples) / rate:.3g} ms")
    return np.asarray(samples, dtype=np.float64)
