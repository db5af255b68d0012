"""Sampled channels: paths spread over a grid of delays, joined over time, filtered; and all of it in NumPy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, read_only
from clsim.numerics.convolution import low_pass_between, shape_of
from clsim.render.envelope import EnvelopeFilters
from clsim.render.plan import ChannelPart
from clsim.render.source_filters import SourceFilters

TAPS = 8  # points over which a path is spread
PHASES = 256  # of its place between two points for which the window is kept, 16 KiB; between them it is linear
FINER, COARSER = 16, 12  # points of the grid in so many samples: lanes of vectors in ``convolve.cl``
WIDEST = 0.95  # share of half the sampling rate, up to which the window's images are 101 dB below
_SHAPE = 0.635 * math.pi * TAPS  # of the Kaiser-Bessel window: the least images up to that share, found by search
SPREAD_ERROR_DB = -101.0  # at most, of a frequency at that end of the band
NODES = 11  # on either side of an instant from which its response is made
OVERSAMPLING = 1.35  # node rate over the least that holds how responses change
NODE_ERROR_DB = -90.0  # of the window over nodes, from its transition band; see `node_window`
_BESIDE_PASSES, _SHARED = 6, 6  # passes that the rest of a transform takes as long as, and a first one in few lines
_SAME_LINES = 64  # vectors, 4 KiB: what lies multiples of that apart shares lines of the first cache
_PASSES = (12, 8, 5, 4, 3, 2)  # parts into which a pass of a transform divides, in this order


def window_at(place: Floats) -> Floats:
    """Return the Kaiser-Bessel window (Fessler and Sutton 2003) at distances from a path, points; 0 beyond half."""
    from scipy.special import i0e

    across = np.sqrt(np.maximum(1.0 - np.square(place / (0.5 * TAPS)), 0.0))
    inside = np.abs(place) <= 0.5 * TAPS
    return np.asarray(np.where(inside, i0e(_SHAPE * across) * np.exp(_SHAPE * (across - 1.0)), 0.0))


def window_spectrum(frequencies: Floats) -> Floats:
    """Return the window's transform at frequencies, cycles a point (Lewitt 1990, eq. A3, in one dimension)."""
    root = np.sqrt(_SHAPE**2 - np.square(math.pi * TAPS * frequencies))
    return np.asarray(TAPS * np.sinh(root) / root * math.exp(-_SHAPE))


