"""Intervals in which paths over edges are there: those of their two sides, one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.diffraction import ON_LINE
from clsim.paths.diffraction.between import FaceLegs
from clsim.paths.diffraction.visibility import CONTRACTED, CONTRACTIONS, FAR, EdgeVisibility
from clsim.paths.specular.intervals import Intervals, find_intervals, merged

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.diffraction.visibility import EdgeCandidates
    from clsim.paths.specular.device_intervals import DeviceSearch
    from clsim.paths.specular.intervals import VisibilityQuery
    from clsim.scene.room.edges import Edges

    Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSearch:
    """Answers one query for paths over the edges of a room: on a device with float64, or by its NumPy twin."""

    query: VisibilityQuery  # room, ends and resolution
    edges: Edges  # of the room
    device: DeviceSearch | None  # of the same query; NumPy when None

    def find(self, candidates: EdgeCandidates) -> Intervals:
        """Return the intervals in which candidates are there.

        The side of the receiver is looked at while that of the source is there: most candidates are gone by then. The
        way between two edges comes last, on the host: mostly nothing stands there.
        """
        row, receiver = np.arange(len(candidates.edge)), candidates.receiver
        begin, end, evaluations = self.query.first[receiver], self.query.last[receiver], 0
        for side in (0, 1):
            found = self._find(candidates, side, row, (begin, end))
            row, begin, end = row[found.path], found.begin, found.end
            evaluations += found.evaluations
        legs = FaceLegs(EdgeVisibility(self.edges, candidates), self.query.walls)
        hindered = legs.hindered(row)
        if not hindered.any():
            return merged(row, begin, end, evaluations)
        asked, spans = row[hindered], (begin[hindered], end[hindered])
        found = find_intervals(self.query, asked.astype(np.int32)[:, None], receiver[asked], legs.evaluate, spans)
        parts = (row, asked[found.path]), (begin, found.begin), (end, found.end)
        row, begin, end = (np.concatenate([free[~hindered], rest]) for free, rest in parts)
        return merged(row, begin, end, evaluations + found.evaluations)

    def _find(self, candidates: EdgeCandidates, side: int, row: Rows, spans: tuple[Floats, Floats]) -> Intervals:
        """Return when one side of some candidates is there within spans of time."""
        if self.device is None:
            evaluate = partial(EdgeVisibility(self.edges, candidates).evaluate, side)
            sequence = row.astype(np.int32)[:, None]
            return find_intervals(self.query, sequence, candidates.receiver[row], evaluate, spans)
        mine, other = (candidates.before, candidates.after)[:: 1 - 2 * side]
        edges = self.edges
        columns: dict[str, NDArray[Any]] = {
            "sequences": mine[row], "others": other[row], "edge_of": candidates.edge[row],
            "face_of": candidates.face[row],
            "end_of": candidates.end[row], "receiver_of": candidates.receiver[row],
        }  # fmt: skip
        constants = {"AT_EDGE": 1, "CONTRACTIONS": CONTRACTIONS, "CONTRACTED": CONTRACTED, "HALF_TURN": np.pi,
            "ON_LINE": ON_LINE}  # fmt: skip
        others = {
            "other_count": other.shape[1], "from_receiver": side, "far": FAR * self.query.walls.size,
            "edges": np.column_stack([edges.frames.reshape(-1, 12), edges.length, edges.n]),
        }  # fmt: skip
        return self.device.settle("edge_intervals", constants, columns, spans, others)
