"""Tracks: delay and gain of every path over time, whoever computed them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, short_repr
from clsim.errors import InputError
from clsim.paths.family import PairPaths, PeakSpeeds
from clsim.paths.path_set import PathSet
from clsim.paths.response import Arrivals, Kinematics, SceneResponse
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.ends import Receiver
from clsim.scene.motion.curves import CONTINUATION
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.scene import Scene
from clsim.tracks.basis import Basis
from clsim.tracks.splines import DEFAULT_TRANSITION, Rows, Tapers, as_transition, fitted_tracks, in_batches

_BESIDE = 1e-4  # s, to either side, between which the lateness of channels is taken to change evenly


@dataclass(frozen=True, slots=True, eq=False)
class PairTracks:
    """Paths from one source to one receiver."""

    source: int  # indices
    receiver: int  # likewise
    start: Floats  # (paths,) interval of reception in which each path is heard, s
    end: Floats  # likewise
    channels: range = range(1)  # of the receiver: those that have the delays
    tapers: Tapers | None = None  # slow weights of the paths, beside their transitions; None for 1
    silent_ends: bool = False  # whether nothing is heard of paths where they begin or end

    def __len__(self) -> int:
        return len(self.start)

    @property
    def always_audible(self) -> bool:
        """Whether no path begins or ends."""
        return bool(np.all(np.isneginf(self.start)) and np.all(np.isposinf(self.end)))

    @property
    def fades(self) -> bool:
        """Whether any path begins or ends while it is heard."""
        return not (self.silent_ends or self.always_audible)


class Tracks(ABC):
    """Delay and gain of paths as functions of the time of reception."""

    pairs: tuple[PairTracks, ...]
    source_count: int
    receiver_names: tuple[str, ...]
    transition: float  # s, over which paths begin and end; 0 for at once

    @property
    def of_scene(self) -> SceneTracks | None:
        """These tracks with the scene whose paths they are; None for those that were computed elsewhere."""
        return None

    @property
    def least_level(self) -> float:
        """Level of gains in a segment below which their errors are relative to it."""
        return 1e-30

    @property
    def eased_db(self) -> float:
        """Allowance for the error of delays and gains between nodes, dB above the default bound."""
        return 0.0

    @property
    def on_device(self) -> bool:
        """Whether gains are those of paths of a scene, which devices make nodes of."""
        return self.of_scene is not None

    @property
    def channels(self) -> tuple[tuple[str, ...], ...]:
        """Names of the channels of each receiver."""
        return (("",),) * len(self.receiver_names)

    def evaluate(
        self, pair: int, times: Floats, basis: Basis, rows: NDArray[np.int64] | None = None, every: int = 1
    ) -> tuple[Floats, Floats, Floats]:
        """Return delays (P, T), s, rates and gains of a `pair`, as of `evaluate_together` with one pair.

        Parameters
        ----------
        times, basis, rows, every
            As of `evaluate_together`.
        """
        return self.evaluate_together([pair], times, basis, rows, every)[0]

    def evaluate_together(
        self, pairs: Sequence[int], times: Floats, basis: Basis, rows: NDArray[np.int64] | None = None, every: int = 1
    ) -> list[tuple[Floats, Floats, Floats]]:
        """Return delays, their derivatives and gains of the paths of pairs, or of some that these have in common.

        Parameters
        ----------
        pairs : sequence of int
            Indices of source and receiver, in `pairs`, with the same `paths_of`.
        times : ndarray (T,)
            Times of reception, s.
        basis : Basis
            K functions of frequency of which responses are sums.
        rows : ndarray (P,) of int, optional
            Paths of each pair; all of them when left out.
        every : int
            Gains are asked for at the first of so many times, and so on.

        Returns
        -------
        list of (ndarray (P, T), ndarray (P, T), ndarray (C, K, P, ceil(T / every)))
            Of each pair delays from emission to reception, s, their derivatives by the time of reception, s/s, and
            received over emitted pressure, by channels of the receiver and functions of the basis.
        """
        return [self.evaluate(pair, times, basis, rows, every) for pair in pairs]

    def paths_of(self, pair: int) -> Any:
        """Return a key that pairs have in common whose paths are the same; `pair` is an index of `pairs`."""
        return pair

    def costly(self, pair: int) -> bool:
        """Test if the gains of the paths of a `pair`, an index of `pairs`, cost much, see `PathFamily`."""
        return False

    @abstractmethod
    def max_rate(self, source: int) -> float:
        """Return a bound on the magnitude of the rate of change of delays of a `source`, s/s."""

    @abstractmethod
    def fastest(self, source: int, max_rate: float) -> tuple[float, float]:
        """Return the largest speed of a `source` or its receivers, m/s, and that by a `max_rate` of delays, s/s."""

    def delay_range(self, pair: int, start: float, end: float) -> tuple[Floats, Floats]:
        """Return bounds (paths,), (paths,) on the delays of a `pair`'s paths received from `start` to `end`, s."""
        return self.delay_ranges([pair], start, end)[0]

    def delay_ranges(self, pairs: Sequence[int], start: float, end: float) -> list[tuple[Floats, Floats]]:
        """Return bounds (paths,), (paths,) on the delays of each of `pairs` received from `start` to `end`, s."""
        return [self.delay_range(pair, start, end) for pair in pairs]

    def longest_delay(self, start: float, end: float, source: int | None = None) -> float:
        """Return a bound on delays from `start` to `end` of reception, s, of one `source` or all; 0 without paths."""
        pairs = [i for i, pair in enumerate(self.pairs) if source in (None, pair.source)]
        return max((float(high.max()) for _, high in self.delay_ranges(pairs, start, end)), default=0.0)

    @abstractmethod
    def first_end(self) -> tuple[float, str]:
        """Return the time of reception up to which the tracks are known, s, and what ends then, in words."""

    def last_time(self) -> float:
        """Return the time of reception up to which the tracks are known, s."""
        return self.first_end()[0]

    @staticmethod
    def from_samples(
        times: Any, delays: Any, gains: Any, *, sources: Any = None, receivers: Any = None,
        transition: float = DEFAULT_TRANSITION,
    ) -> SampledTracks:  # fmt: skip
        """Return tracks from anybody's delays and gains.

        Parameters
        ----------
        times : array_like (T,)
            Times of reception, from 0 or before, strictly increasing, s.
        delays : array_like (P, T)
            From emission to reception, at least 0, s; NaN where a path is not heard.
        gains : array_like (P, T)
            Received over emitted pressure; NaN where, and only where, delays are.
        sources, receivers : array_like (P,) of int, optional
            Between which each path runs; all 0 when left out.
        transition : float
            Over which paths begin and end, s; 0 for at once.

        Returns
        -------
        SampledTracks
            C2 splines through the samples. A path that is silent in between is heard from its first to its last
            sample of every stretch.

        Examples
        --------
        >>> import clsim
        >>> tracks = clsim.Tracks.from_samples([0.0, 1.0], [[0.010, 0.011]], [[0.3, 0.3]])
        >>> tone = clsim.Signal.tone(1e3, duration=1.0, sampling_rate=48e3)
        >>> clsim.render_tracks([tone], tracks, sampling_rate=48e3).pressure.shape
        (1, 48000)
        """
        pairs, fitted = fitted_tracks(times, delays, gains, sources, receivers)
        each = tuple(PairTracks(*pair) for pair in pairs)
        return SampledTracks(each, **fitted, transition=as_transition(transition))


