"""Every path over one edge up to a number of reflections: candidates from beams of both ends, and their intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import TERMS, adjacent_reflections
from clsim.arrays import Floats, as_count
from clsim.errors import InputError
from clsim.paths.chain import Chain, check_support
from clsim.paths.family import DIFFRACTION, PathFamily
from clsim.paths.options import PathOptions
from clsim.paths.search.beam_tree import BeamTree, TooManyBeamsError
from clsim.paths.search.edge_chains import edge_chain, edge_pair_chain, gap_chain, with_swaps
from clsim.paths.search.edge_gaps import gap_candidates
from clsim.paths.search.mesh import BEAM_LIMIT, LARGEST_MESH_ORDER, float64_device, sides_of_air, visibility_query
from clsim.paths.vertices.edge_end import ends_of
from clsim.paths.visibility.clearance import mirrored
from clsim.paths.visibility.device import DeviceSearch
from clsim.paths.visibility.edge_intervals import EdgeSearch, find_pieces
from clsim.paths.visibility.edges import ENDS_BESIDE, EdgeCandidates
from clsim.paths.visibility.intervals import BoundingSpheres
from clsim.paths.visibility.occlusion import Ears
from clsim.scene.room.edges import Edges
from clsim.scene.room.walls import Walls
from clsim.scene.scene import Scene

Rows = NDArray[np.int64]
Sides = list[list[NDArray[np.int32]]]  # by edge and number of walls: sequences (n, N)
Reached = Callable[[tuple[Floats, float]], Sides]
Requested = Iterator[tuple[float, EdgeCandidates]]  # with the share of the work so far
Kind = Callable[[EdgeSearch, tuple[Sides, list[Sides]], Reached, int, float], Requested]

_ON = 1e-7  # of the room's size
_BATCH = 20_000  # candidates searched at a time
_SAME_EVENT = 1e-4  # s between a boundary of an edge path and the beginning or end of its partner, at most
_FARTHEST = 8  # resolutions, the same where that is more


def edge_paths(scene: Scene, search: PathOptions, others: tuple[PathFamily, ...]) -> Chain:
    """Return every path over one edge with up to `max_order` reflections before and after it.

    others: paths without edges: where an edge path takes over from one of them, that one's time is taken.

    A path keeps only the terms whose partners have no more reflections than are asked for: others are not there.
    """
    rows, order, within = rows_of(scene, search, others, edges_and_ends)
    return with_swaps(edge_chain(scene, search.diffraction_model, order, rows), within)


def double_edge_paths(scene: Scene, search: PathOptions, others: tuple[PathFamily, ...]) -> Chain:
    """Return every path over two edges that share a face with up to `max_order` reflections before and after them.

    others: paths without edges and over one: where a path over two edges takes over from one of them, that one's time
    is taken.
    """
    check_support("static edge pair", scene.air)
    rows, order, within = rows_of(scene, search, others, edge_pairs, 2)
    return with_swaps(edge_pair_chain(scene, order, rows), within)


def gap_edge_paths(scene: Scene, search: PathOptions, others: tuple[PathFamily, ...]) -> Chain:
    """Return every path over two edges with air between, with up to `max_order` reflections before, between and after.

    others: paths without edges and over one, whose times are taken as by `double_edge_paths`.
    """
    rows, order, within = rows_of(scene, search, others, gap_candidates, 2)
    return with_swaps(gap_chain(scene, order, rows), within)


def rows_of(
    scene: Scene, search: PathOptions, others: tuple[PathFamily, ...], kind: Kind, fewest: int = 1
) -> tuple[list[dict[str, Any]], int, float]:
    """Return paths of all sources, sorted by source, receiver, order, objects and time, and the order.

    The last is how far apart the times of the same event may have been found, s. Rooms with fewer edges than the fewest
    have no such paths.
    """
    order = as_count("max_order", search.max_order, at_most=LARGEST_MESH_ORDER)
    edges = scene.room.edges()
    rows: list[dict[str, Any]] = []
    within = 0.0
    if len(edges) >= fewest:
        for source in range(len(scene.sources)):
            found, resolution = _source_rows(scene, edges, source, order, search, _AdjacentPaths(others, source), kind)
            rows, within = rows + found, _FARTHEST * resolution
    walls = "before", "between", "after"
    rows.sort(key=lambda r: (r["source"], r["receiver"], sum(len(r[name]) for name in walls), *r["edges"], r["end_of"],
                             *(wall for name in walls for wall in r[name]), r["start"]))  # fmt: skip
    return rows, order, within


def _source_rows(
    scene: Scene, edges: Edges, source: int, order: int, search: PathOptions, adjacent: _AdjacentPaths, kind: Kind
) -> tuple[list[dict[str, Any]], float]:
    """Return the paths of a source, one by one, and to which time their ends are found, s."""
    room = scene.room.as_mesh()
    query, longest = visibility_query(scene, room, scene.sources[source], order + 1, search.resolution)
    device = float64_device(search.engine, search.device)
    tables, found, air = query.trajectory_tables, [], sides_of_air(query)
    finder = EdgeSearch(query, edges, None if device is None else DeviceSearch(query, device), air)
    reached = EdgeReach(finder, order)
    from_source = reached(tables.sphere(0, -longest))
    to_receivers = [reached(tables.sphere(1 + r)) for r in range(len(scene.receivers))]
    done = source / len(scene.sources)
    sides = from_source, to_receivers
    for share, candidates in kind(finder, sides, reached, order, longest):
        notify = partial(search.notify, done)
        found += [{**row, "source": source} for row in _rows(finder, candidates, order, adjacent, notify)]
        if len(found) > search.path_limit:
            raise InputError("max_order", f"must give at most {search.path_limit} paths over edges (path_limit)")
        done = (source + share) / len(scene.sources)
        search.notify(done)
    return found, query.resolution


class EdgeReach:
    """Finds the sequences of walls by which each edge may be reached from a sphere, by number of walls."""

    def __init__(self, finder: EdgeSearch, order: int) -> None:
        edges = finder.edges
        self._finder, self._order = finder, order
        self._ears: BoundingSpheres | Ears = BoundingSpheres(0.5 * (edges.start + edges.stop), 0.5 * edges.length)

    def __call__(self, sphere: tuple[Floats, float]) -> Sides:
        """Return those from a sphere, its centre and radius, m."""
        edges, walls = self._finder.edges, self._finder.query.walls
        found: list[list[list[Any]]] = [[[] for _ in range(self._order + 1)] for _ in range(len(edges))]
        tree = BeamTree(walls, *sphere, self._ears, BEAM_LIMIT, self._finder.air)
        self._ears = tree.ears
        try:
            for batch in tree.candidates(self._order):
                count = batch.sequence.shape[1]
                kept = np.flatnonzero(_may_reach(walls, sphere, edges, batch.receiver, batch.sequence[batch.row]))
                sequence, of_edge = batch.sequence[batch.row[kept]], batch.receiver[kept]
                for edge in np.unique(of_edge).tolist():
                    found[edge][count].append(sequence[of_edge == edge])
        except TooManyBeamsError as error:
            raise InputError("max_order", str(error)) from error
        return [[np.concatenate([np.empty((0, n), np.int32), *parts]) for n, parts in enumerate(x)] for x in found]


def _may_reach(
    walls: Walls, sphere: tuple[Floats, float], edges: Edges, edge: Rows, sequence: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Mask of sequences (n, N) that may lead to edges (n,): not from inside their wedges, nor by walls they lie in.

    As seen from the last walls of a sequence the edge may lie in the plane of an earlier one: such a path would meet
    that wall at the edge's image, at its very end.
    """
    image = np.tile(sphere[0], (len(sequence), 1))
    for wall in sequence.T:
        image = mirrored(walls, wall, image)
    within = in_planes(walls, edges.start[edge], sequence) & in_planes(walls, edges.stop[edge], sequence)
    r, angle, _ = edges.cylindrical(edge, image)
    beyond = np.maximum(-angle, angle - np.pi * edges.n[edge])
    depth = np.where(beyond < 0.5 * np.pi, r * np.sin(np.clip(beyond, 0.0, 0.5 * np.pi)), r)
    return np.asarray(~within.any(axis=1) & (depth <= sphere[1] + _ON * walls.size))


