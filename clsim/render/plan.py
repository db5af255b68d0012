"""The plan of a rendering, decided before anything is computed; both engines execute the same plan."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import InitVar, dataclass, field

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, row_name, short_repr
from clsim.errors import InputError, counted
from clsim.numerics.convolution import Upsampler
from clsim.render.baseband import (
    LONG_ENVELOPE_BLOCK,
    SLOW_CHANGE,
    WIDEST_SUBBLOCK,
    Baseband,
    blocks_of,
    segment_of,
)
from clsim.render.contributions import Contribution
from clsim.render.interpolator import SMALL_SUBBLOCK
from clsim.render.options import RenderOptions
from clsim.render.source_filters import SourceFilters
from clsim.scene.ends import Receiver
from clsim.tail.design import SourceTail
from clsim.tracks.tracks import Tracks

SEGMENT = 18432  # samples; chunks are whole segments, and the block length is chosen for each segment
BLOCKS = (768, 384, 192, 96, 48, 24, 8)  # samples in a block, divisors of a segment, tried in this order
LONG_BLOCKS = (3072, 1536, *BLOCKS)  # the same where block polynomials are looked at a few times each
FINE = 96  # samples, shorter blocks than which are rendered in small subblocks by all terms of their cubics
BATCH = 64  # paths expanded at a time, the unit in which slots are filled up
_TRANSFORMED = 80.0  # bytes of a sample while what is emitted is filtered: transforms in float64, measured
_PRESSURE_BUDGET = 256 * 2**20  # bytes of output held at a time
_LONG_CHUNK = 48  # segments, beyond which a chunk gains nothing
_ENVELOPES = 40_000  # samples, the same of envelopes, whose branch signals then stay in the third cache
NODE_BUDGET = 48 * 2**20  # bytes of block polynomials on the device at a time


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Everything that is needed to render, with nothing left to decide.

    Attributes
    ----------
    options : RenderOptions
        As they were asked for.
    tracks : Tracks
        Delay and gain of every path over time.
    allocation : Allocation
        Rendering method of each pair and band.
    source_filters : tuple of SourceFilters
        Signals of the sources, and the filters for them.
    sampling_rate : float
        Sampling rate of the recording, Hz; in baseband that of the envelopes.
    samples : int
        Length of the recording.
    chunk : int
        Samples that are held at a time, whole segments.
    segment : int
        Samples for which the block length is chosen at a time.
    blocks : tuple of int
        Samples in a block, divisors of a segment, tried in this order.
    builders : sequence of callable
        Each makes a contribution of the plan, or None.
    left_out : str
        Parts of the scene that are not in the tracks, in words; "" for none.
    fine : int
        Samples: shorter blocks are rendered in small subblocks, by all terms of their cubics.
    contributions : tuple of Contribution
        Contributions to the pressure at the receivers, in this order.
    receivers : tuple of Receiver
        The scene's receivers; none for tracks computed elsewhere.
    first_rows : ndarray (receivers + 1,)
        First row of each receiver's channels, and the number of all rows at the end.
    """

    options: RenderOptions
    tracks: Tracks
    allocation: Allocation
    source_filters: tuple[SourceFilters, ...]
    sampling_rate: float
    samples: int
    chunk: int
    segment: int
    blocks: tuple[int, ...]
    builders: InitVar[Sequence[Callable[[Plan], Contribution | None]]]
    left_out: str = ""
    fine: int = FINE
    contributions: tuple[Contribution, ...] = field(init=False)
    receivers: tuple[Receiver, ...] = field(init=False)
    first_rows: NDArray[np.int32] = field(init=False)

    __repr__ = short_repr

    def __post_init__(self, builders: Sequence[Callable[[Plan], Contribution | None]]) -> None:
        of_scene = self.tracks.of_scene
        first = np.cumsum([0, *map(len, self.tracks.channels)], dtype=np.int32)
        object.__setattr__(self, "first_rows", first)
        object.__setattr__(self, "receivers", () if of_scene is None else tuple(of_scene.paths.scene.receivers))
        made = tuple(made for build in builders if (made := build(self)) is not None)
        object.__setattr__(self, "contributions", made)

    @property
    def baseband(self) -> Baseband | None:
        """The band of complex envelopes, with its sampling rate; None for sound as it is."""
        return None if self.options.baseband is None else Baseband(*self.options.baseband)

    @property
    def carrier(self) -> float | None:
        """That of complex envelopes, Hz; None for sound as it is."""
        return None if self.baseband is None else self.baseband.carrier

    @property
    def delay_terms(self) -> int:
        """Coefficients of the polynomial of a block's delay, 4 or 8; of the gains' it is always 4."""
        return 4 if self.baseband is None else 8

    @property
    def shortest_block(self) -> int:
        """Samples in the shortest block for which room is made beforehand: shorter ones are rare."""
        return max(self.blocks[-1], FINE) if self.baseband is None else self.blocks[-1]

    def is_fine(self, block: int) -> bool:
        """Test whether blocks of `block` samples are rendered in small subblocks with all terms of their cubics."""
        return self.baseband is None and block < self.fine

    def subblock(self, source: int, block: int) -> int:
        """Return the number of samples of a `block` of a `source` that share the whole part of a delay."""
        subblock = self.source_filters[source].bank.subblock
        return min(subblock, SMALL_SUBBLOCK) if self.is_fine(block) else subblock

    def left_out_over(self, source: int, block: int, *, few: bool = False) -> float:
        """Return the share of a block of the samples that take few terms of its polynomials; 0 where they take all.

        Parameters
        ----------
        source : int
            Index of the source.
        block : int
            Samples in a block.
        few : bool
            Whether the paths are a few that need shorter blocks than others.

        Returns
        -------
        float
            Of the source's subblocks; of envelopes' widest vectors, if blocks are long and motion is slow for these.
            Few paths by envelopes take all terms: a costlier sum, but longer blocks.
        """
        if self.baseband is not None:
            change = WIDEST_SUBBLOCK / self.sampling_rate * self.tracks.max_rate(source)
            suits = block >= LONG_ENVELOPE_BLOCK and change <= SLOW_CHANGE and not few
            return WIDEST_SUBBLOCK / block if suits else 0.0
        return 0.0 if self.is_fine(block) else self.subblock(source, block) / block

    def where_claimed(self, claim: str, build: Callable[[Plan], Contribution]) -> Contribution | None:
        """Build a contribution by `build` of the plan if the allocation's `claim` holds something, else None."""
        return build(self) if any(part is not None for part in getattr(self.allocation, claim)) else None

    def where_scattered(self, name: str, build: Callable[[Plan, str], Contribution]) -> Contribution | None:
        """Build a contribution by `build` of the plan of scatterers' pairs of a `name` if there are any, else None."""
        parts = self.allocation.scattered
        return next((build(part.plan, name) for part in parts if part.name == name and part.sounds), None)

    def where_left(self, build: Callable[[Plan], Contribution]) -> Contribution | None:
        """Build a contribution by `build` of the plan if other methods leave a pair, else None."""
        return None if len(self.allocation.claimed) == len(self.tracks.pairs) else build(self)

    def is_claimed(self, source: int) -> bool:
        """Test whether a `source`, by index, has paths and none of them is rendered path by path."""
        mine = {i for i, pair in enumerate(self.tracks.pairs) if pair.source == source}
        return bool(mine) and mine <= self.allocation.claimed

    @property
    def sample_type(self) -> type[np.generic]:
        """Type of the samples: float32, or complex64 in baseband."""
        return np.float32 if self.baseband is None else np.complex64

    @property
    def pressure_type(self) -> type[np.generic]:
        """Type in which contributions are summed: that of the samples, of the reference engine twice as wide."""
        if self.options.engine == "opencl":
            return self.sample_type
        return np.float64 if self.baseband is None else np.complex128

    @property
    def duration(self) -> float:
        """Length of the recording, s."""
        return self.samples / self.sampling_rate

    @property
    def path_count(self) -> int:
        """Number of paths over all pairs of source and receiver."""
        return sum(len(pair) for pair in self.tracks.pairs if pair.channels.start == 0)

    @property
    def max_rate(self) -> float:
        """Fastest change of any delay, s/s."""
        return max(self.tracks.max_rate(source) for source in range(self.tracks.source_count))

    @property
    def memory_bytes(self) -> int:
        """Memory that the rendering takes at a time, estimated, bytes."""
        return int(sum(self._memory().values())) + sum(plan.memory_bytes for plan in self.allocation.plans)

    @property
    def largest_field(self) -> str:
        """Field of a scene file that makes the memory large."""
        memory = self._memory()
        largest = max(memory, key=memory.__getitem__)
        return "receivers" if largest == "render.chunk" and self.chunk == self.segment else largest

    def _memory(self) -> dict[str, float]:
        """Return the bytes that the fields of a scene file ask for: buffers of the device, and arrays beside them."""
        length = -(-min(self.chunk, self.samples) // BLOCKS[0]) * BLOCKS[0]
        middle, half = 0.5 * self.duration, 0.5 * length / self.sampling_rate
        span = self.tracks.longest_delay(middle - half, middle + half) * self.sampling_rate + 256.0  # margins
        parts = 1 if self.baseband is None else 2
        rows = max(e.oversampling * int(e.rows[-1]) for e in self.source_filters)
        functions = max(e.oversampling * len(e.basis) for e in self.source_filters)
        # Branch signals, rounded up by 1/32 on average; what is emitted, on the device, of this chunk and of the next.
        a_sample = 4.0 * parts * (1.03 * (rows + functions) + 2.0 * functions) + _TRANSFORMED
        held = 4.0 * parts * 2.0 * self.row_count * length  # on the device, and read from it
        return {
            "render.chunk": a_sample * length + held,
            "paths.max_order": a_sample * span + self._node_bytes(-(-length // self.segment)) + self.path_count * 150,
        }

    def bytes_per_node(self, source: int, channels: int = 1) -> int:
        """Return the bytes of a block of a path, by its `source` and the number of `channels` of the receiver."""
        return 4 + 4 * self.delay_terms + 16 * len(self.source_filters[source].basis) * channels

    def _node_bytes(self, segments: int) -> float:
        """Return the memory of the polynomials of a chunk of segments, in blocks of the two longest lengths, bytes.

        Shorter ones are for motion that is near and fast; each of these lengths takes `NODE_BUDGET` at most.
        """
        most = 0.0
        for source in range(len(self.source_filters)):
            mine = [
                pair
                for i, pair in enumerate(self.tracks.pairs)
                if pair.source == source and i not in self.allocation.claimed and len(pair)
            ]
            slots = [-(-len(pair) // BATCH) * BATCH for pair in mine]
            most_channels = max((len(pair.channels) for pair in mine), default=1)
            node = self.bytes_per_node(source, most_channels)
            a_segment = node * (self.segment // self.shortest_block)
            together = min(sum(slots), max(NODE_BUDGET // a_segment, *slots, 0)) if slots else 0
            each = [float(node * together * (self.segment // b)) for b in self.blocks[:2]]
            at_once = [min(segments, max(1, NODE_BUDGET // max(size, 1.0))) for size in each]
            most = max(most, sum(size * count for size, count in zip(each, at_once, strict=True)))
        return most

    @property
    def motion_error_db(self) -> float:
        """Bound on the error of delays and gains between nodes, dB."""
        return self.options.interpolator.error_db - 6.0 + self.tracks.eased_db

    @property
    def receiver_count(self) -> int:
        """Number of receivers."""
        return len(self.tracks.receiver_names)

    def rows_of_pair(self, pair: int) -> slice:
        """Return the rows of the pressure that have the paths of a `pair`, an index of `Tracks.pairs`."""
        member = self.tracks.pairs[pair]
        first = int(self.first_rows[member.receiver])
        return slice(first + member.channels.start, first + member.channels.stop)

    def rows_of(self, receiver: int) -> slice:
        """Return the rows of the pressure that are channels of a `receiver`, an index."""
        first, last = self.first_rows[receiver : receiver + 2].tolist()
        return slice(first, last)

    @property
    def row_count(self) -> int:
        """Number of rows of the pressure: channels of all receivers."""
        return int(self.first_rows[-1])

    @property
    def channels(self) -> tuple[tuple[str, str], ...]:
        """Names of the receiver and of its channel for each row; of a plain receiver the channel is ""."""
        named = zip(self.tracks.receiver_names, self.tracks.channels, strict=True)
        return tuple((receiver, channel) for receiver, all_of_it in named for channel in all_of_it)

    @property
    def recorded(self) -> tuple[tuple[str, str], ...]:
        """The same as `channels`, but of an array's elements the array's name and theirs in it."""
        return tuple(row for receiver in self.receivers for row in receiver.rows) or self.channels

    @property
    def row_names(self) -> tuple[str, ...]:
        """Name of each row: that of the receiver, and of its channel where it has several."""
        return tuple(map(row_name, self.channels))

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each row's samples: Pa, or V."""
        return tuple(r.unit for r in self.receivers for _ in r.directivity.channels) or ("Pa",) * self.row_count

    def describe(self) -> list[str]:
        """Describe the plan, one line for each fact: the whole, each contribution, the receivers."""
        lines = [
            f"{counted(self.path_count, 'path')} from {counted(len(self.source_filters), 'source')} to "
            f"{counted(self.receiver_count, 'receiver')}"
            + (f" with {self.row_count} channels" if self.row_count > self.receiver_count else ""),
            f"{self.samples} samples at {self.sampling_rate:g} Hz, {self.duration:g} s, in chunks of {self.chunk}",
            f"{self.path_count * self.samples:.3g} path-samples, about {self.memory_bytes / 2**20:.0f} MiB at a time",
            f"delays change by at most {self.max_rate:.3g} s/s",
            *([self.left_out] if self.left_out else []),
            *self.allocation.notes,
        ]
        if self.baseband is not None:
            lines[1] += f"; complex envelopes of {self.baseband.bandwidth:g} Hz about {self.baseband.carrier:g} Hz"
        for contribution in self.contributions:
            lines += contribution.describe()
        for i, r in enumerate(self.receivers):
            if r.electronics is not None or r.transducer is not None:
                name = "" if r.transducer is None else f"; transducer {r.transducer.name or 'without a name'}"
                what = "ideal" if r.electronics is None else r.electronics.describe(r.unit)
                lines.append(f"receiver {i}: recorded in {r.unit}{name}; {what}")
        return lines


@dataclass(frozen=True, slots=True, eq=False)
class NarrowPart:
    """Signals of some sources about one carrier, rendered as complex envelope and upsampled at each receiver."""

    plan: Plan  # of the envelopes
    sources: tuple[int, ...]  # which sources
    upsampler: Upsampler  # converts received envelopes to sound


@dataclass(frozen=True, slots=True, eq=False)
class PairPart:
    """Pairs that have a plan of their own."""

    plan: Plan
    pairs: frozenset[int]  # indices


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredPart(PairPart):
    """Pairs by scatterers of which the field varies over frequency."""

    name: str  # of the contribution: "scattered" where fields are by approximate formulae, "series" for the others

    @property
    def sounds(self) -> bool:
        """Whether narrow parts leave anything of a signal."""
        return not all(getattr(filters, "silent", False) for filters in self.plan.source_filters)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelPart(PairPart):
    """Pairs of one source, rendered by impulse responses that are sampled over time; the plan has long blocks."""

    source: int  # index
    spacing: int  # samples from one response to the next
    error_db: float  # measured, of what is between them


@dataclass(frozen=True, slots=True, eq=False)
class Allocation:
    """The pairs and bands that each rendering method claims; whatever no other method claims is rendered per sample."""

    # Indices of the pairs at rest, which are convolved with their impulse responses.
    convolved: frozenset[int] = frozenset()
    # Bands that are rendered as complex envelopes, for all other pairs of their sources.
    narrow: tuple[NarrowPart, ...] = ()
    channels: tuple[ChannelPart, ...] = ()  # pairs of which impulse responses are sampled
    beside: tuple[PairPart, ...] = ()  # paths of these that cannot be, for as long as they cannot; one part at most
    # Pairs with receivers whose channels differ over frequency, by the sound at each one's centre; one part at most.
    ears: tuple[PairPart, ...] = ()
    scattered: tuple[ScatteredPart, ...] = ()  # one part of each name at most
    tails: tuple[SourceTail | None, ...] = ()  # diffuse tail by source; empty without tails
    # Why a method is not used although it would be cheaper or was requested, a sentence each.
    notes: tuple[str, ...] = ()

    @property
    def plans(self) -> list[Plan]:
        return [part.plan for name in WITH_PLANS for part in getattr(self, name)]

    @property
    def claimed(self) -> frozenset[int]:
        """Indices of the pairs that are not rendered path by path."""
        parts: tuple[PairPart, ...] = (*self.channels, *self.ears, *self.scattered)
        return self.convolved.union(*(part.pairs for part in parts))


WITH_PLANS = "narrow", "channels", "beside", "ears", "scattered"  # fields whose parts have plans of their own


def node_times(start: int, block: int, blocks: int, sampling_rate: float) -> Floats:
    """Return the times of a run's nodes: starts of its blocks, one before, and two after, s."""
    return (start + block * np.arange(-1, blocks + 2, dtype=np.float64)) / sampling_rate


def chunk_of(
    options: RenderOptions, samples: int, rate: float, segment: int, rows: int, longest: Callable[[float, float], float]
) -> int:
    """Return the chunk in whole segments: as requested, or long against the longest delay, s, and small in memory."""
    whole = math.ceil(samples / segment)
    if options.chunk is not None:
        return segment * min(whole, math.ceil(options.chunk / segment))
    span = longest(0.0, samples / rate) * rate
    wanted = min(math.ceil(4.0 * span / segment), _LONG_CHUNK)
    affordable = _PRESSURE_BUDGET // (4 * segment * rows)
    least = 8 if options.baseband is None else min(math.ceil(_ENVELOPES / segment), _LONG_CHUNK)
    return segment * max(1, min(whole, max(least, wanted), affordable))


def plan_of_part(
    options: RenderOptions, tracks: Tracks, allocation: Allocation, filters: tuple[SourceFilters, ...], samples: int,
    blocks: tuple[int, ...] = BLOCKS, builders: Sequence[Callable[[Plan], Contribution | None]] = (), *,
    fine: int = FINE,
) -> Plan:  # fmt: skip
    """Return the plan of a part at the sampling rate of the recording; in baseband blocks are those of envelopes."""
    rate, segment = options.sampling_rate, SEGMENT
    if options.baseband is not None:
        carrier, _, at = Baseband(*options.baseband)
        rate = at or rate
        blocks = blocks_of(rate, carrier, max(tracks.max_rate(source) for source in range(tracks.source_count)))
        segment = segment_of(blocks)
    chunk = chunk_of(options, samples, rate, segment, sum(map(len, tracks.channels)), tracks.longest_delay)
    return Plan(options, tracks, allocation, filters, rate, samples, chunk, segment, blocks, builders, fine=fine)


@contextmanager
def within_memory(field: str, what: str, wanted: float) -> Iterator[None]:
    """Refuse what needs more memory than the machine has, and tell what needed it where less than that is free."""
    rule = f"must ask for less memory: {what} needs about {wanted / 2**20:.0f} MiB"
    there = machine_memory()
    if wanted > there:
        raise InputError(field, f"{rule}, but the machine has {there / 2**20:.0f} MiB")
    try:
        yield
    except MemoryError as error:
        raise InputError(field, f"{rule}, but there is not enough memory left") from error


def machine_memory() -> float:
    """Return the machine's memory, bytes; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return float("inf")
