"""Paths of a source at instants of a run, drawn by their energy, and their responses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, firsts, ranges
from clsim.paths.family import PairPaths
from clsim.paths.response import QUASI_STATIC, Arrivals, SceneResponse
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.room.faces import NEAREST
from clsim.tracks.basis import GRIDS, IN_CACHE, Band, Sample
from clsim.tracks.tracks import SceneTracks, Tracks

LEAST_WHOLE = 5  # instants at which at least all paths are taken, where responses are costly
TIMES = 24  # instants of a run at which the paths of a pair are looked at, fewer where there are many pairs
TIMES_OF_BANDS = 8  # the same for narrow bands, of ends that receive alike in all directions
_FRAMES, _ALIKE = 48, 16  # of all pairs, about, and of such ends
_PER_DISTANCE = 12  # instants for ends that go as far as they are apart at least
_BEYOND = 0.02  # s after the end of a run up to which nodes lie that its last blocks are made of
_MOST_TIMES = 256  # of a pair by things whose field changes with every direction: 24 miss its lobes
_TOGETHER = 512  # responses that are worked on together
_MOST_PAIRS = 16  # pairs of source and receiver looked at
_MOST_PATHS = 1024  # of each: of more, the loudest half of so many, and as many of the others
_FAINT = 0.35  # share of the mean level, by which every path is drawn beside its own
SILENT = 1e-150  # gain, whose square is still a number; what air leaves of 40 kHz after some 2 km
SEED = 20_160_914
_ROWS = 768  # responses of which the functions are made
_HELD_OUT = 2048  # responses at which they are checked
_COSTLY, _FEWER = (192, 256), 33  # the same, and frequencies, of costly responses
_LATEST = 0.012  # s between the earliest and the latest of responses that can be told
_MOST_DELAYS = 512  # samples of them
_LATE_ROWS = 64  # responses that tell it
_PROBED = 7  # instants from one at which a delay and a grid are looked for to the next, where all paths are taken
_LATE_SHARE = 1e-4  # of their energy may lie earlier than the time of which the middle is taken, and later
_LEAST_LATE = 32  # samples; less is not worth being taken out
_FAINTEST = 0.01  # weight of frequencies with next to nothing where a delay is looked for


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


def picked_paths(
    tracks: SceneTracks, source: int, until: float, counts: tuple[int, ...], rng: np.random.Generator,
    whole: bool = False, times: int = TIMES,
) -> list[tuple[Picked, ...]]:  # fmt: skip
    """Draw samples of about `counts` of a source's paths, each at instants of its own; `whole`: all paths at each."""
    pairs = [i for i, g in enumerate(tracks.pairs) if g.source == source]
    if len(pairs) > _MOST_PAIRS:
        pairs = sorted(rng.choice(pairs, _MOST_PAIRS, replace=False).tolist())
    few, alike = (max(3, min(TIMES, frames // max(len(pairs), 1))) for frames in (_FRAMES, _ALIKE))
    total = sum(len(tracks.pairs[i].start) for i in pairs)
    of_varied = [count // max(len(pairs) if not whole else total, 1) for count in counts]
    centre = np.array([tracks.paths.scene.sources[source].emitted.centre_frequency])
    at_centre = SceneResponse(tracks.paths.scene, source, centre)
    found: list[list[Picked]] = [[] for _ in counts]
    for i in pairs:
        length = max(len(tracks.pairs[i].start), 1)
        instants = [_instants(tracks, i, until, few, min(times, alike))] * len(counts)
        if tracks.pair_paths[i].family.varies:
            instants = [max(LEAST_WHOLE, n) if whole else max(few, min(_MOST_TIMES, n // length)) for n in of_varied]
        shares = [max(-(-n // (len(pairs) * t)), length * whole) for n, t in zip(counts, instants, strict=True)]
        for sample, some in _of_pair(tracks, i, until, list(zip(instants, shares, strict=True)), at_centre, rng, whole):
            found[sample].append(some)
    return [tuple(some) for some in found]


def _of_pair(
    tracks: SceneTracks, pair: int, until: float, samples: list[tuple[int, int]], at_centre: SceneResponse,
    rng: np.random.Generator, whole: bool,
) -> Iterator[tuple[int, Picked]]:  # fmt: skip
    """Yield the number of a sample and some of a pair's paths in it; `samples`: instants of each, and paths at each."""
    paths, start, end = tracks.pair_paths[pair], tracks.pairs[pair].start, tracks.pairs[pair].end
    family, weights = paths.family, np.ones((len(start), len(samples)))
    last = until + _BEYOND * family.varies
    if len(start) > _MOST_PATHS:
        some, weights = _candidates(paths, last, at_centre, rng, len(samples))
        paths, start, end = paths.part(some), start[some], end[some]
    at = [np.linspace(0.0, last, instants) for instants, _ in samples]
    for each in at:  # all but the first and the last anywhere between those halfway to the next ones
        each[1:-1] += rng.uniform(-0.5, 0.5, len(each) - 2) * each[1]
    if tracks.pairs[pair].silent_ends:
        at = [while_active(start, end, each, last) for each in at]
    of, times = np.repeat(np.arange(len(at)), [len(instants) for instants in at]), np.concatenate(at)
    together = len(times) if family.one_by_one else max(IN_CACHE // max(len(start), 1), 1)
    for begin in range(0, len(times), together):
        part = times[begin : begin + together]
        found = paths.arrivals(part, tracks.kinematics)
        received = (part >= start[:, None]) & (part < end[:, None])
        level = 1.0 if whole else np.abs(family.unshaded(paths.rows, found, part, at_centre)[..., 0])
        level = np.where(received, level, 0.0) * weights[:, of[begin : begin + together]]
        level[level < SILENT] = 0.0
        for sample, (_, share) in enumerate(samples):
            mine = np.flatnonzero(of[begin : begin + together] == sample)
            own, when, weight = level[:, mine], part[mine], weights[:, sample, None]
            if family.varies and not family.one_by_one and len(start) <= share and own.size and own.all():
                scale = (weight / np.linalg.norm(own, axis=0)).T.reshape(-1, 1)
                first = range(0, own.size + 1, len(start))
                here = found.part(np.arange(len(start))[:, None], mine)
                yield sample, Picked(paths, here, when, scale, tuple(first), whole)
                continue
            for rows, t, scale, begins in _drawn(own, share, rng, together=not family.one_by_one):
                here, now = found.part(rows[:, None], mine[t]), when[t if family.one_by_one else t[0]]
                yield sample, Picked(paths.part(rows), here, now, scale * weight[rows], begins, whole)


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
    paths: PairPaths, last: float, at_centre: SceneResponse, rng: np.random.Generator, samples: int
) -> tuple[NDArray[np.int64], Floats]:
    """Return loudest paths at an instant until `last`, and as many others for each sample.

    Beside their indices (n,) there are roots (n, samples) of how many each stands for, 0 for those of other samples.
    """
    instant, half = rng.uniform(0.0, last, 1), _MOST_PATHS // 2
    found = paths.arrivals(instant, QUASI_STATIC)  # near enough, and not solved for
    level = np.abs(paths.family.response(paths.rows, found, instant, at_centre)[:, 0, 0])
    order = np.argpartition(-level, half)
    weights = np.zeros((len(order), samples))
    for weight in weights.T:
        weight[rng.choice(order[half:], half, replace=False)] = math.sqrt((len(order) - half) / half)
    weights[order[:half]] = 1.0
    some = np.flatnonzero(np.any(weights, axis=1))
    return some, weights[some]


def _drawn(
    level: Floats, share: int, rng: np.random.Generator, *, together: bool
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Floats, tuple[int, ...]]]:
    """Yield rows of `share` paths of each instant by their levels (P, T), instants (n, 1), scales (n, 1) and firsts."""
    # Faint paths are drawn as well: what is faint at the centre frequency may be all that is left of the lowest ones.
    chance = _chances(np.where(level > 0.0, level + _FAINT * level.mean(axis=0), 0.0), share)
    # The picks of an instant are evenly spaced in the sums of its chances.
    passed = np.floor(np.cumsum(chance, axis=0) - (1.0 - rng.random(level.shape[1])))
    at, rows = np.nonzero(np.diff(passed, axis=0, prepend=-1.0).T > 0.0)
    scale = 1.0 / (np.sqrt(chance[rows, at]) * np.linalg.norm(level, axis=0)[at])
    counts = np.bincount(at, minlength=level.shape[1])
    counts = counts[counts > 0]
    each, first = 1 if together else max(_TOGETHER // int(counts.max(initial=1)), 1), firsts(counts)
    for begin in range(0, len(counts), each):
        ends = first[begin : begin + each + 1]
        mine = slice(ends[0], ends[-1])
        yield rows[mine], at[mine, None], scale[mine, None], tuple((ends - ends[0]).tolist())


def _chances(level: Floats, count: int) -> Floats:
    """Return the chances (P, T) of about `count` paths at each instant, the higher the louder (P, T) they are."""
    chance, before = np.minimum(count * level / np.maximum(level.sum(axis=0), 1e-300), 1.0), np.zeros(level.shape[1])
    for _ in range(8):
        sure = chance >= 1.0  # the loudest, more of them each time
        number = np.count_nonzero(sure, axis=0)
        if np.array_equal(number, before):
            break
        before, rest = number, np.where(sure, 0.0, level)
        left = np.maximum(count - number, 1) / np.maximum(rest.sum(axis=0), 1e-300)
        chance = np.where(sure, 1.0, np.minimum(left * rest, 1.0))
    return np.where(np.count_nonzero(level, axis=0) <= count, level > 0.0, chance)


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
        if costly and LEAST_WHOLE * total <= min(counts):
            (rows,) = picked_paths(of_scene, source, until, (sum(counts),), rng, whole=True)
            return cls(of_scene, source, until, rows, (), grids, True, approximate)
        rows, held_out = picked_paths(of_scene, source, until, counts, rng, times=times)
        return cls(of_scene, source, until, rows, held_out, grids, False, approximate)

    def probe(self) -> Draw:
        """Return the same with few of the instants."""
        several = [some for some in self.rows if len(some.first) > 2]
        rows = tuple(some.thinned(_PROBED) for some in several) or self.rows[::_PROBED]
        return replace(self, rows=rows)

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
                along = along * np.conj(band.turn)  # real ones too
            along *= some.scale
            spans = list(pairwise(some.first))
            if some.whole:
                energy = np.mean(np.abs(along[:, :, middle]) ** 2, axis=0)
                if family.adds:
                    path = family.unshaded(some.paths.rows, some.found, some.times, at)[..., middle]
                    energy = np.abs(path.T.ravel() * some.scale[:, 0]) ** 2
                level = np.sqrt(np.add.reduceat(energy, some.first[:-1]))
                along /= np.maximum(level, SILENT).repeat(np.diff(some.first))[:, None]
                spans = [span for span, sounds in zip(spans, (level > SILENT).tolist(), strict=True) if sounds]
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
        level = np.interp(even, band.frequencies[::-1], np.maximum(level / level.max(), _FAINTEST)[::-1])
        few = self.probe()
        if not self.whole:
            rng = np.random.default_rng(SEED)
            few = replace(self, rows=picked_paths(self.tracks, self.source, self.until, (_LATE_ROWS,), rng)[0])
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
