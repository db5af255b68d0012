"""An edge and an end of another edge as vertices: sound over both, in either order."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics import diffraction
from clsim.acoustics.corner import CornerLeg, meeting_field
from clsim.arrays import Floats
from clsim.paths.family import Pair
from clsim.paths.response import SceneResponse
from clsim.paths.vertices import edge_events, edge_pair
from clsim.paths.vertices.edge import Triple

_GRAZING, _INSIDE = (1.2, 2.2), (-1.5, -0.5)  # roots of phases, between which one theory goes over into another


def ends_of(number: int) -> list[tuple[int, int]]:
    """List edges, 0 for the first and 1 for the last, that end, and at which end, of a number of `over_end`."""
    return [(place, int(end)) for place, end in enumerate(edge_events.end_numbers(number)) if end >= 0]


@dataclass(frozen=True, slots=True, eq=False)
class EdgeEndVertex(edge_pair.GapPairVertex):
    """Two edges, over a free end of one of which P paths run, with open air or a shared face between.

    Where the shortest path over both edges runs off the end, the path over both goes over into this one. `over_end` is
    0 for the start of the first edge, 1 for its end, and 2 and 3 for those of the last edge; from 4 on both edges of a
    face end at one corner. From 8 on the path over one end runs off the other edge: this is a path over ends of both
    edges of a face. `shared` is 2 across air. The signs of `lit` count at edges that do not end, and where both
    do; at the other ones their own angles do.
    """

    kind: ClassVar[str] = "edge and end"
    loudest: ClassVar[float] = 18.0
    solver: ClassVar[type[edge_events.EdgeEndSolver]] = edge_events.EdgeEndSolver

    @property
    def end_place(self) -> Floats:
        """NaN (P,): `met` says where paths meet both edges."""
        return np.full(len(self), np.nan)

    @property
    def of_last(self) -> NDArray[np.bool_]:
        """Mask (P,) of paths over an end of the last edge."""
        return (self.over_end % edge_events.MEETING >= edge_events.OF_LAST) & ~self.meeting

    @property
    def meeting(self) -> NDArray[np.bool_]:
        """Mask (P,) of paths over a corner at which both edges end."""
        return np.asarray(edge_events.at_meeting(self.over_end))

    @property
    def held(self) -> Floats:
        """Where the other edges end (P, 1), of paths over ends of both, m; else NaN."""
        length = self.lines.length[np.where(self.of_last, self.edge, self.last.edge)]
        end = np.where(self.over_end >= edge_events.TWO_ENDS + edge_events.MEETING, length, 0.0)
        return np.where(self.over_end >= edge_events.TWO_ENDS, end, np.nan)[:, None]

    @property
    def objects(self) -> NDArray[np.int64]:
        """Numbers of the edge and the end among the names, (P, 2)."""
        first, last = self.edge, self.last.edge
        ends = zip((first, last), edge_events.end_numbers(self.over_end), strict=True)
        return np.stack([np.where(end < 0, edge, len(self.lines) + 2 * edge + end) for edge, end in ends], axis=1)

    def ended_at(self, frames: Pair | None = None) -> tuple[Floats, Floats, Floats, Floats]:
        """Where the ends are along their edges (P, 1), m, and (P, 3), and r and z (P, 1) about the other edges, m."""
        ended, other = self._frames(frames)
        length = self.lines.length[np.where(self.of_last, self.last.edge, self.edge)]
        along = np.where(self.over_end % edge_events.OF_LAST == 1, length, 0.0)
        place = ended[:, 0] + along[:, None] * ended[:, 3]
        x, y, z = np.moveaxis(np.einsum("pai,pi->pa", other[:, 1:], place - other[:, 0]), 1, 0)
        return along[:, None], place, np.hypot(x, y)[:, None], z[:, None]

    def _frames(self, frames: Pair | None = None) -> Pair:
        """Frames (P, 4, 3) of the edges that end, and of the other ones, as the first edges see them."""
        of_last, (first, last) = self.of_last[:, None, None], frames or (self.frame, self.seen)
        return np.where(of_last, last, first), np.where(of_last, first, last)

    def met(self, source: Pair, receiver: Pair, frames: Pair | None = None) -> tuple[Pair, Floats]:
        """Places on both edges, and lengths, of shortest paths between ends at r and z about them, (P, T) m each."""
        (along, _, r, z), of_last = self.ended_at(frames), self.of_last[:, None]
        (r_f, r_n), (z_f, z_n) = (  # beyond the ends, and beyond the other edges
            (np.where(of_last, r, s), np.where(of_last, s, r)) for s, r in zip(source, receiver, strict=True)
        )
        route = diffraction.path_over_edge(r, z, r_n, z_n)
        end, held = np.broadcast_to(along, route.apex.shape), self.held
        over = np.where(np.isnan(held), route.apex, held)
        places = np.where(of_last, over, end), np.where(of_last, end, over)
        behind = np.where(np.isnan(held), route.length, np.hypot(r, over - z) + np.hypot(r_n, over - z_n))
        length, rows = np.hypot(r_f, along - z_f) + behind, np.flatnonzero(self.meeting)
        ends = zip(places, (self.edge, self.last.edge), edge_events.end_numbers(self.over_end), strict=True)
        for place, edge, number in ends if len(rows) else ():
            place[rows] = np.where(number == 1, self.lines.length[edge], 0.0)[rows, None]
        legs = (np.hypot(r, place - z) for (r, z), place in zip((source, receiver), places, strict=True))
        return places, np.where(self.meeting[:, None], next(legs) + next(legs), length)

    def _length_between(self, frames: Pair, source: Pair, receiver: Pair) -> Floats:
        return self.met(source, receiver, (frames[0][:, 0], frames[1][:, 0]))[1]

    def _field(self, source: Triple, receiver: Triple, end: Floats, wave: Floats, at: SceneResponse) -> Any:
        """Field (P, T, F) beyond the edge and the end, without its phase, of endpoints at r, θ, z about both."""
        middle = end if end.ndim == 3 else None
        field, count = np.zeros(wave.shape, dtype=np.complex128), max(1, wave.size // edge_pair.AT_ONCE)
        kinds = np.where(self.meeting, 4, 2 * (self.shared[:, 0] == ACROSS) + self.of_last)
        kinds = np.where(self.over_end >= edge_events.TWO_ENDS, 6 + self.of_last, kinds)
        for kind in range(8):
            rows = np.flatnonzero(kinds == kind)
            for some in np.array_split(rows, min(count, len(rows))) if len(rows) else ():
                part: Any = self.part(some)
                ends: Any = tuple(tuple(x[some] for x in end_at) for end_at in (source, receiver))
                bend = None if middle is None else middle[some]
                if bend is not None and kind >= 4:
                    part, ends, bend = replace(part, seen=part.last.frame), part.from_starts(ends), None
                if kind == 4:
                    field[some] = _corner_field(part, ends, wave[some], at)
                else:
                    field[some] = _end_field(part, ends, bend, kind % 2, kind in (2, 3), wave[some], at)
        if self.between.size and middle is None:
            towards = self._towards(source, receiver)
            field *= at.reflection(self.between)[:, None]
            at.apply_angular_walls(field, self.between, towards)
        return field

    def from_starts(self, ends: tuple[Triple, Triple]) -> tuple[Triple, Triple]:
        """Endpoints at z (P, T) from the starts of edges that both end, of those at z from the ends, m."""
        both = np.stack([self.edge, self.last.edge], axis=1)
        places = edge_events.held_places(self.over_end, self.lines.length[both])
        (r_s, t_s, z_s), (r_r, t_r, z_r) = ends
        return (r_s, t_s, z_s + places[:, :1]), (r_r, t_r, z_r + places[:, 1:])

    def _towards(self, source: Triple, receiver: Triple) -> Floats:
        """Directions (P, T, 3) in which paths leave the first edges."""
        first, last = self.met(source[::2], receiver[::2])[0]
        away = self.seen[:, None, 0] + last[..., None] * self.seen[:, None, 3] - self.frame[:, None, 0]
        away = away - first[..., None] * self.frame[:, None, 3]
        return np.asarray(away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), diffraction.ON_LINE))


ACROSS = 2  # of `shared`


def _bend_at_rest(pair: EdgeEndVertex, near: Pair, ended: int) -> tuple[Floats, ...]:
    """Place ends along their edges (P, 1), with lengths and angles of paths from them over the other edges."""
    (along, corner, r_c, z_c), (mine, theirs), (r_n, z_n) = pair.ended_at(), pair._frames(), near
    route = diffraction.path_over_edge(r_c, z_c, r_n, z_n)
    between, behind = np.hypot(r_c, route.apex - z_c), np.maximum(np.hypot(r_n, route.apex - z_n), diffraction.ON_LINE)
    onto = theirs[:, None, 0] + route.apex[..., None] * theirs[:, None, 3] - corner[:, None]
    slope = np.einsum("pti,pi->pt", onto, mine[:, 3]) / between
    return along, between, behind, route.length, slope, *pair.gap.angles((1.0 - 2.0 * ended) * -onto)


def _bend_in_motion(middle: Floats, near: Pair, ended: int) -> tuple[Floats, ...]:
    """`_bend_at_rest` from `GapEvents.middle` and near endpoints from places on the edges."""
    ahead, back, between, turn, *slopes = np.moveaxis(middle, 2, 0)
    behind = np.maximum(np.hypot(*near), diffraction.ON_LINE)
    return np.zeros_like(turn), between, behind, between + behind, slopes[ended], ahead, back, turn


def _end_field(
    pair: EdgeEndVertex, ends: tuple[Triple, Triple], middle: Floats | None, ended: int, across_air: bool,
    wave: Floats, at: SceneResponse,
) -> Any:  # fmt: skip
    """Compute the field (P, T, F) of paths over ends of all first, 0, or of all last edges, 1.

    Our own derivation: the far endpoint is rolled out beyond the place V on the other edge, into the line from the end
    C through V. Of the product of both edges' terms, with the lengths of the legs by C, the end takes away as much as
    of the terms of its own edge alone between the endpoint and the one rolled out.
    """
    (_, t_s, _), (_, t_r, _) = ends
    (r_f, _, z_f), near = ends[ended], ends[1 - ended][::2]
    bend = _bend_at_rest(pair, near, ended) if middle is None else _bend_in_motion(middle, near, ended)
    along, between, behind, length, slope, ahead, back, turn = bend
    beyond = np.maximum(np.sqrt(np.maximum(1.0 - slope**2, 0.0)) * length, diffraction.ON_LINE), along + slope * length
    rolled, leg = diffraction.path_over_edge(r_f, z_f, *beyond), np.hypot(r_f, along - z_f)
    whole = leg + length
    inside = np.where(pair.over_end[:, None] % edge_events.OF_LAST == 1, along - rolled.apex, rolled.apex)
    detour = diffraction.end_detour(rolled, (r_f, z_f), beyond, np.broadcast_to(along, rolled.apex.shape))
    own, scale = np.where(inside < 0.0, -1.0, 1.0), np.sqrt(wave)
    side: Any = np.where(np.isnan(pair.held), pair.end_side[:, None], own)
    root: Any = own * side * np.sqrt(detour)

    def share(term: Floats) -> Any:
        """Share (P, T, F) of a term that ends, by its root (P, T)."""
        at_edge = term[..., None] * scale
        return diffraction.end_transition(root[..., None] * scale, at_edge) / diffraction.transition(at_edge)

    slopes: list[Any] = [(r_f + beyond[0]) / rolled.length, near[0] / behind]
    breadths: list[Any] = [rolled.breadth, 2.0 * behind * (whole - behind) / whole * slopes[1] ** 2]
    legs = leg * behind / ((leg + between) * (between + behind))
    if ended:
        slopes, breadths = slopes[::-1], breadths[::-1]
    sides: Any = -1.0 * side[..., None]
    if pair.over_end[0] >= edge_events.TWO_ENDS:
        sides = sides * _off_end(pair, near, root, wave)
    if across_air:
        angles = (t_s, ahead), (back, t_r)
        given = zip((pair, pair.last), angles, slopes, breadths, (edge_pair.LEAVING, edge_pair.COMING), strict=True)
        found = [edge_pair.terms_of(*columns, at, own=i == ended) for i, columns in enumerate(given)]
        roots, _, _, factors = found[ended]
        for i, factor in enumerate(factors):
            factors[i] = share(roots[..., i]) * (1.0 if factor is None else factor)
        field = edge_pair.product_of_terms(pair, (found[0], found[1]), turn * np.sqrt(legs), wave)
        return field * sides / rolled.length[..., None]
    made = pair.face_terms((t_s, t_r), (breadths[0], breadths[1]), at, own=ended)
    roots, weights, _ = made[ended]
    for i in range(2):
        weights[i] = weights[i] * share(roots[..., i])
    return pair.over_face(made, np.sqrt(legs), wave, rolled.length) * sides


def _off_end(pair: EdgeEndVertex, near: Pair, root: Floats, wave: Floats) -> Any:
    """Share (P, T, F) of the field of paths over one end that paths over ends of both edges have.

    Our own derivation: the double integral along both edges is one over ``exp(-j (x² + y²))``. Beyond both ends it is
    half the sum of the integrals ``C`` along both borders, `root` from the shortest path, of `end_transition`.
    """
    (_, _, r_c, z_c), held, side = pair.ended_at(), pair.held, pair.end_side[:, None]
    route = diffraction.path_over_edge(r_c, z_c, *near)
    inside = np.where(held == 0.0, route.apex, held - route.apex)
    detour = diffraction.end_detour(route, (r_c, z_c), near, np.broadcast_to(held, route.apex.shape))
    end: Any = np.where(inside < 0.0, -1.0, 1.0) * side * np.sqrt(detour)
    at_end, at_both = (x[..., None] * np.sqrt(wave) for x in (end, root))
    return -1.0 * side[..., None] * diffraction.end_transition(at_end, at_both) / diffraction.transition(at_both)


def _corner_field(pair: EdgeEndVertex, ends: tuple[Triple, Triple], wave: Floats, at: SceneResponse) -> Any:
    """Compute the field (P, T, F) of paths over corners at which both edges of a face end.

    Our own derivation: where both edges meet, the double integral of `double_transition` with a tie of 1 is a
    convolution of two poles, ``E(a, b) = E(a + b)``. The corner takes away as much as an end of one edge of that root.
    So it is where sound grazes the face. Elsewhere, up to where the shortest path over both edges is far from the
    corner, the field is that of `meeting_field`, which has the path over both edges.
    """
    (r_s, t_s, z_s), (r_r, t_r, z_r) = ends
    edge_paths, beyond = pair.rolled_out((r_s, z_s), (r_r, z_r))
    along = np.where(pair.over_end % 2 == 1, pair.lines.length[pair.edge], 0.0)[:, None]
    inside = np.where(pair.over_end[:, None] % 2 == 1, along - edge_paths[0].apex, edge_paths[0].apex)
    detour = diffraction.end_detour(edge_paths[0], (r_s, z_s), beyond, np.broadcast_to(along, inside.shape))
    root: Any = np.where(inside < 0.0, -1.0, 1.0) * pair.end_side[:, None] * np.sqrt(detour)
    scale = np.sqrt(wave)

    def share(first: Floats, last: Floats, tie: Floats, wave: Floats) -> Any:
        return diffraction.end_transition(root[..., None] * scale, (first + last)[..., None] * scale)

    made = pair.face_terms((t_s, t_r), (edge_paths[0].breadth, edge_paths[1].breadth), at)
    field = -1.0 * pair.end_side[:, None, None] * pair.over_face(made, root, wave, edge_paths[0].length, share)
    far = (np.sqrt(r / path.breadth) for r, path in zip((r_s, r_r), edge_paths, strict=True))
    off = [np.abs(roots).min(axis=-1) * r for (roots, _, _), r in zip(made, far, strict=True)]
    outer = (pair.n >= 1.0) & (pair.last.n >= 1.0)
    mixed = _risen(np.minimum(*off)[..., None] * scale, *_GRAZING) * outer[:, None, None]
    mixed = mixed * _risen((-root * pair.end_side[:, None])[..., None] * scale, *_INSIDE)
    rows = np.flatnonzero(np.any(mixed > 0.0, axis=(1, 2)))
    if len(rows):
        part: Any = pair.part(rows)
        some: Any = tuple(tuple(x[rows] for x in end) for end in ends)
        field[rows] += mixed[rows] * (_by_corner(part, some, detour[rows], wave[rows], at) - field[rows])
    return field


def _risen(x: Floats, first: float, last: float) -> Floats:
    """Share by which x has come from a first to a last value, smoothly."""
    share = np.clip((x - first) / (last - first), 0.0, 1.0)
    return np.asarray(share**2 * (3.0 - 2.0 * share))


def _by_corner(
    pair: EdgeEndVertex, ends: tuple[Triple, Triple], detour: Floats, wave: Floats, at: SceneResponse
) -> Any:
    """Compute `meeting_field` (P, T, F) less the paths over both edges where these are, shorter by a detour (P, T)."""
    legs, cosine, factors = _corner_legs(pair, ends, at)
    field = meeting_field(legs, cosine, wave) / pair.doubled(factors)
    beside = np.flatnonzero(pair.end_side == 1)
    if len(beside):
        source, receiver = ((r[beside], t[beside], z[beside]) for r, t, z in ends)
        turned = np.exp(1j * wave[beside] * detour[beside, :, None])
        over, args = edge_pair.EdgePairVertex, (source, receiver, detour, wave[beside], at)
        field[beside] -= turned * over._field(pair.part(beside), *args)
    return field


def _corner_legs(
    pair: EdgeEndVertex, ends: tuple[Triple, Triple], at: SceneResponse
) -> tuple[tuple[CornerLeg, CornerLeg], Floats, list[Any]]:
    """Legs of paths over corners, cosines (P, 1) between their edges, and factors of the last edges' faces."""
    angles = ends[0][1], ends[1][1]
    made, numbers = pair.face_terms(angles, (np.ones(angles[0].shape),) * 2, at), edge_events.end_numbers(pair.over_end)
    face = pair.shared * np.pi * np.stack([pair.n, pair.last.n], axis=1)
    legs, inwards = [], []
    for i, (edge, (r, _, z)) in enumerate(zip((pair, pair.last), ends, strict=True)):
        came, went = (angles[0], face[:, :1]) if i == 0 else (face[:, 1:], angles[1])
        lit = diffraction.lit_angles(edge.n[:, None], came, went)
        weight, _ = diffraction.wedge_terms(edge.n[:, None], lit, edge.lit[:, None])
        by_face = weight[..., 2:] if i == 0 else weight[..., :1:-1]
        kept = np.where(edge.lit[:, None, :2] != 0, weight[..., :2], by_face)
        kept = np.where(kept == 0.0, 1.0, kept)  # where a term vanishes
        shares = [term / kept[..., k, None] for k, term in enumerate(made[i][1])]
        inward, end = np.where(numbers[i] == 1, -1.0, 1.0), numbers[i] * pair.lines.length[edge.edge]
        legs.append(CornerLeg(edge.n[:, None], r, inward[:, None] * (z - end[:, None]), went - came, shares))
        inwards.append(inward[:, None] * edge.frame[:, 3])
    return (legs[0], legs[1]), np.sum(inwards[0] * inwards[1], axis=1)[:, None], made[1][2]
