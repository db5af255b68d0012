"""Beginnings and ends of paths at a corner, given one time where they follow each other more closely than is known.

Where the line of sight, or a mirror path, passes exactly through a corner, paths over both edges, over their ends and
without an edge begin and end together. Each is found by its own test, with its own tolerance: between their times the
sum would jump by as much as the strongest path.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, Rows, by_value, ranges, read_only, unique_rows
from clsim.paths.chain import Chain
from clsim.paths.family import DIFFRACTION, NONE, PathFamily, ends_at
from clsim.paths.vertices.edge import EdgeVertex
from clsim.paths.vertices.edge_end import EdgeEndVertex
from clsim.paths.vertices.edge_field import BOTH
from clsim.paths.visibility.edge_intervals import LONGEST, STEP, indistinct
from clsim.scene.scene import Scene

SAME_DELAY = 3e-8  # s, between paths of which one goes over into the other

_WINDOW = 1e-3  # s between two times of one event, at most: ends may go along an edge within the tolerance of outlines
_GRAZED = 0.25  # s, the same where a way goes along an edge
_ROUNDING = 1e-14  # of the room's size, by which lengths of the same way differ
_DETOUR = 3e-15  # of it, over the corner at most: ten times the tolerance of outlines beside it
_STEP = 1e-4  # s, between instants at which the detour over a corner is computed
_SHORT = 1e-5  # s, between instants at which it is seen that a way passes the corner itself
_SAME = 1e-8  # s, between the times at which it passes an edge and its end
_ROUNDS = 3  # of Newton's method on its slope


def at_one_time(scene: Scene, found: tuple[PathFamily, ...], resolution: float) -> tuple[PathFamily, ...]:
    """Give one time to all that begins and ends as a corner is passed, in paths without and over edges.

    These are events of one source and one receiver which follow each other by no more than the resolution, s, or the
    tolerance of outlines explains, at which all paths are as long. The first one's time is that of all. Where the way
    over the corner of an edge is the shortest one at an instant, this instant is their time. A path without edges that
    passes one slowly takes the time of that edge's own terms.
    """
    chains = [family for family in found if isinstance(family, Chain)]
    if not any(family.vertex is not None for family in chains):
        return found
    bounds = [[np.array(family.start), np.array(family.end)] for family in chains]
    events = Events.of(chains, scene)
    groups, converged = list(_groups(events, resolution)), np.zeros(len(events.time), dtype=bool)
    timed = [(group, float(np.min(events.time[group]))) for group in groups] + list(_passed_corners(events, converged))
    converged[[event for group in groups for event in group.tolist()]] = True
    for group, time in (*timed, *_along_edges(events, converged)):
        events.set(bounds, group, time)
    for place, (start, end) in enumerate(bounds):
        family = chains[place]
        if not (np.array_equal(start, family.start) and np.array_equal(end, family.end)):
            family = replace(family, start=read_only(start), end=read_only(end))
            chains[place] = family.part(np.flatnonzero(start < end))
    changed = iter(_with_corners(chains, scene))
    return tuple(next(changed) if isinstance(family, Chain) else family for family in found)


def _with_corners(chains: list[Chain], scene: Scene) -> list[Chain]:
    """Tell paths over ends which terms pass their boundaries as the path passes the corner, and at which angle."""
    events = Events.of(chains, scene)
    over_ends = events.over_edges(ends=True)
    columns: dict[int, tuple[NDArray[np.int8], Floats]] = {}
    _, instant, count = np.unique(np.stack([events.pair, events.time]), axis=1, return_inverse=True, return_counts=True)
    with_ends = np.bincount(instant, weights=over_ends, minlength=len(count))
    some = np.flatnonzero(((with_ends > 0.0) & (count - with_ends > 1.0))[instant])
    some = some[np.argsort(instant[some], kind="stable")]
    for group in np.split(some, np.flatnonzero(np.diff(instant[some])) + 1):
        if events.paths_beside_ends(group) < 2:
            continue
        ends = group[over_ends[group]]
        for number, some_ends in by_value(events.family[ends]):
            mine, vertex = ends[some_ends], chains[number].vertex
            links, rows = chains[number].links(events.row[mine]), events.row[mine]
            lit, corner = columns.setdefault(number, (np.array(vertex.lit), np.array(vertex.corner)))
            instants = events.time[group[0]] + _SHORT * np.array([1.0, -1.0])  # after it and before it
            angles, *squares = links.vertex.boundaries(links, instants)
            sides, each = np.where(angles >= 0.0, 1, -1), np.arange(len(mine))
            own, (detours, over_end) = (each, events.side[mine]), (np.sqrt(x) for x in squares)
            # Both roots grow evenly with the time from where each is zero.
            apart = _SHORT * (_share(detours) - _share(over_end)[:, None])
            passed = (np.abs(apart) <= _SAME) & (sides[:, 0] != sides[:, 1]) & (lit[rows] != 0)
            term, some_passed = np.argmax(passed, axis=1), passed.any(axis=1)
            angle = np.arctan2(detours[(*own, term)], over_end[own])
            lit[rows] = np.where(passed, BOTH * sides[own], lit[rows])
            corner[rows] = np.where(some_passed, angle, corner[rows])
    for number, (lit, corner) in columns.items():
        vertex = replace(chains[number].vertex, lit=read_only(lit), corner=read_only(corner))
        chains[number] = replace(chains[number], vertex=vertex)
    return chains


def _share(roots: Floats) -> Floats:
    """Place of the zero of roots (n, 2, ...) after and before it, from -1 to 1."""
    after, before = roots[:, 0], roots[:, 1]
    return np.asarray((before - after) / np.maximum(before + after, 1e-300))


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """Beginnings and ends of paths, in order of pairs and times."""

    chains: Sequence[Chain]
    scene: Scene
    pair: Rows  # (n,) which source and receiver
    time: Floats  # (n,) s
    family: Rows  # (n,) which of the chains
    side: Rows  # (n,) 0 for a start, 1 for an end
    row: Rows  # (n,) of the family

    @staticmethod
    def of(chains: Sequence[Chain], scene: Scene) -> Events:
        """List those of all rows of chains."""
        parts: list[Any] = []
        for place, family in enumerate(chains):
            pairs = family.source.astype(np.int64) * len(scene.receivers) + family.receiver
            for end, bounds in enumerate((family.start, family.end)):
                some = np.flatnonzero(np.isfinite(bounds))
                parts.append((pairs[some], bounds[some], np.full(len(some), place), np.full(len(some), end), some))
        columns: Any = [np.concatenate(column) for column in zip(*parts, strict=True)]
        order = np.lexsort((columns[1], columns[0]))
        return Events(chains, scene, *(column[order] for column in columns))

    def set(self, bounds: list[list[Floats]], group: Rows, time: float) -> None:
        """Set the starts and ends of each family to the time of a group of events, s."""
        for family, side, row in zip(self.family[group], self.side[group], self.row[group], strict=True):
            bounds[family][side][row] = time

    def delays(self, which: Rows, instants: Floats) -> Floats:
        """Compute the delays (n,) of the paths of events at instants (n,), s."""
        found = np.empty(len(which))
        for family, mine in by_value(self.family[which]):
            found[mine] = self.chains[family].delays(self.row[which[mine]], instants[mine])
        return found

    def paths(self) -> Rows:
        """Return numbers (n,) of the paths of events: pieces of one path have the same number, and length."""
        met = [np.concatenate([chain.interactions, chain.objects], axis=1) for chain in self.chains]
        keys = np.full((len(self.time), 2 + max(x.shape[1] for x in met)), NONE, dtype=np.int64)
        keys[:, 0], keys[:, 1] = self.family, self.pair
        for number, columns in enumerate(met):
            mine = self.family == number
            keys[mine, 2 : 2 + columns.shape[1]] = columns[self.row[mine]]
        return unique_rows(keys)[2]

    def detours(self, group: Rows, which: Rows, own: Rows, instants: Floats) -> Floats:
        """Compute by how much paths of groups' own events, (k,) in time, are longer than those of events (n,), m."""
        family, row, each = self.family[group], self.row[group], np.empty(len(group))
        received, sent = instants[which], (instants - self.delays(group[own], instants))[which]
        for number, mine in by_value(family):
            chain, rows = self.chains[number], row[mine]
            source = ends_at(self.scene.sources, chain.source[rows], sent[mine])
            receiver = ends_at(self.scene.receivers, chain.receiver[rows], received[mine])
            each[mine] = chain.lengths(rows, source, receiver)
        return np.asarray(each[own][which] - each)

    def paths_beside_ends(self, group: Rows) -> int:
        """Count different paths of a group that are not over ends of edges: one of them ends where another begins."""
        sequences = set()
        for number, row in zip(self.family[group].tolist(), self.row[group].tolist(), strict=True):
            chain = self.chains[number]
            if not isinstance(chain.vertex, EdgeVertex) or chain.vertex.over_end[row] < 0:
                sequences.add((number, *chain.objects[row].tolist()))
        return len(sequences)

    def over_edges(self, ends: bool) -> NDArray[np.bool_]:
        """Mask (n,) of events of paths over ends of edges of the room, or over edges themselves; of none over both."""
        over = np.zeros(len(self.time), dtype=bool)
        for number, chain in enumerate(self.chains):
            single = isinstance(chain.vertex, EdgeVertex) and not isinstance(chain.vertex, EdgeEndVertex)
            if single and not chain.legs[0].moving:
                mine = self.family == number
                over[mine] = (chain.vertex.over_end[self.row[mine]] >= 0) == ends
        return over


