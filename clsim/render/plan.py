"""What will be computed, settled before anything is: both engines carry out the same plan."""

from __future__ import annotations

from dataclasses import InitVar, dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from clsim.render.baseband import Baseband
from clsim.render.interpolator import SMALL_SUBBLOCK

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from clsim.arrays import Floats
    from clsim.render.contributions import Contribution
    from clsim.render.options import RenderOptions
    from clsim.render.source_filters import SourceFilters
    from clsim.render.static_pairs import StaticPairs
    from clsim.scene.ends import Receiver
    from clsim.tracks.tracks import Tracks

SEGMENT = 18432  # samples; chunks are whole segments, and the block length is chosen for each segment
BLOCKS = (768, 384, 192, 96, 48, 24, 8)  # samples in a block, divisors of a segment, tried in this order
FINE = 96  # samples, shorter blocks than which are rendered in small subblocks by all terms of their cubics
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
    static_pairs : StaticPairs
        Which pairs of the tracks are convolved instead of rendered path by path.
    source_filters : tuple of SourceFilters
        What each source emits, and the filters for it.
    sampling_rate : float
        Of the recording, Hz; in baseband that of the envelopes.
    samples : int
        Length of the recording.
    chunk : int
        Samples that are held at a time, whole segments.
    segment : int
        Samples for which the block length is chosen at a time.
    blocks : tuple of int
        Samples in a block, divisors of a segment, tried in this order.
    left_out : str
        What of the scene is not in the tracks, in words; "" for nothing.
    contributions : tuple of Contribution
        What adds to the pressure at the receivers, in this order.
    builders : sequence of callable
        Of all the above each makes a contribution, or None.
    """

    options: RenderOptions
    tracks: Tracks
    static_pairs: StaticPairs
    source_filters: tuple[SourceFilters, ...]
    sampling_rate: float
    samples: int
    chunk: int
    segment: int
    blocks: tuple[int, ...]
    left_out: str
    builders: InitVar[Sequence[Callable[[Plan], Contribution | None]]]
    contributions: tuple[Contribution, ...] = field(init=False)

    def __post_init__(self, builders: Sequence[Callable[[Plan], Contribution | None]]) -> None:
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
        """Return whether blocks of a length are rendered in small subblocks by all terms of their cubics.

        Parameters
        ----------
        block : int
            Samples in a block.

        Returns
        -------
        bool
            Whether they are that short.
        """
        return self.baseband is None and block < FINE

    def subblock(self, source: int, block: int) -> int:
        """Return how many neighbouring samples of a block share the whole part of a delay.

        Parameters
        ----------
        source : int
            Index of the source.
        block : int
            Samples in a block.

        Returns
        -------
        int
            Samples in a subblock.
        """
        subblock = self.source_filters[source].bank.subblock
        return min(subblock, SMALL_SUBBLOCK) if self.is_fine(block) else subblock

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
        return sum(len(pair) for pair in self.tracks.pairs)

    @property
    def max_rate(self) -> float:
        """Fastest change of any delay, s/s."""
        return max_rate(self.tracks)

    @property
    def memory_bytes(self) -> int:
        """Memory that the rendering takes at a time, estimated, bytes."""
        return int(sum(self._memory().values()))

    @property
    def largest_field(self) -> str:
        """Field of a scene file that makes the memory large."""
        memory = self._memory()
        largest = max(memory, key=memory.__getitem__)
        return "receivers" if largest == "render.chunk" and self.chunk == self.segment else largest

    def _memory(self) -> dict[str, float]:
        """Return the bytes that the fields of a scene file ask for."""
        middle, length = 0.5 * self.duration, 0.5 * min(self.chunk / self.sampling_rate, self.duration)
        span = self.tracks.longest_delay(middle - length, middle + length) * self.sampling_rate
        rows = max(e.oversampling * int(e.rows[-1]) for e in self.source_filters)
        functions = max(len(e.basis) for e in self.source_filters)
        per_segment = (
            (4 + 4 * self.delay_terms + 16 * functions)
            * (self.segment // self.shortest_block)
            * max((len(pair) for pair in self.tracks.pairs), default=0)
        )
        size = 4.0 if self.baseband is None else 8.0
        return {
            "render.chunk": size * ((rows + 1) * self.chunk + 2 * self.chunk * self.receiver_count),
            "paths.max_order": size * (rows + 1) * span + max(NODE_BUDGET, per_segment) + self.path_count * 150,
        }

    @property
    def motion_error_db(self) -> float:
        """Bound on the error of delays and gains between nodes, dB."""
        return self.options.interpolator.error_db - 6.0

    @property
    def receiver_count(self) -> int:
        """Number of receivers."""
        return len(self.tracks.receiver_names)

    @property
    def receivers(self) -> tuple[Receiver, ...]:
        """The scene's receivers; none for tracks computed elsewhere."""
        of_scene = self.tracks.of_scene
        return () if of_scene is None else tuple(of_scene.scene.receivers)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each receiver's samples: Pa, or V."""
        return tuple(r.unit for r in self.receivers) or ("Pa",) * self.receiver_count

    def describe(self) -> list[str]:
        """Return what will be computed, a line each: the whole, each contribution, the receivers.

        Returns
        -------
        list of str
            As in the notes of the recording.
        """
        lines = [
            f"{self.path_count} paths from {len(self.source_filters)} sources to {self.receiver_count} receivers",
            f"{self.samples} samples at {self.sampling_rate:g} Hz, {self.duration:g} s, in chunks of {self.chunk}",
            f"{self.path_count * self.samples:.3g} path-samples, about {self.memory_bytes / 2**20:.0f} MiB at a time",
            f"delays change by at most {self.max_rate:.3g} s/s",
            *([self.left_out] if self.left_out else []),
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


def max_rate(tracks: Tracks) -> float:
    """Return the fastest change of any delay, s/s."""
    return max(tracks.max_rate(source) for source in range(tracks.source_count))


def node_times(start: int, block: int, blocks: int, sampling_rate: float) -> Floats:
    """Return the times of a run's nodes: starts of its blocks, one before, and two after, s."""
    return (start + block * np.arange(-1, blocks + 2, dtype=np.float64)) / sampling_rate
