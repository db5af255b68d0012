"""Channels: impulse responses of paths that do not change, and gains, delays and taps in complex baseband."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, as_number, short_repr, texts
from clsim.errors import InputError, warn
from clsim.numerics.band_filters import BandKernels
from clsim.numerics.convolution import band_taper, delayed_sums, ringing
from clsim.paths.family import PairPaths
from clsim.paths.path_table import labelled_dataset
from clsim.paths.response import QUASI_STATIC, Arrivals, Kinematics, SceneResponse, check_band_coverage, slices_of
from clsim.scene.scene import Scene

Pairs = Iterable[tuple[NDArray[np.int64], PairPaths]]

_LEAST_RATE = 1.25  # of the bandwidth
_FEWEST, _MOST = 8, 128  # frequencies at which responses are taken
_TAIL = 1e-5  # of the largest coefficient, below which responses are held
_LOUD_TAIL = 1e-4  # at which that is a warning
_MOST_BYTES = 2**33


@dataclass(frozen=True, slots=True, eq=False)
class ChannelPaths:
    """Complex gain and delay of P paths at T times of reception.

    Attributes
    ----------
    delay : ndarray (P, T)
        Absolute, from emission to reception, s; NaN while the path is not heard. In air that disperses that of what
        sounds about the carrier, the group delay.
    gain : ndarray (P, T) complex
        Received over emitted complex envelope about the carrier, a ratio: with the carrier's phase, in air that
        does not disperse ``exp(-2j pi carrier delay)``; 0 while the path is not active.
    """

    times: Floats  # (T,) s
    source: NDArray[np.int32]  # (P,) indices in the scene
    receiver: NDArray[np.int32]  # likewise
    delay: Floats
    gain: Complexes
    carrier: float  # hz
    source_names: tuple[str, ...]  # what the indices mean
    receiver_names: tuple[str, ...]  # likewise

    __repr__ = short_repr

    def to_xarray(self) -> Any:
        """Return it with dimensions ``path`` and ``times``, coordinates and units.

        result: ``delay`` and complex ``gain``; names of ``source`` and ``receiver`` by path.
        """
        coordinates: dict[str, Any] = {
            "times": ("times", self.times), "source": ("path", texts(self.source_names)[self.source]),
            "receiver": ("path", texts(self.receiver_names)[self.receiver]),
        }  # fmt: skip
        over = ("path", "times")
        found = labelled_dataset({"delay": (over, self.delay), "gain": (over, self.gain)}, coordinates)
        return found.assign_attrs(carrier=self.carrier)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelTaps:
    """A linear filter that changes with time, for each source and receiver.

    What is received at ``times[t]`` is the sum over l of ``gain[:, :, l, t]`` times the source's envelope at ``times[t]
    - delays[l]``.

    Attributes
    ----------
    delays : ndarray (L,)
        Whole multiples of a sample from 0 on, s; from below 0 where the band-limited onset of a near path begins
        there.
    """

    times: Floats  # (T,) s
    delays: Floats
    gain: Complexes  # (sources, receivers, L, T) ratios
    carrier: float  # hz
    bandwidth: float  # likewise
    sampling_rate: float  # likewise
    source_names: tuple[str, ...]  # along the first two axes
    receiver_names: tuple[str, ...]  # likewise

    __repr__ = short_repr

    def to_xarray(self) -> Any:
        """Return it with dimensions ``source``, ``receiver``, ``tap`` and ``times``, coordinates and units."""
        coordinates = {
            "source": ("source", texts(self.source_names)), "receiver": ("receiver", texts(self.receiver_names)),
            "tap": ("tap", np.round(self.delays * self.sampling_rate).astype(np.int64)), "delay": ("tap", self.delays),
            "times": ("times", self.times),
        }  # fmt: skip
        found = labelled_dataset({"gain": (("source", "receiver", "tap", "times"), self.gain)}, coordinates)
        given = ("carrier", "bandwidth", "sampling_rate")
        return found.assign_attrs({name: getattr(self, name) for name in given})


@dataclass(frozen=True, slots=True, eq=False)
class DelayDoppler:
    """P paths as points of delay and Doppler shift over a time, and how far they move within it.

    Attributes
    ----------
    delay_change, doppler_change : ndarray (P,)
        From the beginning to the end of the time, s and Hz. Where the first is small against ``1 / bandwidth`` and
        the second against ``1 / duration``, points say all.
    """

    time: float  # when it begins and how long it lasts, s
    duration: float  # likewise
    source: NDArray[np.int32]  # (P,) indices in the scene
    receiver: NDArray[np.int32]  # likewise
    delay: Floats  # (P,) in the middle of the time, s; NaN for paths that are not heard then
    doppler_shift: Floats  # (P,) of the carrier in the middle, Hz
    gain: Complexes  # (P,) in the middle, a ratio, with the carrier's phase
    delay_change: Floats
    doppler_change: Floats
    carrier: float  # hz

    __repr__ = short_repr


def channel_paths(
    scene: Scene, pairs: Pairs, span: tuple[Floats, Floats], times: Floats, carrier: float, kinematics: Kinematics
) -> tuple[Floats, Floats, Complexes]:
    """Return delays, their rates and complex gains (P, T) of paths that are heard from `span[0]` to `span[1]`, s."""
    carrier = as_number("carrier", carrier, above=0.0, unit="Hz")
    check_band_coverage(scene, range(len(scene.sources)), carrier, carrier, "the carrier")
    shape = (len(span[0]), len(times))
    delay, rate, gain = np.empty(shape), np.empty(shape), np.zeros(shape, dtype=np.complex128)
    for rows, pair in pairs:
        at = SceneResponse(scene, pair.source, np.array([carrier]))
        for part in slices_of(len(times), len(rows)):
            found = pair.arrivals(times[part], kinematics)
            delay[rows, part] = found.delay + pair.group_delay_offset(found, carrier)
            rate[rows, part] = found.delay_rate
            turned = np.exp(-2j * np.pi * _fraction(carrier * found.delay))
            gain[rows, part] = pair.response(found, times[part], at)[..., 0] * turned
    silent = (times < span[0][:, None]) | (times >= span[1][:, None])
    delay[silent], rate[silent], gain[silent] = math.nan, math.nan, 0.0
    return delay, rate, gain


def channel_taps(
    scene: Scene, pairs: Pairs, span: tuple[Floats, Floats], times: Floats, band: ChannelBand, kinematics: Kinematics
) -> tuple[Complexes, int]:
    """Return taps (sources, receivers, L, T) of paths heard from `span[0]` to `span[1]`, s, and the first's index.

    A path's response over the band is a Chebyshev series of as many terms as it needs; each term has a band-limited
    impulse of its own, laid at the path's delay with the carrier's phase. Nothing is interpolated in time.
    """
    low, high = band.carrier - 0.5 * band.bandwidth, band.carrier + 0.5 * band.bandwidth
    check_band_coverage(scene, range(len(scene.sources)), low, high, "the band of the taps")
    kernels = BandKernels(band.bandwidth / band.sampling_rate)
    members = list(pairs)
    ends = len(scene.sources), len(scene.receivers)
    _check_size((*ends, 2 * kernels.reach, len(times)))  # at least, before delays are known
    first, last = _reach(members, times, kinematics, band.sampling_rate, kernels.reach)
    shape = (*ends, last - first + 1, len(times))
    _check_size(shape)
    out = np.zeros((*shape[:2], shape[3], shape[2]), dtype=np.complex128)
    for rows, pair in members:
        for part in slices_of(len(times), len(rows)):
            now = times[part]
            found = pair.arrivals(now, kinematics)
            series = _series(scene, pair, found, now, band)
            there = (now >= span[0][rows, None]) & (now < span[1][rows, None])
            series *= (np.exp(-2j * np.pi * _fraction(band.carrier * found.delay)) * there)[..., None]
            place = out[pair.source, pair.receiver, part]
            for late, weights in zip(found.delay * band.sampling_rate - first, series, strict=True):
                kernels.add(place, late, weights)
    return np.moveaxis(out, 3, 2), first


@dataclass(frozen=True, slots=True)
class ChannelBand:
    """A band about a carrier, and the rate of the taps that hold it, Hz."""

    carrier: float
    bandwidth: float
    sampling_rate: float

    def __post_init__(self) -> None:
        for name in ("carrier", "bandwidth", "sampling_rate"):
            object.__setattr__(self, name, as_number(name, getattr(self, name), above=0.0, unit="Hz"))
        if self.sampling_rate < _LEAST_RATE * self.bandwidth:
            least = f"{_LEAST_RATE:g} times the bandwidth, {_LEAST_RATE * self.bandwidth:g} Hz"
            raise InputError("sampling_rate", f"must be at least {least}, but is {self.sampling_rate:g} Hz")
        if self.carrier <= 0.5 * self.bandwidth:
            half = f"half the bandwidth, {0.5 * self.bandwidth:g} Hz"
            raise InputError("carrier", f"must be above {half}, but is {self.carrier:g} Hz")

    def at(self, places: Floats) -> Floats:
        """Return the frequencies at places from -1 to 1 of what the taps hold, Hz: at least a thousandth of it."""
        return np.maximum(self.carrier + 0.5 * self.sampling_rate * places, 1e-3 * self.sampling_rate)


def _check_size(shape: tuple[int, ...]) -> None:
    if 16 * math.prod(shape) > _MOST_BYTES:
        raise InputError("times", f"must give at most {_MOST_BYTES >> 30} GiB of taps, but give {shape}; take fewer")


def _fraction(turns: Floats) -> Floats:
    return turns - np.round(turns)


def _reach(
    pairs: list[tuple[NDArray[np.int64], PairPaths]], times: Floats, kinematics: Kinematics, sampling_rate: float,
    reach: int,
) -> tuple[int, int]:  # fmt: skip
    """Return the first tap, 0 or less, and the last that paths need at times."""
    earliest, latest = math.inf, 0.0
    for rows, pair in pairs:
        for part in slices_of(len(times), len(rows)):
            delay = pair.arrivals(times[part], kinematics).delay
            earliest, latest = min(earliest, float(delay.min())), max(latest, float(delay.max()))
    if not math.isfinite(earliest):
        return 0, 0
    return min(0, math.floor(earliest * sampling_rate) - reach), math.floor(latest * sampling_rate) + reach + 1


def _series(scene: Scene, pair: PairPaths, found: Arrivals, times: Floats, band: ChannelBand) -> Complexes:
    """Return the Chebyshev coefficients (P, T, K) of responses over what the taps hold."""
    count = _FEWEST
    while True:
        angles = np.pi * (np.arange(count) + 0.5) / count
        values = pair.response(found, times, SceneResponse(scene, pair.source, band.at(np.cos(angles))))
        turned = np.cos(np.outer(angles, np.arange(count))) * (2.0 / count)
        turned[:, 0] *= 0.5
        series: Complexes = (values @ turned).astype(np.complex128)
        size = np.abs(series).max(axis=(0, 1), initial=0.0)
        needed = np.flatnonzero(size > _TAIL * size.max(initial=0.0))
        last = int(needed[-1]) + 1 if len(needed) else 1
        if last <= count - 2:
            return series[..., :last]
        if count >= _MOST:
            if size[-2:].max() > _LOUD_TAIL * size.max():
                held = 20.0 * math.log10(float(size[-2:].max() / size.max()))
                warn(f"responses over the band are approximated to about {held:.0f} dB only, with {_MOST} terms")
            return series
        count *= 2


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
