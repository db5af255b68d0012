"""Paths of a source that sampled channels take, and for how long; the sum over paths keeps the rest of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import mul

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.paths.family import PairPaths
from clsim.render.channel_grid import NODES, node_window
from clsim.render.methods.costs import passes, passing_times
from clsim.render.methods.ear_components import Heads
from clsim.render.plan import BLOCKS, FINE, PairPart
from clsim.render.source_filters import Emission, SourceFilters
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import Receiver, Source
from clsim.tracks.basis import flat_basis
from clsim.tracks.onward import LEAST_JUMP, turn_jumps
from clsim.tracks.splines import REACH, Pieces, Rows
from clsim.tracks.tracks import SceneTracks, clock_time

_BLOCKS_IN_TAPER = 8  # at least: cubics hold its weight within -94 dB, root mean square
_STEADY = 2500  # samples of a taper from which on lines hold its weight over a subblock of 32, within -86 dB of a path
_CUT_STEP = 4e-3  # s between times at which delays are looked at about a jump, and between which they are lines
_A_CHANNEL = 0.1  # of a path's processor time, for each channel beside the first: 4 to 16 were measured
_EVALUATED_AT = (4, 8, 32)  # pairs, paths of each, and instants of all pairs: the error over time is measured there
_LEAST_JUMP = 0.03  # rad/s, of beams: aims that follow a motion have jumps of some 0.02 rad/s
MOST_JUMPS = 64  # of the angular velocity of an end, that are cut out
_INSTANTS = 64  # at which distances of paths are looked at
_FEW = 64  # paths, about, that tell what all cost
_NEAR = 2.0  # distances from which a path is taken for near, over the least that is allowed


@dataclass(frozen=True, slots=True)
class Split:
    """Rows of the pairs that sampled channels take, and of what they leave, of some of these."""

    pairs: tuple[int, ...]  # indices among the tracks' pairs
    taken: dict[int, Rows]  # of pairs of which not all is taken
    left: dict[int, Rows]  # of pairs of which something is left
    length: float  # of a taper, s

    def at_nodes(self, tracks: SceneTracks, until: float) -> tuple[float, float, int]:
        """Return the number of paths that are taken, on average over a run, these by channels, and rows of pressure."""
        paths = [self.taken[i].seconds(until) / until if i in self.taken else len(tracks.pairs[i]) for i in self.pairs]
        channels = [len(tracks.pairs[i].channels) for i in self.pairs]
        return sum(paths), sum(map(mul, paths, channels)), sum(channels)

    def summed(self, until: float) -> tuple[float, int]:
        """Return the seconds of paths that are left, and the number of their stretches."""
        return sum(rows.seconds(until) for rows in self.left.values()), sum(map(len, self.left.values()))

    def blocks(self, rate: float) -> tuple[tuple[int, ...], int]:
        """Return the lengths of blocks for what is left, and the `Plan.fine` of it."""
        samples = self.length * rate
        blocks = tuple(b for b in BLOCKS if b * _BLOCKS_IN_TAPER <= samples or b == BLOCKS[-1])
        return blocks, FINE if samples >= _STEADY else max(blocks[0] + 1, FINE)


@dataclass(frozen=True, slots=True)
class Splitter:
    """Splits pairs of a source for any margin."""

    emission: Emission
    tracks: SceneTracks
    pairs: tuple[int, ...]
    pieces: dict[int, Pieces]  # of pairs whose paths begin, end or jump
    _summed: dict[int, float] = field(default_factory=dict, init=False)  # by pair; for all margins the same

    @classmethod
    def of_few(cls, emission: Emission, tracks: SceneTracks, pairs: list[int]) -> tuple[Splitter, float]:
        """Return that of some of the paths, and how many times as many there are: pieces of all take long."""
        whole = sum(len(tracks.pairs[i]) for i in pairs)
        every, members, paths = max(whole // _FEW, 1), list(tracks.pairs), list(tracks.pair_paths)
        for i in pairs:
            rows = np.arange(0, len(members[i]), every)
            members[i] = replace(members[i], start=members[i].start[rows], end=members[i].end[rows])
            paths[i] = paths[i].part(rows)
        few = replace(tracks, pairs=tuple(members), pair_paths=tuple(paths))
        return cls.of(emission, few, pairs), whole / sum(len(members[i]) for i in pairs)

    @classmethod
    def of(cls, emission: Emission, tracks: SceneTracks, pairs: list[int]) -> Splitter:
        pieces = {}
        for i in pairs:
            member, jumps = tracks.pairs[i], cuts(tracks, i)
            if jumps.shape[1] or not member.always_audible:
                pieces[i] = Pieces.of(member.start, member.end, jumps, emission.until)
        return cls(emission, tracks, tuple(pairs), pieces)

    def summed(self, pairs: tuple[int, ...]) -> float:
        """Return the seconds of all paths of pairs, as costly as paths to one channel, that are summed otherwise.

        They begin when the first sound arrives by a path, and end with the last.
        """
        if not self._summed:
            self._summed.update(zip(self.pairs, self._seconds(), strict=True))
        return sum(self._summed[pair] for pair in pairs)

    def _seconds(self) -> Iterator[float]:
        """Yield the seconds of the paths of each pair, see `summed`."""
        until, start = self.emission.until, self.emission.start
        ranges = self.tracks.delay_ranges(self.pairs, 0.0, until)
        for member, (low, high) in zip((self.tracks.pairs[i] for i in self.pairs), ranges, strict=True):
            first = np.maximum(member.start, np.maximum(start + low, 0.0))
            last = np.minimum(member.end, np.minimum(start + self.emission.signal.duration + high, until))
            yield float(np.sum(np.maximum(last - first, 0.0))) * (1.0 + _A_CHANNEL * (len(member.channels) - 1))

    def at(self, margin: float, near: Mapping[object, NDArray[np.bool_]]) -> Split:
        """Return the split for a margin beyond the Doppler shift, Hz, with `near` paths left."""
        length, pairs, taken, left = REACH / margin, [], dict[int, Rows](), dict[int, Rows]()
        for i in self.pairs:
            apart = near.get(self.tracks.paths_of(i)) if near else None
            if i not in self.pieces and apart is None:
                pairs.append(i)
                continue
            member = self.tracks.pairs[i]
            none = np.zeros(len(member), dtype=np.bool_)
            pieces = self.pieces.get(i) or Pieces.of(member.start, member.end, np.empty((len(member), 0)), math.inf)
            some, rest = pieces.handed_over(none if apart is None else apart, length, self.tracks.transition)
            if len(some):
                pairs.append(i)
                taken[i] = some
                left |= {i: rest} if len(rest) else {}
        return Split(tuple(pairs), taken, left, length)

    def near(self, shift: float, margin: float, level: float) -> dict[object, NDArray[np.bool_]]:
        """Return masks (paths,) of the paths that ends pass too near, by the `paths_of` of pairs.

        Passing an end at a distance d with a speed v spreads a tone beyond its shift D, at an offset f, by
        ``exp(-2 pi sqrt(f^2 - D^2) d / v)``: the phase has branch points at +-j d / v. This is to be below a level at
        a margin beyond the shift, both in Hz.
        """
        needed = -math.log(level) / (2.0 * math.pi * math.sqrt(margin * (margin + 2.0 * shift)))
        found: dict[object, NDArray[np.bool_]] = {}
        tracks, until = self.tracks, self.emission.until
        receivers = sorted({tracks.pairs[i].receiver for i in self.pairs})
        for what, ends, most, radius in passes(tracks, self.emission.source, receivers):
            times = passing_times(ends, until, needed, most, radius) if most > 0.0 else np.empty(0)
            times = times[:: max(len(times) // _INSTANTS, 1)]
            for i in self.pairs if len(times) else ():
                paths, key = tracks.pair_paths[i], tracks.paths_of(i)
                if paths.family.is_specular and what == f"receiver {paths.receiver}" and key not in found:
                    bound = _NEAR * needed * most / tracks.scene.air.slowest
                    found[key] = np.any(paths.arrivals(times, tracks.kinematics).delay < bound, axis=1)
                elif not paths.family.is_specular:
                    found[key] = np.ones(len(paths), dtype=np.bool_)
        return found


def sudden_times(end: Source | Receiver) -> Floats:
    """Return times (k,) at which the velocity of an end jumps, or that of its turning if it has a directivity, s."""
    directivity = end.directivity
    heads = isinstance(directivity, ChannelDirectivity) and not directivity.by_functions
    jumps = turn_jumps(end.trajectory, LEAST_JUMP if heads else _LEAST_JUMP)
    jumps = jumps[:0] if type(directivity) is Omni else jumps
    # Many are small, and near each other: measurements between nodes show if they matter.
    return np.union1d(end.trajectory.breaks, jumps if len(jumps) <= MOST_JUMPS else jumps[:0])


def cuts(tracks: SceneTracks, pair: int) -> Floats:
    """Return the times (paths, Q) by the receiver's clock at which jumps of velocity are received, s."""
    paths = tracks.pair_paths[pair]
    receiver, source = tracks.scene.receivers[paths.receiver], tracks.scene.sources[paths.source]
    at = [np.tile(sudden_times(receiver), (len(paths), 1))]
    for jump in sudden_times(source).tolist():
        at.append(_received(tracks, paths, jump) if tracks.kinematics.retarded else np.full((len(paths), 1), jump))
    return clock_time(receiver, np.concatenate(at, axis=1))