@dataclass(frozen=True, slots=True, eq=False)
class SceneTracks(Tracks):
    """Tracks of a scene's paths: computed when asked for, exactly.

    Times are those of the receivers' clocks, and delays what a receiver must take from its own time to find the time of
    emission: for a clock of its own, less than the sound's by as much as samples are taken later than told.
    """

    paths: PathSet
    kinematics: Kinematics
    pairs: tuple[PairTracks, ...]
    pair_paths: tuple[PairPaths, ...]
    speeds: PeakSpeeds
    transition: float
    source_count: int
    receiver_names: tuple[str, ...]
    # By start, end and source: filters, chunks and memory ask for the same ones.
    _longest: dict[tuple[float, float, int | None], float] = field(default_factory=dict, init=False)
    _rates: dict[int, float] = field(default_factory=dict, init=False)  # by source, likewise

    __repr__ = short_repr

    def longest_delay(self, start: float, end: float, source: int | None = None) -> float:
        key = start, end, source if self.source_count > 1 else None
        if key not in self._longest:
            self._longest[key] = Tracks.longest_delay(self, *key)
        return self._longest[key]

    @property
    def of_scene(self) -> SceneTracks:
        return self

    @property
    def scene(self) -> Scene:
        return self.paths.scene

    @property
    def channels(self) -> tuple[tuple[str, ...], ...]:
        return tuple(receiver.directivity.channels for receiver in self.paths.scene.receivers)

    def paths_of(self, pair: int) -> Any:
        paths = self.pair_paths[pair]
        return id(paths.family), paths.source, paths.receiver, len(paths), int(paths.index[0])

    def among(self, pairs: Sequence[int]) -> SceneTracks:
        """Return the tracks of some of the pairs, by their indices, and of no other kinds of paths."""
        some = tuple(self.pair_paths[i] for i in pairs)
        families = tuple({id(pair.family): pair.family for pair in some}.values()) or self.paths.families
        mine = tuple(self.pairs[i] for i in pairs)
        return replace(self, pairs=mine, pair_paths=some, paths=PathSet(self.paths.scene, families))

    def with_ends(self, **ends: Iterable[Any]) -> SceneTracks:
        """Return the same tracks between other `sources` or `receivers`, which are not checked."""
        scene, families = copy(self.paths.scene), {id(family): copy(family) for family in self.paths.families}
        for name, values in ends.items():
            object.__setattr__(scene, name, tuple(values))
        for family in families.values():
            object.__setattr__(family, "scene", scene)
        pair_paths = tuple(replace(pair, family=families[id(pair.family)]) for pair in self.pair_paths)
        return replace(self, paths=PathSet(scene, tuple(families.values())), pair_paths=pair_paths)

    def with_rows(self, rows: Mapping[int, Rows]) -> SceneTracks:
        """Return the same tracks, of some pairs with other paths: stretches of theirs."""
        pairs, pair_paths = list(self.pairs), list(self.pair_paths)
        for i, some in rows.items():
            pairs[i] = replace(pairs[i], start=some.start, end=some.end, tapers=some.tapers)
            pair_paths[i] = pair_paths[i].part(some.rows)
        return replace(self, pairs=tuple(pairs), pair_paths=tuple(pair_paths))

    def costly(self, pair: int) -> bool:
        receiver = self.paths.scene.receivers[self.pairs[pair].receiver]
        return self.pair_paths[pair].family.costly or isinstance(receiver.directivity, ChannelDirectivity)

    def evaluate_together(
        self, pairs: Sequence[int], times: Floats, basis: Basis, rows: NDArray[np.int64] | None = None, every: int = 1
    ) -> list[tuple[Floats, Floats, Floats]]:
        """Solve the paths once that pairs have in common, as those of both ears."""
        of_pairs = [self.pair_paths[i] if rows is None else self.pair_paths[i].part(rows) for i in pairs]
        paths = of_pairs[0]
        receiver = self.paths.scene.receivers[paths.receiver]
        clock_error, clock_rate = receiver.clock_error(times), receiver.clock_rate
        now = times + clock_error
        found = paths.arrivals(now, self.kinematics)
        some = found if every == 1 else found.part(np.arange(len(paths)), slice(None, None, every))
        delay, rate = found.delay - clock_error, found.delay_rate * clock_rate - (clock_rate - 1.0)
        late, beside = np.zeros((*delay.shape, 1)), np.zeros((*delay.shape, 1))
        if paths.reach > 0.0:
            late = paths.emission_lateness(found, now)
            before, after = (
                paths.emission_lateness(paths.arrivals(at, self.kinematics), at)
                for at in (now - _BESIDE, now + _BESIDE)
            )
            beside = (after - before) / (2.0 * _BESIDE)
        out, gains = [], self.gains(pairs, of_pairs, some, now[::every], basis)
        for member, gain in zip(of_pairs, gains, strict=True):
            if member.reach == 0.0:
                out.append((delay, rate, gain))
            else:
                ear = member.only_channel
                out.append((delay + late[..., ear], rate + beside[..., ear], gain))
        return out

    def gains(
        self, pairs: Sequence[int], paths: Sequence[PairPaths], found: Arrivals, times: Floats, basis: Basis
    ) -> list[Floats]:
        """Return the gains (C, K, P, T) of paths of some pairs, whose responses are taken once."""
        at = SceneResponse(self.paths.scene, paths[0].source, basis.nodes, basis.tilt.at(basis.nodes))
        response, receiver = paths[0].response(found, times, at), self.paths.scene.receivers[paths[0].receiver]
        each = (at.of_channels(response, receiver, member.channels, found, times) for member in paths)
        return [np.moveaxis(basis.gains(responses), -1, 1) for responses in each]

    def max_rate(self, source: int) -> float:
        """Return the bound of the kinds of paths with peak speeds, by the clock of the receiver where it is most."""
        if source not in self._rates:
            self._rates[source] = self._max_rate(source)
        return self._rates[source]

    def _max_rate(self, source: int) -> float:
        fastest, source_speed = 0.0, float(self.speeds.source[source])
        clock_rates = (receiver.clock_rate for receiver in self.paths.scene.receivers)
        for speed, clock_rate in set(zip(self.speeds.receiver.tolist(), clock_rates, strict=True)):
            rate = max(family.max_rate(source_speed, speed) for family in self.paths.families)
            fastest = max(fastest, rate * clock_rate + abs(clock_rate - 1.0))
        return fastest

    def fastest(self, source: int, max_rate: float) -> tuple[float, float]:
        """Return the largest peak speed, of scatterers and bodies too, and what it would be at another rate."""
        v_s, v_r = float(self.speeds.source[source]), float(self.speeds.receiver.max())
        surfaces = [scatterer.peak_speeds()[1] for scatterer in self.scene.scatterers]
        v_b = max([*surfaces, *(body.peak_speed for body in self.scene.bodies)], default=0.0)  # seen there and back
        together = v_s + v_r + 2.0 * v_b + max_rate * v_s
        if together == 0.0:
            return 0.0, 0.0
        most = max(v_s, v_r, v_b)
        return most, max_rate * self.paths.scene.air.slowest / together * most

    def delay_ranges(self, pairs: Sequence[int], start: float, end: float) -> list[tuple[Floats, Floats]]:
        clock_times = np.array([start, end])
        clock_error = np.stack([r.clock_error(clock_times) for r in self.paths.scene.receivers])
        first, last = (clock_times + clock_error).T
        least, most = clock_error.min(axis=1), clock_error.max(axis=1)
        bounds: dict[int, tuple[Floats, Floats]] = {}
        for family in self.paths.families:
            mine = [i for i in pairs if self.pair_paths[i].family is family]
            for batch in in_batches(mine, [len(self.pair_paths[i]) for i in mine]):
                rows = np.concatenate([self.pair_paths[i].index for i in batch])
                r, counts = family.receiver[rows], [len(self.pair_paths[i]) for i in batch]
                low, high = family.delay_bounds(rows, first[r], last[r], self.speeds)
                reach = np.repeat([self.pair_paths[i].reach for i in batch], counts)
                reach *= 1.0 + family.max_rate(float(self.speeds.source.max()), float(self.speeds.receiver.max()))
                each = (np.split(x, np.cumsum(counts)[:-1]) for x in (low - most[r] - reach, high - least[r] + reach))
                bounds |= dict(zip(batch, zip(*each, strict=True), strict=True))
        return [bounds[pair] for pair in pairs]

    def first_end(self) -> tuple[float, str]:
        scene = self.paths.scene
        ends = [(thing.trajectory.end, thing.name) for thing in scene.scatterers]
        ends += [(body.trajectory.end, body.name) for body in scene.bodies]
        known = [min([(r.trajectory.end, r.name), *ends]) for r in scene.receivers]
        audible = [float(clock_time(r, np.array([end]))[0]) for r, (end, _) in zip(scene.receivers, known, strict=True)]
        first = int(np.argmin(audible))
        return audible[first], f"the trajectory of {known[first][1]!r}"


