"""Paths over three edges at some times: where they run, whether they are there, and how loud they are."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import ON_LINE, TERMS, lit_angles, path_over_edge, wedge_terms
from clsim.arrays import Floats
from clsim.paths.legs.mirrors import dot
from clsim.paths.vertices.edge_events import MEETING, TWO_ENDS, at_meeting, end_numbers
from clsim.paths.vertices.edge_pair import EdgePairVertex
from clsim.paths.vertices.edge_third import ThirdEdgeVertex
from clsim.paths.visibility.clearance import Reach, path_status
from clsim.paths.visibility.edge_intervals import EdgeSearch
from clsim.paths.visibility.edges import CONTRACTED, CONTRACTIONS, imaged, in_face, lines_apart
from clsim.paths.visibility.intervals import PERTURBATIONS

Rows = NDArray[np.int64]
Bools = NDArray[np.bool_]
Angles = tuple[tuple[Floats, Floats], tuple[Floats, Floats]]

ABSENT = -1
SHORT_EDGE = 0.12  # m; shorter edges may be passed from one of the instants at which paths are looked for to the next
LAST = TERMS + 1  # first bit of codes for the terms of the last edge; those of the first one are before, and the end's
_HALVES = 1 << (LAST + TERMS), 2 << (LAST + TERMS)


@dataclass(frozen=True, slots=True, eq=False)
class Thirds:
    """Candidates over three edges, n of them."""

    vertex: ThirdEdgeVertex
    before: NDArray[np.int32]  # (n, N) walls before the first edge from the source's side
    after: NDArray[np.int32]  # (n, M) walls behind the last one from the receiver's side
    receiver: Rows

    def part(self, rows: Any) -> Thirds:
        """Return some of them."""
        return Thirds(self.vertex.part(rows), self.before[rows], self.after[rows], self.receiver[rows])


@dataclass(frozen=True, slots=True, eq=False)
class ThirdStance:
    """Where P candidates run at T times."""

    ends: tuple[Floats, Floats]  # emission and receiver (P, T, 3), m
    seen: tuple[Any, Any]  # r, θ, z about the outer edges, (P, T)
    places: tuple[Floats, Floats, Floats]  # on the pair's edges and the third ones, (P, T) m
    points: tuple[Floats, Floats, Floats]  # there, from the source's side, (P, T, 3) m
    length: Floats  # (P, T) m


def stance_of(finder: EdgeSearch, some: Thirds, times: Floats) -> ThirdStance:
    """Find it at times (P, T), s."""
    query, edges, v = finder.query, finder.edges, some.vertex
    tables, shape, leads = query.trajectory_tables, times.shape, v.leads[:, None, None]
    each = np.repeat(np.arange(shape[0]), shape[1])
    row, source, flat = some.receiver[each] + 1, np.zeros(times.size, dtype=np.int64), times.ravel()
    first, last = v.outer

    def about(edge: Rows, sequence: NDArray[np.int32], place: Floats) -> Any:
        seen = edges.cylindrical(edge[each], imaged(query.walls, sequence[each], place))
        return tuple(x.reshape(shape) for x in seen)

    at = tables.lifted(row, tables.position(row, flat) + PERTURBATIONS[1])
    received, delay = about(last, some.after, at), np.zeros(times.size)
    for _ in range(CONTRACTIONS):
        emitted_at = tables.lifted(source, tables.position(source, flat - delay) + PERTURBATIONS[0])
        sent = about(first, some.before, emitted_at)
        places, length, _ = v.places_on(sent[::2], received[::2])
        later = query.medium.passage(length.ravel(), at - emitted_at).time - delay
        delay += later
        if tables.scales[0, 2] == 0.0 or not np.any(np.abs(later) > CONTRACTED):
            break
    frames = (v.lines.frames[edge, None] for edge in (v.pair.edge, v.pair.last.edge, v.third.edge))
    one, other, third = (f[:, :, 0] + p[..., None] * f[:, :, 3] for f, p in zip(frames, places, strict=True))
    points = np.where(leads, third, one), np.where(leads, one, other), np.where(leads, other, third)
    ends = emitted_at.reshape(*shape, 3), at.reshape(*shape, 3)
    return ThirdStance(ends, (sent, received), places, points, length)


def _angles(v: ThirdEdgeVertex, seen: tuple[Any, Any]) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Angles (P, T) about the first and the last edges."""
    n, leads = v.lines.n, v.leads
    first, last = v.outer
    ahead = np.where(leads, v.face[:, 1], v.pair.shared[:, 0]) * np.pi * n[first]
    back = np.where(leads, v.pair.shared[:, 1], v.face[:, 1]) * np.pi * n[last]
    return (seen[0][1], ahead[:, None]), (back[:, None], seen[1][1])