def _groups(events: Events, resolution: float) -> Iterator[Rows]:
    """Yield groups of events that are one."""
    pair, times = events.pair, events.time
    gap = np.where(pair[1:] == pair[:-1], times[1:] - times[:-1], np.inf)
    near = gap <= LONGEST
    scene, late, moved = events.scene, times[1:][near], np.zeros(int(near.sum()))
    source, receiver = np.divmod(pair[1:][near], len(scene.receivers))
    for ends, which in ((scene.sources, source), (scene.receivers, receiver)):
        for each, mine in by_value(which):
            place = ends[each].trajectory.position(late[mine][:, None] + np.array([0.0, STEP]))
            moved[mine] += np.linalg.norm(place[:, 1] - place[:, 0], axis=-1)
    near[near] = gap[near] <= indistinct(moved, resolution, scene.room.as_mesh().walls.size)
    for first, after in pairwise([0, *(np.flatnonzero(~near) + 1).tolist(), len(times)]):
        if after - first < 2 or times[after - 1] == times[first]:
            continue
        here = np.arange(first, after)
        delay = events.delays(here, times[here])
        ranks = np.argsort(delay, kind="stable")
        for group in np.split(here[ranks], np.flatnonzero(np.diff(delay[ranks]) >= SAME_DELAY) + 1):
            if any(events.chains[number].vertex is not None for number in np.unique(events.family[group]).tolist()):
                yield group