@dataclass(frozen=True, slots=True, eq=False)
class SampledTracks(Tracks):
    """Tracks given as samples over time; see `Tracks.from_samples`."""

    pairs: tuple[PairTracks, ...]
    splines: tuple[tuple[tuple[NDArray[np.int64], Any], ...], ...]
    source_count: int
    receiver_names: tuple[str, ...]
    largest_rate: float
    end: float
    transition: float

    __repr__ = short_repr

    def evaluate_together(
        self, pairs: Sequence[int], times: Floats, basis: Basis, rows: NDArray[np.int64] | None = None, every: int = 1
    ) -> list[tuple[Floats, Floats, Floats]]:
        which = slice(None) if rows is None else rows
        found = (self._values(pair, times) for pair in pairs)
        return [(delay[which], rate[which], gain[None, None, which, ::every]) for delay, rate, gain in found]

    def _values(self, pair: int, times: Floats) -> tuple[Floats, Floats, Floats]:
        """Values of splines, one gain for all frequencies; outside its stretch a path goes on straight."""
        shape = (len(self.pairs[pair]), len(times))
        delay, rate, gain = np.empty(shape), np.empty(shape), np.empty(shape)
        # The gain's slope goes on through the transition, and to the next node.
        reach = max(0.5 * self.transition, times[1] - times[0] if len(times) > 1 else 0.0)
        for which, spline in self.splines[pair]:
            inside = np.clip(times, spline.x[0], spline.x[-1])
            values, slopes = spline(inside), spline(inside, 1)
            delay[which] = values[:, :, 0].T + slopes[:, :, 0].T * (times - inside)
            rate[which] = slopes[:, :, 0].T
            gain[which] = values[:, :, 1].T + slopes[:, :, 1].T * np.clip(times - inside, -reach, reach)
        return delay, rate, gain

    def max_rate(self, source: int) -> float:
        return self.largest_rate

    def fastest(self, source: int, max_rate: float) -> tuple[float, float]:
        """Return the speeds that change delays by as much in air of 343 m/s."""
        return 343.0 * self.largest_rate, 343.0 * max_rate

    def delay_ranges(self, pairs: Sequence[int], start: float, end: float) -> list[tuple[Floats, Floats]]:
        middle, slack = np.array([0.5 * (start + end)]), 0.5 * (end - start) * self.largest_rate
        delays = [self._values(pair, middle)[0][:, 0] for pair in pairs]
        return [(delay - slack, delay + slack) for delay in delays]

    def first_end(self) -> tuple[float, str]:
        return self.end, "the samples"


