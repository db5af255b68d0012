"""Tracks of paths over one edge, computed on the device from both sides' isometries and the edge's axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.diffraction import partner_reflections
from clsim.paths.diffraction.family import least_angle
from clsim.paths.diffraction.ways import EdgeView
from clsim.render.opencl.device_nodes import DeviceTracks
from clsim.render.opencl.lookup_tables import end_table, field_tables, transition_table
from clsim.render.opencl.path_kinds import END_CELLS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.opencl.compiler import Compiler
    from clsim.render.plan import Plan
    from clsim.tracks.basis import Basis
    from clsim.tracks.tracks import SceneTracks

# An edge as both ends are seen by it, as in nodes/edge_view.h.
EDGE_VIEW = np.dtype(
    [("source_turn", "f8", 9), ("source_shift", "f8", 3), ("receiver_turn", "f8", 9), ("receiver_shift", "f8", 3),
     ("n", "f8"), ("low", "f8", 2), ("wide", "f8", 2), ("narrow", "f8", 2), ("even", "f8", 2),
     ("odd", "f8", 2), ("end", "f8"), ("lit", "i4", 4), ("end_side", "i4"), ("face", "i4", 2), ("bounces", "i4", 2),
     ("unused", "i4")]
)  # fmt: skip


class EdgeTracks(DeviceTracks):
    """Makes block polynomials of `EdgePaths` with ``tracks.cl``."""

    def __init__(
        self, plan: Plan, tracks: SceneTracks, family: Any, queue: Any, compiler: Compiler, together: int
    ) -> None:
        super().__init__(plan, tracks, family, queue, compiler, together)
        self._transitions = [self._tables_of(filters.basis) for filters in plan.source_filters]

    def _kinds(self) -> dict[str, int]:
        return {"EDGES": 1}

    def _tables_of(self, basis: Basis) -> dict[str, Any]:
        """Make the tables of the transition functions of edges and of their ends at the frequencies of a basis."""
        waves = basis.nodes / self._tracks.scene.air.speed_of_sound
        table, middle = transition_table(waves, basis.parts)
        both = np.concatenate([table, end_table(waves, basis.parts, middle, END_CELLS)])
        return self._uploaded(field_tables=field_tables(waves, both)) | {"middle": middle, "modes": None}

    def _images(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        family, around = self._family, self._surroundings[source]
        edges = np.zeros(len(rows), dtype=EDGE_VIEW)
        sides = (family.before_matrix, family.before_offset), (family.after_matrix, family.after_offset)
        for end, (matrix, offset) in zip(("source", "receiver"), sides, strict=True):
            view = EdgeView.of(matrix[rows], offset[rows], family.frame[rows])
            edges[f"{end}_turn"], edges[f"{end}_shift"] = view.turn.reshape(-1, 9), view.shift
        for name in ("n", "lit", "end_side"):
            edges[name] = getattr(family, name)[rows]
        half_turns, edges["bounces"] = np.pi * edges["n"], partner_reflections(edges["n"])[:, 1:3]
        even, odd = (half_turns * (count // 2) for count in edges["bounces"].T)
        angles = {"wide": half_turns, "narrow": 0.5 * np.pi / edges["n"], "even": even, "odd": odd}
        for name, angle in angles.items():
            edges[name] = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        edges["low"] = np.stack([least_angle(family.n[rows], beside) for beside in family.beside[rows].T], axis=1)
        edges["end"] = np.nan_to_num(family.end_place[rows])
        edges["face"] = around.tables_of(family.faces[rows])
        return self._uploaded(views=edges) | {"image_matrix": None, "image_offset": None}

    def _bounces(self, source: int, rows: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        return self._surroundings[source].bounces_of_sides(*self._family.walls_of_sides(rows))

    def _field(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        factors = self._surroundings[source].reflection(self._family.faces[rows].reshape(-1, 1))
        return self._transitions[source] | self._uploaded(faces=factors.astype(np.float32))
