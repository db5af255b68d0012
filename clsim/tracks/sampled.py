"""Responses of a source's paths, sampled over a run, errors of received signals from theirs, and longer tracks."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.numerics.quaternions import quaternion_product
from clsim.paths.response import SceneResponse
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.ends import Receiver, Source
from clsim.scene.motion.curves import CONTINUATION, onward
from clsim.scene.motion.motion import Motion, Turning
from clsim.tracks.basis import GRIDS, Band, Sample
from clsim.tracks.picked import LEAST_WHOLE, SILENT, TIMES, Picked, picked_paths
from clsim.tracks.tracks import SceneTracks, Tracks

SEED = 20_160_914
_ROWS = 768  # responses of which the functions are made
_HELD_OUT = 2048  # responses at which they are checked
_COSTLY, _FEWER = (192, 256), 33  # the same, and frequencies, of costly responses
LEAST_JUMP = 1e-4  # rad/s, of the angular velocity, below which it counts as smooth
_LATEST = 0.012  # s between the earliest and the latest of responses that can be told
_MOST_DELAYS = 512  # samples of them
_LATE_ROWS = 64  # responses that tell it
_PROBED = 7  # instants from one at which a delay and a grid are looked for to the next, where all paths are taken
_LATE_SHARE = 1e-4  # of their energy may lie earlier than the time of which the middle is taken, and later
_LEAST_LATE = 32  # samples; less is not worth being taken out
_FAINT = 0.01  # weight of frequencies with next to nothing where a delay is looked for


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
                along *= np.conj(band.turn)
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
        level = np.interp(even, band.frequencies[::-1], np.maximum(level / level.max(), _FAINT)[::-1])
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
