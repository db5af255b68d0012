"""Search for shadows: which bodies come near which paths that walls reflect, and when.

Every part of a path between two walls is a line between two points that move. Bodies, and these points, are held by
balls for a stretch of time. Where the balls come near each other, the stretch is divided, until it is short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.silhouette import WITHIN
from clsim.arrays import Floats, firsts, read_only
from clsim.paths.chain import Chain, check_support
from clsim.paths.family import NONE, SHADOW, PairPaths
from clsim.paths.vertices.scatterer import centre_of
from clsim.paths.vertices.shade import WIDER, ShadeVertex
from clsim.scene.scene import Scene, known_until

_RIGHT = 1e-9  # cosine of an angle that counts as a right one
_DIVIDED = 4  # parts of a stretch
_LONGEST = 0.05  # s, of a stretch in which it is not looked any closer when a body is near
_MOST_STRETCHES = 1 << 16  # of a run; in an hour they take 55 ms each
_MERGED, _MOST_ROWS = 0.1, 256  # s between two rows of a path that are one, and about the most rows of a path

Parts = tuple[list[tuple[int, ...]], Floats, Floats]  # walls before each part, and the isometry by these


def shaded_paths(scene: Scene, paths: Chain, order: int) -> Chain:
    """Find the shadows on paths of up to `order` reflections: a row for every time in which any body is near."""
    check_support("static shade", scene.air)
    paths = paths.part(np.flatnonzero(paths.order <= order))
    known: dict[tuple[int, ...], Parts] = {}
    balls = _Balls.of(scene, paths)
    found = [_Rows.of(balls, pair, known) for pair in paths.pairs()]
    if not found:
        return paths
    rows, start, end, count = (
        np.concatenate([getattr(f, x) for f in found]) for x in ("path", "start", "end", "count")
    )
    walls = [walls for f in found for walls in f.walls]
    before = np.full((len(walls), order), -1, dtype=np.int32)
    for row, met in zip(before, walls, strict=True):
        row[: len(met)] = met
    matrix, offset = (np.concatenate([getattr(f, x) for f in found]) for x in ("matrix", "offset"))
    always = bool(np.all(np.isneginf(paths.start)) and np.all(np.isposinf(paths.end)))
    vertex = ShadeVertex(
        read_only(np.arange(len(rows))), read_only(firsts(count)), read_only(matrix), read_only(offset),
        read_only(before), tuple(scene.scatterers), always,
    )  # fmt: skip
    some: Any = paths.part(rows)
    last = np.full((len(some), 1), -1)
    kinds, objects = (np.append(x, last, axis=1) for x in (some.interactions, some.objects))
    kinds[np.arange(len(some)), np.sum(some.interactions != NONE, axis=1)] = SHADOW
    shaded: Chain = replace(
        some, interactions=read_only(kinds), objects=read_only(objects), vertex=vertex,
        start=read_only(start), end=read_only(end),
    )  # fmt: skip
    return shaded


def parts_of(walls: tuple[int, ...], scene: Scene) -> Parts:
    """List the walls before each part of a path, from the source's side, and the isometries by these.

    In convex rooms walls at right angles to each other may stand in another order than they are met in: parts that a
    path does not have lie outside the room. Isometries by walls at right angles commute, and what they change adds up.
    """
    normals, groups = scene.room.faces.normals, list[list[int]]()
    for wall in walls:
        alike = [g for g in groups if not scene.room.is_convex or np.any(np.abs(normals[g] @ normals[wall]) > _RIGHT)]
        groups = [g for g in groups if g not in alike] + [[*(x for g in alike for x in g), wall]]
    begins = [[tuple(group[:count]) for count in range(len(group) + 1)] for group in groups]
    change, offset = np.zeros((1, 3, 3)), np.zeros((1, 3))
    for group in groups:
        by_matrix, by_offset = _isometries(group, scene)
        change = (change[:, None] + (by_matrix - np.eye(3))).reshape(-1, 3, 3)
        offset = (offset[:, None] + by_offset).reshape(-1, 3)
    return [tuple(wall for begin in split for wall in begin) for split in product(*begins)], np.eye(3) + change, offset


def _isometries(walls: list[int], scene: Scene) -> tuple[Floats, Floats]:
    """Isometries (n + 1, 3, 3), (n + 1, 3) by the first of some walls, from none to all."""
    faces, matrix, offset = scene.room.faces, [np.eye(3)], [np.zeros(3)]
    for wall in walls:
        mirror = np.eye(3) - 2.0 * np.outer(faces.normals[wall], faces.normals[wall])
        matrix.append(mirror @ matrix[-1])
        offset.append(mirror @ offset[-1] + 2.0 * faces.offsets[wall] * faces.normals[wall])
    return np.stack(matrix), np.stack(offset)


@dataclass(frozen=True, slots=True, eq=False)
class _Balls:
    """Balls that hold what moves in stretches of time, in quarters of quarters of a run and so on.

    Of every level there are centres (things, stretches, 3), m, and radii (things, stretches), m. Times are those of
    reception: sources and bodies are held for as long as sound takes before.
    """

    until: float  # end of the run, s
    sources: list[tuple[Floats, Floats]]  # from the whole run to the shortest stretches
    receivers: list[tuple[Floats, Floats]]
    bodies: list[tuple[Floats, Floats]]  # those that cast shadows
    together: list[tuple[Floats, Floats]]  # all of them in one

    @classmethod
    def of(cls, scene: Scene, paths: Chain) -> _Balls:
        """Hold the ends of paths and the bodies of a scene for as long as all trajectories are known."""
        until = known_until([*scene.named_ends(), *scene.named_scatterers()])
        casting = [body for body in scene.scatterers if body.shape.outlined]
        count = 1
        while until / count > _LONGEST and count < _MOST_STRETCHES:
            count *= _DIVIDED

        def held(things: Any, late: float, radii: Any = 0.0) -> list[tuple[Floats, Floats]]:
            return _levels(*_balls([thing.trajectory for thing in things], until, count, late), radii)

        receivers = held(scene.receivers, 0.0)
        late = _longest(paths, held(scene.sources, 0.0)[0], receivers[0])
        bodies = held(casting, late, np.array([[body.shape.radius] for body in casting]))
        together = [tuple(x[0] for x in _joined(*(x[None] for x in level))) for level in bodies]
        return cls(until, held(scene.sources, late), receivers, bodies, together)


def _longest(paths: Chain, sources: tuple[Floats, Floats], receivers: tuple[Floats, Floats]) -> float:
    """Bound of the delays of paths between ends in balls, s."""
    (place, off), (ear, other) = (tuple(x[:, 0] for x in ends) for ends in (sources, receivers))
    image = np.einsum("pij,pj->pi", paths.legs[0].matrix, place[paths.source]) + paths.legs[0].offset
    length = np.linalg.norm(image - ear[paths.receiver], axis=1) + off[paths.source] + other[paths.receiver]
    fastest = max(end.trajectory.peak_speed(*end.time_range)[0] for end in paths.scene.sources)
    return float(length.max(initial=0.0) / (paths.speed_range.slowest - fastest))


def _balls(motions: list[Any], until: float, count: int, late: float) -> tuple[Floats, Floats]:
    """Centres (things, n, 3) and radii (things, n) for the shortest stretches, and `late`, s, before them."""
    longer = until / count + late
    times = (np.arange(count) + 0.5) * (until / count) - 0.5 * late
    places = np.stack([motion.position(times) for motion in motions])
    speeds = np.stack([motion.speed_over(times - 0.5 * longer, times + 0.5 * longer) for motion in motions])
    return places, speeds * (0.5 * longer)


def _levels(centre: Floats, radius: Floats, radii: Any) -> list[tuple[Floats, Floats]]:
    """Balls of all levels from those of the shortest stretches, of things with radii (things, 1)."""
    levels = [(centre, radius + radii)]
    while levels[0][0].shape[1] > 1:
        each = tuple(x.reshape(len(centre), -1, _DIVIDED, *x.shape[2:]).swapaxes(1, 2) for x in levels[0])
        levels.insert(0, _joined(*each))
    return levels


def _joined(centre: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """Balls (things, n) that hold several others (things, several, n)."""
    middle = 0.5 * (centre.min(axis=1) + centre.max(axis=1))
    return middle, (np.linalg.norm(centre - middle[:, None], axis=-1) + radius).max(axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Rows of shadows on some paths, and their parts, one row's after another's."""

    path: NDArray[np.int64]  # (rows,) row of the path in its family
    start: Floats  # (rows,) of reception, s
    end: Floats
    count: NDArray[np.int64]  # (rows,) parts
    walls: list[tuple[int, ...]]  # before each part
    matrix: Floats  # (parts, 3, 3) of the isometry by these
    offset: Floats  # (parts, 3)

    @classmethod
    def of(cls, balls: _Balls, pair: PairPaths, known: dict[tuple[int, ...], Parts]) -> _Rows:
        """Find the rows of the paths of a pair; parts of paths are remembered by their walls."""
        family, index, until = pair.family, pair.index, balls.until
        walls = [tuple(x for x in met if x >= 0) for met in family.walls[index].tolist()]
        for met in walls:
            if met not in known:
                known[met] = parts_of(met, family.scene)
        each = [known[met] for met in walls]
        path = np.repeat(np.arange(len(each)), [len(parts[0]) for parts in each])
        number = np.concatenate([np.arange(len(parts[0])) for parts in each])
        lines = _Lines.of(balls, pair, index[path], *(np.concatenate([parts[i] for parts in each]) for i in (1, 2)))
        part, time, length = lines.near()
        order = np.lexsort((time, path[part]))
        part, time = part[order], time[order]
        apart = length + max(_MERGED, until / _MOST_ROWS)
        new = (np.diff(path[part], prepend=-1) != 0) | (np.diff(time, prepend=-np.inf) > apart)
        row, first = np.cumsum(new) - 1, np.flatnonzero(new)
        last = np.append(first, len(time))[1:] - 1
        # Half a stretch more: what fades where a row begins and ends has nothing to take away.
        start, end = time[first] - length, time[last] + length
        start[start <= 0.0], end[end >= until] = -np.inf, np.inf
        mine = index[path[part[first]]]
        start, end = np.maximum(start, family.start[mine]), np.minimum(end, family.end[mine])
        there = start < end
        both = np.unique(np.stack([row, part], axis=1)[there[row]], axis=0)
        some = both[:, 1]
        return cls(
            mine[there], start[there], end[there], np.bincount(both[:, 0], minlength=len(first))[there],
            [each[p][0][n] for p, n in zip(path[some].tolist(), number[some].tolist(), strict=True)],
            lines.matrix[some], lines.offset[some],
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Lines between the ends of S parts of paths of a pair."""

    balls: _Balls
    pair: PairPaths
    matrix: Floats  # (S, 3, 3) from the source's own room to that of the part
    offset: Floats  # (S, 3)
    back: Floats  # (S, 3, 3) from the receiver to there
    moved: Floats  # (S, 3)
    centre: float  # wave number in the middle of the signal's band, 1/m

    @classmethod
    def of(cls, balls: _Balls, pair: PairPaths, index: NDArray[np.int64], matrix: Floats, offset: Floats) -> _Lines:
        """Lines of parts of paths (S,), rows of the family, by the isometries by the walls before them."""
        family: Any = pair.family
        links = family.links(index)
        image = links.legs[0]
        back = matrix @ image.matrix.swapaxes(1, 2)
        moved = offset - np.einsum("sij,sj->si", back, image.offset)
        return cls(balls, pair, matrix, offset, back, moved, centre_of(links))

    def near(self) -> tuple[NDArray[np.int64], Floats, float]:
        """Parts (n,) that bodies come near, the middles (n,) of the shortest stretches, s, and the length of these.

        Outside of these stretches of time no shade differs from 1.
        """
        part, cell = np.arange(len(self.matrix)), np.zeros(len(self.matrix), dtype=np.int64)
        for level in range(len(self.balls.bodies)):
            if level:
                part = part.repeat(_DIVIDED)
                cell = (cell[:, None] * _DIVIDED + np.arange(_DIVIDED)).ravel()
            found = self._are_near(part, cell, level)
            part, cell = part[found], cell[found]
        length = self.balls.until / self.balls.bodies[-1][0].shape[1]
        return part, (cell + 0.5) * length, length

    def _are_near(self, part: NDArray[np.int64], cell: NDArray[np.int64], level: int) -> NDArray[np.bool_]:
        """Test if any body may be near parts (n,) in stretches (n,) of time of a level."""
        source, off = (x[self.pair.source, cell] for x in self.balls.sources[level])
        receiver, other = (x[self.pair.receiver, cell] for x in self.balls.receivers[level])
        begin = np.einsum("sij,sj->si", self.matrix[part], source) + self.offset[part]
        along = np.einsum("sij,sj->si", self.back[part], receiver) + self.moved[part] - begin
        squared, spare = np.maximum(np.sum(along**2, axis=1), 1e-30), np.maximum(off, other)
        longest = np.sqrt(squared) + 2.0 * spare
        reach = spare + WIDER * 2.0 * WITHIN * np.sqrt(0.5 * math.pi * longest / self.centre)

        def comes_near(mine: Any, place: Floats, radius: Floats) -> NDArray[np.bool_]:
            away = place - begin[mine]
            share = np.clip(np.sum(away * along[mine], axis=-1) / squared[mine], 0.0, 1.0)
            away -= share[..., None] * along[mine]
            return np.asarray(np.sum(away**2, axis=-1) < (reach[mine] + radius) ** 2)

        found = comes_near(slice(None), *(x[cell] for x in self.balls.together[level]))
        some = np.flatnonzero(found)
        found[some] = comes_near(some, *(x[:, cell[some]] for x in self.balls.bodies[level])).any(axis=0)
        return found
