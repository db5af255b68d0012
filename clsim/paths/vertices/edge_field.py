"""Edges at rest: shortest paths over them between endpoints that move, in their frames, and the fields of both.

Fields are those over that of the shortest path, by the uniform theory or exact, with factors of the faces.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics import diffraction
from clsim.arrays import Complexes, Floats
from clsim.paths.family import Links
from clsim.paths.propagation import Folds, Medium, Passage, straight
from clsim.paths.response import SceneResponse
from clsim.scene.motion.motion import Motion

End = tuple[Floats, Floats]
Meeting = Callable[[End, End], tuple[tuple[Floats, Floats], Floats]]

_NEWTON_LIMIT = 60
_CONVERGED = 1e-15  # s


@dataclass(frozen=True, slots=True, eq=False)
class EdgeView:
    """How the edges of P paths see one end: as coordinates along `across`, `out` and `along` of each edge."""

    turn: Floats  # (P, 3, 3) from directions in the room to those in each edge's frame, seen by the walls between
    shift: Floats  # (P, 3) where the room's origin is seen, m

    @staticmethod
    def of(matrix: Floats, offset: Floats, frame: Floats) -> EdgeView:
        """Return the view by the walls of isometries (P, 3, 3) and (P, 3), of edges with frames (P, 4, 3)."""
        axes = frame[:, 1:]
        return EdgeView(axes @ matrix, np.einsum("paj,pj->pa", axes, offset - frame[:, 0]))

    def places(self, places: Floats) -> Floats:
        """Return coordinates (3, P, T) of places (T, 3) that are the same for all paths, or (P, T, 3), m."""
        return np.asarray(self.directions(places) + self.shift.T[:, :, None])

    def directions(self, vectors: Floats) -> Floats:
        """Return components (3, P, T) of vectors (T, 3) that are the same for all paths, or (P, T, 3)."""
        seen = self.turn @ np.swapaxes(vectors, -1, -2)
        return np.moveaxis(seen, 1, 0)

    def back(self, components: Floats) -> Floats:
        """Return vectors (P, T, 3) in the room of components (3, P, T)."""
        turned = np.swapaxes(self.turn, 1, 2) @ np.moveaxis(components, 0, 1)
        return np.swapaxes(turned, 1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class RolledOut:
    """How edges see what is beyond others with which they share a face, all rolled out into the plane of that face."""

    offset: Floats  # (P, 2) r and z of what is at r = z = 0 about the other edge, m
    matrix: Floats  # (P, 2, 2) from r and z about the other edge

    @staticmethod
    def of(frame: Floats, inward: Floats, other: Floats, other_inward: Floats) -> RolledOut:
        """Return it for edges with frames (P, 4, 3) and directions (P, 3) into the face, and for the others."""
        axes = np.stack([inward, frame[:, 3]], axis=1)
        columns = np.stack([-other_inward, other[:, 3]], axis=2)
        return RolledOut(np.einsum("pai,pi->pa", axes, other[:, 0] - frame[:, 0]), axes @ columns)

    @staticmethod
    def between(frames: tuple[Floats, Floats], n: tuple[Floats, Floats], face: Any) -> tuple[RolledOut, RolledOut]:
        """Make the views from both edges of pairs beyond each other."""
        angles = np.pi * np.where(face == 1, np.stack(n, axis=1), 0.0)
        inward = [
            np.cos(angle)[:, None] * frame[:, 1] + np.sin(angle)[:, None] * frame[:, 2]
            for frame, angle in zip(frames, angles.T, strict=True)
        ]
        one, other = (frames[0], inward[0]), (frames[1], inward[1])
        return RolledOut.of(*one, *other), RolledOut.of(*other, *one)

    def __call__(self, r: Floats, z: Floats) -> tuple[Floats, Floats]:
        """Return r and z (P, T) as the edges see what is at r and z about the others, m."""
        (a, b), (c, d) = np.moveaxis(self.matrix, 0, 2)[..., None]
        return self.offset[:, :1] + a * r + b * z, self.offset[:, 1:] + c * r + d * z


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLengths:
    """P paths at T times, as each edge sees them."""

    source: Floats  # (3, P, T) coordinates of both images, that of the source at emission, m
    receiver: Floats  # likewise
    # (P, T) points of each path on the first edge and the last, which may be the same, m from its start.
    places: tuple[Floats, Floats]
    emission_time: Floats  # (P, T) s
    delay: Floats  # (P, T) s, and m
    length: Floats  # likewise
    sound: Passage  # what the air makes of it
    mach: Floats  # (P, T) of the source towards the way

    @property
    def parts(self) -> tuple[Floats, Floats]:
        """Unit vectors (3, P, T) from the source to the edge, and from the receiver to it."""
        ends = zip((self.source, self.receiver), self.places, strict=True)
        first, last = (towards_edge(end, place)[0] for end, place in ends)
        return first, last


def edge_lengths(
    views: tuple[EdgeView, EdgeView], met: Meeting, end_place: Floats, source: Motion, receiver: Floats, times: Floats,
    medium: Medium, retarded: bool,
) -> EdgeLengths:  # fmt: skip
    """Return the ways of P paths between a source and a receiver.

    Shapes: end_place (P,) m; receiver (T, 3) m; times (T,) s.
    met: takes r and z (P, T) of both images about the first and the last edge; returns where the shortest paths meet
    these, and their lengths, each (P, T) m.
    end_place: of the ends that paths run over, m; NaN for paths over the edge itself, by the shortest way.
    retarded: whether the source is where it was when the sound was emitted, or where it is at reception.
    As the way over the edge itself is the shortest, the change of its apex does not change it: Newton's steps for the
    time of emission take the source's speed along the first part.
    """
    receiver_at = views[1].places(receiver)
    over_end = np.flatnonzero(~np.isnan(end_place))
    shape = receiver_at.shape[1:]
    emission_time = np.broadcast_to(times, shape)
    positions, velocities = source.position(times), source.velocity(times)
    delay = np.zeros(shape)
    for step_count in range(_NEWTON_LIMIT):
        emitted_at = views[0].places(positions)
        places, length = met(polar(emitted_at), polar(receiver_at))
        towards, first = towards_edge(emitted_at, places[0])
        if len(over_end):
            place = np.array(np.broadcast_to(places[0], shape))
            place[over_end] = end_place[over_end, None]
            places, (towards, first) = (place, place), towards_edge(emitted_at, place)
            length = first + towards_edge(receiver_at, place)[1]
        length = np.broadcast_to(length, shape)
        sound = medium.passage(length, receiver - positions)
        speed = np.einsum("ipt,ipt->pt", towards, np.broadcast_to(views[0].directions(velocities), towards.shape))
        mach = np.broadcast_to(speed, shape) / sound.speed
        if sound.carried is not None:
            mach = mach + np.sum(sound.carried * velocities, axis=-1)
        if not retarded:
            return EdgeLengths(emitted_at, receiver_at, places, emission_time, sound.time, length, sound, mach)
        step = (sound.time - delay) / (1.0 - mach)
        delay = delay + step
        if step_count and not np.any(np.abs(step) > _CONVERGED + 4e-16 * np.abs(times)):
            break
        if np.isinf(source.end):
            continue
        emission_time = times - delay
        flat = emission_time.ravel()
        positions, velocities = (f(flat).reshape(*shape, 3) for f in (source.position, source.velocity))
    return EdgeLengths(emitted_at, receiver_at, places, times - delay, delay, length, sound, mach)


def polar(seen: Floats) -> tuple[Floats, Floats]:
    """Distances from edges and places along them (P, T) of coordinates (3, P, T), m."""
    x, y, z = seen
    return np.maximum(np.hypot(x, y), diffraction.ON_LINE), z


def towards_edge(end: Floats, place: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (3, P, T) from ends (3, P, T) to places on edges (P, T), and the distances (P, T), m."""
    away = np.stack(np.broadcast_arrays(-end[0], -end[1], place - end[2]))
    distance = np.sqrt(np.einsum("ipt,ipt->pt", away, away))
    return away / np.maximum(distance, 1e-300), distance


