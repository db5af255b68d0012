"""Every path over edges of a room up to a number of reflections: candidates from beams of both ends, and their chains.

Paths over one edge, an end of it, or two edges of one face; `edge_gaps` and `edge_ends` have the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import EVEN, TERMS, adjacent_reflections
from clsim.arrays import Floats, as_count, read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain, check_support
from clsim.paths.family import DIFFRACTION, NONE, SPECULAR, PathFamily
from clsim.paths.legs.legs import StaticLeg
from clsim.paths.legs.mirrors import EdgeLines
from clsim.paths.options import PathOptions
from clsim.paths.search.beam_tree import BeamTree, TooManyBeamsError
from clsim.paths.search.mesh import (
    BEAM_LIMIT,
    LARGEST_MESH_ORDER,
    Progress,
    float64_device,
    image_isometries,
    resolution_of,
    sides_of_air,
    visibility_query,
)
from clsim.paths.search.same_events import with_swaps
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.edge_end import ends_of
from clsim.paths.vertices.edge_pair import EdgePairVertex
from clsim.paths.visibility.clearance import in_planes, mirrored
from clsim.paths.visibility.device import DeviceSearch
from clsim.paths.visibility.edge_ends import seen_frames
from clsim.paths.visibility.edge_intervals import EdgeSearch, find_pieces
from clsim.paths.visibility.edges import ENDS_BESIDE, SIDES, EdgeCandidates
from clsim.paths.visibility.intervals import BoundingSpheres
from clsim.paths.visibility.occlusion import Ears
from clsim.scene.room.edges import Edges
from clsim.scene.room.walls import Walls
from clsim.scene.scene import Scene

Rows = NDArray[np.int64]
Sides = list[list[NDArray[np.int32]]]  # by edge and number of walls: sequences (n, N)
Found = list[dict[str, Any]]
Requested = Iterator[tuple[float, EdgeCandidates]]  # with the share of the work so far
Others = tuple[PathFamily, ...]

_ON = 1e-7  # of the room's size
_BATCH = 20_000  # candidates searched at a time
SAME_EVENT = 1e-4  # s between a boundary of an edge path and the beginning or end of its partner, at most
FARTHEST = 8  # resolutions, the same where that is more


class EdgePaths:
    """Looks for paths over edges of a scene's room, one kind of vertices after another."""

    def __init__(self, scene: Scene, search: PathOptions) -> None:
        self.scene, self.search, self.edges = scene, search, scene.room.edges()
        self.order = as_count("max_order", search.max_order, at_most=LARGEST_MESH_ORDER)
        self._reach = cache(self._find_reach)

    def over_one(self, others: Others, progress: Progress | None = None) -> Chain:
        """Find every path over one edge with up to `max_order` reflections before and after it."""
        rows, lines = self.rows(edges_and_ends, others, progress), EdgeLines.of(self.scene.room)
        return self.chain(rows, EdgeVertex(**_first_edges(rows), lines=lines, model=self.search.diffraction_model))

    def over_pairs(self, others: Others, progress: Progress | None = None) -> Chain:
        """Find every path over two edges that share a face, with up to `max_order` reflections before and after."""
        check_support("static edge pair", self.scene.air)
        rows = self.rows(edge_pairs, others, progress, fewest=2)
        return self.chain(rows, EdgePairVertex(**self.both_edges(rows)))

    def rows(
        self,
        kind: Callable[[EdgeReach], Requested],
        others: Others,
        progress: Progress | None,
        fewest: int = 1,
        rows: Any = None,
    ) -> Found:
        """Find paths of all sources, sorted by source, receiver, order, objects and time."""
        found: Found = []
        for source in range(len(self.scene.sources) if len(self.edges) >= fewest else 0):
            found += self._rows_of(
                source, (kind, rows or rows_of), AdjacentPaths(others, source), progress or self.search.notify
            )
        walls = "before", "between", "after"
        found.sort(key=lambda r: (r["source"], r["receiver"], sum(len(r[name]) for name in walls), *r["edges"],
                                  r["end_of"], *(wall for name in walls for wall in r[name]), r["start"]))  # fmt: skip
        return found

    def _rows_of(
        self,
        source: int,
        kinds: tuple[Callable[[EdgeReach], Requested], Any],
        adjacent: AdjacentPaths,
        notify: Progress,
    ) -> Found:
        """Find the paths of a source."""
        found: Found = []
        reach, count, limit = self._reach(source), len(self.scene.sources), self.search.path_limit
        done = source / count
        kind, rows_of = kinds
        for share, candidates in kind(reach):
            rows = rows_of(reach, candidates, adjacent, partial(notify, done))
            found += [{**row, "source": source} for row in rows]
            if len(found) > limit:
                raise InputError("max_order", f"must give at most {limit} paths over edges (path_limit)")
            done = (source + share) / count
            notify(done)
        return found

    def _find_reach(self, source: int) -> EdgeReach:
        """Find how each edge may be reached from a source and its receivers, once for all kinds of vertices."""
        scene, search = self.scene, self.search
        query, longest = visibility_query(
            scene, scene.room.as_mesh(), scene.sources[source], self.order + 1, search.resolution
        )
        device = float64_device(search.engine, search.device)
        on_device = None if device is None else DeviceSearch(query, device)
        return EdgeReach(EdgeSearch(query, self.edges, on_device, sides_of_air(query)), self.order, longest)

    def both_edges(self, rows: Found) -> dict[str, Any]:
        """Make the columns of `EdgePairVertex`."""
        lines, columns = EdgeLines.of(self.scene.room), _first_edges(rows)
        second = {
            "edge": np.array([r["edges"][1] for r in rows], dtype=np.int64),
            "lit": np.array([r["sides"][TERMS + 1 : 2 * TERMS + 1] for r in rows], dtype=np.int8).reshape(-1, TERMS),
        }
        last = EdgeVertex(**(columns | second), lines=lines, model="utd")
        shared = read_only(np.array([r["faces"] for r in rows], dtype=np.int64).reshape(-1, 2))
        return columns | {"lines": lines, "model": "utd", "last": last, "shared": shared}

    def gap_columns(self, rows: Found) -> dict[str, Any]:
        """Make the columns of `GapPairVertex`."""
        columns, walls, order = self.both_edges(rows), self.scene.room.as_mesh().walls, self.order
        between = np.full((len(rows), order), -1, dtype=np.int32)
        for row, r in zip(between, rows, strict=True):
            row[: len(r["between"])] = r["between"]
        met = np.array([len(r["before"]) + len(r["after"]) + len(r["between"]) for r in rows], dtype=np.int64)
        seen = seen_frames(walls, self.edges, columns["last"].edge, between)
        held = (("seen", seen), ("between", between), ("budget", order - met))
        return columns | {name: read_only(x) for name, x in held}

    def chain(self, rows: Found, vertex: EdgeVertex) -> Chain:
        """Make paths over vertices, with one time for each event at which one takes over from another."""
        count, edges, order = len(rows), len(vertex.lines), self.order
        objects = np.full((count, order + 3), -1, dtype=np.int32)
        kinds = np.full((count, order + 3), NONE, dtype=np.int8)
        for i, r in enumerate(rows):
            n, m = len(r["before"]), len(r["after"])
            first, last = r["edges"]
            things = [first, *r["between"], last] if r["faces"][0] >= 0 else [first]
            if r["end_of"] >= 0:
                for place, end in ends_of(r["end_of"]):
                    things[-place] = edges + 2 * r["edges"][place] + end
            met = [DIFFRACTION, *[SPECULAR] * len(r["between"]), DIFFRACTION][: len(things)]
            if "third" in r:
                things.insert(0 if r["leads"] else 2, r["third"])
                met.append(DIFFRACTION)
            objects[i, : n + m + len(things)] = [*r["before"], *things, *r["after"][::-1]]
            kinds[i, : n + m + len(things)] = [SPECULAR] * n + met + [SPECULAR] * m
        longest = order + max((1 + (r["faces"][0] >= 0) + ("third" in r) for r in rows), default=1)
        objects, kinds = read_only(objects[:, :longest]), read_only(kinds[:, :longest])
        legs = self._leg([r["before"] for r in rows]), self._leg([r["after"] for r in rows])
        columns: dict[str, Any] = {
            "source": np.array([r["source"] for r in rows], dtype=np.int32),
            "receiver": np.array([r["receiver"] for r in rows], dtype=np.int32),
            "order": np.sum(objects >= 0, axis=1).astype(np.int32),
            "start": np.array([r["start"] for r in rows], dtype=np.float64),
            "end": np.array([r["end"] for r in rows], dtype=np.float64),
        }
        held: dict[str, Any] = {name: read_only(column) for name, column in columns.items()}
        family = Chain(scene=self.scene, **held, interactions=kinds, objects=objects, legs=legs, vertex=vertex)
        return with_swaps(family, FARTHEST * resolution_of(self.scene, self.search.resolution))

    def _leg(self, sequences: list[NDArray[np.int32]]) -> StaticLeg:
        """Make legs by sequences of walls."""
        found = np.full((len(sequences), self.order), -1, dtype=np.int32)
        for row, sequence in zip(found, sequences, strict=True):
            row[: len(sequence)] = sequence
        if not sequences:
            return StaticLeg(np.empty((0, 3, 3)), np.empty((0, 3)))
        return StaticLeg(*(read_only(x) for x in image_isometries(self.scene.room.as_mesh().walls, found)))


