"""Complex envelopes of emitted signals, and the filters that delay them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.interpolation import design_bandlimited
from clsim.errors import InputError
from clsim.render.baseband import GROUP, blocks_of
from clsim.render.emission import Emission
from clsim.render.interpolator import Bandlimited, Bank

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.render.baseband import Baseband
    from clsim.render.basis import Basis
    from clsim.render.interpolator import Interpolator
    from clsim.scene.signal import Signal

_MARGIN_DB = 10.0  # by which the low-pass is better than the delay filters
_NARROWEST = 0.05  # of half the sampling rate, the least band of the delay filters
_ROWS = 8192  # samples of envelopes made at a time


@dataclass(frozen=True, slots=True, eq=False)
class EnvelopeEmission(Emission):
    """One source's complex envelope and the filters for it; what is removed lies outside the band on either side.

    Attributes
    ----------
    carrier : float
        Hz.
    every : int
        Samples of the signal in one of the envelope.
    reach : int
        Samples of the envelope by which `mixers` look to either side.
    mixers : ndarray (every, K 2 reach 2)
        Taps that mix the signal down, low-pass it and apply a function of the basis: by function, sample of the
        envelope, and real and imaginary part.
    half : float
        Frequencies off the carrier that are held, Hz.
    """

    carrier: float
    every: int
    reach: int
    mixers: Floats
    half: float

    @property
    def cycles(self) -> float:
        """Of the carrier in one sample of the envelope."""
        return self.carrier * self.every / self.signal.sampling_rate

    @property
    def turn(self) -> Fraction:
        """Part of a turn of the carrier in one sample of the envelope beyond whole ones."""
        return Fraction(self.carrier) * self.every / Fraction(self.signal.sampling_rate) % 1

    def streams(self, first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of the envelope through each function of the basis, (K, n) complex."""
        out = np.zeros((len(self.basis), last - first), dtype=np.complex128)
        for start in range(first, last, _ROWS):
            stop = min(start + _ROWS, last)
            out[:, start - first : stop - first] = self._made(start, stop)
        return out

    def _made(self, first: int, last: int) -> Complexes:
        count, span, functions = last - first, 2 * self.reach, len(self.basis)
        signal = self.signal.read((first - self.reach) * self.every, (last + self.reach) * self.every)
        out = np.zeros((functions, count), dtype=np.complex128)
        if not np.any(signal):
            return out
        parts = (signal.reshape(-1, self.every) @ self.mixers).view(np.complex128)
        parts = parts.reshape(-1, functions, span)
        for j in range(span):
            out += parts[j : j + count, :, j].T
        turn = self.turn
        whole = first * turn % 1  # exact, however late
        cycles = float(whole) + float(turn) * np.arange(count)
        return np.asarray(out * np.exp(-2j * math.pi * cycles))

    def turned(self, late: Floats) -> Complexes:
        """Return the carrier's phase ``exp(-2 pi j carrier delay)`` of delays (P, n), samples of the envelope."""
        return np.asarray(np.exp(-2j * math.pi * self.cycles * late))

    def describe(self) -> list[str]:
        """Return how delays, air, walls and beams are carried, and what it costs, a line each."""
        removed = "none" if np.isneginf(self.removed_db) else f"{self.removed_db:.0f} dB"
        return [
            f"filters of {len(self.bank.taps)} branches hold {self.half:.0f} Hz on either side of "
            f"{self.carrier:.0f} Hz within {self.bank.error_db:.1f} dB; share of the signal outside: {removed}",
            self.describe_responses(),
        ]


def envelope_emission(
    signal: Signal,
    start: float,
    baseband: Baseband,
    half: float,
    removed_db: float,
    interpolator: Interpolator,
    basis: Basis,
    max_rate: float,
) -> EnvelopeEmission:
    """Return a source's envelope with its filters.

    Parameters
    ----------
    signal : Signal
        As emitted, at its own sampling rate.
    start : float
        Time at which it begins, s.
    baseband : Baseband
        With its sampling rate.
    half : float
        Frequencies off the carrier that are held, Hz.
    removed_db : float
        Share of the signal outside, dB.
    interpolator : Bandlimited
        Says how exact the filters are.
    basis : Basis
        Functions of frequency at the signal's sampling rate.
    max_rate : float
        Fastest change of a delay, s/s.

    Raises
    ------
    InputError
        If the interpolator is none of `Bandlimited`.
    """
    if not isinstance(interpolator, Bandlimited):
        raise InputError("interpolator", f"must be Bandlimited in baseband, but is {interpolator!r:.80}")
    rate = baseband.sampling_rate or 0.0
    edge = 2.0 * math.pi * max(half / rate, 0.5 * _NARROWEST)
    edge = math.ceil(edge * 64) / 64
    mu_max = math.ceil((0.52 + 0.5 * blocks_of(rate, max_rate)[0] * max_rate) * 32) / 32
    taps, reached = design_bandlimited(interpolator.error_db, edge, mu_max)
    bank = Bank(taps, taps.shape[1] // 2, 0.0, edge, mu_max, GROUP, reached)
    banks = tuple(interpolator.weaker(bank, size) for size in basis.sizes)
    every = round(signal.sampling_rate / rate)
    mixers, reach = _mixers(signal.sampling_rate, every, baseband.carrier, half, basis, interpolator.error_db)
    highest = baseband.carrier + 0.5 * baseband.bandwidth
    whole = Emission(signal, start, banks, basis, highest, removed_db)
    common = {f.name: getattr(whole, f.name) for f in fields(Emission)}
    return EnvelopeEmission(
        **common, carrier=baseband.carrier, every=every, reach=reach, mixers=mixers, half=half
    )  # fmt: skip


def _mixers(rate: float, every: int, carrier: float, half: float, basis: Basis, error_db: float) -> tuple[Floats, int]:
    """Return taps as in `EnvelopeEmission`, and how far they reach.

    A low-pass by the window method (Kaiser) that passes `half` Hz and stops what would be folded onto them, or is the
    image of the carrier; the window makes both ripples equal.
    """
    from scipy.signal import firwin, kaiserord

    stop = min(rate / every, 2.0 * carrier) - half
    length, beta = kaiserord(-error_db + _MARGIN_DB, (stop - half) / (0.5 * rate))
    length += 1 - length % 2
    # Twice, for half of a real signal is on the carrier's negative side.
    low_pass = 2.0 * firwin(length, 0.5 * (stop + half), window=("kaiser", beta), fs=rate)
    mixed = low_pass * np.exp(-2j * math.pi * (carrier / rate) * (np.arange(length) - length // 2))
    taps = np.stack([np.convolve(f[::-1], mixed) for f in basis.filters])
    most = taps.shape[1] // 2
    reach = most // every + 1
    padded = np.zeros((len(taps), 2 * reach * every), dtype=np.complex128)
    padded[:, reach * every - most : reach * every + most + 1] = taps
    by_sample = padded.reshape(len(taps), 2 * reach, every).transpose(2, 0, 1)
    return np.ascontiguousarray(by_sample).view(np.float64).reshape(every, -1), reach