def _passed_corners(events: Events, converged: NDArray[np.bool_]) -> Iterator[tuple[Rows, float]]:
    """Yield groups of events at which a way passes the corner of an edge, and when it does so, s; mark them."""
    size = events.scene.room.as_mesh().walls.size
    for turns, first, group in _beside_turns(events):
        which = np.repeat(np.arange(len(turns)), np.diff([*first, len(group)]))
        own = np.flatnonzero(group == turns[which])
        times, found = events.time[turns], np.ones(len(turns), dtype=bool)
        for _ in range(_ROUNDS):
            before, here, after = (
                np.maximum.reduceat(events.detours(group, which, own, times + step), first)
                for step in (-_STEP, 0.0, _STEP)
            )
            bend = before + after - 2.0 * here
            found &= bend > 16.0 * _ROUNDING * size
            times = np.where(found, times + 0.5 * _STEP * (before - after) / np.where(found, bend, 1.0), times)
        beside = np.abs(events.detours(group, which, own, times)) <= _DETOUR * size
        for turn in np.flatnonzero(found & ~converged[turns]).tolist():
            some, there = group[which == turn], beside[which == turn]
            same, at, time = some[there], events.time[some], float(times[turn])
            near = np.array_equal(np.isin(at, at[there]), there) and np.all(np.abs(at[there] - time) <= _WINDOW)
            if not converged[turns[turn]] and near and events.paths_beside_ends(same) > 1:
                converged[same] = True
                yield same, time


