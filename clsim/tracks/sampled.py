"""Responses of a source's paths, sampled over a run, errors of received signals from theirs, and longer tracks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, firsts, ranges
from clsim.numerics.quaternions import quaternion_product
from clsim.paths.family import PairPaths
from clsim.paths.response import Arrivals, SceneResponse
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import Receiver, Source
from clsim.scene.motion.curves import CONTINUATION, onward
from clsim.scene.motion.motion import Motion, Turning
from clsim.scene.room.faces import NEAREST
from clsim.tracks.basis import GRIDS, IN_CACHE, Band, Sample
from clsim.tracks.tracks import SceneTracks, Tracks

SEED = 20_160_914
_ROWS = 1024  # responses of which the functions are made
_HELD_OUT = 4096  # responses at which they are checked
_COSTLY, _FEWER = (192, 256), 33  # the same, and frequencies, of costly responses
_LEAST_WHOLE = 5  # instants at which at least all paths are taken, where responses are costly
TIMES = 24  # instants of a run at which the paths of a pair are looked at, fewer where there are many pairs
TIMES_OF_BANDS = 8  # the same for narrow bands, of ends that receive alike in all directions
_FRAMES = 48  # of all pairs, about
_PER_DISTANCE = 12  # instants for ends that go as far as they are apart at least
_BEYOND = 0.02  # s after the end of a run up to which nodes lie that its last blocks are made of
_MOST_TIMES = 256  # of a pair by things whose field changes with every direction: 24 miss its lobes
_TOGETHER = 512  # responses that are worked on together
LEAST_JUMP = 1e-4  # rad/s, of the angular velocity, below which it counts as smooth
_MOST_PAIRS = 16  # pairs of source and receiver looked at
_MOST_PATHS = 1024  # of each: of more, the loudest half of so many, and as many of the others
_LATEST = 0.012  # s between the earliest and the latest of responses that can be told
_MOST_DELAYS = 512  # samples of them
_LATE_ROWS = 64  # responses that tell it
_PROBED = 7  # instants from one at which a delay and a grid are looked for to the next, where all paths are taken
_LATE_SHARE = 1e-4  # of their energy may lie earlier than the time of which the middle is taken, and later
_LEAST_LATE = 32  # samples; less is not worth being taken out
_SILENT = 1e-150  # gain, whose square is still a number; what air leaves of 40 kHz after some 2 km
_FAINT = 0.01  # weight of frequencies with next to nothing where a delay is looked for


@dataclass(frozen=True, slots=True, eq=False)
class Picked:
    """Paths of a pair at instants, drawn by their energy, and the number of paths that each represents."""

    paths: PairPaths  # which: P at each of T instants, or, of responses that take each at its own, of all together
    found: Arrivals  # (P, T), or of each at its instant, (P, 1)
    times: Floats  # (T,) the instants, s, or (P, 1)
    scale: Floats  # (T P, 1) root of how many paths each stands for, over the level of all of the pair
    first: tuple[int, ...]  # where the paths of each instant begin, and P at the end
    whole: bool = False  # all paths of each instant, whose level is that of the responses

    def thinned(self, every: int) -> Picked:
        begin, end = np.array(self.first[:-1])[::every], np.array(self.first[1:])[::every]
        rows, first = ranges(begin, end)[1], tuple(firsts(end - begin).tolist())
        changed: dict[str, Any] = {"scale": self.scale[rows], "first": first}
        if self.times.ndim == 1:
            at = np.arange(len(self.times))[::every]
            found = self.found.part(np.arange(len(self.found.through))[:, None], at)
            return replace(self, found=found, times=self.times[at], **changed)
        found, times = self.found.part(rows), self.times[rows]
        return replace(self, paths=self.paths.part(rows), found=found, times=times, **changed)


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """Paths of a source at instants of the run: whatever its signal and band are, the same."""

    tracks: SceneTracks
    source: int  # index
    until: float  # end of the run, s
    rows: tuple[Picked, ...]  # of which functions are made, and at which they are checked
    held_out: tuple[Picked, ...] = ()  # likewise
    grids: tuple[int, ...] = GRIDS  # frequencies of the band, the first number that resolves the responses
    whole: bool = False  # costly responses of few paths: all at each instant, of which every other one is held out
    approximate: bool = False  # whether all are by scatterers whose fields are approximations

    @classmethod
    def of(cls, tracks: Tracks, source: int, until: float, costly: bool = False, *, times: int = TIMES) -> Draw:
        """Draw paths of a source for a run `until`, s, at `times` instants if little changes; few of costly ones."""
        counts, grids = (_COSTLY, (_FEWER, *GRIDS)) if costly else ((_ROWS, _HELD_OUT), GRIDS)
        of_scene, rng = tracks.of_scene, np.random.default_rng(SEED)
        assert of_scene is not None
        total = sum(len(pair.start) for pair in of_scene.pairs if pair.source == source)
        vertices = [getattr(pair.family, "vertex", None) for pair in of_scene.pair_paths]
        approximate = all(getattr(vertex, "approximate", False) for vertex in vertices)
        if costly and _LEAST_WHOLE * total <= min(counts):
            rows = tuple(picked_paths(of_scene, source, until, sum(counts), rng, whole=True))
            return cls(of_scene, source, until, rows, (), grids, True, approximate)
        rows, held_out = (tuple(picked_paths(of_scene, source, until, count, rng, times=times)) for count in counts)
        return cls(of_scene, source, until, rows, held_out, grids, False, approximate)

    def probe(self) -> Draw:
        """Return the same with few of the instants, where all paths are taken at each."""
        several = [some for some in self.rows if len(some.first) > 2]
        rows = tuple(some.thinned(_PROBED) for some in several) or self.rows[::_PROBED]
        return replace(self, rows=rows) if self.whole else self

    def responses(self, band: Band, *, held_out: bool = False) -> Sample:
        """Responses over a band of the paths of which functions are made, or of those at which they are checked."""
        made: list[Any] = []
        beyond: list[Floats] = []
        beside: list[float] = []
        scene = self.tracks.paths.scene
        at = SceneResponse(scene, self.source, band.frequencies, band.tilt.at(band.frequencies))
        middle = int(np.abs(band.frequencies - scene.sources[self.source].emitted.centre_frequency).argmin())
        for some in self.held_out if held_out else self.rows:
            family = some.paths.family
            directivity = family.scene.receivers[some.paths.receiver].directivity
            alike = not isinstance(directivity, ChannelDirectivity) or directivity.is_flat
            if alike and not family.shapes_channels:  # channels do not differ over frequency: one stands for all
                shapes = family.response(some.paths.rows, some.found, some.times, at)[None]
            else:
                shapes = family.of_channels(some.paths, some.found, some.times, at)
            along = np.swapaxes(shapes, 1, 2).reshape(len(shapes), -1, shapes.shape[3])
            if band.late != 0.0:
                along = along * np.conj(band.turn)
            along, spans = along * some.scale, list(pairwise(some.first))
            if some.whole:
                energy = np.mean(np.abs(along[:, :, middle]) ** 2, axis=0)
                if family.adds:
                    path = family.unshaded(some.paths.rows, some.found, some.times, at)[..., middle]
                    energy = np.abs(path.T.ravel() * some.scale[:, 0]) ** 2
                level = np.sqrt(np.add.reduceat(energy, some.first[:-1]))
                along /= np.maximum(level, _SILENT).repeat(np.diff(some.first))[:, None]
                spans = [span for span, sounds in zip(spans, (level > _SILENT).tolist(), strict=True) if sounds]
            made += [channel[begin:end] for begin, end in spans for channel in along]
            beside += [float(family.adds)] * (len(spans) * len(along))
            further = some.found.through.T.reshape(-1) - 1.0
            beyond += [further[begin:end] for begin, end in spans for _ in along]
        if not made:  # paths that are silent all the time
            return Sample(band, np.ones((1, len(band.frequencies))), np.zeros(1, dtype=np.int64), np.zeros(1))
        first = np.cumsum([0, *(len(rows) for rows in made[:-1])])
        others = np.array(beside) if any(beside) else None
        return Sample(band, np.concatenate(made), first, np.concatenate(beyond), others)

    def common_delay(self, band: Band, sampling_rate: float) -> float:
        """Middle time of nearly all energy of complex responses, s, in whole samples; 0 if little or real."""
        if not self.tracks.paths.is_complex:
            return 0.0
        width = band.high - band.low
        count = int(np.clip(math.ceil(_LATEST * width), 64, _MOST_DELAYS))
        even = np.linspace(band.low, band.high, count)
        level = np.sqrt(band.energy.max(axis=0))
        level = np.interp(even, band.frequencies[::-1], np.maximum(level / level.max(), _FAINT)[::-1])
        few = self.probe()
        if not self.whole:
            rng = np.random.default_rng(SEED)
            few = replace(self, rows=tuple(picked_paths(self.tracks, self.source, self.until, _LATE_ROWS, rng)))
        spread = Band(band.low, band.high, even, np.ones((1, count)) / count)
        rows = few.responses(spread).responses
        energy = np.sum(np.abs(np.fft.ifft(rows * (level * np.hanning(count)), axis=1)) ** 2, axis=0)
        # The transform goes round: time begins opposite to where most of the energy is, rather late than early.
        turns = np.angle(energy @ np.exp(2j * math.pi * np.arange(count) / count)) / (2.0 * math.pi)
        begin = round((turns + (turns < -0.25) - 0.5) * count)
        below = np.cumsum(np.roll(energy, -begin)) / max(float(energy.sum()), 1e-300)
        middle = begin + 0.5 * float(np.searchsorted(below, [_LATE_SHARE, 1.0 - _LATE_SHARE]).sum())
        samples = round(middle * sampling_rate * (count - 1) / count / width)
        return samples / sampling_rate if abs(samples) >= _LEAST_LATE else 0.0


def picked_paths(
    tracks: SceneTracks, source: int, until: float, count: int, rng: np.random.Generator, whole: bool = False,
    times: int = TIMES,
) -> Iterator[Picked]:  # fmt: skip
    """Yield about `count` of a source's paths altogether, at instants of the run; `whole`: all at each."""
    pairs = [i for i, g in enumerate(tracks.pairs) if g.source == source]
    if len(pairs) > _MOST_PAIRS:
        pairs = sorted(rng.choice(pairs, _MOST_PAIRS, replace=False).tolist())
    total = sum(len(tracks.pairs[i].start) for i in pairs)
    few = max(3, min(TIMES, _FRAMES // max(len(pairs), 1)))
    centre = np.array([tracks.paths.scene.sources[source].emitted.centre_frequency])
    at_centre = SceneResponse(tracks.paths.scene, source, centre)
    for i in pairs:
        paths, start, end = tracks.pair_paths[i], tracks.pairs[i].start, tracks.pairs[i].end
        instants, last = _instants(tracks, i, until, few, times), until
        if paths.family.varies:
            last = until + _BEYOND
            instants = max(few, min(_MOST_TIMES, count // (len(pairs) * max(len(start), 1))))
            if whole:
                instants = max(_LEAST_WHOLE, count // max(total, 1))
        weight = np.ones((len(start), 1))
        if len(start) > _MOST_PATHS:
            some, weight = _candidates(paths, tracks, last, at_centre, rng)
            paths, start, end = paths.part(some), start[some], end[some]
        at = np.sort(rng.uniform(0.0, last, instants))
        at[[0, -1]] = 0.0, last
        if tracks.pairs[i].silent_ends:
            at = while_active(start, end, at, last)
        share = max(-(-count // (len(pairs) * instants)), len(start) * whole)
        together = instants if paths.family.one_by_one else max(IN_CACHE // max(len(start), 1), 1)
        for part in (at[i : i + together] for i in range(0, instants, together)):
            found = paths.arrivals(part, tracks.kinematics)
            received = (part >= start[:, None]) & (part < end[:, None])
            level = 1.0 if whole else np.abs(paths.family.unshaded(paths.rows, found, part, at_centre)[..., 0])
            level = np.where(received, level, 0.0) * weight
            level[level < _SILENT] = 0.0
            if paths.family.varies and not paths.family.one_by_one and len(start) <= share and level.all():
                each = (weight / np.linalg.norm(level, axis=0)).T.reshape(-1, 1)
                yield Picked(paths, found, part, each, tuple(range(0, level.size + 1, len(start))), whole)
                continue
            for rows, own, when, scale, first in _drawn(level, part, share, rng, together=not paths.family.one_by_one):
                yield Picked(paths.part(rows), found.part(rows[:, None], own), when, scale * weight[rows], first, whole)


def while_active(start: Floats, end: Floats, times: Floats, last: float) -> Floats:
    """Carry times (T,) from 0 to the last one, s, to those at which any path is active, from (P,) to (P,)."""
    order = np.argsort(start)
    begin, until = (np.clip(x[order], 0.0, last) for x in (start, end))
    begin = np.maximum(begin, np.append(0.0, np.maximum.accumulate(until)[:-1]))  # what is not in the ones before
    length = np.maximum(until - begin, 0.0)
    if not length.sum() > 0.0:
        return times
    begin, length = begin[length > 0.0], length[length > 0.0]
    before = np.append(0.0, np.cumsum(length))
    within = times * (before[-1] / last)
    which = np.clip(np.searchsorted(before, within, side="right") - 1, 0, len(length) - 1)
    return np.asarray(begin[which] + np.minimum(within - before[which], length[which]))


def _candidates(
    paths: PairPaths, tracks: SceneTracks, last: float, at_centre: SceneResponse, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Floats]:
    """Return loudest paths at an instant until `last`, as many others, and roots (n, 1) of how many each stands for."""
    instant, half = rng.uniform(0.0, last, 1), _MOST_PATHS // 2
    found = paths.arrivals(instant, tracks.kinematics)
    order = np.argsort(-np.abs(paths.family.response(paths.rows, found, instant, at_centre)[:, 0, 0]), kind="stable")
    weight = np.zeros((len(order), 1))
    weight[rng.choice(order[half:], half, replace=False)] = math.sqrt((len(order) - half) / half)
    weight[order[:half]] = 1.0
    some = np.flatnonzero(weight)
    return some, weight[some]


def _drawn(
    level: Floats, times: Floats, share: int, rng: np.random.Generator, *, together: bool
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Floats, Floats, tuple[int, ...]]]:
    """Yield rows of `share` paths of each instant by their levels (P, T): rows, instants, times, scales, firsts."""
    drawn = [(t, *_picked(level[:, t], share, rng)) for t in np.flatnonzero(level.any(axis=0)).tolist()]
    most = max((len(rows) for _, rows, _ in drawn), default=1)
    each = 1 if together else max(_TOGETHER // most, 1)
    for begin in range(0, len(drawn), each):
        part = drawn[begin : begin + each]
        counts = [len(rows) for _, rows, _ in part]
        scale = np.concatenate([np.sqrt(standing) / np.linalg.norm(level[:, t]) for t, _, standing in part])
        rows = np.concatenate([rows for _, rows, _ in part])
        at = np.repeat([t for t, _, _ in part], counts)[:, None]
        yield rows, at, times[at[0] if together else at], scale[:, None], tuple(np.cumsum([0, *counts]).tolist())


def _instants(tracks: SceneTracks, pair: int, until: float, most: int, alike_most: int = TIMES) -> int:
    """Return the number of instants that tell of a pair, at least 3: fewer the less its ends approach each other.

    Ends that hear alike in all directions, go a quarter of their distance and have the same paths all the time are
    told of by beginning, end and one instant between them.
    """
    paths, scene = tracks.pair_paths[pair], tracks.paths.scene
    source, receiver = scene.sources[paths.source], scene.receivers[paths.receiver]
    alike = isinstance(source.directivity, Omni) and isinstance(receiver.directivity, Omni)
    if not (alike and paths.family.is_specular and tracks.pairs[pair].always_audible) or paths.family.moves:
        return most
    travelled = until * float(tracks.speeds.source[paths.source] + tracks.speeds.receiver[paths.receiver])
    begin = np.zeros(1)
    apart = float(np.linalg.norm(source.trajectory.position(begin) - receiver.trajectory.position(begin)))
    wanted = math.ceil(_PER_DISTANCE * travelled / max(apart - travelled, 1e-3 * travelled, NEAREST))
    return int(np.clip(wanted, 3, min(most, alike_most)))


def _picked(level: Floats, count: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], Floats]:
    """Return about `count` paths, likelier the louder (P,) they are, and how many paths each stands for."""
    emitting = np.flatnonzero(level)
    if len(emitting) <= count:
        return emitting, np.ones(len(emitting))
    loud = level[emitting]
    chance = np.minimum(count * loud / loud.sum(), 1.0)
    before = 0
    for _ in range(8):
        sure = chance >= 1.0  # the loudest, more of them each time
        number = int(np.count_nonzero(sure))
        if number == before:  # nothing changes any more
            break
        before, left = number, max(count - number, 1)
        chance = np.where(sure, 1.0, np.minimum(left * loud / max(float(loud[~sure].sum()), 1e-300), 1.0))
    at = np.searchsorted(chance.cumsum(), rng.random() + np.arange(math.floor(chance.sum())))
    at = at[(at < len(emitting)) & (np.diff(at, prepend=-1) > 0)]
    return emitting[at], 1.0 / chance[at]


@dataclass(frozen=True, slots=True, eq=False)
class OnwardTurning:
    """A turning that goes on at its last angular velocity beyond two times, s."""

    turning: Turning
    first: float
    last: float

    turns = property(lambda self: self.turning.turns)
    peak = property(lambda self: self.turning.peak)
    breaks = property(lambda self: self.turning.breaks)

    def lever(self, points: Floats) -> float:
        return self.turning.lever(points)

    def orientation(self, time: Floats) -> Floats:
        known = np.clip(time, self.first, self.last)
        half = 0.5 * self.angular_velocity(time) * (time - known)[..., None]
        angle = np.linalg.norm(half, axis=-1, keepdims=True)
        turn = np.concatenate([np.sinc(angle / math.pi) * half, np.cos(angle)], axis=-1)
        return quaternion_product(turn, self.turning.orientation(known))

    def angular_velocity(self, time: Floats) -> Floats:
        return self.turning.angular_velocity(np.clip(time, self.first, np.nextafter(self.last, -np.inf)))


def turn_jumps(motion: Motion, least: float = LEAST_JUMP) -> Floats:
    """Return times (k,) between start and end at which the angular velocity jumps by at least so much, rad/s, s."""
    times = np.empty(0) if motion.turning is None else motion.turning.breaks
    times = times[(times > motion.start) & (times < motion.end)]
    before, after = (motion.angular_velocity(at) for at in (np.nextafter(times, -np.inf), times))
    return np.asarray(times[np.linalg.norm(after - before, axis=-1) > least])


def continued(tracks: SceneTracks, seconds: float) -> SceneTracks:
    """Return the same tracks between ends that move on at either side, s: silent, they may leave the room."""
    ends: dict[str, Any] = {"sources": tracks.scene.sources, "receivers": tracks.scene.receivers}
    return tracks.with_ends(**{name: [_end(end, seconds) for end in some] for name, some in ends.items()})


def _end(end: Source | Receiver, seconds: float) -> Source | Receiver:
    """Return an end that moves on: on lines and circles as they are, on others straight beyond their continuation."""
    made, motion = copy(end), end.trajectory
    if motion.end != np.inf:
        curve = onward(motion.curve, motion.start - CONTINUATION, motion.end + CONTINUATION)
        turning = None if motion.turning is None else OnwardTurning(motion.turning, motion.start, motion.end)
        begin, stop = motion.start - seconds, motion.end + seconds
        longer = replace(motion, curve=curve, turning=turning, start=begin, end=stop)
        object.__setattr__(made, "trajectory", longer)
    return made
