"""Beginnings and ends of paths at a corner, given one time where they follow each other more closely than is known.

Where the line of sight, or a mirror path, passes exactly through a corner, paths over both edges, over their ends and
without an edge begin and end together. Each is found by its own test, with its own tolerance: between their times the
sum would jump by as much as the strongest path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.paths.chain import Chain
from clsim.paths.family import ends_at
from clsim.paths.search.edge_chains import SAME_DELAY, delays_of
from clsim.paths.vertices.edge import EdgeVertex
from clsim.paths.visibility.edge_intervals import LONGEST, STEP, indistinct

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.family import PathFamily
    from clsim.scene.scene import Scene

    Rows = NDArray[np.int64]


_WINDOW = 1e-3  # s between two times of one event, at most: ends may go along an edge within the tolerance of outlines
_ROUNDING = 1e-14  # of the room's size, by which lengths of the same way differ
_DETOUR = 1e-13  # of it, over the corner at most: some micrometres beside it, within which tests contradict each other
_STEP = 1e-4  # s, between instants at which the detour over a corner is computed
_ROUNDS = 3  # of Newton's method on its slope


def at_one_time(scene: Scene, found: tuple[PathFamily, ...], resolution: float) -> tuple[PathFamily, ...]:
    """Give one time to all that begins and ends as a corner is passed, in paths without and over edges.

    These are events of one source and one receiver which follow each other by no more than the resolution, s, or the
    tolerance of outlines explains, at which all paths are as long. The first one's time is that of all. Where the way
    over the corner of an edge is the shortest one at an instant, this instant is their time.
    """
    chains = [family for family in found if isinstance(family, Chain)]
    if not any(family.vertex is not None for family in chains):
        return found
    bounds = [[np.array(family.start), np.array(family.end)] for family in chains]
    events = _Events.of(chains, scene)
    for group in _groups(events, resolution):
        events.set(bounds, group, float(np.min(events.time[group])))
    for group, time in _passed_corners(events):
        events.set(bounds, group, time)
    changed = iter([_with_bounds(family, *each) for family, each in zip(chains, bounds, strict=True)])
    return tuple(next(changed) if isinstance(family, Chain) else family for family in found)


def _with_bounds(family: Chain, start: Floats, end: Floats) -> Chain:
    if np.array_equal(start, family.start) and np.array_equal(end, family.end):
        return family
    family = replace(family, start=read_only(start), end=read_only(end))
    return family.part(np.flatnonzero(start < end))


@dataclass(frozen=True, slots=True, eq=False)
class _Events:
    """Beginnings and ends of paths, in order of pairs and times."""

    chains: Sequence[Chain]
    scene: Scene
    pair: Rows  # (n,) which source and receiver
    time: Floats  # (n,) s
    family: Rows  # (n,) which of the chains
    side: Rows  # (n,) 0 for a start, 1 for an end
    row: Rows  # (n,) of the family

    @staticmethod
    def of(chains: Sequence[Chain], scene: Scene) -> _Events:
        parts: list[Any] = []
        for place, family in enumerate(chains):
            pairs = family.source.astype(np.int64) * len(scene.receivers) + family.receiver
            for end, bounds in enumerate((family.start, family.end)):
                some = np.flatnonzero(np.isfinite(bounds))
                parts.append((pairs[some], bounds[some], np.full(len(some), place), np.full(len(some), end), some))
        columns: Any = [np.concatenate(column) for column in zip(*parts, strict=True)]
        order = np.lexsort((columns[1], columns[0]))
        return _Events(chains, scene, *(column[order] for column in columns))

    def set(self, bounds: list[list[Floats]], group: Rows, time: float) -> None:
        """Set the starts and ends of each family to the time of a group of events, s."""
        for family, side, row in zip(self.family[group], self.side[group], self.row[group], strict=True):
            bounds[family][side][row] = time

    def delays(self, which: Rows, instants: Floats) -> Floats:
        """Compute the delays (n,) of the paths of events at instants (n,), s."""
        found = np.empty(len(which))
        for family in np.unique(self.family[which]).tolist():
            mine = self.family[which] == family
            found[mine] = delays_of(self.chains[family], self.row[which[mine]], instants[mine])
        return found

    def detours(self, group: Rows, place: int, instant: float) -> Floats:
        """Compute by how much the path of one event of a group is longer than each of them (n,), m, at an instant, s.

        All are paths of one pair, from where the source was for this event.
        """
        family, row, each = self.family[group], self.row[group], np.empty(len(group))
        delay = self.delays(group[[place]], np.array([instant]))[0]
        for number in np.unique(family).tolist():
            chain, mine = self.chains[number], family == number
            rows = row[mine]
            source = ends_at(self.scene.sources, chain.source[rows], instant - delay)
            each[mine] = chain.lengths(rows, source, ends_at(self.scene.receivers, chain.receiver[rows], instant))
        return np.asarray(each[place] - each)

    def ways_beside_ends(self, group: Rows) -> int:
        """Count the different paths of a group that are not over ends of edges: of those one ends where another begins."""
        ways = set()
        for number, row in zip(self.family[group].tolist(), self.row[group].tolist(), strict=True):
            chain = self.chains[number]
            if not isinstance(chain.vertex, EdgeVertex) or chain.vertex.over_end[row] < 0:
                ways.add((number, *chain.objects[row].tolist()))
        return len(ways)

    def over_edges(self, group: Rows) -> bool:
        return any(self.chains[number].vertex is not None for number in np.unique(self.family[group]).tolist())


def _groups(events: _Events, resolution: float) -> Iterator[Rows]:
    """Yield groups of events that are one."""
    pair, times = events.pair, events.time
    gap = np.where(pair[1:] == pair[:-1], times[1:] - times[:-1], np.inf)
    near = gap <= LONGEST
    near[near] = gap[near] <= _explained(events.scene, pair[1:][near], times[1:][near], resolution)
    for first, after in pairwise([0, *(np.flatnonzero(~near) + 1).tolist(), len(times)]):
        if after - first < 2 or times[after - 1] == times[first]:
            continue
        here = np.arange(first, after)
        delay = events.delays(here, times[here])
        ranks = np.argsort(delay, kind="stable")
        for group in np.split(here[ranks], np.flatnonzero(np.diff(delay[ranks]) >= SAME_DELAY) + 1):
            if events.over_edges(group):
                yield group


def _passed_corners(events: _Events) -> Iterator[tuple[Rows, float]]:
    """Yield groups of events at which a way passes the corner of an edge, and when it does so, s."""
    settled = np.zeros(len(events.time), dtype=bool)
    for turn, group in _beside_turns(events):
        if settled[turn]:
            continue
        place = int(np.flatnonzero(group == turn)[0])
        time, size = float(events.time[turn]), events.scene.room.as_mesh().walls.size
        for _ in range(_ROUNDS):
            before, here, after = (
                float(np.max(events.detours(group, place, time + step))) for step in (-_STEP, 0.0, _STEP)
            )
            bend = before + after - 2.0 * here
            if bend <= 16.0 * _ROUNDING * size:
                break
            time += 0.5 * _STEP * (before - after) / bend
        else:
            there, at = np.abs(events.detours(group, place, time)) <= _DETOUR * size, events.time[group]
            same, together = group[there], np.isin(at, at[there])
            near = np.array_equal(together, there) and np.all(np.abs(at[there] - time) <= _WINDOW)
            if near and events.ways_beside_ends(same) > 1:
                settled[same] = True
                yield same, time


def _beside_turns(events: _Events) -> Iterator[tuple[int, Rows]]:
    """Yield events at which a path over an end of an edge begins, and all (n,) at which paths are nearly as long."""
    vertices = [chain.vertex for chain in events.chains]
    over = np.zeros(len(events.time), dtype=bool)
    for number, vertex in enumerate(vertices):
        if isinstance(vertex, EdgeVertex) and not events.chains[number].legs[0].moving:
            mine = (events.family == number) & (events.side == 0)
            over[mine] = vertex.over_end[events.row[mine]] >= 0
    for pair in np.unique(events.pair[over]).tolist():
        here = slice(*np.searchsorted(events.pair, (pair, pair + 1)).tolist())
        turns, times = here.start + np.flatnonzero(over[here]), events.time[here]
        first = here.start + np.searchsorted(times, events.time[turns] - _WINDOW)
        after = here.start + np.searchsorted(times, events.time[turns] + _WINDOW, "right")
        several = events.time[first] != events.time[after - 1]
        turns, first, count = turns[several], first[several], (after - first)[several]
        turn = np.repeat(np.arange(len(turns)), count)
        near = np.arange(count.sum()) + np.repeat(first - np.cumsum(count) + count, count)
        instants = events.time[turns][turn]
        apart = events.delays(turns, events.time[turns])[turn] - events.delays(near, instants)
        alike = np.abs(apart) < SAME_DELAY
        groups = np.split(near[alike], np.searchsorted(turn[alike], np.arange(len(turns)))[1:])
        for number, group in zip(turns.tolist(), groups, strict=False):
            if np.ptp(events.time[group]) > 0.0:
                yield number, group


def _explained(scene: Scene, pair: Rows, times: Floats, resolution: float) -> Floats:
    """Compute by how much times (n,) of the same event of pairs (n,) may differ, s."""
    source, receiver = np.divmod(pair, len(scene.receivers))
    moved = np.zeros(len(pair))
    for ends, which in ((scene.sources, source), (scene.receivers, receiver)):
        for each in np.unique(which).tolist():
            mine = which == each
            place = ends[each].trajectory.position(times[mine][:, None] + np.array([0.0, STEP]))
            moved[mine] += np.linalg.norm(place[:, 1] - place[:, 0], axis=-1)
    return indistinct(moved, resolution, scene.room.as_mesh().walls.size)