def third_levels(finder: EdgeSearch, some: Thirds, times: Floats, wave: float, direct: bool) -> Floats:
    """Estimate pressures (P, T) over that in free air, see `end_levels`; 0 where an end is not in the air of its edge.

    Magnitudes of all terms add up, and those of transitions are ``1 / sqrt(1 + π x²)``: within some decibels.
    """
    v, stance = some.vertex, stance_of(finder, some, times)
    (sent, received), n, whole = stance.seen, v.lines.n, stance.length
    near = v.coupling(sent[::2], received[::2])[0] * np.sqrt(wave)
    points, outer = stance.points, (stance.points[0], stance.points[2])
    between = [np.linalg.norm(q - p, axis=2) for p, q in pairwise(points)]
    level = 0.5 / _fall(near)
    for edge, angles, (r, _, z), place, part in zip(
        v.outer, _angles(v, stance.seen), stance.seen, outer, between, strict=True
    ):
        frame, wedge = v.lines.frames[edge, None], n[edge, None]
        leg = np.maximum(np.hypot(r, z - dot(place - frame[:, :, 0], frame[:, :, 3])), ON_LINE)
        weight, root = wedge_terms(wedge, lit_angles(wedge, *angles))
        behind = np.maximum(whole - leg - part, ON_LINE)
        root = root * (np.sqrt(2.0 * wave * leg * np.maximum(whole - leg, 0.0) / whole) * r / leg)[..., None]
        left = np.maximum(1.0 - leg * behind / ((leg + part) * (part + behind)), 0.0)
        least = np.minimum(root, near[..., None]) * np.sqrt(left)[..., None]
        level = level * (0.5 * np.abs(weight) * _fall(np.maximum(root, near[..., None])) * _fall(least)).sum(axis=2)
        own = angles[0] if angles[0].shape == times.shape else angles[1]
        level = np.where((own < 0.0) | (own > np.pi * wedge), 0.0, level)
    ended = np.flatnonzero(v.pair.over_end >= 0)
    if len(ended):
        pair = v.part(ended)
        ends = pair.rolled_out(*(tuple(x[ended] for x in end[::2]) for end in stance.seen))
        shortest, both = EdgePairVertex.met(pair.pair, *ends)[1], pair.pair.over_end[:, None] >= TWO_ENDS
        detour = np.maximum(whole[ended] - shortest, 0.0)
        level[ended] *= np.where(both, 0.25, 0.5) * _fall(np.sqrt(wave * detour))
    apart = np.linalg.norm(stance.ends[0] - stance.ends[1], axis=2) if direct else whole
    return np.asarray(level * apart / whole)


def _fall(root: Floats) -> Floats:
    return np.asarray(1.0 / np.sqrt(1.0 + np.pi * root**2))


def third_codes(finder: EdgeSearch, wanted: Thirds, free: Any, rows: Rows, times: Floats) -> NDArray[np.int32]:
    """Codes (P, T) of paths: `ABSENT`, or bits for the sides of terms, of the end, and of both endpoints."""
    some = wanted.part(rows)
    stance = stance_of(finder, some, times)
    p, t = np.nonzero(_on(finder, some, stance))
    there = _unhindered(finder, some, stance, free, p, t)
    code = ABSENT - _beside(some.vertex, stance)
    code[p[there], t[there]] = _code(some.vertex, stance)[p[there], t[there]]
    return code


