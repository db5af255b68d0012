"""The impulse response of paths that do not change: what air, walls and directivities make of each, at its delay."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.numerics.convolution import band_taper, delayed_sums, ringing
from clsim.paths.family import PairPaths
from clsim.paths.response import QUASI_STATIC, SceneResponse

_SKELETON = 3e-9  # relative to the strongest response, to which all are made of a few
_ALLOWED = 1e-7  # the same, found between the frequencies at which they were chosen
_FREQUENCIES = 64  # at which they are chosen at first
_SPARE = 1024  # samples, at least, for what walls make of an arrival
_QUIET = 1e-9  # of the peak, below which nothing is left in the middle of what is spare
_LONGEST_SPARE = 2**16
_CUT = 1e-15  # share of energy that is cut off at either end


@dataclass(frozen=True, slots=True)
class ResponseBand:
    """Where an impulse response is exact, Hz."""

    low: float  # the band
    high: float  # likewise
    below: float  # widths over which it falls to nothing beneath and above; without one (0) it goes on down to 0 Hz
    above: float  # likewise

    @property
    def ringing(self) -> float:
        """How long an arrival rings before and after its own time, s."""
        return ringing(self.below, self.above)


@dataclass(frozen=True, slots=True, eq=False)
class ImpulseResponse:
    """Taps (n,) of a filter; the first one is that of a delay of `first` samples, which can be negative."""

    first: int
    taps: NDArray[Any]

    @property
    def last(self) -> int:
        """Delay of the last tap, samples."""
        return self.first + len(self.taps) - 1

    def read(self, start: int, stop: int) -> Floats:
        """Return the taps of delays from `start` up to `stop` (n,), zero beyond the ends."""
        out = np.zeros(max(stop - start, 0), dtype=self.taps.dtype)
        first, last = max(start, self.first), min(stop, self.last + 1)
        if first < last:
            out[first - start : last - start] = self.taps[first - self.first : last - self.first]
        return out

    def causal(self) -> tuple[ImpulseResponse, float]:
        """Return the response without the taps before time 0, and these taps' share of its energy, dB."""
        early = max(-self.first, 0)
        if early == 0:
            return self, -math.inf
        energy = np.square(np.abs(self.taps))
        cut, whole = float(energy[:early].sum()), float(energy.sum())
        share_db = 10.0 * math.log10(cut / whole) if cut > 0.0 else -math.inf
        return ImpulseResponse(0, self.taps[early:] if early < len(self.taps) else np.zeros(1)), share_db


def impulse_response(
    delays: Floats, responses: Callable[[Floats, NDArray[np.int64]], Floats | Complexes], sampling_rate: float,
    band: ResponseBand,
) -> ImpulseResponse:  # fmt: skip
    """Return the impulse response of paths with delays (P,), s, exact over a band.

    `responses` takes frequencies (F,), Hz, and rows of paths (n,), and gives their responses (n, F). The spectrum is
    ``sum_p R_p(f) exp(-2j pi f delay_p)`` within -110 dB of the strongest response over the band.
    All responses are sums of a few of them (an interpolative decomposition: H. Cheng et al., "On the compression of low
    rank matrices", SIAM J. Sci. Comput. 26(4), 2005). For each of these few, the impulses of all paths are summed, and
    the sum's spectrum is multiplied by the response, taken at every frequency of the transform.
    """
    from scipy.fft import next_fast_len

    late = delays * sampling_rate
    reach = math.ceil(band.ringing * sampling_rate)
    first = math.floor(float(late.min())) - reach
    span = math.ceil(float(late.max())) + reach - first
    few, weights = _skeleton(responses, len(delays), span, sampling_rate, band)
    spare = _SPARE
    while True:
        size = int(next_fast_len(span + spare + (span + spare) % 2, real=True))
        taps = _synthesis(late - first, few, weights, responses, sampling_rate, band, size)
        # What walls make of an arrival comes after it, and before it: the transform goes round.
        middle = span + (size - span) // 2
        peak = float(np.abs(taps).max())
        if np.abs(taps[middle - 32 : middle + 32]).max() <= _QUIET * peak or spare >= _LONGEST_SPARE:
            break
        spare *= 4
    return _trimmed(np.roll(taps, size - middle), first - (size - middle))


def summed(responses: list[ImpulseResponse]) -> ImpulseResponse:
    """Return the sum of responses; that of a single one as it is."""
    if len(responses) == 1:
        return responses[0]
    first, last = min(r.first for r in responses), max(r.last for r in responses)
    return ImpulseResponse(first, np.sum([r.read(first, last + 1) for r in responses], axis=0))


