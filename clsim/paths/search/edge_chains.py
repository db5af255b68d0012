"""Chains over edges: from candidates found one by one, with one time for each event at which paths take over."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import EVEN, TERMS
from clsim.arrays import Floats, read_only
from clsim.paths.chain import Chain
from clsim.paths.family import DIFFRACTION, NONE, SPECULAR, ends_at
from clsim.paths.legs.mirrors import EdgeLines
from clsim.paths.legs.static import StaticLeg
from clsim.paths.search.mesh import image_isometries
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.edge_end import EdgeEndVertex, ends_of
from clsim.paths.vertices.edge_field import BOTH
from clsim.paths.vertices.edge_pair import EdgePairVertex
from clsim.paths.vertices.gap_pair import GapPairVertex
from clsim.paths.visibility.edge_gaps import seen_frames
from clsim.paths.visibility.edges import ENDS_BESIDE, SIDES
from clsim.scene.scene import Scene

Found = list[dict[str, Any]]
Rows = NDArray[np.int64]
Sides = NDArray[np.int8]


SAME_DELAY = 3e-8  # s, between paths of which one goes over into the other
_ROUNDS = 4  # of finding the time of emission


def edge_chain(scene: Scene, model: str, order: int, rows: Found) -> Chain:
    """Make paths over one edge with the field of a model."""
    lines = EdgeLines.of(scene.room)
    return _chain(scene, order, rows, EdgeVertex(**_first_edges(rows), lines=lines, model=model))


def edge_pair_chain(scene: Scene, order: int, rows: Found) -> Chain:
    """Make paths over two edges that share a face."""
    return _chain(scene, order, rows, EdgePairVertex(**_both_edges(scene, rows)))


def gap_chain(scene: Scene, order: int, rows: Found) -> Chain:
    """Make paths over two edges with air between."""
    return _chain(scene, order, rows, GapPairVertex(**_gaps(scene, order, rows)))


def end_chain(scene: Scene, order: int, rows: Found) -> Chain:
    """Make paths over an edge and an end of another one."""
    return _chain(scene, order, rows, EdgeEndVertex(**_gaps(scene, order, rows)))


def _gaps(scene: Scene, order: int, rows: Found) -> dict[str, Any]:
    """Columns of `GapPairVertex`."""
    columns, walls = _both_edges(scene, rows), scene.room.as_mesh().walls
    between = np.full((len(rows), order), -1, dtype=np.int32)
    for row, r in zip(between, rows, strict=True):
        row[: len(r["between"])] = r["between"]
    met = np.array([len(r["before"]) + len(r["after"]) + len(r["between"]) for r in rows], dtype=np.int64)
    seen = seen_frames(walls, scene.room.edges(), columns["last"].edge, between)
    held = (("seen", seen), ("between", between), ("budget", order - met))
    return columns | {name: read_only(x) for name, x in held}


def _both_edges(scene: Scene, rows: Found) -> dict[str, Any]:
    """Columns of `EdgePairVertex`."""
    lines, columns = EdgeLines.of(scene.room), _first_edges(rows)
    second = {
        "edge": np.array([r["edges"][1] for r in rows], dtype=np.int64),
        "lit": np.array([r["sides"][TERMS + 1 : 2 * TERMS + 1] for r in rows], dtype=np.int8).reshape(-1, TERMS),
    }
    last = EdgeVertex(**(columns | second), lines=lines, model="utd")
    shared = read_only(np.array([r["faces"] for r in rows], dtype=np.int64).reshape(-1, 2))
    return columns | {"lines": lines, "model": "utd", "last": last, "shared": shared}


def _first_edges(rows: Found) -> dict[str, Any]:
    """Columns of `EdgeVertex` of the first edges."""
    sides = np.array([r["sides"] for r in rows], dtype=np.int8).reshape(-1, SIDES)
    edge = np.array([r["edges"][0] for r in rows], dtype=np.int64)
    end = np.array([r["end_of"] for r in rows], dtype=np.int8)
    even = np.full(len(rows), EVEN)
    values: tuple[Any, ...] = (edge, end, sides[:, :TERMS], sides[:, TERMS], sides[:, ENDS_BESIDE], even)
    return {name: read_only(column) for name, column in zip(COLUMNS, values, strict=True)}


def _chain(scene: Scene, order: int, rows: Found, vertex: EdgeVertex) -> Chain:
    count, edges = len(rows), len(vertex.lines)
    objects = np.full((count, order + 2), -1, dtype=np.int32)
    kinds = np.full((count, order + 2), NONE, dtype=np.int8)
    for i, r in enumerate(rows):
        n, m = len(r["before"]), len(r["after"])
        first, last = r["edges"]
        things = [first, *r["between"], last] if r["faces"][0] >= 0 else [first]
        if r["end_of"] >= 0:
            for place, end in ends_of(r["end_of"]):
                things[-place] = edges + 2 * r["edges"][place] + end
        objects[i, : n + m + len(things)] = [*r["before"], *things, *r["after"][::-1]]
        met = [DIFFRACTION, *[SPECULAR] * len(r["between"]), DIFFRACTION][: len(things)]
        kinds[i, : n + m + len(things)] = [SPECULAR] * n + met + [SPECULAR] * m
    longest = order + max((1 + (r["faces"][0] >= 0) for r in rows), default=1)
    objects, kinds = read_only(objects[:, :longest]), read_only(kinds[:, :longest])
    legs = _leg(scene, order, [r["before"] for r in rows]), _leg(scene, order, [r["after"] for r in rows])
    columns: dict[str, Any] = {
        "source": np.array([r["source"] for r in rows], dtype=np.int32),
        "receiver": np.array([r["receiver"] for r in rows], dtype=np.int32),
        "order": np.sum(objects >= 0, axis=1).astype(np.int32),
        "start": np.array([r["start"] for r in rows], dtype=np.float64),
        "end": np.array([r["end"] for r in rows], dtype=np.float64),
    }
    held = {name: read_only(column) for name, column in columns.items()}
    return Chain(scene=scene, **held, interactions=kinds, objects=objects, legs=legs, vertex=vertex)


def _leg(scene: Scene, width: int, sequences: list[NDArray[np.int32]]) -> StaticLeg:
    """Make legs by sequences of walls."""
    found = np.full((len(sequences), width), -1, dtype=np.int32)
    for row, sequence in zip(found, sequences, strict=True):
        row[: len(sequence)] = sequence
    if not sequences:
        return StaticLeg(np.empty((0, 3, 3)), np.empty((0, 3)))
    return StaticLeg(*(read_only(x) for x in image_isometries(scene.room.as_mesh().walls, found)))


def joined_over_ends(
    path: Rows, begin: Floats, end: Floats, lit: Sides, side: Sides, beside: Sides
) -> tuple[Rows, Floats, Floats, Sides]:
    """Join the pieces of paths over ends of edges between two changes of side of the end.

    Shapes: path (n,); begin, end (n,) s; lit (n, 4); side (n,); beside (n, 2); result (m,), (m,) s, (m, 4).

    path: which path each piece belongs to; pieces are in the order of paths and times.

    lit: sides of the terms as the end changes sides: beyond that the field depends on them, elsewhere not. Times `BOTH`
    where the term passes its own boundary at the same time: the line of sight passes the corner itself, and the paths
    over both edges there cancel in what each would add by going round its boundary on one side.
    """
    follows = np.append(False, (path[1:] == path[:-1]) & (begin[1:] == end[:-1]))[: len(path)]
    turns = follows & np.append(False, side[1:] != side[:-1])[: len(path)]
    cut = ~follows | turns | np.append(False, np.any(beside[1:] != beside[:-1], axis=1))[: len(path)]
    first = np.flatnonzero(cut)
    last = np.append(first[1:], len(path))[: len(first)] - 1
    times = np.ones(lit.shape, dtype=np.int8)
    times[1:][lit[1:] != lit[:-1]] = BOTH
    found: list[tuple[int, float, float, Sides]] = []
    for one, other in zip(first.tolist(), last.tolist(), strict=True):
        at_start = times[one] * lit[one] if turns[one] else None
        at_end = times[other + 1] * lit[other] if other + 1 < len(path) and turns[other + 1] else None
        at_start, at_end = (lit[one] if at_end is None else at_end) if at_start is None else at_start, at_end
        if at_end is None or np.array_equal(at_start, at_end):
            found.append((one, begin[one], end[other], at_start))
        else:
            middle = 0.5 * (begin[one] + end[other])
            found += [(one, begin[one], middle, at_start), (one, middle, end[other], at_end)]
    kept, starts, ends, sides = ([row[i] for row in found] for i in range(4))
    return (
        np.array(kept, np.int64),
        np.array(starts),
        np.array(ends),
        np.array(sides, np.int8).reshape(-1, lit.shape[1]),
    )


def with_swaps(family: Chain, within: float) -> Chain:
    """Return the paths with one time for the end of one and the beginning of another where they are the same event.

    This is where two walls are met in another order, or where the apex goes on from an edge to the next one or to its
    corner: both paths are as long as each other then. Pieces of one path meet already; where a path over an end of an
    edge changes sides, the path over the edge itself begins or ends.
    """
    start, end = _with_ends(family, within)
    pair = family.source.astype(np.int64) * len(family.scene.receivers) + family.receiver
    ends = np.flatnonzero(np.isfinite(end) & ~_among(pair, end, pair, start))
    starts = np.flatnonzero(np.isfinite(start) & ~_among(pair, start, pair, end))
    mine, theirs = _same_events(family, (starts, start[starts]), (ends, end[ends]), within)
    longer = end[theirs] < end[mine]  # nothing ends as it begins
    start[mine[longer][::-1]] = end[theirs[longer][::-1]]
    family = replace(family, start=read_only(start), end=read_only(end))
    kept = np.flatnonzero(start < end)
    return family if len(kept) == len(start) else family.part(kept)


def _with_ends(family: Chain, within: float) -> tuple[Floats, Floats]:
    """Compute starts and ends, s, where paths over edges have the times at which those over their ends change sides."""
    start, end, count = np.array(family.start), np.array(family.end), len(family.vertex.lines)
    edges = (family.interactions == DIFFRACTION) & (family.objects >= count)
    over = np.where(edges, (family.objects - count) // 2, family.objects)
    keys = [tuple(row) for row in np.column_stack([family.source, family.receiver, over]).tolist()]
    follows = np.append(False, np.all(family.objects[1:] == family.objects[:-1], axis=1) & (start[1:] == end[:-1]))
    turns = follows & np.append(False, family.vertex.end_side[1:] != family.vertex.end_side[:-1])
    passing: dict[tuple[int, ...], list[float]] = {}
    for row in np.flatnonzero(turns[: len(start)]).tolist():
        passing.setdefault(keys[row], []).append(float(start[row]))
    first = np.flatnonzero(~follows[: len(start)])
    for one, after in zip(first.tolist(), [*first[1:].tolist(), len(start)], strict=True) if passing else ():
        rows = slice(one, after)
        for time in passing.get(keys[one], []) if family.vertex.end_side[one] == 0 else ():
            if abs(start[one] - time) <= within:
                start[one] = time
                start[rows] = np.maximum(start[rows], time)
            elif abs(end[after - 1] - time) <= within:
                end[after - 1] = time
                end[rows] = np.minimum(end[rows], time)
    return start, end


def _same_events(
    family: Chain, one: tuple[Rows, Floats], other: tuple[Rows, Floats], within: float
) -> tuple[Rows, Rows]:
    """Find the rows of `one` and of `other` (n,) at whose times, s, both paths between two ends are as long.

    Each is given as rows and their times; times are at most `within` apart.
    """
    pair = family.source.astype(np.int64) * len(family.scene.receivers) + family.receiver
    found = [np.empty((2, 0), dtype=np.int64)]
    for each in np.intersect1d(pair[one[0]], pair[other[0]]):
        (rows, times), (others, their_times) = ((r[pair[r] == each], t[pair[r] == each]) for r, t in (one, other))
        order = np.argsort(their_times, kind="stable")
        others, their_times = others[order], their_times[order]
        first = np.searchsorted(their_times, times - within)
        count = np.searchsorted(their_times, times + within, side="right") - first
        mine = np.repeat(np.arange(len(rows)), count)
        theirs = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
        when = 0.5 * (times[mine] + their_times[theirs])
        mine, theirs = rows[mine], others[theirs]
        same = np.abs(delays_of(family, mine, when) - delays_of(family, theirs, when)) < SAME_DELAY
        found.append(np.stack([mine[same], theirs[same]]))
    both = np.concatenate(found, axis=1)
    return both[0], both[1]


def _among(pair: Rows, times: Floats, other_pair: Rows, others: Floats) -> NDArray[np.bool_]:
    """Mask of times of pairs that are, to the last bit, among others of the same pair."""
    known = set(zip(other_pair.tolist(), others.tolist(), strict=True))
    return np.array([moment in known for moment in zip(pair.tolist(), times.tolist(), strict=True)], dtype=bool)


def delays_of(family: Chain, rows: Rows, times: Floats) -> Floats:
    """Return the delays (n,) of rows at times (n,), s, as near as tells whether two are the same."""
    scene, source = family.scene, family.source[rows]
    receiver = ends_at(scene.receivers, family.receiver[rows], times)
    delay = np.zeros(len(rows))
    for _ in range(_ROUNDS):
        delay = family.lengths(rows, ends_at(scene.sources, source, times - delay), receiver) / scene.air.speed_of_sound
    return delay