class LayeredLengths:
    """Paths over edges to a receiver at places (T, 3), as the delay equation takes them in air that varies."""

    def __init__(self, links: Links, received_at: Floats) -> None:
        (self._before, after), self._received_at = links.legs, received_at
        self._frame, self._end_place = links.vertex.frame, links.vertex.end_place
        self._receiver_at = after.image(received_at[None])
        self._after = after
        scene = links.chain.scene
        planes = scene.room.faces.normals, scene.room.faces.offsets
        self._folds = [Folds(planes, walls) for walls in links.surfaces] if scene.air.layers else []

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Return lengths and directions at the source, see `LegTable`."""
        (first, direction), (second, _) = self._legs(p, t, start)
        return first + second, np.einsum("pji,p...j->p...i", self._before.matrix[p], direction)

    def arrive(self, start: Floats) -> Floats:
        """Return directions at the receiver, see `LegTable`."""
        _, (_, direction) = self._legs(slice(None), slice(None), start)
        return np.asarray(np.einsum("pji,ptj->pti", self._after.matrix, direction))

    def seen(self) -> Floats:
        """Return the receiver as the source sees it, see `LegTable`."""
        apart = self._receiver_at - self._before.offset[:, None]
        return np.asarray(np.einsum("pji,ptj->pti", self._before.matrix, apart))

    def bends(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Bends of paths, see `LegTable`."""
        apex, first, second = self._parts(p, t, start)
        one, other = straight(first, apex)[0][..., None], straight(apex, second)[0][..., None]
        before, low = self._folds[0].bends(p, start, apex)
        after, high = self._folds[1].bends(p, self._received_at[t], apex)  # from the receiver's side
        shares = [one * before, one + other * (1.0 - after[..., -2::-1])]
        return np.concatenate(shares, axis=-1) / (one + other), np.concatenate([low, high[..., -2::-1]], axis=-1)

    def _legs(self, p: Any, t: Any, start: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        apex, first, second = self._parts(p, t, start)
        return straight(first, apex), straight(apex, second)

    def _parts(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats, Floats]:
        """Points where paths meet the edges, and both endpoints as seen from these."""
        receiver_at, frame, end = self._receiver_at[p, t], self._frame[p], self._end_place[p]
        if receiver_at.ndim == 3:  # all times of a path, or one each
            frame, end = frame[:, None], end[:, None]
        emitted_at = self._before.part(p).image(np.broadcast_to(start, receiver_at.shape))
        coordinates: list[Floats] = []
        for place in (emitted_at, receiver_at):
            away = place - frame[..., 0, :]
            x, y, z = (np.sum(away * frame[..., axis, :], axis=-1) for axis in (1, 2, 3))
            coordinates += [np.maximum(np.hypot(x, y), diffraction.ON_LINE), z]
        along = np.where(np.isnan(end), diffraction.path_over_edge(*coordinates).apex, end)
        return frame[..., 0, :] + along[..., None] * frame[..., 3, :], emitted_at, receiver_at


BOTH = 2  # times a term's side: both paths round its boundary count as much beyond the end


@dataclass(frozen=True, slots=True, eq=False)
class EndsOfEdges:
    """Ends of edges that P paths run over, at T times."""

    # (P,) 1 where the shortest way is taken to meet the edge, -1 where it passes the end; 0 of paths over the
    # edge itself.
    side: NDArray[np.int8]
    root: Floats  # (P, T) root of the detour by the end, √m; negative where the shortest way is on the other side
    corner: Floats  # (P,) angle at which the way comes to the corner itself, see `end_transition`

    @staticmethod
    def of(
        side: NDArray[np.int8], edge_path: diffraction.EdgePath,
        ends: tuple[tuple[Floats, Floats], tuple[Floats, Floats]], end: Floats, inside: Floats, corner: Floats,
    ) -> EndsOfEdges:  # fmt: skip
        """Make it from r and z of source and receiver (P, T), m."""
        signed, root = np.where(inside < 0.0, -1.0, 1.0) * side[:, None], np.zeros(edge_path.length.shape)
        over = np.flatnonzero(side)
        if len(over):
            some = diffraction.EdgePath(edge_path.length[over], edge_path.apex[over], edge_path.breadth[over])
            (r_s, z_s), (r_r, z_r) = ((r[over], z[over]) for r, z in ends)
            detour = diffraction.end_detour(some, (r_s, z_s), (r_r, z_r), np.broadcast_to(end, (len(side), 1))[over])
            root[over] = signed[over] * np.sqrt(detour)
        return EndsOfEdges(side, root, corner)

    def transition(self, rows: NDArray[np.int64], lit: NDArray[np.int8], wave: Floats, root: Floats) -> Complexes:
        """Compute the transition function of some rows' edges or ends (n, T, F), without the phase of the detour."""
        over = self.side[rows] != 0
        if not over.any():
            return diffraction.transition(root)
        found, ends = np.empty(root.shape, dtype=np.complex128), rows[over]
        found[~over] = diffraction.transition(root[~over])
        end, both = self.root[ends, :, None] * np.sqrt(wave[over]), np.abs(lit[over]) == BOTH
        at_end = diffraction.end_transition(end, root[over], self.corner[ends, None, None])
        if both.any():  # half of either way round the boundary
            twice = np.exp(1j * (end[both] ** 2 + root[over][both] ** 2))
            at_end[both] -= np.where(end[both] < -diffraction.AT_CORNER, twice, 0.0)
        found[over] = -1.0 * self.side[ends, None, None] * at_end
        return found


def utd_field(
    n: Floats, lit: NDArray[np.int8], angles: Floats, distances: tuple[Floats, Floats], edge_path: diffraction.EdgePath,
    wave: Floats, factors: list[Any], ends: EndsOfEdges,
) -> Any:  # fmt: skip
    """Compute the field (P, T, F) of edges (P,) and of their ends over that of the shortest ways, see `Edges`."""
    weight, root = diffraction.wedge_terms(n[:, None], angles, np.sign(lit)[:, None])
    scale, field = np.sqrt(wave * edge_path.breadth[..., None]), np.zeros(wave.shape, dtype=np.complex128)
    for term in range(lit.shape[1]):
        kept = np.flatnonzero(lit[:, term])
        both = ends.transition(kept, lit[kept, term], wave[kept], root[kept, :, term, None] * scale[kept])
        both *= 0.5 * weight[kept, :, term, None]
        field[kept] += both if factors[term] is None else both * factors[term][kept]
    return field


def exact_field(
    n: Floats, lit: NDArray[np.int8], angles: Floats, distances: tuple[Floats, Floats], edge_path: diffraction.EdgePath,
    wave: Floats, factors: list[Any], ends: EndsOfEdges,
) -> Any:  # fmt: skip
    """Compute the exact field (P, T, F) of edges over that of the shortest ways, from what `utd_field` takes."""
    field = np.zeros(wave.shape, dtype=np.complex128)
    within = ((ends.side != 0)[:, None] & (ends.root >= 0.0))[..., None]
    sides = np.where(within, np.where(angles >= 0.0, 1, -1), np.where(lit < 0, -1, 1)[:, None])
    _, root = diffraction.wedge_terms(n[:, None], angles, sides)
    terms = diffraction.exact_wedge_terms(n[:, None], angles, sides, *distances, edge_path, wave)
    for term, each in enumerate(terms):
        kept = np.flatnonzero(lit[:, term])
        over = np.flatnonzero(lit[:, term] * ends.side)
        if len(over):
            phase = root[over, :, term, None] * np.sqrt(wave[over] * edge_path.breadth[over, :, None])
            each[over] *= ends.transition(over, lit[over, term], wave[over], phase) / diffraction.transition(phase)
        field[kept] += each[kept] if factors[term] is None else (each * factors[term])[kept]
    return field


def cylindrical(n: Floats, seen: Floats, beside: NDArray[np.int8]) -> tuple[Floats, Floats, Floats]:
    """Return r, θ and z of coordinates (3, P, T) about edges (P,), see `least_angle`."""
    x, y, z = seen
    return *diffraction.off_line(n[:, None], x, y, least_angle(n, beside)[:, None]), z


def least_angle(n: Floats, beside: NDArray[np.int8]) -> Floats:
    """Origin of the angles about edges (P,)."""
    return np.asarray(0.5 * np.pi * (n - 2.0) + 0.25 * np.pi * n * beside)


def adjacent_factors(
    n: Floats, faces: NDArray[np.int64], angles: tuple[Floats, Floats], slope: Floats, at: SceneResponse
) -> list[Any]:
    """Multiply the reflection factors (P, T, F) of each term's partner; None for terms whose partners have none.

    Shapes: n (P,); faces (P, 2); slope (P, T).
    Our own derivation: on the boundary of a partner the angle from a face of one leg to the edge gives all angles of
    incidence, in steps of nπ; elsewhere both ends share what is left to the boundary. Behind a sheet that
    lets the share T of the pressure pass there is a path of T: the term past its edge stands for the rest, 1 - T.
    """
    (came, went), counts = angles, diffraction.adjacent_reflections(n)
    sheets = np.flatnonzero(at.panels[faces[:, 0]] & (faces[:, 0] == faces[:, 1]))
    found: list[Any] = []
    for term, half in enumerate((0.5 * (went + came),) * 2 + (0.5 * (came - went),) * 2):
        product, count = None, counts[:, term]
        for bounce in range(count.max(initial=0)):
            turned = (bounce - count // 2) * np.pi * n
            wall = faces[:, ((term >= 2) * term + bounce) % 2]
            factor = face_factor(wall, np.cos(half + turned[:, None]) * slope, at)
            factor[bounce >= count] = 1.0
            product = factor if product is None else product * factor
        if len(sheets) and term < 2:
            product = np.ones((*slope.shape, len(at.frequencies)), dtype=np.complex128) if product is None else product
            passing = faces[sheets, 0] + at.surfaces
            product[sheets] -= face_factor(passing, (np.cos(half) * slope)[sheets], at)
        found.append(product)
    return found


def face_factor(walls: NDArray[np.int64], cosine: Floats, at: SceneResponse) -> Any:
    """Compute the reflection factors (P, T, F) of walls (P,) at cosines (P, T) of incidence, of any sign."""
    factor: Any = np.broadcast_to(at.reflection(walls[:, None])[:, None], (*cosine.shape, len(at.frequencies))).astype(
        np.complex128
    )
    for wall in np.unique(walls[at.angular[walls]]):
        here = np.flatnonzero(walls == wall)
        factor[here] = at.reflection_at(wall, np.abs(cosine[here]))
    return factor
