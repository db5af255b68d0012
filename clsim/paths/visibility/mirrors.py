"""Looks at paths by mirrors that move: whether each is there at a time, and for how long that is certain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.paths.legs.events import Events, find_events
from clsim.paths.legs.mirrors import ROOM
from clsim.paths.propagation import UniformAir
from clsim.paths.visibility.certainty import EARLIER, Drift, Line, absent, behind, drift, straightened
from clsim.paths.visibility.obstacles import LegDrift, Legs, Obstacles
from clsim.paths.visibility.rates import FAR, EndRates, Pace, lasts, taken_for
from clsim.paths.visibility.subdivision import ROUNDS
from clsim.scene.motion.motion import Motion

Bools = NDArray[np.bool_]
Rows = NDArray[np.int64]


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
        for count in np.unique(order).tolist():
            some = np.flatnonzero(order == count)
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
        slide = self._slides(walls, (change.place, change.dilation), (pace.speed, pace.turn, pace.half), far)
        sure = np.zeros(len(walls))
        gone = np.flatnonzero(~met)
        not_met = np.minimum(absent(line, change, holds, lasts(apart, slide)), change.holds)
        sure[gone] = np.maximum(not_met, behind(self.obstacles.mirrors, walls, line, pace, self.medium, delay))[gone]
        there, some = met, np.flatnonzero(met)
        if len(some):
            lengths = np.linalg.norm(np.diff(line.place[some], axis=1), axis=2)
            closing = change.place[some, 1:] + change.place[some, :-1]
            kept = np.minimum(lasts(apart, slide)[some].min(axis=1, initial=FAR), lasts(lengths, closing).min(axis=1))
            kept = np.minimum(kept, change.holds[some])
            there[some], sure[some] = self._free(walls[some], line, change, pace, some, kept)
        certain = sure
        jumps = np.any((pace.jolt > 0.0) | (pace.twist > 0.0), axis=1)
        certain = np.where(jumps & (certain < half), 0.0, certain)
        loose = np.minimum(lasts(np.full(len(walls), self.step), pace.all_lengths), FAR)
        fastest = np.minimum(change.place.max(axis=1), FAR) + pace.all_lengths
        return there, certain, np.where((change.holds > 0.0) | (certain > 0.0), taken_for(certain, fastest), loose)

    def _on_faces(self, walls: NDArray[np.int32], place: Floats, when: Floats) -> tuple[Bools, Floats, Floats]:
        """Mask of hits (n, N) on their faces, and distances from borders and from the middles of bodies, m."""
        holds, apart, far = np.zeros(walls.shape, dtype=bool), np.zeros(walls.shape), np.zeros(walls.shape)
        for k in range(walls.shape[1]):
            for surface in np.unique(walls[:, k]).tolist():
                p = np.flatnonzero(walls[:, k] == surface)
                hits = place[p, k + 1], when[p, k + 1]
                holds[p, k], apart[p, k], far[p, k] = self.obstacles.border(surface, *hits)
        return holds, apart, far

    def _slides(
        self,
        walls: NDArray[np.int32],
        moved: tuple[Floats, Floats],
        turning: tuple[Floats, Floats, Floats],
        far: Floats,
    ) -> Floats:
        """Speeds of hits (n, N) in the axes of their faces, m/s."""
        body = self.obstacles.mirrors.owner[walls]
        rows = np.arange(len(walls))[:, None]
        slide, (fast, turns, halves) = moved[0][:, 1:-1], turning
        speed, turn = (x[rows, np.maximum(body, 0)] for x in (fast, turns))
        late, half = moved[1][:, 1:-1], halves[:, None]
        away = far + half * (slide + late * speed)
        return np.asarray(np.where(body == ROOM, slide, slide + late * (speed + turn * away)))

    def _free(
        self, walls: NDArray[np.int32], line: Line, change: Drift, pace: Pace, some: Rows, kept: Floats
    ) -> tuple[Bools, Floats]:
        """Mask of free paths among some that meet their mirrors, and the time for which that is certain."""
        free, sure, order = np.ones(len(some), dtype=bool), np.array(kept), walls.shape[1]
        padded: Any = np.pad(walls, ((0, 0), (1, 1)), constant_values=-1)
        when = line.now[:, None] + line.time
        for leg in range(order + 1):
            rows = np.flatnonzero(free)
            p = some[rows]
            legs = Legs(line.place[p, leg], line.place[p, leg + 1], when[p, leg], when[p, leg + 1])
            held = pace.held[p] & np.array([leg == 0, leg == order])
            changes = LegDrift(
                change.place[p, leg], change.place[p, leg + 1], change.dilation[p, leg : leg + 2].max(axis=1), held,
                pace.part(p),
            )  # fmt: skip
            blocked, certain = self.obstacles.evaluated(legs, padded[rows, leg], padded[rows, leg + 1], changes)
            free[rows] = ~blocked
            certain = np.minimum(certain, kept[rows])
            sure[rows] = np.where(blocked, certain, np.minimum(sure[rows], certain))
        return free, sure


class _Ears:
    """Receivers (n,) of paths as one motion, of times (n, T)."""

    def __init__(self, motions: Sequence[Motion], which: Rows) -> None:
        self._motions, self._rows = motions, [(ear, np.flatnonzero(which == ear)) for ear in np.unique(which).tolist()]

    def position(self, times: Floats) -> Floats:
        return self._of("position", times)

    def velocity(self, times: Floats) -> Floats:
        return self._of("velocity", times)

    def _of(self, name: str, times: Floats) -> Floats:
        out = np.empty((*times.shape, 3))
        for ear, rows in self._rows:
            out[rows] = getattr(self._motions[ear], name)(times[rows])
        return out