@cache
def window_table() -> Floats:
    """Return the window at the points about a path, and its changes to the next phase, (PHASES + 3, 2, TAPS)."""
    phases = np.arange(-1, PHASES + 3) / PHASES
    values = window_at(np.arange(1 - TAPS // 2, TAPS // 2 + 1) - phases[:, None])
    return read_only(np.stack([values[:-1], np.diff(values, axis=0)], axis=1))


def spread(places: Floats, gains: NDArray[Any], points: int) -> NDArray[Any]:
    """Return grids (K, points) of paths at places (P,), with gains (K, P): twin of ``scatter.cl`` (ibid., III)."""
    near = np.floor(places).astype(np.int64)[:, None] + np.arange(1 - TAPS // 2, TAPS // 2 + 1)
    window = window_at(near - places[:, None])
    parts = (gains,) if np.isrealobj(gains) else (gains.real, gains.imag)
    made = [
        np.stack([np.bincount(near.ravel(), (window * gain[:, None]).ravel(), points) for gain in part])
        for part in parts
    ]
    return made[0] if len(made) == 1 else made[0] + 1j * made[1]


@cache
def node_window(spacing: int) -> Floats:
    """Return the weights (2 NODES spacing - 1,) of a node's response in the samples about it.

    A sinc with zeros at other nodes, through Kaiser's window. What changes by up to 1 / (2 OVERSAMPLING) of the node
    rate is passed and its images are stopped, both within `NODE_ERROR_DB` (J. F. Kaiser, 1974).
    """
    from scipy.special import i0

    place = np.arange(1 - NODES * spacing, NODES * spacing) / spacing
    shape = shape_of(-NODE_ERROR_DB)
    return read_only(np.sinc(place) * i0(shape * np.sqrt(1.0 - np.square(place / NODES))) / i0(shape))


@cache
def passes_of(count: int) -> list[int]:
    """Return the numbers of parts of the passes of a transform of a 5-smooth number of vectors."""
    found = []
    for parts in _PASSES:
        while count % parts == 0:
            found.append(parts)
            count //= parts
    return found


@lru_cache(maxsize=256)
def quick_count(least: int) -> int:
    """Return the number of vectors, at least so many, whose transform takes the least time."""
    from scipy.fft import next_fast_len

    counts, count = list[int](), least
    while (count := next_fast_len(count, real=True)) <= 1.2 * least or not counts:
        counts.append(count)
        count += 1
    shared = [_SHARED * (n // passes_of(n)[0] % _SAME_LINES == 0) for n in counts]
    of_all = [n * (_BESIDE_PASSES + len(passes_of(n)) + more) for n, more in zip(counts, shared, strict=True)]
    return counts[int(np.argmin(of_all))]


def digit_reversed(passes: Sequence[int]) -> NDArray[np.int64]:
    """Return the frequencies (count,) in the order in which passes leave them."""
    found = np.zeros(1, dtype=np.int64)
    for parts in reversed(passes):
        found = (np.arange(parts)[:, None] + parts * found).ravel()
    return found


def turns_of(angles: Floats) -> NDArray[np.float32]:
    """Return cosines and sines (..., 2, n) of angles (..., n), turns."""
    return np.stack([np.cos(2.0 * math.pi * angles), np.sin(2.0 * math.pi * angles)], axis=-2).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Transform:
    """Tables of transforms of grids of a number of vectors, see ``convolve.cl``."""

    radix: NDArray[np.int32]  # parts of passes, then 0
    turns: NDArray[np.float32]  # of passes
    lane_turns: NDArray[np.float32]  # of the grid's lanes
    back_turns: NDArray[np.float32]  # of those at the sampling rate
    bins: NDArray[np.int64]  # (groups, COARSER, FINER) frequencies at the sampling rate, from 0 to the transform's size

    @classmethod
    @cache
    def of(cls, count: int) -> Transform:
        """Return the tables for a number of vectors."""
        passes, length, turns = passes_of(count), count, []
        for parts in passes:
            angles = np.arange(length // parts)[:, None] * np.arange(1, parts) / length
            turns.append(turns_of(angles[..., None]).ravel())
            length //= parts
        order = np.zeros(-(-count // FINER) * FINER, dtype=np.int64)
        order[:count] = digit_reversed(passes)
        of_lanes = order[:, None] * np.arange(FINER)
        block = np.arange(COARSER)[:, None]
        bins = order.reshape(-1, 1, FINER) + count * np.where(block < COARSER // 2, block, block - COARSER)
        return cls(
            np.array([*passes, 0], np.int32), np.concatenate(turns), turns_of(of_lanes / (FINER * count)),
            turns_of(of_lanes / (COARSER * count)), bins % (COARSER * count),
        )  # fmt: skip

    def packed(self, spectra: NDArray[Any]) -> NDArray[np.float32]:
        """Return spectra (..., size) in the order of transforms, as kernels take them."""
        found = np.take(spectra.astype(np.complex64, copy=False), self.bins, axis=-1, mode="clip")
        return found.view(np.float32)


@dataclass(frozen=True, slots=True)
class ChannelGrid:
    """Where responses lie over delay, and how long transforms are."""

    first: int  # delay of the first point, samples
    span: int  # samples from there to the end of the longest response
    spacing: int  # samples from node to node
    size: int  # samples of a transform; of the grid there are 4 / 3 as many points

    @classmethod
    def between(cls, shortest: float, longest: float, ringing: int, spacing: int) -> ChannelGrid:
        """Return the grid for delays, samples, that ring so many samples to either side."""
        first = math.floor(shortest) - ringing - TAPS
        span = math.ceil(longest) + ringing + TAPS - first
        least = span + (2 * NODES + 1) * spacing  # two nodes at a time
        return cls(first, span, spacing, COARSER * quick_count(-(-least // COARSER)))

    @property
    def points(self) -> int:
        return self.size // COARSER * FINER

    def places(self, delays: Floats) -> Floats:
        """Return places of delays in samples, points."""
        return np.asarray((delays - self.first) * (FINER / COARSER))

    def received(self, node: int) -> tuple[int, int]:
        """Return the first sample that a node's window weighs, and the one behind the last."""
        return (node - NODES) * self.spacing + 1, (node + NODES) * self.spacing

    def needed(self, node: int) -> int:
        """Return the first sample of what is emitted, without delay, that is transformed for a node."""
        return self.received(node)[0] - self.first - self.span

    def shaping(self, filters: Floats) -> Complexes:
        """Return the spectra (K, size) of filters (K, L) about their middle, over that of the window."""
        from scipy.fft import fft, fftfreq

        half = filters.shape[1] // 2
        placed = np.zeros((len(filters), self.size))
        placed[:, : half + 1], placed[:, self.size - half :] = filters[:, half:], filters[:, :half]
        return np.asarray(fft(placed) / window_spectrum(fftfreq(self.size, self.points / self.size)))


def nodes_of(start: int, stop: int, spacing: int) -> range:
    """Return the nodes whose windows weigh any of the samples from `start` up to `stop` (Kaiser, 1974)."""
    return range(start // spacing - NODES + 1, (stop - 1) // spacing + NODES + 1)


_LEFT_OUT_DB = -100.0  # of all functions at any frequency: ends of their filters that are left out
_HELD = 0.43  # of an envelope's rate: what a signal leaves beside its band is held as far as filters are short
_STOPPED_DB = 100.0  # by which responses fall from the band's end to half the sampling rate: without it they ring long


# By sources that are still used: costs of several spacings and the engine ask for the same ones.
_known: WeakKeyDictionary[SourceFilters, Floats] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFilters:
    """Filters of a source's functions of frequency in a sampled channel."""

    # (K, L), each through the low-pass beyond the band, without ends that add nothing; of envelopes the low-pass alone.
    filters: Floats
    source: SourceFilters

    @classmethod
    def of(cls, source: SourceFilters) -> ChannelFilters:
        if source not in _known:
            _known[source] = cls._shaped(source)
        return cls(_known[source], source)

    @staticmethod
    def _shaped(source: SourceFilters) -> Floats:
        """Return the `filters` of a source."""
        rate, own = source.rate, source.filters
        passed = source.band
        if isinstance(source, EnvelopeFilters):
            passed, own = max(source.half, _HELD * rate), np.ones((1, 1))  # streams have passed the functions' filters
        taper = low_pass_between(passed, 0.5 * rate, rate, _STOPPED_DB)
        filters = np.stack([np.convolve(taps, taper) for taps in own])
        half = filters.shape[1] // 2
        both = np.abs(filters[:, half:]) + np.abs(filters[:, half::-1])
        beyond = np.linalg.norm(np.cumsum(both[:, ::-1], axis=1)[:, ::-1], axis=0)  # bounds what taps from there on add
        kept = max(int(np.count_nonzero(beyond > 10 ** (_LEFT_OUT_DB / 20))), 1) - 1
        return filters[:, half - kept : half + kept + 1]

    @property
    def ringing(self) -> int:
        """Samples by which a response rings to either side."""
        return int(self.filters.shape[1] // 2)

    def grid(self, shortest: float, longest: float, spacing: int) -> ChannelGrid:
        """Return the grid for delays between two bounds, s."""
        rate = self.source.rate
        low, high = ((delay + self.source.start) * rate for delay in (shortest, longest))
        return ChannelGrid.between(low, high, self.ringing, spacing)


class ChannelFrames:
    """Adds what the responses of nodes make of one source's signal, or its envelope, to a piece of the pressure."""

    def __init__(self, filters: ChannelFilters, grid: ChannelGrid, pressure: NDArray[Any], start: int) -> None:
        self.grid, self._pressure, self._start = grid, pressure, start
        self.nodes = nodes_of(start, start + pressure.shape[1], grid.spacing)
        self.transform = Transform.of(grid.size // COARSER)
        self._shaping = grid.shaping(filters.filters).astype(np.result_type(pressure, np.complex64))
        self.window = node_window(grid.spacing).astype(pressure.real.dtype)
        self._first = grid.needed(self.nodes[0])
        source = filters.source
        emitted = source.streams if isinstance(source, EnvelopeFilters) else source.emitted_samples
        self._emitted = emitted(self._first, grid.needed(self.nodes[-1]) + grid.size).astype(pressure.dtype)
        self.is_real = not np.iscomplexobj(pressure)

    @cached_property
    def _shapes(self) -> NDArray[np.float32]:
        return self.transform.packed(self._shaping / self.grid.size)

    def active_nodes(self, nodes: range) -> list[int]:
        """Return those of some nodes to whose windows something that sounds may contribute."""
        inside = range(max(nodes.start, self.nodes.start), min(nodes.stop, self.nodes.stop))
        return [node for node in inside if np.any(self._frame(node))]

    def _frame(self, node: int) -> NDArray[Any]:
        begin = self.grid.needed(node) - self._first
        return np.asarray(self._emitted[..., begin : begin + self.grid.size])

    def spectra(self, nodes: Sequence[int]) -> NDArray[Any]:
        """Return the spectra (nodes, size), or of streams (nodes, K, size), of what nodes receive without delay."""
        from scipy.fft import fft

        return np.asarray(fft(np.stack([self._frame(node) for node in nodes])))

    def factors(self, nodes: Sequence[int]) -> dict[str, Any]:
        """Return the factors of the spectra of functions, and of their sum, for units of ``scatter.cl``."""
        emitted = self.transform.packed(self.spectra(nodes))
        (inner, of_inner), (outer, of_outer) = (self._shapes, 0), (emitted, emitted[0].size)
        if not self.is_real:
            (inner, of_inner), (outer, of_outer) = (outer, of_outer), (inner, of_inner)
        return {"inner": inner, "inner_stride": of_inner, "outer": outer, "outer_stride": of_outer}

    def received(self, emitted: NDArray[Any], grids: NDArray[Any]) -> NDArray[Any]:
        """Return weighted samples (nodes, rows, n) of spectra and responses (nodes, rows, K, points)."""
        from scipy.fft import fft, ifft

        half, spectra = self.grid.size // 2, fft(grids)
        spectra = np.concatenate([spectra[..., :half], spectra[..., -half:]], axis=-1) * self._shaping
        response = np.sum(spectra * emitted.reshape(len(emitted), 1, -1, self.grid.size), axis=2)
        received = ifft(response)[..., self.grid.span :][..., : len(self.window)] * self.window
        return np.asarray(received.real if self.is_real else received)

    def received_components(self, emitted: NDArray[Any], grids: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """Return weighted samples (n, M) of a node's spectrum and its grids (points, M) of functions of frequency."""
        from scipy.fft import irfft, rfft

        size, bins = self.grid.size, self.grid.size // 2 + 1
        filters = (self._shaping * emitted)[:, :bins]
        response = rfft(grids[0], axis=0)[:bins]  # no other function has more components
        response *= filters[0, :, None]
        for grid, filtered in zip(grids[1:], filters[1:], strict=True):
            response[:, : grid.shape[1]] += rfft(grid, axis=0)[:bins] * filtered[:, None]
        sound = irfft(response, size, axis=0)[self.grid.span :][: len(self.window)]
        return np.asarray(sound * self.window[:, None])

    def add(self, node: int, receivers: NDArray[np.integer[Any]], received: NDArray[Any]) -> None:
        """Add a node's samples (receivers, n) to the pressure of receivers."""
        first, last = (at - self._start for at in self.grid.received(node))
        begin, end = max(first, 0), min(last, self._pressure.shape[1])
        for row, samples in zip(receivers, received, strict=True):
            self._pressure[row, begin:end] += samples[begin - first : end - first]


def work_at_nodes(
    filters: SourceFilters, counts: tuple[float, float, int], spacing: int, longest: float, until: float
) -> tuple[float, ...]:
    """Return counts of paths at nodes, these by functions, points of transforms, and paths in samples."""
    (paths, gains, rows), functions = counts, len(filters.basis)
    rate, parts = filters.rate, 1 + int(isinstance(filters, EnvelopeFilters))
    functions *= parts
    nodes = until * rate / spacing + 2 * NODES
    points = ChannelFilters.of(filters).grid(0.0, longest, spacing).size * (
        (FINER / COARSER * functions + parts) * rows + parts
    )
    return nodes * paths, nodes * gains * functions, nodes * points, paths * (until * rate + 2 * NODES * spacing)


def reference_channels(part: ChannelPart, start: int, stop: int) -> NDArray[Any]:
    """Return the pressure (rows, stop - start) of the pairs of a part, Pa, with delays and gains at every node."""
    plan, rate = part.plan, part.plan.sampling_rate
    filters = plan.source_filters[part.source]
    channel, pressure = (
        ChannelFilters.of(filters),
        np.zeros((plan.row_count, stop - start), np.result_type(filters.carrier_phase(np.zeros(1)))),
    )
    ranges = [plan.tracks.delay_range(pair, start / rate - 1.0, stop / rate + 1.0) for pair in part.pairs]
    low, high = min(float(low.min()) for low, _ in ranges), max(float(high.max()) for _, high in ranges)
    frames = ChannelFrames(channel, channel.grid(low, high, part.spacing), pressure, start)
    nodes = frames.active_nodes(frames.nodes)
    for pair in part.pairs if nodes else ():
        delay, _, gain = plan.tracks.evaluate(pair, np.array(nodes) * (part.spacing / rate), filters.basis)
        places, tapers = frames.grid.places((delay + filters.start) * rate), plan.tracks.pairs[pair].tapers
        gain = gain if tapers is None else gain * tapers.weights(np.array(nodes) * (part.spacing / rate))
        turned = np.asarray(gain * filters.carrier_phase((delay + filters.start) * rate))
        for i, node in enumerate(nodes):
            grids = np.stack([spread(places[:, i], of_row[:, :, i], frames.grid.points) for of_row in turned])
            rows = plan.rows_of_pair(pair)
            received = frames.received(frames.spectra([node]), grids[None])[0]
            frames.add(node, np.arange(rows.start, rows.stop), received)
    return pressure
