"""Whether paths by mirrors that move are there at a time, or others past all bodies, and for how long it is certain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Bools, Floats, Rows, by_value
from clsim.paths.family import PathFamily
from clsim.paths.legs.events import Events, find_events
from clsim.paths.legs.legs import path_vertices
from clsim.paths.propagation import UniformAir, mean_medium_of
from clsim.paths.visibility.certainty import EARLIER, Drift, Line, absent, averted, behind, drift, straightened
from clsim.paths.visibility.obstacles import LegDrift, Obstacles
from clsim.paths.visibility.rates import FAR, GRAZE_TIME, EndRates, Pace, lasts, taken_for
from clsim.paths.visibility.subdivision import ROUNDS, Status
from clsim.scene.motion.motion import Motion

_NODES = 8  # times at which corners of paths are asked for, between which they are smooth


@dataclass(frozen=True, slots=True, eq=False)
class MirrorEvaluation:
    """How paths by mirrors (P, N) from a source to receivers are at a time."""

    obstacles: Obstacles  # of the scene
    source: Motion  # of the source
    receivers: Sequence[Motion]  # of the receivers
    medium: UniformAir  # what sound travels in
    rates: EndRates  # how fast all that moves is
    surfaces: NDArray[np.int32]  # (P, N) mirrors from the source's side, filled up with -1
    receiver: Rows  # (P,) of each path
    step: float  # how far all that moves may go where nothing is certain until the next look, m

    def status(self, rows: Rows, times: Floats) -> Bools:
        """Mask of paths (n,) that are valid at times (n,)."""
        walls = self.surfaces[rows]
        return self.obstacles.there(walls, self._events(walls, self.receiver[rows], times), times[:, None])[:, 0]

    def evaluate(self, rows: Rows, times: Floats, half: Floats) -> tuple[Bools, Floats, Floats]:
        """Mask of valid paths (n,), and the times for which that is certain and assumed, s."""
        there, sure, taken = np.zeros(len(rows), dtype=bool), np.zeros(len(rows)), np.zeros(len(rows))
        order = np.sum(self.surfaces[rows] >= 0, axis=1)
        for count, some in by_value(order):
            walls = self.surfaces[rows[some], :count]
            ears = self.receiver[rows[some]]
            there[some], sure[some], taken[some] = self._evaluate(walls, ears, times[some], half[some])
        return there, sure, taken

    def _events(self, walls: NDArray[np.int32], ears: Rows, times: Floats) -> Events:
        ends: Any = (self.source, _Ears(self.receivers, ears))
        return find_events(self.obstacles.mirrors, walls, ends, self.medium, times[:, None], rounds=ROUNDS)

    def _evaluate(
        self, walls: NDArray[np.int32], ears: Rows, times: Floats, half: Floats
    ) -> tuple[Bools, Floats, Floats]:
        events = self._events(walls, ears, times)
        line = straightened(self.obstacles.mirrors, walls, events, times, self.medium)
        delay = events.delay[:, 0]
        pace = self.rates.over(ears, times - EARLIER * (half + delay), times, half)
        met = np.array(np.all((events.share[:, 0] > 0.0) & (events.share[:, 0] < 1.0), axis=1))
        holds, apart, far = self._on_faces(walls, line.place, line.now[:, None] + line.time)
        met &= np.all(holds, axis=1)
        change = drift(self.obstacles.mirrors, walls, line, pace, self.medium, met)
        slide = change.slides(self.obstacles.mirrors.owner[walls], pace, far)
        sure = np.zeros(len(walls))
        gone = np.flatnonzero(~met)
        not_met = np.minimum(absent(line, change, holds, lasts(apart, slide)), change.holds)
        sure[gone] = np.maximum(not_met, behind(self.obstacles.mirrors, walls, line, pace, self.medium, delay))[gone]
        there, some = met, np.flatnonzero(met)
        if len(some):
            lengths = np.linalg.norm(np.diff(line.place[some], axis=1), axis=2)
            closing = change.place[some, 1:] + change.place[some, :-1]
            kept = np.minimum(lasts(apart, slide)[some].min(axis=1, initial=FAR), lasts(lengths, closing).min(axis=1))
            kept = np.minimum(kept, np.minimum(change.holds, change.steady.min(axis=1, initial=FAR))[some])
            there[some], sure[some] = self._free(walls[some], line, change, pace, some, kept)
        certain = pace.unless_jumps(sure)
        most = GRAZE_TIME if walls.shape[1] < 2 else FAR  # many images of higher orders are that slanted
        loose = np.minimum(lasts(np.full(len(walls), self.step), pace.all_lengths), most)
        fastest = np.minimum(change.place.max(axis=1), FAR) + pace.all_lengths
        taken = np.where((change.holds > 0.0) | (certain > 0.0), taken_for(certain, fastest), loose)
        gone = gone[(taken[gone] > 0.0) & np.any(pace.turn[gone] > 0.0, axis=1)]

        def pace_of(p: Rows, late: Floats) -> Pace:
            n = gone[p]
            return self.rates.over(ears[n], times[n] - EARLIER * (half[n] + late), times[n], half[n])

        ends = self.source, _Ears(self.receivers, ears[gone])
        aside, brief = averted(self.obstacles.mirrors, walls[gone], ends, times[gone], pace_of, self.medium)
        certain[gone], taken[gone] = np.maximum(certain[gone], aside), np.where(brief, 0.0, taken[gone])
        return there, certain, taken

    def _on_faces(self, walls: NDArray[np.int32], place: Floats, when: Floats) -> tuple[Bools, Floats, Floats]:
        """Mask of hits (n, N) on their faces, and distances from borders and from the middles of bodies, m."""
        holds, apart, far = np.zeros(walls.shape, dtype=bool), np.zeros(walls.shape), np.zeros(walls.shape)
        for k in range(walls.shape[1]):
            for surface, p in by_value(walls[:, k]):
                hits = place[p, k + 1], when[p, k + 1]
                holds[p, k], apart[p, k], far[p, k] = self.obstacles.border(surface, *hits)
        return holds, apart, far

    def _free(
        self, walls: NDArray[np.int32], line: Line, change: Drift, pace: Pace, some: Rows, kept: Floats
    ) -> tuple[Bools, Floats]:
        """Mask of free paths among some that meet their mirrors, and the time for which that is certain."""
        order = walls.shape[1]

        def changes(leg: int, rows: Rows) -> LegDrift:
            p = some[rows]
            held, late = pace.held[p] & np.array([leg == 0, leg == order]), change.dilation[p, leg : leg + 2]
            return LegDrift(change.place[p, leg], change.place[p, leg + 1], late.max(axis=1), held, pace.part(p))

        when, every = line.now[some, None] + line.time[some], np.full(len(some), order)
        free, sure = self.obstacles.free(line.place[some], when, walls, every, changes)
        return free, np.minimum(sure, kept)


class _Ears:
    """Receivers (n,) of paths as one motion, of times (n, T)."""

    def __init__(self, motions: Sequence[Motion], which: Rows) -> None:
        self._motions, self._which = motions, which
        self._rows = list(by_value(which))

    def part(self, rows: Rows) -> _Ears:
        return _Ears(self._motions, self._which[rows])

    def position(self, times: Floats) -> Floats:
        return self._of("position", times)

    def velocity(self, times: Floats) -> Floats:
        return self._of("velocity", times)

    def _of(self, name: str, times: Floats) -> Floats:
        out = np.empty((*times.shape, 3))
        for ear, rows in self._rows:
            out[rows] = getattr(self._motions[ear], name)(times[rows])
        return out


@dataclass(frozen=True, slots=True, eq=False)
class PastBodies:
    """Whether bodies are in the way of paths of one pair; of those by walls alone, for how long that is certain."""

    family: PathFamily
    index: Rows  # (P,) of the pair in it
    obstacles: Obstacles  # bodies of the scene alone
    rates: EndRates  # how fast the ends and the bodies are
    medium: UniformAir  # what sound travels in

    def polylines(self, rows: Rows, times: Floats) -> tuple[Floats, Floats]:
        """Return the corners (P, T, V, 3) of paths, m, and when sound is there (P, T, V), s."""
        family, (count, every) = self.family, times.shape
        sender = family.scene.sources[family.source[rows][0]]
        source, receiver = sender.trajectory, family.scene.receivers[family.receiver[rows][0]].trajectory
        if family.is_specular:  # whatever the order of walls, their image is one and the same
            medium = mean_medium_of(family.scene.air, sender.emitted.centre_frequency)
            met = family.walls[rows]
            met = np.take_along_axis(met, np.argsort(met < 0, axis=1, kind="stable"), axis=1)
            delay = find_events(self.obstacles.mirrors, met, (source, receiver), medium, times, rounds=ROUNDS).delay
            faces, walls = family.scene.room.faces, np.repeat(met, every, axis=0)
            ends = source.position((times - delay).ravel()), receiver.position(times.ravel())
            corners = path_vertices((faces.normals, faces.offsets), walls, *ends).reshape(count, every, -1, 3)
        else:
            delay = family.arrivals(rows, times[0]).delay
            corners = np.stack([family.vertices(rows, float(time)) for time in times[0]], axis=1)
        steps = np.linalg.norm(np.diff(corners, axis=2), axis=3)
        along = np.concatenate([np.zeros((count, every, 1)), np.cumsum(steps, axis=2)], axis=2)
        whole = np.nanmax(along, axis=2, keepdims=True)
        return corners, (times - delay)[..., None] + delay[..., None] * along / np.maximum(whole, 1e-300)

    def free(self, rows: Rows, times: Floats) -> NDArray[np.bool_]:
        """Mask of paths (P,) that are free of all bodies at times (P, T)."""
        free = np.ones(times.shape, dtype=bool)
        shared = np.zeros(len(rows), dtype=np.int64)
        if not self.family.is_specular:  # those looked at at the same times are so together
            shared = np.unique(times[:, [0, -1]], axis=0, return_inverse=True)[1].ravel()
        for group in range(int(shared.max(initial=-1)) + 1):
            some = np.flatnonzero(shared == group)
            free[some] = self._passes(*self.polylines(rows[some], times[some]))
        return free

    def nearby(self, rows: Rows, times: Floats) -> Status:
        """Return the same test for some of the rows, from the first to the last of times (T,), by polynomials."""
        nodes = np.cos(np.pi * np.arange(_NODES) / (_NODES - 1))
        weights = np.where(np.arange(_NODES) % 2, -1.0, 1.0)
        weights[[0, -1]] *= 0.5
        middle, half = 0.5 * (times[0] + times[-1]), max(0.5 * (times[-1] - times[0]), 1e-12)
        place, when = self.polylines(rows, np.tile(middle + half * nodes, (len(rows), 1)))

        def status(some: Rows, at: Floats) -> NDArray[np.bool_]:
            apart = ((at - middle) / half)[..., None] - nodes
            exact = np.abs(apart) < 1e-14
            share = weights / np.where(exact, 1.0, apart)
            share = np.where(exact.any(axis=2, keepdims=True), exact, share)
            share /= share.sum(axis=2, keepdims=True)
            corners = np.einsum("ptn,pnvx->ptvx", share, place[some])
            return self._passes(corners, np.einsum("ptn,pnv->ptv", share, when[some]))

        return status

    def _passes(self, place: Floats, when: Floats) -> NDArray[np.bool_]:
        """Mask (P, T) of polylines (P, T, V, 3) of events at times (P, T, V) that pass all bodies."""
        flat, at = place.reshape(-1, *place.shape[2:]), when.reshape(-1, when.shape[2])
        order = np.sum(np.isfinite(at), axis=1) - 2
        return self.obstacles.free(flat, at, _no_mirrors(at), order, None)[0].reshape(when.shape[:2])

    def status(self, rows: Rows, times: Floats) -> NDArray[np.bool_]:
        """Mask of paths (n,) that are free at times (n,)."""
        return self.free(self.index[rows], times[:, None])[:, 0]

    def evaluate(self, rows: Rows, times: Floats, half: Floats) -> tuple[NDArray[np.bool_], Floats, Floats]:
        """Mask of free paths (n,), the time for which that is certain, s, and the speed of what decides, m/s.

        Walls rest: every point at a fixed share of a path moves by no more than its ends, see `certainty`, and a corner
        along the wall by as much again over the cosine of the angle of incidence.
        """
        place, when = (x[:, 0] for x in self.polylines(self.index[rows], times[:, None]))
        first = np.zeros(len(rows), dtype=np.int64)
        pace = self.rates.over(first, times - EARLIER * (half + times - when[:, 0]), times, half)
        medium = self.medium
        c, wind = medium.speed_of_sound, float(np.linalg.norm(medium.wind or (0.0, 0.0, 0.0)))
        late = 1.0 + (pace.source + pace.receiver) / np.maximum(c - wind - pace.source, 1e-3)
        slides = _corner_slides(place, np.maximum(late * pace.source, pace.receiver))
        order = np.sum(np.isfinite(when), axis=1) - 2
        speed = np.column_stack([pace.source * late, slides, np.zeros(len(rows))])
        speed[np.arange(len(rows)), order + 1] = pace.receiver

        def changes(leg: int, some: Rows) -> LegDrift:
            at = np.stack([np.full(len(some), leg == 0), order[some] == leg], axis=1)
            ends = speed[some, leg], speed[some, leg + 1]
            sooner = late[some] + np.maximum(*ends) / c
            return LegDrift(*ends, sooner, pace.held[some] & at[:, None], pace.part(some))

        free, sure = self.obstacles.free(place, when, _no_mirrors(when), order, changes)
        sure = pace.unless_jumps(sure)
        return free, sure, taken_for(sure, np.minimum(np.nanmax(speed, axis=1), FAR) + pace.all_lengths)


def _no_mirrors(when: Floats) -> Rows:
    """Mirrors (n, V - 2) at corners (n, V) on none."""
    return np.full((len(when), when.shape[1] - 2), -1)


def _corner_slides(place: Floats, most: Floats) -> Floats:
    """Speeds of corners of paths (n, V, 3) along their walls, (n, V - 2) m/s, whose ends go at most so fast, (n,)."""
    steps = np.diff(place, axis=1)
    steps /= np.maximum(np.linalg.norm(steps, axis=2), 1e-300)[..., None]
    with np.errstate(divide="ignore"):
        bends = 1.0 + 2.0 / np.linalg.norm(np.diff(steps, axis=1), axis=2)
        slides = np.multiply(most[:, None], bends, out=np.zeros_like(bends), where=most[:, None] > 0.0)
    return np.where(most[:, None] > 0.0, slides, 0.0)