def _along_edges(events: Events, converged: NDArray[np.bool_]) -> Iterator[tuple[Rows, float]]:
    """Yield beginnings and ends of paths without edges, and when such a path passes an edge by the edge's own test, s.

    Where it passes within 0.1 mrad of the edge's direction, outlines, with their tolerance, tell other times: up to a
    quarter of a second off, at which both paths are as long as each other.
    """
    plain = np.array([chain.vertex is None for chain in events.chains])[events.family]
    over, size = events.over_edges(ends=False) & (events.side == 0), events.scene.room.as_mesh().walls.size
    _, instant = np.unique(np.stack([events.pair, events.time]), axis=1, return_inverse=True)
    with_plain, with_edge = (np.bincount(instant, weights=mask) > 0.0 for mask in (plain, over))
    lone = np.flatnonzero(plain & ~with_edge[instant] & ~converged)
    turns = np.flatnonzero(over & ~with_plain[instant] & ~converged)
    for pair in np.intersect1d(events.pair[lone], events.pair[turns]).tolist():
        mine, theirs = (which[events.pair[which] == pair] for which in (lone, turns))
        known, now = events.time[theirs], events.time[mine]
        first, after = (np.searchsorted(known, now + shift) for shift in (-_GRAZED, _GRAZED))
        of, place = ranges(first, after)
        one, other = mine[of], theirs[place]
        apart = events.delays(one, events.time[one]) - events.delays(other, events.time[one])
        for pair_of in np.stack([one, other], axis=1)[np.abs(apart) < SAME_DELAY]:
            begin, end = events.time[pair_of].tolist()
            instants, zero = np.linspace(begin, end, 5), np.zeros(2, dtype=np.int64)
            if not converged[pair_of].any() and all(
                abs(events.detours(pair_of, zero, zero[:1], instants[[i]])[1]) <= _ROUNDING * size for i in range(5)
            ):
                converged[pair_of[0]] = True
                yield pair_of[:1], float(events.time[pair_of[1]])


def _beside_turns(events: Events) -> Iterator[tuple[Rows, Rows, Rows]]:
    """Yield events of a pair at which paths over ends of edges begin, (k,), and all at which paths are nearly as long.

    The latter, (n,), follow each other: those of each of the former from a place (k,) on.
    """
    over, paths = events.over_edges(ends=True) & (events.side == 0), events.paths()
    for pair in np.unique(events.pair[over]).tolist():
        here = slice(*np.searchsorted(events.pair, (pair, pair + 1)).tolist())
        turns, times = here.start + np.flatnonzero(over[here]), events.time[here]
        first = here.start + np.searchsorted(times, events.time[turns] - _WINDOW)
        after = here.start + np.searchsorted(times, events.time[turns] + _WINDOW, "right")
        several = events.time[first] != events.time[after - 1]
        turns, first, after = turns[several], first[several], after[several]
        turn, near = ranges(first, after)
        _, instant = np.unique(events.time[turns], return_inverse=True)
        _, some, same = np.unique(paths[near] * len(turns) + instant[turn], return_index=True, return_inverse=True)
        each = events.delays(near[some], events.time[turns[turn[some]]])[same]
        apart = events.delays(turns, events.time[turns])[turn] - each
        alike = np.abs(apart) < SAME_DELAY
        near, turn = near[alike], turn[alike]
        first = np.searchsorted(turn, np.arange(len(turns) + 1))
        kept = events.time[near[first[1:] - 1]] > events.time[near[first[:-1]]]
        if kept.any():
            yield turns[kept], np.cumsum(np.diff(first)[kept]) - np.diff(first)[kept], near[kept[turn]]


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
    """Find the rows of `one` and of `other` (n,) at whose times, s, both paths between two ends are as long."""
    pair = family.source.astype(np.int64) * len(family.scene.receivers) + family.receiver
    found = [np.empty((2, 0), dtype=np.int64)]
    for each in np.intersect1d(pair[one[0]], pair[other[0]]):
        (rows, times), (others, their_times) = ((r[pair[r] == each], t[pair[r] == each]) for r, t in (one, other))
        order = np.argsort(their_times, kind="stable")
        others, their_times = others[order], their_times[order]
        first = np.searchsorted(their_times, times - within)
        after = np.searchsorted(their_times, times + within, side="right")
        mine, theirs = ranges(first, after)
        when = 0.5 * (times[mine] + their_times[theirs])
        mine, theirs = rows[mine], others[theirs]
        same = np.abs(family.delays(mine, when) - family.delays(theirs, when)) < SAME_DELAY
        found.append(np.stack([mine[same], theirs[same]]))
    both = np.concatenate(found, axis=1)
    return both[0], both[1]


def _among(pair: Rows, times: Floats, other_pair: Rows, others: Floats) -> NDArray[np.bool_]:
    """Mask of times of pairs that are, to the last bit, among others of the same pair."""
    known = set(zip(other_pair.tolist(), others.tolist(), strict=True))
    return np.array([moment in known for moment in zip(pair.tolist(), times.tolist(), strict=True)], dtype=bool)
