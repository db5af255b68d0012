"""Paths over three edges: where one over two of them would break off in the plane of a face that ends at the third."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import EVEN, TERMS, adjacent_reflections, lit_angles
from clsim.arrays import Floats, read_only
from clsim.paths.chain import Chain
from clsim.paths.legs.mirrors import EdgeLines
from clsim.paths.search.edge_ends import over_faces
from clsim.paths.search.edge_levels import least_level, lowest_wave
from clsim.paths.search.edges import FARTHEST, SAME_EVENT, AdjacentPaths, EdgePaths, EdgeReach, Others
from clsim.paths.search.mesh import Progress
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.edge_end import EdgeEndVertex
from clsim.paths.vertices.edge_third import ThirdEdgeVertex
from clsim.paths.visibility.edge_intervals import EdgeSearch
from clsim.paths.visibility.edge_thirds import LAST, Thirds, ends_of_pair, third_codes, third_levels
from clsim.paths.visibility.edges import footprint
from clsim.paths.visibility.subdivision import coded

Rows = NDArray[np.int64]

_STEP = 0.03  # m that both ends go from one instant at which paths are looked for to the next
_ESTIMATED = 9  # instants at which levels are estimated
_BATCH = 20_000  # candidates whose levels are estimated together


def third_edge_paths(search: EdgePaths, others: Others, progress: Progress | None = None) -> Chain:
    """Find every path over three edges of the room of which each shares a face with the next."""
    lines, direct = EdgeLines.of(search.scene.room), search.search.direct is not False
    find: Any = partial(third_candidates, lines=lines, wave=lowest_wave(search.scene), direct=direct)
    rows = search.rows(find, others, progress, 2, third_rows)
    pair = EdgeEndVertex(**search.gap_columns(rows))
    columns: dict[str, Any] = {name: getattr(pair, name) for name in (*COLUMNS, "lines", "model")}
    second: dict[str, Any] = {
        "edge": np.array([r["third"] for r in rows], dtype=np.int64),
        "over_end": np.full(len(rows), -1, dtype=np.int8),
        "lit": np.array([r["third_lit"] for r in rows], dtype=np.int8).reshape(-1, TERMS),
    }
    face = np.array([r["third_face"] for r in rows], dtype=np.int64).reshape(-1, 2)
    leads = np.array([r["leads"] for r in rows], dtype=bool)
    third = EdgeVertex(**(columns | {name: read_only(x) for name, x in second.items()}))
    return search.chain(rows, ThirdEdgeVertex(**columns, pair=pair, third=third, face=face, leads=leads))


def third_candidates(reach: EdgeReach, lines: EdgeLines, wave: float, direct: bool) -> Iterator[tuple[float, Thirds]]:
    """Yield candidates that are not quiet at all times, and the share of the work, see `end_candidates`."""
    finder, order, sides = reach.finder, reach.order, (reach.from_source, reach.to_receivers)
    routes, least = _routes(finder, lines), adjacent_reflections(finder.edges.n).min(axis=1)
    first, last = routes.outer
    fewest = least[first] + least[routes.near] + least[last]
    numbers = [(n, m) for n in range(order + 1) for m in range(order + 1 - n)]
    for done, (n, m) in enumerate(numbers):
        kept, before = np.flatnonzero(n + m + fewest <= order), [of_edge[n] for of_edge in sides[0]]
        for receiver, side in enumerate(sides[1] if len(kept) else []):
            after, counts = [of_edge[m] for of_edge in side], np.empty((2, len(kept)), dtype=np.int64)
            for count, edge, met in zip(counts, (first[kept], last[kept]), (before, after), strict=True):
                count[:] = np.array([len(x) for x in met])[edge]
            many = counts.prod(axis=0)
            rows, number = np.repeat(np.arange(len(kept)), many), np.arange(many.sum())
            number -= np.repeat(np.cumsum(many) - many, many)
            i, j = np.divmod(number, np.maximum(counts[1][rows], 1))
            for some in np.array_split(np.arange(len(rows)), -(-len(rows) // _BATCH)) if len(rows) else ():
                k = kept[rows[some]]
                near, far = _taken(before, first[k], i[some]), _taken(after, last[k], j[some])
                found = Thirds(routes.part(k), near, far, np.full(len(k), receiver))
                loud = _loud(finder, found, wave, direct)
                yield (done + 1) / len(numbers), found.part(loud)


def _taken(sequences: list[NDArray[np.int32]], edge: Rows, number: Rows) -> NDArray[np.int32]:
    """Sequences (n, N) of numbers among those of their edges."""
    first = np.cumsum([0, *(len(x) for x in sequences[:-1])])
    return np.asarray(np.concatenate(sequences)[first[edge] + number])


def _routes(finder: EdgeSearch, lines: EdgeLines) -> ThirdEdgeVertex:
    """Make all candidates without their sides: pairs, and such of which edges end, with third edges."""
    edges, (pair, face) = finder.edges, finder.edges.pairs()
    ends, solid = over_faces(finder.query.walls, edges, 0), np.all(edges.n[pair] > 1.0, axis=1)
    outer, outer_face, alone = pair[solid], face[solid], np.full(len(pair), -1)
    pair, face, end = (np.concatenate(x) for x in ((pair, ends.edge), (face, ends.face), (alone, ends.end)))
    parts = []
    for leads, some in ((False, end >= -1), (True, ends_of_pair(end)[1] >= 0)):  # else the same with another pair
        i, third = np.nonzero((pair[:, 0 if leads else 1, None] == outer[:, 0]) & some[:, None])
        parts.append((i, third, np.full(len(i), leads)))
    row, third, first = (np.concatenate(x) for x in zip(*parts, strict=True))
    return _vertices(edges.frames, lines, (pair[row], face[row], end[row]), (outer[third, 1], outer_face[third]), first)


def _vertices(frames: Floats, lines: EdgeLines, pair: Any, third: tuple[Rows, Rows], leads: Any) -> ThirdEdgeVertex:
    """Make vertices of pairs, given as edges, faces (n, 2) and ends, and of third edges with faces (n, 2)."""
    (edge, face, end), count = pair, len(leads)
    ones, none = np.ones((count, TERMS), dtype=np.int8), np.empty((count, 0), dtype=np.int32)
    still = np.zeros(count, np.int8), np.zeros((count, 2), np.int8), np.full(count, EVEN)
    one, other, outer = (EdgeVertex(x, end.astype(np.int8), ones, *still, lines, "utd") for x in (*edge.T, third[0]))
    columns: Any = (*(getattr(one, name) for name in COLUMNS), lines, "utd")
    made: Any = (*columns, other, face, frames[edge[:, 1]], none, np.zeros(count, np.int64))
    every: Any = (*columns, EdgeEndVertex(*made), outer, third[1], leads)
    return ThirdEdgeVertex(*every)


def _loud(finder: EdgeSearch, found: Thirds, wave: float, direct: bool) -> Rows:
    """Candidates that may be louder than the least level at some times."""
    begin, end = finder.query.first[found.receiver, None], finder.query.last[found.receiver, None]
    levels = third_levels(finder, found, begin + np.linspace(0.0, 1.0, _ESTIMATED) * (end - begin), wave, direct)
    return np.flatnonzero(levels.max(axis=1, initial=0.0) > least_level(direct))


def third_rows(reach: EdgeReach, wanted: Thirds, adjacent: AdjacentPaths, notify: Any) -> Iterator[dict[str, Any]]:
    """Yield paths that candidates give, with the times of their partners."""
    finder, query, tables = reach.finder, reach.finder.query, reach.finder.query.trajectory_tables
    free, every = cache(partial(footprint, finder.edges, query.walls)), []
    for receiver in np.unique(wanted.receiver).tolist():
        first, last = float(query.first[receiver]), float(query.last[receiver])
        steps = math.ceil((last - first) * (tables.scales[0, 2] + tables.scales[1 + receiver, 2]) / _STEP)
        if first < last:
            every.append((np.flatnonzero(wanted.receiver == receiver), np.linspace(first, last, max(2, steps + 1))))
    if not every:
        return
    row, begin, end, code = coded(partial(third_codes, finder, wanted, free), every, query.resolution)
    notify()
    begin, end = _with_adjacent(finder, wanted, (row, begin, end, code), adjacent)
    last_of = query.last[wanted.receiver[row]]
    begin, end = np.where(begin <= 0.0, -np.inf, begin), np.where(end >= last_of, np.inf, end)
    met = np.sum(wanted.before >= 0, axis=1) + np.sum(wanted.after >= 0, axis=1)
    for i, k in enumerate(row.tolist()):
        if begin[i] < end[i]:
            yield _row(wanted, k, int(code[i]), reach.order - int(met[k])) | {"start": begin[i], "end": end[i]}


def _with_adjacent(finder: EdgeSearch, wanted: Thirds, pieces: Any, adjacent: AdjacentPaths) -> tuple[Floats, Floats]:
    """Beginnings and ends (n,) of pieces, s, taken from paths over two edges that take over there."""
    (row, begin, end, code), names = pieces, -1 - wanted.vertex.objects
    begin, end, within = begin.copy(), end.copy(), max(SAME_EVENT, FARTHEST * finder.query.resolution)
    for i in range(1, len(row)):
        k, changed = row[i], int(code[i]) ^ int(code[i - 1])
        if k != row[i - 1] or begin[i] != end[i - 1]:
            continue
        time = float(begin[i])
        for first, kept in ((0, names[k, 1:]), (LAST, names[k, :-1])):
            if changed >> first & (1 << TERMS) - 1 and time == begin[i]:
                through = *wanted.before[k].tolist(), *kept.tolist(), *wanted.after[k][::-1].tolist()
                time = adjacent.nearest(int(wanted.receiver[k]), through, time, within)
        begin[i] = end[i - 1] = time
    return begin, end


def _row(wanted: Thirds, k: int, code: int, left: int) -> dict[str, Any]:
    """Columns of a path by its code, with the terms that stand for `left` reflections at most."""
    v, leads = wanted.vertex, bool(wanted.vertex.leads[k])
    edges = v.pair.edge[k], v.pair.last.edge[k], v.third.edge[k]
    faces, third_face, n, near = v.pair.shared[k].tolist(), v.face[k].tolist(), v.lines.n, int(not leads)
    passed = np.pi * n[edges[near]] * np.array([third_face[0], faces[0]] if leads else [faces[1], third_face[0]])
    own = np.where(lit_angles(n[edges[near]], *passed) >= 0.0, 1, -1)
    bits = np.where(code >> np.arange(LAST + TERMS + 2) & 1, 1, -1)
    first, last = bits[:TERMS], bits[LAST : LAST + TERMS]
    fewest = np.array([adjacent_reflections(n[e]) for e in edges])
    others = fewest.min(axis=1).sum() - fewest.min(axis=1)
    lits = np.where(fewest + others[:, None] > left, 0, [own, last, first] if leads else [first, own, last])
    over_end = int(v.pair.over_end[k])
    side = bits[TERMS] if over_end >= 0 else 0
    return {
        "receiver": int(wanted.receiver[k]), "before": wanted.before[k], "after": wanted.after[k],
        "edges": [int(e) for e in edges[:2]], "between": np.empty(0, np.int32), "faces": faces, "end_of": over_end,
        "sides": np.array([*lits[0], side, *lits[1], *bits[LAST + TERMS :]], np.int8),
        "third": int(edges[2]), "third_face": third_face, "leads": leads, "third_lit": lits[2].astype(np.int8),
    }  # fmt: skip
