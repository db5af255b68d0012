"""Complex baseband: the request, its checks, and the block lengths that follow from it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clsim.arrays import Floats, as_number
from clsim.errors import InputError, warn
from clsim.scene.scene import Scene
from clsim.scene.signal.signal import Signal
from clsim.scene.transducer import Electronics
from clsim.tracks.tracks import Tracks

_BLOCKS_IN_SEGMENT = 12  # of the longest; all others go into it a whole number of times, too
SUBBLOCK = 8  # samples, the unit of blocks and of what is silent
WIDEST_SUBBLOCK = 16  # samples that share the whole part of a delay at most
LONG_ENVELOPE_BLOCK = 64  # samples, blocks from which on these are summed with few terms of the polynomials
SLOW_CHANGE = 3.5e-5  # s, of a delay over a vector of the envelope, up to which few terms ask for no shorter blocks
WIDEST = 0.94  # of the sampling rate of envelopes, the widest band that is rendered at it
USUAL = 0.8  # the same where no rate is requested: delay filters and upsampling are short
CYCLES = 16  # of the carrier in a sample at most: float32 phases are then right to -110 dB
_LONGEST, _SHORTEST = 50e-3, 0.5e-3  # s, of blocks
_DRIFT = 24.0  # cycles of the carrier by which a delay may change in a block: float32 terms are right to -110 dB
_REFUSED_DB, _LOUD_DB = -40.0, -60.0  # shares of a signal's energy outside the band
_RAMP = 6  # samples that a transition should take


class Baseband(NamedTuple):
    """A band about a carrier whose complex envelope is rendered, instead of the sound itself.

    Attributes
    ----------
    carrier : float
        Hz.
    bandwidth : float
        Width of the band about the carrier, both sides together, that holds what the receivers hear: the signals and
        their Doppler shifts, Hz.
    sampling_rate : float or None
        Sampling rate of the envelopes, Hz: that of the signals over a whole number, and at least 1.07 times the
        bandwidth. Left out: the lowest of these that is a whole number of Hz, and at least 1.25 times the bandwidth and
        a 16th of the carrier.

    Examples
    --------
    >>> as_baseband((40e3, 4e3), 192e3)
    Baseband(carrier=40000.0, bandwidth=4000.0, sampling_rate=6000.0)
    """

    carrier: float
    bandwidth: float
    sampling_rate: float | None = None


def as_baseband(value: object, rate: float) -> Baseband:
    """Return the checked request with its sampling rate, for signals of the sampling rate `rate`, Hz."""
    if not isinstance(value, tuple | list) or len(value) not in (2, 3):
        raise InputError("baseband", f"must be a carrier and a bandwidth, Hz, but is {value!r:.80}")
    carrier = as_number("baseband.carrier", value[0], above=0.0, below=0.5 * rate, unit="Hz")
    most = min(carrier, rate - 2.0 * carrier)
    bandwidth = as_number("baseband.bandwidth", value[1], above=0.0, unit="Hz")
    if bandwidth > most:
        raise InputError(
            "baseband.bandwidth",
            f"must be at most {most:g} Hz, for the band to lie between half the carrier of {carrier:g} Hz and half the "
            f"sampling rate of {rate:g} Hz, but is {bandwidth:g} Hz",
        )
    if len(value) == 3 and value[2] is not None:
        return Baseband(carrier, bandwidth, _given_rate(value[2], rate, bandwidth / WIDEST))
    return Baseband(carrier, bandwidth, rate / _decimation(rate, max(bandwidth / USUAL, carrier / CYCLES)))


def _given_rate(value: object, rate: float, least: float) -> float:
    field = "baseband.sampling_rate"
    given = as_number(field, value, at_least=least, at_most=rate, unit="Hz")
    every = round(rate / given)
    if abs(rate / given - every) > 1e-9 * every:
        near = ", ".join(f"{rate / n:.9g}" for n in (every + 1, every, every - 1) if n > 0 and rate / n >= least)
        raise InputError(field, f"must be {rate:g} Hz over a whole number, such as {near} Hz, but is {given:g} Hz")
    return rate / every


def _decimation(rate: float, least: float) -> int:
    """Return the largest whole number by which a rate can be divided; whole Hz go before a lower rate."""
    most = max(1, math.floor(rate / least * (1.0 + 1e-12)))
    whole = [n for n in range(most, (most + 1) // 2, -1) if (rate / n).is_integer()]
    return whole[0] if whole else most


def half_band(
    index: int, signal: Signal, spectrum: tuple[Floats, Floats], baseband: Baseband, max_rate: float
) -> tuple[float, float]:
    """Return the largest offset of an emitted frequency from the carrier, Hz, and the signal's share beyond it, dB.

    An emitted frequency f is received within ``f (1 +- max_rate)``: all are within ``bandwidth / 2`` of the carrier if
    ``|f - carrier| (1 + max_rate) <= bandwidth / 2 - carrier max_rate``.
    """
    carrier, bandwidth, _ = baseband
    shift = carrier * max_rate
    if 0.5 * bandwidth <= shift:
        raise InputError(
            "baseband.bandwidth",
            f"must be above {2.0 * shift:.4g} Hz, twice the Doppler shift of the carrier by source {index} at up to "
            f"{max_rate:.3g} s/s, but is {bandwidth:g} Hz",
        )
    half = (0.5 * bandwidth - shift) / (1.0 + max_rate)
    frequencies, energy = spectrum
    total = float(energy.sum())
    share = float(energy[np.abs(frequencies - carrier) > half].sum()) / total if total > 0.0 else 0.0
    outside_db = 10.0 * math.log10(share) if share > 0.0 else -math.inf
    outside = (
        f"{outside_db:.0f} dB of the energy of signals[{index}] lies outside {carrier - half:.0f} to "
        f"{carrier + half:.0f} Hz, the bandwidth of {bandwidth:g} Hz less Doppler shifts of up to {shift:.0f} Hz"
    )
    if outside_db > _REFUSED_DB:
        low, high = signal.band()
        raise InputError(
            "baseband",
            f"must hold the signals but for {_REFUSED_DB:g} dB of their energy, but {outside}; 99 % of it lies between "
            f"{low:.0f} and {high:.0f} Hz",
        )
    if outside_db > _LOUD_DB:
        warn(f"baseband: {outside}, and is removed; widen it, or fade the signal")
    return half, outside_db


def blocks_of(sampling_rate: float, carrier: float, max_rate: float) -> tuple[int, ...]:
    """Return the lengths of blocks, samples, from the longest that motion allows: powers of two, and thrice those."""
    longest = max(SUBBLOCK, sampling_rate * min(_LONGEST, _DRIFT / (carrier * max(max_rate, 1e-12))))
    shortest = max(SUBBLOCK, min(_SHORTEST * sampling_rate, longest))
    powers = [WIDEST_SUBBLOCK * 2**k for k in range(24)]
    blocks = sorted(b for b in (SUBBLOCK, *powers, *(3 * p for p in powers)) if b <= longest)
    return tuple(b for b in reversed(blocks) if b >= shortest or b == blocks[-1])


def check_ends(scene: Scene) -> None:
    """Refuse receivers whose transducer or electronics work on the sound itself."""
    for i, receiver in enumerate(scene.receivers):
        if receiver.transducer is not None:
            raise InputError(
                f"receivers[{i}].transducer",
                "must be left out in baseband, where complex sound pressure is rendered; render without baseband",
            )
        ends = receiver.electronics
        if ends is not None and replace(ends, clock_ppm=0.0, clock_offset=0.0) != Electronics():
            raise InputError(
                f"receivers[{i}].electronics",
                "must be no more than a clock in baseband: noise, cuts, gain and converter work on the sound itself; "
                "render without baseband",
            )


def segmented(tracks: Tracks, sampling_rate: float, carrier: float) -> tuple[int, tuple[int, ...]]:
    """Return the lengths of segments and blocks, samples; warn where paths begin or end faster than envelopes can."""
    samples = tracks.transition * sampling_rate
    if samples < _RAMP and any(pair.fades for pair in tracks.pairs):
        warn(
            f"transition: paths begin and end within {samples:.1f} samples of the envelopes at {sampling_rate:g} Hz, "
            f"which aliases; {_RAMP / sampling_rate:.2g} s or more does not"
        )
    fastest = max(tracks.max_rate(source) for source in range(tracks.source_count))
    blocks = blocks_of(sampling_rate, carrier, fastest)
    return segment_of(blocks), blocks


def segment_of(blocks: tuple[int, ...]) -> int:
    """Return the length of segments of blocks of these lengths, samples."""
    return _BLOCKS_IN_SEGMENT * blocks[0]