def _first_edges(rows: Found) -> dict[str, Any]:
    """Columns of `EdgeVertex` of the first edges."""
    sides = np.array([r["sides"] for r in rows], dtype=np.int8).reshape(-1, SIDES)
    edge = np.array([r["edges"][0] for r in rows], dtype=np.int64)
    end = np.array([r["end_of"] for r in rows], dtype=np.int8)
    even = np.full(len(rows), EVEN)
    values: tuple[Any, ...] = (edge, end, sides[:, :TERMS], sides[:, TERMS], sides[:, ENDS_BESIDE], even)
    return {name: read_only(column) for name, column in zip(COLUMNS, values, strict=True)}


class EdgeReach:
    """How each edge of a room may be reached: sequences of walls from a source, its receivers and other balls.

    longest: time that sound takes at most, s.
    """

    def __init__(self, finder: EdgeSearch, order: int, longest: float) -> None:
        edges, tables = finder.edges, finder.query.trajectory_tables
        self.finder, self.order, self.longest = finder, order, longest
        self._ears: BoundingSpheres | Ears = BoundingSpheres(0.5 * (edges.start + edges.stop), 0.5 * edges.length)
        self.from_source = self.from_ball(tables.sphere(0, -longest))
        self.to_receivers = [self.from_ball(tables.sphere(row)) for row in range(1, len(tables.places))]

    def from_edges(self, some: NDArray[np.int64]) -> list[Sides]:
        """Find the sequences from some edges, by edge; none from the others."""
        edges = self.finder.edges
        balls = zip(0.5 * (edges.start + edges.stop), 0.5 * edges.length, strict=True)
        return [self.from_ball(ball) if e in some else [] for e, ball in enumerate(balls)]

    def from_ball(self, sphere: tuple[Floats, float]) -> Sides:
        """Find the sequences from a ball, its centre and radius, m."""
        edges, walls = self.finder.edges, self.finder.query.walls
        found: list[list[list[Any]]] = [[[] for _ in range(self.order + 1)] for _ in range(len(edges))]
        tree = BeamTree(walls, *sphere, self._ears, BEAM_LIMIT, self.finder.air)
        self._ears = tree.ears
        try:
            for batch in tree.candidates(self.order):
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
    """Mask of sequences (n, N) that may lead to edges (n,): not from inside their wedges, nor by walls they lie in."""
    image = np.tile(sphere[0], (len(sequence), 1))
    for wall in sequence.T:
        image = mirrored(walls, wall, image)
    within = in_planes(walls, edges.start[edge], sequence) & in_planes(walls, edges.stop[edge], sequence)
    r, angle, _ = edges.cylindrical(edge, image)
    beyond = np.maximum(-angle, angle - np.pi * edges.n[edge])
    depth = np.where(beyond < 0.5 * np.pi, r * np.sin(np.clip(beyond, 0.0, 0.5 * np.pi)), r)
    return np.asarray(~within.any(axis=1) & (depth <= sphere[1] + _ON * walls.size))