def _received(tracks: SceneTracks, paths: PairPaths, emitted: float) -> Floats:
    """Return when paths (paths, 1) bring what is emitted at a time, s, within some microseconds."""
    fastest = tracks.max_rate(paths.source)
    delay = paths.arrivals(np.array([emitted]), tracks.kinematics).delay
    low, high = delay.min() / (1.0 + fastest), delay.max() / (1.0 - fastest)
    times = emitted + np.linspace(low, high, 2 + math.ceil((high - low) / _CUT_STEP))
    early = times - emitted - paths.arrivals(times, tracks.kinematics).delay  # it increases
    after = np.clip(np.count_nonzero(early < 0.0, axis=1)[:, None], 1, len(times) - 1)
    before, behind = (np.take_along_axis(early, i, axis=1) for i in (after - 1, after))
    return np.asarray(times[after - 1] - before * (times[after] - times[after - 1]) / (behind - before))


def node_error_db(
    tracks: SceneTracks, emission: Emission, filters: SourceFilters, pairs: tuple[int, ...], spacing: int,
    heads: Heads | None = None,
) -> float:  # fmt: skip
    """Measure the error between nodes at the end of the band, relative to responses, dB, by a few active paths.

    It is that of the channel where it is most, relative to the loudest one.
    """
    rate = filters.rate
    rng, window = np.random.default_rng(emission.source), node_window(spacing)
    some = pairs[:: -(-len(pairs) // _EVALUATED_AT[0])]
    count = _EVALUATED_AT[2] // len(some)  # of each
    wrong = loud = 0.0
    for pair in some:
        of_run = rng.integers(0, max(round(emission.until * rate), 1), count)
        of_run[:2] = 0, round(emission.until * rate)
        rows = np.unique(np.append(0, rng.integers(0, len(tracks.pairs[pair]), _EVALUATED_AT[1] - 1)))
        places, tapers = of_run, tracks.pairs[pair].tapers
        if len(shaken := _left_jumps(tracks, pair, emission.until)):
            places[2::2] = np.rint(rng.choice(shaken, len(places[2::2])) * rate)
        if tapers is not None:
            times = tapers.part(np.resize(rows, count)).some_times(emission.until, rng)
            places = np.rint(times * rate).astype(np.int64)
        whole, within = np.divmod(places, spacing)
        whole, within = whole[:, None] + np.arange(1 - NODES, NODES + 1), np.where(within == 0, spacing // 2, within)
        weights = window[within[:, None] + spacing * np.arange(2 * NODES - 1, -1, -1) - 1]
        times = np.concatenate([whole * spacing, whole[:, NODES - 1, None] * spacing + within[:, None]], axis=1) / rate
        delay, _, gain = tracks.evaluate(pair, times.ravel(), flat_basis(filters.band), rows)
        gain = gain if tapers is None else gain * tapers.part(rows).weights(times.ravel())
        turned = gain[:, 0] * np.exp(-2j * math.pi * filters.band * delay)  # (C, P, T)
        if heads is not None:
            turned = turned * heads.responses(tracks.pair_paths[pair].part(rows), tracks, times.ravel(), filters.band)
        turned = turned.reshape(*turned.shape[:2], count, times.shape[1])
        apart = np.einsum("cpin,in->cpi", turned[..., :-1], weights) - turned[..., -1]
        wrong += float(np.max(np.sum(np.abs(apart) ** 2, axis=1)))
        loud += float(np.max(np.mean(np.sum(np.abs(turned[..., -1]) ** 2, axis=1), axis=-1)))
    return 10.0 * math.log10(max(wrong / max(loud, 1e-300), 1e-30))


def _left_jumps(tracks: SceneTracks, pair: int, until: float) -> Floats:
    """Return times (k,), s, at which the turning of a pair's ends jumps, where there are too many to be cut out."""
    scene, member = tracks.scene, tracks.pairs[pair]
    ends = scene.receivers[member.receiver], scene.sources[member.source]
    found = [np.empty(0) if type(end.directivity) is Omni else turn_jumps(end.trajectory) for end in ends]
    here, there = (jumps[: len(jumps) * (len(jumps) > MOST_JUMPS)] for jumps in found)
    if len(there):
        there = there + float(tracks.delay_range(pair, 0.0, until)[1].max())
    times = np.concatenate([here, there])
    return np.asarray(times[(times > 0.0) & (times < until)])


def described_beside(part: PairPart) -> list[str]:
    """Describe what is summed beside sampled channels, a line for each source."""
    tracks, lines = part.plan.tracks, []
    for source in sorted({tracks.pairs[i].source for i in part.pairs}):
        mine = [t for i in part.pairs if tracks.pairs[i].source == source and (t := tracks.pairs[i].tapers) is not None]
        count, whole = sum(len(t.rise) for t in mine), sum(int(np.count_nonzero(np.isposinf(t.rise))) for t in mine)
        lines.append(
            f"source {source}: {count} stretches of paths are summed beside them: {count - whole} beginnings, ends and "
            f"jumps for {1e3 * mine[0].length:.0f} ms each, {whole} that are too short or pass too near"
        )
    return lines