def in_planes(walls: Walls, place: Floats, sequence: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Mask of walls of sequences (n, N) in whose plane places (3,) or (n, 3) lie, as seen by the walls behind each."""
    found, seen = np.zeros(sequence.shape, dtype=bool), np.broadcast_to(place, (len(sequence), 3))
    for k in range(sequence.shape[1] - 1, -1, -1):
        wall = sequence[:, k]
        height = np.einsum("ni,ni->n", seen, walls.normal[wall]) - walls.offset[wall]
        found[:, k] = np.abs(height) <= _ON * walls.size
        seen = mirrored(walls, wall, seen)
    return found


def edges_and_ends(
    finder: EdgeSearch, sides: tuple[Sides, list[Sides]], reached: Reached, order: int, longest: float
) -> Requested:
    """Yield candidates over edges and free ends of them."""
    edges = finder.edges
    fewest = adjacent_reflections(edges.n).min(axis=1).tolist()
    ends = [(-1, *np.flatnonzero(free).tolist()) for free in edges.free]
    return _requested(
        finder, sides, order, [((e, e), (-1, -1), end, fewest[e]) for e in range(len(edges)) for end in ends[e]]
    )


def edge_pairs(
    finder: EdgeSearch, sides: tuple[Sides, list[Sides]], reached: Reached, order: int, longest: float
) -> Requested:
    """Yield candidates over pairs of edges that share a face."""
    edges, fewest = finder.edges, adjacent_reflections(finder.edges.n).min(axis=1)
    pairs = zip(*edges.pairs(), strict=True)
    return _requested(finder, sides, order, [(pair, face, -1, fewest[pair].sum()) for pair, face in pairs])


def _requested(finder: EdgeSearch, sides: tuple[Sides, list[Sides]], order: int, vertices: list[Any]) -> Requested:
    """Yield pairs of sequences to vertices, by numbers of walls.

    Vertices are given as edges, faces shared, end, and fewest reflections of an adjacent path.
    """
    edges, walls = finder.edges, finder.query.walls
    numbers = [(n, m) for n in range(order + 1) for m in range(order + 1 - n)]
    for done, (n, m) in enumerate(numbers):
        parts: list[EdgeCandidates] = []
        waiting = 0
        for receiver, to_receiver in enumerate(sides[1]):
            for both, face, end, fewest in vertices:
                if n + m + fewest > order:
                    continue
                before, after = sides[0][both[0]][n], to_receiver[both[1]][m]
                if end >= 0:  # nothing comes to an end by a wall that it lies in
                    place = (edges.start, edges.stop)[end][both[0]]
                    before, after = (x[~in_planes(walls, place, x).any(axis=1)] for x in (before, after))
                i, j = np.divmod(np.arange(len(before) * len(after)), max(len(after), 1))
                pair, faces = (np.tile(x, (len(i), 1)) for x in (both, face))
                ends, to, none = np.full(len(i), end), np.full(len(i), receiver), np.empty((len(i), 0), np.int32)
                parts.append(EdgeCandidates(before[i], after[j], pair, faces, ends, to, none))
                waiting += len(i)
                if waiting >= _BATCH:
                    yield done / len(numbers), EdgeCandidates.joined(parts)
                    parts, waiting = [], 0
        if waiting:
            yield (done + 1) / len(numbers), EdgeCandidates.joined(parts)


class _AdjacentPaths:
    """When other paths begin and end, by receiver, walls and edges."""

    def __init__(self, others: tuple[PathFamily, ...], source: int) -> None:
        self._events: dict[tuple[int, ...], list[float]] = {}
        for family in others:
            met = np.where(family.interactions == DIFFRACTION, -1 - family.objects, family.objects)
            for row in np.flatnonzero(family.source == source).tolist():
                events = [float(t) for t in (family.start[row], family.end[row]) if np.isfinite(t)]
                if events and np.all(family.interactions[row] <= DIFFRACTION):
                    key = (int(family.receiver[row]), *met[row, : family.order[row]].tolist())
                    self._events.setdefault(key, []).extend(events)

    def nearest(self, receiver: int, through: tuple[int, ...], time: float, within: float) -> float:
        """Return when a path begins or ends near a time, s; the time itself where none does.

        The way is by walls, and by edges, which are told as -1 less their number.
        """
        events = self._events.get((receiver, *through), [])
        event = min(events, key=lambda t: abs(t - time), default=np.inf)
        return event if abs(event - time) <= within else time


def _rows(
    finder: EdgeSearch, wanted: EdgeCandidates, order: int, adjacent: _AdjacentPaths, notify: Callable[[], None]
) -> Iterator[dict[str, Any]]:
    """Yield paths that candidates give, with the times of their partners."""
    pieces, query = find_pieces(finder, wanted, order, notify), finder.query
    within = max(_SAME_EVENT, _FARTHEST * query.resolution)
    begin, end, of_pairs = pieces.begin.copy(), pieces.end.copy(), wanted.over_ends_of_pairs
    for i in range(1, len(pieces.row)):
        row = pieces.row[i]
        over_end = wanted.end[row] >= 0 and not of_pairs
        if row != pieces.row[i - 1] or begin[i] != end[i - 1] or over_end:
            continue  # paths over ends go on smoothly where a partner begins
        before, after = (walls[walls >= 0].tolist() for walls in (wanted.before[row], wanted.after[row][::-1]))
        time = float(begin[i])
        for term in np.flatnonzero(pieces.sides[i] != pieces.sides[i - 1]).tolist():
            if term not in ENDS_BESIDE and (term != TERMS or of_pairs):
                through = (*before, *_instead(finder.edges, wanted, row, term), *after)
                time = adjacent.nearest(int(wanted.receiver[row]), through, float(begin[i]), within)
            if time != begin[i]:
                break
        begin[i] = end[i - 1] = time
    last = query.last[wanted.receiver[pieces.row]]
    begin, end = np.where(begin <= 0.0, -np.inf, begin), np.where(end >= last, np.inf, end)
    for i, row in enumerate(pieces.row.tolist()):
        if begin[i] < end[i]:
            before, after = (walls[walls >= 0] for walls in (wanted.before[row], wanted.after[row]))
            yield {
                "receiver": int(wanted.receiver[row]), "before": before, "after": after,
                "edges": wanted.edge[row].tolist(), "between": wanted.between[row], "faces": wanted.face[row].tolist(),
                "end_of": int(wanted.end[row]), "start": begin[i], "end": end[i], "sides": pieces.sides[i],
            }  # fmt: skip


def _instead(edges: Edges, wanted: EdgeCandidates, row: int, term: int) -> list[int]:
    """Interactions of a term's partner in place of the edges: faces in turn, or the other one of two edges."""
    (one, other), shared, end = wanted.edge[row].tolist(), int(wanted.face[row, 0]), int(wanted.end[row])
    if end >= 0 and term == TERMS:  # where the path over both edges takes over
        return [-1 - one, *wanted.between[row].tolist(), -1 - other]
    second = term > TERMS
    met = [-1 - one, -1 - other]
    for place, number in ends_of(end) if end >= 0 else ():
        met[place] = -1 - len(edges) - 2 * (one, other)[place] - number
    edge, term = (other, term - TERMS - 1) if second else (one, term)
    faces, count = edges.faces[edge].tolist(), int(adjacent_reflections(edges.n[edge])[term])
    bounces = [int(faces[(term + bounce) % 2]) for bounce in range(count)]
    if shared < 0:
        return bounces
    between = wanted.between[row].tolist()
    if shared in (0, 1):
        return [met[0] if second else met[1]]
    return [met[0], *between, *bounces] if second else [*bounces, *between, met[1]]