def edges_and_ends(reach: EdgeReach) -> Requested:
    """Yield candidates over edges and free ends of them."""
    edges = reach.finder.edges
    fewest = adjacent_reflections(edges.n).min(axis=1).tolist()
    ends = [(-1, *np.flatnonzero(free).tolist()) for free in edges.free]
    return _requested(reach, [((e, e), (-1, -1), end, fewest[e]) for e in range(len(edges)) for end in ends[e]])


def edge_pairs(reach: EdgeReach) -> Requested:
    """Yield candidates over pairs of edges that share a face."""
    edges = reach.finder.edges
    fewest, pairs = adjacent_reflections(edges.n).min(axis=1), zip(*edges.pairs(), strict=True)
    return _requested(reach, [(pair, face, -1, fewest[pair].sum()) for pair, face in pairs])


def _requested(reach: EdgeReach, vertices: list[Any]) -> Requested:
    """Yield pairs of sequences to vertices, by numbers of walls."""
    edges, walls, order = reach.finder.edges, reach.finder.query.walls, reach.order
    numbers = [(n, m) for n in range(order + 1) for m in range(order + 1 - n)]
    for done, (n, m) in enumerate(numbers):
        parts: list[EdgeCandidates] = []
        waiting = 0
        for receiver, to_receiver in enumerate(reach.to_receivers):
            for both, face, end, fewest in vertices:
                if n + m + fewest > order:
                    continue
                before, after = reach.from_source[both[0]][n], to_receiver[both[1]][m]
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


class AdjacentPaths:
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
        """Return when a path begins or ends near a time, s; the time itself where none does."""
        events = self._events.get((receiver, *through), [])
        event = min(events, key=lambda t: abs(t - time), default=np.inf)
        return event if abs(event - time) <= within else time


def rows_of(
    reach: EdgeReach, wanted: EdgeCandidates, adjacent: AdjacentPaths, notify: Callable[[], None]
) -> Iterator[dict[str, Any]]:
    """Yield paths that candidates give, with the times of their partners."""
    finder, query = reach.finder, reach.finder.query
    pieces = find_pieces(finder, wanted, reach.order, notify)
    within = max(SAME_EVENT, FARTHEST * query.resolution)
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