def as_tracks(value: object) -> Tracks:
    """Return tracks."""
    if not isinstance(value, Tracks):
        raise InputError("tracks", f"must be Tracks, but is {value!r:.80}")
    return value


def track(
    paths: PathSet, *, motion: str = "retarded", amplitude: str = "wave-equation",
    transition: float = DEFAULT_TRANSITION,
) -> SceneTracks:  # fmt: skip
    """Return the tracks of a scene's paths.

    Parameters
    ----------
    paths : PathSet
        From `find_paths`, or made by hand.
    motion : {"retarded", "quasi-static"}
        Whether the image is where it was when the sound was emitted, or where it is when it is received.
    amplitude : {"wave-equation", "static", "convective"}
        Exponent 1, 0 or 2 of ``1 / (1 - M)``.
    transition : float
        Over which paths begin and end, s; 0 for at once.
    """
    if not isinstance(paths, PathSet):
        raise InputError("paths", f"must be a PathSet, but is {paths!r:.80}")
    kinematics = Kinematics(motion, amplitude)
    scene = paths.scene
    pairs, pair_paths = [], []
    for _, of_pair in paths.pairs():
        receiver, family = scene.receivers[of_pair.receiver], of_pair.family
        start, end = (clock_time(receiver, times[of_pair.rows]) for times in (family.start, family.end))
        for group in of_pair.by_delay():
            channels, silent = group.channels or range(1), family.silent_ends
            pairs.append(PairTracks(of_pair.source, of_pair.receiver, start, end, channels, silent_ends=silent))
            pair_paths.append(group)
    # Speeds are sampled; 2 % covers what lies between the samples.
    source_speed, receiver_speed = (
        np.array([1.02 * _peak_speed(end.trajectory, *end.time_range) for end in ends])
        for ends in (scene.sources, scene.receivers)
    )
    return SceneTracks(
        paths=paths, kinematics=kinematics, pairs=tuple(pairs), pair_paths=tuple(pair_paths),
        speeds=PeakSpeeds(source_speed, receiver_speed), transition=as_transition(transition),
        source_count=len(scene.sources), receiver_names=tuple(r.name for r in scene.receivers),
    )  # fmt: skip


def _peak_speed(trajectory: Trajectory, start: float, end: float) -> float:
    """Return the largest speed from a start to an end, m/s, and shortly beyond, where a trajectory goes on."""
    return 0.0 if trajectory.is_static else trajectory.peak_speed(start - CONTINUATION, end + CONTINUATION)[0]


def clock_time(receiver: Receiver, times: Floats) -> Floats:
    """Return the readings of the receiver's clock at true times (n,), s."""
    if receiver.electronics is None:
        return times
    return (times - receiver.clock_error(np.zeros(1))) / receiver.clock_rate
