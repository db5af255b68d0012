"""Paths straight through thin panels: which panels each passes, and when.

Panels that let sound pass hide nothing of paths by walls alone. These are found as if panels only reflected, and then
divided in time by the panels that their legs cross. Which these are changes only where a leg touches an edge of a
panel: an end that touches a panel is refused before, and a point of reflection changes sides only past an edge of the
panel, or at a line along which both walls meet. So the subdivision that finds when paths are valid finds crossings too.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.visibility.clearance import blocks, segments_apart, unfold
from clsim.paths.visibility.intervals import ends_about, find_intervals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.search.beam_tree import FoundPaths
    from clsim.paths.visibility.intervals import VisibilityQuery
    from clsim.scene.room.walls import Walls

    Ints = NDArray[np.int64]

THROUGH = -2  # less the wall: a panel that a path passes through, among the walls that it meets


def see_through(walls: Walls, panels: tuple[int, ...]) -> Walls:
    """Mark panels, by numbers of their planes below 0, as walls that hide nothing."""
    plane, outward, which = walls.plane.copy(), walls.outward.copy(), list(panels)
    plane[which] = -1 - plane[which]
    outward[np.isin(walls.shell, walls.shell[which])] = 0  # paths are on both sides of them
    return replace(walls, plane=plane, outward=outward)


def divided(query: VisibilityQuery, found: FoundPaths, panels: tuple[int, ...]) -> FoundPaths:
    """Divide paths by the panels that they cross: `met` holds these among the walls, and `order` counts both."""
    span = np.maximum(found.begin, query.first[found.receiver]), np.minimum(found.end, query.last[found.receiver])
    crossed = _crossings(query, found, panels, span)
    row, begin, end = _pieces(span, crossed)
    middle = 0.5 * (begin + end)
    begin = np.where(begin <= span[0][row], found.begin[row], begin)
    end = np.where(end >= span[1][row], found.end[row], end)
    # Of each piece: its walls, at whole numbers along the path, and the panels of its legs between these.
    walls = found.walls[row]
    piece, bounce = np.nonzero(walls >= 0)
    entries = [(piece, bounce + 1.0, walls[piece, bounce])]
    of_path = np.searchsorted(row, np.stack([crossed[0], crossed[0] + 1]))
    for path, leg, panel, first, last, low, high in zip(*crossed, *of_path, strict=True):
        mine = low + np.flatnonzero((first < middle[low:high]) & (middle[low:high] < last))
        share = _share(query, found, path, leg, panel, middle[mine])
        entries.append((mine, leg + share, np.full(len(mine), THROUGH - panel)))
    piece, place, thing = (np.concatenate([each[i] for each in entries]) for i in range(3))
    ranks = np.lexsort((place, piece))
    piece, thing, order = piece[ranks], thing[ranks], np.bincount(piece, minlength=len(row))
    met = np.full((len(row), int(order.max(initial=0))), -1, dtype=np.int32)
    met[piece, np.arange(len(piece)) - (np.cumsum(order) - order)[piece]] = thing
    rank = np.lexsort([begin, *met.T[::-1], order, found.receiver[row]])
    return replace(
        found, receiver=found.receiver[row][rank], order=order[rank], walls=walls[rank], begin=begin[rank],
        end=end[rank], met=met[rank],
    )  # fmt: skip


def _crossings(
    query: VisibilityQuery, found: FoundPaths, panels: tuple[int, ...], span: tuple[Floats, Floats]
) -> tuple[Any, ...]:
    """Find which paths cross which panels, on which legs, and when: path, leg, panel (n,), begin, end (n,) s."""
    parts: list[tuple[Any, ...]] = [(*(np.empty(0, dtype=np.int64),) * 3, np.empty(0), np.empty(0))]
    bounces = np.sum(found.walls >= 0, axis=1)
    for count in np.unique(bounces).tolist():
        rows = np.flatnonzero(bounces == count)
        sequence, spans = found.walls[rows, :count], (span[0][rows], span[1][rows])
        for panel in panels:
            for leg in range(count + 1):
                looks = partial(_evaluate, panel, leg)
                crossed = find_intervals(query, sequence, found.receiver[rows], looks, spans)
                each = (np.full(len(crossed.path), x) for x in (leg, panel))
                parts.append((rows[crossed.path], *each, crossed.begin, crossed.end))
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


def _evaluate(
    panel: int, leg: int, query: VisibilityQuery, sequence: NDArray[np.int32], receiver: Ints, time: Floats,
    half: Floats,
) -> tuple[NDArray[np.bool_], Floats, Floats]:  # fmt: skip
    """Test whether a leg of paths crosses a panel, how far ends may move before that changes, and how far they do."""
    walls = query.walls
    source, ear, reach = ends_about(query, sequence, receiver, time, half)
    paths = unfold(walls, sequence, source, ear, reach)
    tau, slack = paths.tau, paths.slack
    a, b = paths.along(leg, tau[:, leg]), paths.along(leg, tau[:, leg + 1])
    crossed = blocks(walls, panel, a, b)
    a = paths.along(leg, np.maximum(tau[:, leg] - slack[:, leg], 0.0))
    b = paths.along(leg, np.minimum(tau[:, leg + 1] + slack[:, leg + 1], 1.0))
    clear = segments_apart(walls.edges_of(panel), a, b).min(axis=1, initial=np.inf)
    plane = np.maximum(walls.plane, -1 - walls.plane)
    for k in (leg - 1, leg):  # what is reflected in the plane of a panel does not cross it
        if 0 <= k < sequence.shape[1]:
            beside = plane[sequence[:, k]] == plane[panel]
            crossed[beside], clear[beside] = False, np.inf
    return crossed, clear, reach.most


def _pieces(span: tuple[Floats, Floats], crossed: tuple[Any, ...]) -> tuple[Ints, Floats, Floats]:
    """Divide spans of paths where a panel begins or ceases to be crossed: path (n,), begin, end (n,) s."""
    every = np.arange(len(span[0]))
    path = np.concatenate([every, crossed[0], crossed[0], every])
    time = np.concatenate([span[0], crossed[3], crossed[4], span[1]])
    path, time = np.unique(np.stack([path, time]), axis=1)
    row = path.astype(np.int64)
    inner = np.flatnonzero(row[1:] == row[:-1])
    return row[inner], time[inner], time[inner + 1]


def _share(query: VisibilityQuery, found: FoundPaths, path: int, leg: int, panel: int, times: Floats) -> Floats:
    """Find at which share of a leg (n,) a path crosses a panel at times (n,)."""
    walls, receiver = query.walls, np.full(len(times), found.receiver[path])
    met = found.walls[path][found.walls[path] >= 0]
    sequence = np.tile(met, (len(times), 1))
    source, ear, reach = ends_about(query, sequence, receiver, times, np.zeros(len(times)))
    paths = unfold(walls, sequence, source, ear, reach)
    a, b = (paths.along(leg, paths.tau[:, leg + i]) @ walls.normal[panel] - walls.offset[panel] for i in range(2))
    return np.asarray(a / (a - b))