def _skeleton(
    responses: Callable[[Floats, NDArray[np.int64]], Floats | Complexes], count: int, span: int, sampling_rate: float,
    band: ResponseBand,
) -> tuple[NDArray[np.int64], Floats]:  # fmt: skip
    """Return a few paths (K,) and weights (P, K) with which their responses make up those of all paths."""
    from scipy.linalg.interpolative import interp_decomp

    everyone = np.arange(count)
    low = max(band.low - band.below, 0.5 * sampling_rate / span)  # walls need not know what they do at 0 Hz
    high = min(band.high + band.above, 0.5 * sampling_rate)
    most, evaluated_at = span // 2, _FREQUENCIES
    while True:
        fine = np.linspace(low, high, 2 * evaluated_at + 1)
        between = fine[:: 2 * (evaluated_at // _FREQUENCIES)]
        found = responses(fine[1::2], everyone)
        parts = [found.real, found.imag] if np.iscomplexobj(found) else [found]
        rows: Any = np.concatenate(parts, axis=1).T
        strongest = float(np.abs(rows).max())
        if strongest == 0.0:
            return everyone[:1], np.zeros((count, 1))
        rank, order, made = interp_decomp(rows / strongest, _SKELETON, rand=False)
        few = order[:rank].astype(np.int64)
        weights = np.zeros((count, rank))
        weights[few, np.arange(rank)] = 1.0
        weights[order[rank:]] = made.T
        unseen = responses(between, everyone)
        wrong = float(np.abs(weights @ unseen[few] - unseen).max())
        if wrong <= _ALLOWED * strongest or evaluated_at >= most:
            return few, weights
        evaluated_at *= 4


def _synthesis(
    late: Floats, few: NDArray[np.int64], weights: Floats,
    responses: Callable[[Floats, NDArray[np.int64]], Floats | Complexes], sampling_rate: float, band: ResponseBand,
    size: int,
) -> Floats:  # fmt: skip
    """Return taps (size,) for delays (P,) in samples, around the end of which they go on at the beginning."""
    from scipy.fft import irfft

    frequencies: Floats = np.arange(size // 2 + 1, dtype=np.float64) * (sampling_rate / size)
    weight = band_taper(frequencies, band.low, band.high, band.below, band.above)
    passed = np.flatnonzero(weight)
    spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
    sums = delayed_sums(late, weights, size)
    above_zero = np.maximum(frequencies[passed], 0.5 * sampling_rate / size)
    spectrum[passed] = weight[passed] * np.einsum("kf,kf->f", responses(above_zero, few), sums[:, passed])
    return np.asarray(irfft(spectrum, size))


def _trimmed(taps: Floats, first: int) -> ImpulseResponse:
    """Return taps without what is next to nothing at either end; one tap at least."""
    energy = np.square(taps)
    allowed = _CUT * float(energy.sum())
    before = int(np.count_nonzero(np.cumsum(energy) <= allowed))
    after = int(np.count_nonzero(np.cumsum(energy[::-1]) <= allowed))
    if before + after >= len(taps):
        return ImpulseResponse(0, np.zeros(1))
    return ImpulseResponse(first + before, np.ascontiguousarray(taps[before : len(taps) - after]))


def frozen_responses(
    pair: PairPaths, time: float, sampling_rate: float, band: ResponseBand, *, later: float = 0.0,
    centre: float | None = None,
) -> list[ImpulseResponse]:  # fmt: skip
    """Return the impulse response of each channel of a pair's receiver at a time, as if nothing moved.

    Air, walls and directivities are taken at the frequency `centre`, Hz, or each at its own when left out.
    """
    now = np.array([time])
    found = pair.arrivals(now, QUASI_STATIC)
    delay, several = found.delay[:, 0], len(pair.family.scene.receivers[pair.receiver].directivity.channels)
    if pair.reach > 0.0:
        delay = delay + pair.lateness(found, now)[:, 0, pair.only_channel]

    def responses(channel: int, frequencies: Floats, rows: NDArray[np.int64]) -> Floats | Complexes:
        """Return the responses `(paths, frequencies)` of paths: at the centre, if there is one, for all."""
        at = SceneResponse(pair.family.scene, pair.source, frequencies if centre is None else np.array([centre]))
        along: Any = pair.part(rows).responses(found.part(rows), now, at)[channel, :, 0]
        return np.asarray(np.broadcast_to(along, (len(rows), len(frequencies))))

    return [
        impulse_response(delay + later, partial(responses, channel), sampling_rate, band)
        for channel in range(several if pair.channels is None else len(pair.channels))
    ]