def _beside(v: ThirdEdgeVertex, stance: ThirdStance) -> NDArray[np.int32]:
    """Numbers (P, T) of the sides on which paths pass short edges: where these differ, a path may be there between."""
    number, ended = np.zeros(stance.length.shape, dtype=np.int32), (*ends_of_pair(v.pair.over_end), np.full(len(v), -1))
    edges = v.pair.edge, v.pair.last.edge, v.third.edge
    for i, (edge, place, end) in enumerate(zip(edges, stance.places, ended, strict=True)):
        length = v.lines.length[edge, None]
        side = np.where(place <= 0.0, 1, np.where(place >= length, 2, 0))
        number += np.where((end[:, None] < 0) & (length < SHORT_EDGE), side, 0).astype(np.int32) * 3**i
    return number


def _on(finder: EdgeSearch, some: Thirds, stance: ThirdStance) -> Bools:
    """Mask (P, T) of candidates that meet their edges in order, from the air."""
    v, edges, lines, on = some.vertex, finder.edges, some.vertex.lines, np.ones(stance.length.shape, dtype=bool)
    meeting, leads, never = at_meeting(v.pair.over_end), v.leads[:, None], np.zeros(len(v), dtype=bool)
    for edge, (_, angle, _) in zip(v.outer, stance.seen, strict=True):
        on &= (angle > 0.0) & (angle < np.pi * lines.n[edge, None])
    ended = (*ends_of_pair(v.pair.over_end), np.full(len(v), -1))
    for edge, place, end in zip((v.pair.edge, v.pair.last.edge, v.third.edge), stance.places, ended, strict=True):
        on &= (end >= 0)[:, None] | (place > 0.0) & (place < lines.length[edge, None])
    first, last, near = (*v.outer, v.near)
    shared, outer, (p, q, r) = v.pair.shared, v.face, stance.points
    faces = np.where(leads, outer[:, ::-1], shared), np.where(leads, shared, outer)
    for (a, b), away, face, always in (
        ((first, near), q - p, faces[0], np.where(v.leads, never, meeting)),
        ((near, last), r - q, faces[1], np.where(v.leads, meeting, never)),
    ):
        for edge, own, sign in ((a, face[:, 0], 1.0), (b, face[:, 1], -1.0)):
            on &= always[:, None] | (sign * dot(away, edges.inward(edge, own)[:, None]) > 0.0)
    seen = [end[::2] for end in stance.seen]
    on &= v.beyond()[0](*(np.where(leads, *x) for x in zip(*seen, strict=True)))[0] > 0.0
    straight = (v.pair.over_end < 0) | meeting
    for beyond, end in zip(v.pair.beyond(), v.rolled_out(*seen)[::-1], strict=True):
        on &= ~straight[:, None] | (beyond(*end)[0] > 0.0)
    return on


def _unhindered(finder: EdgeSearch, some: Thirds, stance: ThirdStance, free: Any, p: Rows, t: Rows) -> Bools:
    """Mask (n,) of candidates p at times t in the way of which nothing is."""
    v, walls, edges = some.vertex, finder.query.walls, finder.edges
    still, none = np.zeros(len(p)), np.zeros((len(p), 3))
    ok, points = np.ones(len(p), dtype=bool), [x[p, t] for x in stance.points]
    for sequence, end, place in ((some.before, 0, points[0]), (some.after, 1, points[2])):
        left = np.flatnonzero(ok)
        reach = Reach(still[left], still[left], none[left], none[left])
        ok[left] = path_status(walls, sequence[p[left]], stance.ends[end][p, t][left], place[left], reach, True)[0]
    pairs = np.column_stack([v.outer[0], v.near]), np.column_stack([v.near, v.outer[1]])
    leads = v.leads
    faces = np.where(leads, v.face[:, 1], v.pair.shared[:, 0]), np.where(leads, v.pair.shared[:, 0], v.face[:, 0])
    for pair, face, one, other in zip(pairs, faces, points[:2], points[1:], strict=True):
        for a, b, own in np.unique(np.column_stack([pair, face]), axis=0).tolist():
            lines = free(a, b, own)
            here = ok & ((pair == (a, b)).all(axis=1) & (face == own))[p]
            for i in np.flatnonzero(here).tolist() if len(lines) else ():
                leg = np.stack([in_face(edges, a, own, x[i]) for x in (one, other)])
                ok[i] = np.array_equal(one[i], other[i]) or not lines_apart(leg, lines)[0].any()
    return ok


