"""What bodies hide of other paths: their intervals, cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, read_only
from clsim.paths.family import PathFamily
from clsim.paths.legs.events import find_events
from clsim.paths.legs.static import path_vertices
from clsim.paths.propagation import mean_medium_of
from clsim.paths.search.bodies import BodySearch, PairQuery
from clsim.paths.search.mesh import report
from clsim.paths.visibility.obstacles import LegDrift, Legs, Obstacles, hidden_by
from clsim.paths.visibility.rates import FAR, taken_for
from clsim.paths.visibility.subdivision import ROUNDS, Status, certified, sampled

Progress = Callable[[float], None]
Rows = NDArray[np.int64]

_NODES = 8  # times at which corners of paths are asked for, between which they are smooth
_EARLIER = 1.25  # of a delay, and more, before which sound of a stretch of time was not emitted


def behind_bodies(search: BodySearch, family: PathFamily, progress: Progress = lambda share: None) -> PathFamily:
    """Return the paths of a kind that is reflected by no body without what bodies hide, rows cut as it takes."""
    rows: list[Any] = [np.empty(0, dtype=np.int64)]
    begins, ends = [np.empty(0)], [np.empty(0)]
    pairs = list(family.pairs())
    for number, pair in enumerate(pairs):
        part = partial(report, progress, number / len(pairs), (number + 1) / len(pairs))
        query = search.pair(pair.source, pair.receiver)
        past = PastBodies(family, pair.index, search.obstacles, query)
        if family.is_specular:
            every = np.arange(len(pair.index))
            spans = every, np.maximum(family.start[pair.index], 0.0), np.minimum(family.end[pair.index], query.last)
            path, begin, end = certified(past.evaluate, past.status, spans, query.resolution, part)
        else:
            path, begin, end = sampled(past.free, pair.index, query.times, query.resolution, past.nearby)
            part(1.0)
        begin, end = query.bounded(begin, end)
        path = pair.index[path]
        begin, end = np.maximum(begin, family.start[path]), np.minimum(end, family.end[path])
        rows.append(path[begin < end])
        begins.append(begin[begin < end])
        ends.append(end[begin < end])
    path, begin, end = (np.concatenate(each) for each in (rows, begins, ends))
    order = np.lexsort((begin, path))
    cut = family.part(path[order])
    return replace(cut, start=read_only(begin[order]), end=read_only(end[order]))


@dataclass(frozen=True, slots=True, eq=False)
class PastBodies:
    """Whether bodies are in the way of paths of one pair; of those by walls alone, for how long that is certain."""

    family: PathFamily
    index: Rows  # (P,) of the pair in it
    obstacles: Obstacles  # of the scene
    query: PairQuery

    def polylines(self, rows: Rows, times: Floats) -> tuple[Floats, Floats]:
        """Return the corners (P, T, V, 3) of paths, m, and when sound is there (P, T, V), s.

        It is received at times (P, T), which may differ from path to path where walls alone reflect these. Behind the
        receiver of paths of fewer corners stands NaN.
        """
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
        shape = when.shape[:2]
        free = np.ones(shape[0] * shape[1], dtype=bool)
        flat, at = place.reshape(-1, *place.shape[2:]), when.reshape(-1, when.shape[2])
        for leg in range(at.shape[1] - 1):
            for body in self.family.scene.bodies:
                rows = np.flatnonzero(free & np.isfinite(at[:, leg + 1]))
                legs = Legs(flat[rows, leg], flat[rows, leg + 1], at[rows, leg], at[rows, leg + 1])
                none = np.full(len(rows), -1)
                free[rows] = ~hidden_by(body, legs, none, none)[0]
        return free.reshape(shape)

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
        pace = self.query.rates.over(first, times - _EARLIER * (half + times - when[:, 0]), times, half)
        medium = self.query.medium
        c, wind = medium.speed_of_sound, float(np.linalg.norm(medium.wind or (0.0, 0.0, 0.0)))
        late = 1.0 + (pace.source + pace.receiver) / np.maximum(c - wind - pace.source, 1e-3)
        slides = _slides(place, np.maximum(late * pace.source, pace.receiver))
        free, sure = np.ones(len(rows), dtype=bool), np.full(len(rows), FAR)
        order = np.sum(np.isfinite(when), axis=1) - 2
        speed = np.column_stack([pace.source * late, slides, np.zeros(len(rows))])
        speed[np.arange(len(rows)), order + 1] = pace.receiver
        for leg in range(when.shape[1] - 1):
            for body, thing in enumerate(self.obstacles.mirrors.bodies):
                some = np.flatnonzero(free & (order >= leg))
                at = np.stack([np.full(len(some), leg == 0), order[some] == leg], axis=1)
                held = pace.held[some] & at[:, None]
                ends = speed[some, leg], speed[some, leg + 1]
                sooner = late[some] + np.maximum(*ends) / c
                changes = LegDrift(*ends, sooner, held, pace.part(some))
                legs = Legs(place[some, leg], place[some, leg + 1], when[some, leg], when[some, leg + 1])
                none = np.full(len(some), -1)
                blocked, certain = hidden_by(thing, legs, none, none, (body, changes))
                free[some] = ~blocked
                sure[some] = np.where(blocked, certain, np.minimum(sure[some], certain))
        jumps = np.any((pace.jolt > 0.0) | (pace.twist > 0.0), axis=1)
        sure = np.where(jumps & (sure < pace.half), 0.0, sure)
        return free, sure, taken_for(sure, np.minimum(np.nanmax(speed, axis=1), FAR) + pace.all_lengths)


def _slides(place: Floats, most: Floats) -> Floats:
    """Speeds of corners of paths (n, V, 3) along their walls, (n, V - 2) m/s, whose ends go at most so fast, (n,)."""
    steps = np.diff(place, axis=1)
    steps /= np.maximum(np.linalg.norm(steps, axis=2), 1e-300)[..., None]
    with np.errstate(divide="ignore"):
        bends = 1.0 + 2.0 / np.linalg.norm(np.diff(steps, axis=1), axis=2)
        slides = np.multiply(most[:, None], bends, out=np.zeros_like(bends), where=most[:, None] > 0.0)
    return np.where(most[:, None] > 0.0, slides, 0.0)
