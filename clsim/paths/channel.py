"""Channels from sources to receivers in complex baseband: gains and delays of paths, taps, delay and Doppler shift."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, as_number, short_repr, texts
from clsim.errors import InputError, warn
from clsim.numerics.band_filters import BandKernels
from clsim.paths.family import PairPaths
from clsim.paths.path_table import labelled_dataset
from clsim.paths.response import Arrivals, Kinematics, SceneResponse, check_band_coverage, slices_of
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