def _code(v: ThirdEdgeVertex, stance: ThirdStance) -> NDArray[np.int32]:
    """Codes (P, T) of candidates that are there."""
    n, code = v.lines.n, _inside(v, stance).astype(np.int32) << TERMS
    own, single = ends_of_pair(v.pair.over_end), ~at_meeting(v.pair.over_end)
    ended = (own[0] >= 0) & ~v.leads & single, (own[1] >= 0) & v.leads & single
    for first, edge, angles, end in zip((0, LAST), v.outer, _angles(v, stance.seen), ended, strict=True):
        lit = (lit_angles(n[edge, None], *angles) >= 0.0) | end[:, None, None]
        code += (lit @ (1 << (first + np.arange(TERMS)))).astype(np.int32)
    for bit, edge, (_, angle, _) in zip(_HALVES, v.outer, stance.seen, strict=True):
        code += (bit * (angle > 0.5 * np.pi * n[edge, None])).astype(np.int32)
    return code


def _inside(v: ThirdEdgeVertex, stance: ThirdStance) -> Bools:
    """Mask (P, T) of paths over ends whose shortest paths over the same edges, or over one end, meet what ends."""
    inside, rows = np.zeros(stance.length.shape, dtype=bool), np.flatnonzero(v.pair.over_end >= 0)
    if not len(rows):
        return inside
    pair, number = v.pair.part(rows), v.pair.over_end[rows]
    meeting = at_meeting(number)
    last = (number % MEETING >= 2) & ~meeting
    last = np.where(number >= TWO_ENDS, ~last, last)[:, None]  # of both edges, that whose end is looked at
    ends = v.part(rows).rolled_out(*(tuple(x[rows] for x in seen[::2]) for seen in stance.seen))
    edge = np.where(last[:, 0], pair.last.edge, pair.edge)
    end, place = (
        np.where(last[:, 0], *ends_of_pair(number)[::-1]),
        np.where(last, stance.places[1][rows], stance.places[0][rows]),
    )
    r, z = (np.where(last, b, a) for a, b in zip(*ends, strict=True))
    one, other = (x[rows] for x in stance.points[:2])
    leads = v.leads[rows, None, None]
    one, other = np.where(leads, other, one), np.where(leads, stance.points[2][rows], other)
    away = np.where(last[..., None], other - one, one - other)
    apart = np.maximum(np.linalg.norm(away, axis=2), ON_LINE)
    slope = (place - z) / np.hypot(r, place - z) + dot(away, v.lines.frames[edge, None, 3]) / apart
    beyond = pair.beyond()[0](*ends[1])
    apex = path_over_edge(*ends[0], np.maximum(beyond[0], ON_LINE), beyond[1]).apex
    at_corner = np.where(number[:, None] % 2 == 1, v.lines.length[pair.edge, None] - apex, apex)
    inside[rows] = np.where(meeting[:, None], at_corner, np.where(end[:, None] == 1, slope, -slope)) >= 0.0
    return inside


def ends_of_pair(number: Any) -> tuple[Any, Any]:
    """Numbers (n,) of the ends of the pair's edges, -1 of those that do not end."""
    first, last = end_numbers(number)
    return np.where(number < 0, -1, first), np.where(number < 0, -1, last)
