"""Edges that diffract: where walls end, and where they meet at any angle of air but 180/m degrees."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import off_line
from clsim.arrays import Floats, read_only
from clsim.scene.room.faces import Faces
from clsim.scene.room.walls import Walls

Inside = Callable[[Floats], NDArray[np.bool_]]

_NEAR = 1e-7  # of the room's size; what is nearer to a line is on it
_BESIDE = 1e-6  # of the room's size; how far from an edge it is looked for faces
_FLAT = 1e-6  # by which the exterior angle over π may differ from 1
_WHOLE = 1e-5  # by which a half turn over the angle of air of an inner corner may differ from an integer


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Straight edges, E of them, each between two faces with air from one round to the other."""

    start: Floats  # (E, 3) where each begins, m
    along: Floats  # (E, 3) unit vectors ``across x out``
    across: Floats  # (E, 3) unit vectors in the 0-face, away from the edge
    out: Floats  # (E, 3) unit vectors off this face into the air
    length: Floats  # (E,) m
    n: Floats  # (E,) exterior angle over π: 2 of the edge of a screen, 1 where the material of a plane changes
    faces: NDArray[np.int64]  # (E, 2) walls of the 0-face and the n-face; the same at the edge of a screen
    free: NDArray[np.bool_]  # (E, 2) whether start and stop end in the air, and not at a wall
    names: tuple[str, ...]  # of each

    @staticmethod
    def none() -> Edges:
        """Return no edges: those of a room in which no wall ends in the air and no corner points inwards."""
        no = np.empty((0, 3))
        pairs = np.empty((0, 2), dtype=np.int64)
        return Edges(no, no, no, no, np.empty(0), np.empty(0), pairs, pairs.astype(bool), ())

    def __len__(self) -> int:
        return len(self.names)

    @property
    def stop(self) -> Floats:
        """Where each ends, (E, 3) m."""
        return np.asarray(self.start + self.length[:, None] * self.along)

    @property
    def frames(self) -> Floats:
        """Start of each, m, and its vectors `across`, `out` and `along`, (E, 4, 3)."""
        return np.stack([self.start, self.across, self.out, self.along], axis=1)

    def cylindrical(self, edge: NDArray[np.int64], places: Floats) -> tuple[Floats, Floats, Floats]:
        """Return distances r (...), angles θ (...) and heights z (...) of places (..., 3) about edges (...)."""
        # Angles are from the 0-face through the air, 0 to nπ; those inside a wedge are beyond either by up to half of
        # it.
        away = places - self.start[edge]
        x, y, z = (np.einsum("...i,...i->...", away, axis[edge]) for axis in (self.across, self.out, self.along))
        n = self.n[edge]
        return *off_line(n, x, y, 0.5 * np.pi * (n - 2.0)), z  # from half of the wedge below its 0-face on

    def inward(self, edge: NDArray[np.int64], face: NDArray[np.integer[Any]]) -> Floats:
        """Return unit vectors (..., 3) from edges (...) into their 0-faces, where `face` (...) is 0, or n-faces."""
        angle = np.pi * self.n[edge] * (np.asarray(face) == 1)
        return np.asarray(np.cos(angle)[..., None] * self.across[edge] + np.sin(angle)[..., None] * self.out[edge])

    def off(self, edge: NDArray[np.int64], face: NDArray[np.integer[Any]]) -> Floats:
        """Return unit vectors (..., 3) off faces of edges (...) into the air: 0-faces where `face` (...) is 0."""
        angle = np.pi * np.where(np.asarray(face) == 1, self.n[edge] - 0.5, 0.5)
        return np.asarray(np.cos(angle)[..., None] * self.across[edge] + np.sin(angle)[..., None] * self.out[edge])

    def beyond(
        self, edge: NDArray[np.int64], face: NDArray[Any], other: NDArray[np.int64], other_face: NDArray[Any],
        r: Floats, z: Floats,
    ) -> tuple[Floats, Floats]:  # fmt: skip
        """Return r (...) and z (...) of what is beyond other edges, at `r` and `z` about them, as edges (...) see it.

        Both share a face, into whose plane all is rolled out; where `face` is -1 they are the same edge.
        """
        inward, other_inward = self.inward(edge, face), self.inward(other, other_face)
        place = self.start[other] + z[..., None] * self.along[other] - r[..., None] * other_inward
        away = place - self.start[edge]
        seen = (np.sum(away * axis, axis=-1) for axis in (inward, self.along[edge]))
        one = np.asarray(face) < 0
        return np.where(one, r, next(seen)), np.where(one, z, next(seen))

    def pairs(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return edges (n, 2) that share a face, in either order, and which face of each that is (n, 2), 0 or 1."""
        # Of sheets that is the same side of them. Changes of material are left out.
        solid = np.flatnonzero(self.n != 1.0)
        same = self.faces[solid][:, None, :, None] == self.faces[solid][None, :, None, :]
        first, second, one, other = np.nonzero(same & ~np.eye(len(solid), dtype=bool)[:, :, None, None])
        edge, face = np.stack([solid[first], solid[second]], axis=1), np.stack([one, other], axis=1)
        off = [self.off(edge[:, i], face[:, i]) for i in (0, 1)]
        faced = np.sum(off[0] * off[1], axis=1) > 0.0
        for a, b in ((0, 1), (1, 0)):  # each before the other one, in the face
            away = np.stack([x[edge[:, b]] - self.start[edge[:, a]] for x in (self.start, self.stop)], axis=1)
            ahead = np.einsum("nei,ni->ne", away, self.inward(edge[:, a], face[:, a]))
            faced &= ahead.max(axis=1) > _BESIDE * self.length[edge[:, a]]
        return edge[faced], face[faced]

    def describe(self) -> list[str]:
        """Return description of the edges, a line each."""
        lines = [f"edges: {len(self)} that diffract, {self.length.sum():.4g} m together"] if len(self) else []
        for name, n, length, start in zip(self.names, self.n, self.length, self.start, strict=True):
            kind = f"{180.0 * n:.4g} degrees of air"
            kind = "free" if n == 2.0 else "a change of material" if n == 1.0 else kind
            at = ", ".join(f"{x:.4g}" for x in start)
            lines.append(f"{name}: {kind}, {length:.4g} m from ({at}) m")
        return lines or ["edges of the room: none that diffract"]


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """A line that bounds walls, and the positions (m,) on it between which its faces do not change."""

    point: Floats
    along: Floats
    places: Floats
    bounded: Floats  # (k, 2), where walls end on it
    walls: NDArray[np.int64]  # whose planes hold it


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """A wedge on a part of a line, from one face round to another one."""

    line: _Line
    first: float
    last: float
    n: float
    across: Floats
    out: Floats
    faces: tuple[int, int]

    @property
    def middle(self) -> Floats:
        """Return the point halfway between both ends, m."""
        return self.line.point + 0.5 * (self.first + self.last) * self.line.along

    @property
    def into_air(self) -> Floats:
        """Half-way between both faces."""
        return np.asarray(np.cos(0.5 * np.pi * self.n) * self.across + np.sin(0.5 * np.pi * self.n) * self.out)


def find_edges(walls: Walls, faces: Faces, inside: Inside | None, wall: int | None = None) -> Edges:
    """Return the edges of walls at which sound is diffracted; `inside` masks positions (n, 3) in the air of a room."""
    # Those between two neighbouring faces, with 360 degrees about a single one, and with 180 degrees between faces of
    # different materials. Inner corners of 180/m degrees are left out: their reflections are the whole field.
    found: list[_Piece] = []
    for line in _lines(walls):
        if wall is not None and wall not in line.walls:
            continue
        found += _joined([p for p in _pieces(walls, line) if _diffracts(p, faces)])
    if inside is not None and found:
        step = _BESIDE * walls.size
        air = inside(np.array([p.middle + step * p.into_air for p in found]))
        found = [p for p, audible in zip(found, air, strict=True) if audible]
    if not found:
        return Edges.none()
    along = np.array([p.line.along for p in found])
    start = np.array([p.line.point + p.first * p.line.along for p in found])
    length = np.array([p.last - p.first for p in found])
    into_air = np.array([p.into_air for p in found])
    free = [~_ends_at_a_wall(walls, start + d * length[:, None] * along, along, into_air) for d in (0.0, 1.0)]
    columns: list[Any] = [
        start, along, np.array([p.across for p in found]), np.array([p.out for p in found]), length,
        np.array([p.n for p in found]), np.array([p.faces for p in found]), np.stack(free, axis=1),
    ]  # fmt: skip
    held = zip((f.name for f in fields(Edges)), map(read_only, columns), strict=False)
    sides = [[faces.names[wall] for wall in dict.fromkeys(p.faces)] for p in found]
    return Edges(**dict(held), names=numbered([f"edge {' | '.join(names)}" for names in sides]))


def _lines(walls: Walls) -> Iterator[_Line]:
    """Yield the lines that bound walls."""
    ends, tolerance = walls.edge, _NEAR * walls.size
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    left = np.argsort(-length, kind="stable")  # the longest tells the direction best
    left = left[length[left] > tolerance]
    while len(left):
        a, b = ends[left[0]]
        along = (b - a) / length[left[0]]
        away = ends[left] - a
        place = away @ along
        off = np.linalg.norm(away - place[..., None] * along, axis=2)
        mine = np.all(off <= tolerance, axis=1)
        bounded, left = np.sort(place[mine], axis=1), left[~mine]
        held = (np.abs(walls.normal @ along) * walls.radius <= tolerance) | (np.abs(walls.normal @ along) < 1e-12)
        held &= np.abs(walls.normal @ along) < 0.5  # short walls of a huge room are within the tolerance of any line
        held &= np.abs(walls.normal @ a - walls.offset) <= tolerance
        places = [bounded.ravel(), *(_met(walls, w, a, along) for w in np.flatnonzero(held).tolist())]
        together = np.sort(np.concatenate(places))
        apart = np.append(True, np.diff(together) > tolerance)
        yield _Line(a, along, together[apart], bounded, np.flatnonzero(held))


def _met(walls: Walls, wall: int, point: Floats, along: Floats) -> Floats:
    """Return the places (n,) on a line in a wall's plane at which it meets the wall's outline."""
    ends = walls.edges_of(wall) - point
    height = ends @ np.cross(walls.normal[wall], along)
    crossing = np.flatnonzero(height[:, 0] * height[:, 1] < 0.0)
    share = (height[crossing, 0] / (height[crossing, 0] - height[crossing, 1]))[:, None]
    return np.asarray((ends[crossing, 0] + share * (ends[crossing, 1] - ends[crossing, 0])) @ along)


def _pieces(walls: Walls, line: _Line) -> Iterator[_Piece]:
    """Yield the wedges along a line, from each face to the next one round."""
    for first, last in zip(line.places[:-1], line.places[1:], strict=True):
        middle = 0.5 * (first + last)
        if not np.any((line.bounded[:, 0] < middle) & (line.bounded[:, 1] > middle)):
            continue
        around = _faces_around(walls, line, line.point + middle * line.along)
        for i, (angle, wall, across) in enumerate(around):
            after, face, _ = around[(i + 1) % len(around)]
            gap = (after - angle) % (2.0 * np.pi) if len(around) > 1 else 2.0 * np.pi
            n = gap / np.pi
            n = next((whole for whole in (1.0, 2.0) if abs(n - whole) < _FLAT), n)
            yield _Piece(line, first, last, n, across, np.cross(line.along, across), (wall, face))


def _faces_around(walls: Walls, line: _Line, place: Floats) -> list[tuple[float, int, Floats]]:
    """Return angle, wall and direction away from the line of every face at a place, in the order of angles."""
    found: list[tuple[float, int, Floats]] = []
    zero = np.cross(line.along, np.eye(3)[np.argmin(np.abs(line.along))])
    zero /= np.linalg.norm(zero)
    ninety = np.cross(line.along, zero)
    for wall in line.walls.tolist():
        sideways = np.cross(walls.normal[wall], line.along)
        sideways /= np.linalg.norm(sideways)
        for across in (sideways, -sideways):
            if walls.holds(wall, (place + _BESIDE * walls.size * across)[None])[0]:
                angle = float(np.arctan2(across @ ninety, across @ zero)) % (2.0 * np.pi)
                found.append((angle, wall, across))
    found.sort(key=lambda face: face[0])
    apart = [i for i, face in enumerate(found) if abs(np.sin(0.5 * (face[0] - found[i - 1][0]))) > _FLAT]
    return [found[i] for i in apart] if apart else found[:1]  # of twins that lie on each other, the first


def _diffracts(piece: _Piece, faces: Faces) -> bool:
    """Whether a wedge diffracts."""
    if piece.n == 1.0:
        return faces.materials[piece.faces[0]] is not faces.materials[piece.faces[1]]
    return abs(1.0 / piece.n - round(1.0 / piece.n)) > _WHOLE


def _joined(pieces: list[_Piece]) -> list[_Piece]:
    """Return pieces of one line, neighbours of the same faces as one."""
    found: dict[tuple[Any, ...], _Piece] = {}
    for piece in pieces:
        key = (piece.faces, round(piece.n, 6), piece.last)
        before = found.pop((piece.faces, round(piece.n, 6), piece.first), None)
        kept = {f.name: getattr(piece, f.name) for f in fields(_Piece)}
        found[key] = _Piece(**(kept | {"first": before.first if before else piece.first}))
    return list(found.values())


def _ends_at_a_wall(walls: Walls, end: Floats, along: Floats, into_air: Floats) -> NDArray[np.bool_]:
    """Return mask of edges that meet a wall at their ends (E, 3), as seen from the adjacent air."""
    closed = np.zeros(len(end), dtype=bool)
    beside = end + _BESIDE * walls.size * into_air
    for w in range(len(walls)):
        slope = along @ walls.normal[w]
        steep = np.abs(slope) > 1e-3
        on = (walls.offset[w] - beside @ walls.normal[w]) / np.where(steep, slope, 1.0)
        near = np.flatnonzero(steep & (np.abs(on) < 1e3 * _BESIDE * walls.size))
        near = near[np.abs(end[near] @ walls.normal[w] - walls.offset[w]) <= _NEAR * walls.size]
        closed[near] |= walls.holds(w, beside[near] + on[near, None] * along[near])
    return closed


def numbered(labels: Sequence[str], nameless: str = "") -> tuple[str, ...]:
    """Return a name for each of some things: its label, numbered where several have the same or none."""
    names, seen, count = [], dict.fromkeys(labels, 0), Counter(labels)
    for label in labels:
        seen[label] += 1
        alone = bool(label) and count[label] == 1
        names.append(label if alone else f"{label or nameless} {seen[label]}")
    return tuple(names)
