"""Tracks of paths by scatterers, computed on the device from both sides' isometries and the poses of scatterers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.paths.pose_cubics import pose_knots, pose_rate
from clsim.render.opencl.device_nodes import DeviceTracks
from clsim.render.opencl.path_kinds import CAPSULE, ELLIPSOID, POINT

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.opencl.compiler import Compiler
    from clsim.render.opencl.device_nodes import DeviceChunk, DeviceNodes
    from clsim.render.plan import Plan
    from clsim.tracks.tracks import SceneTracks

_SHAPES = {"point": POINT, "ellipsoid": ELLIPSOID, "capsule": CAPSULE}
_NO_WAY = -1e5  # s, above what the program tells where it found no way
# A scatterer as both ends are seen by it, as in nodes/views.h.
SCATTERER_VIEW = np.dtype(
    [("source_turn", "f8", 9), ("source_shift", "f8", 3), ("receiver_turn", "f8", 9), ("receiver_shift", "f8", 3),
     ("semi_axes", "f8", 3), ("strength", "f8"), ("thing", "i4"), ("turned", "i4"), ("shape", "i4"), ("unused", "i4")]
)  # fmt: skip


class ScattererTracks(DeviceTracks):
    """Makes block polynomials of `ScatteredPaths` with ``tracks.cl``."""

    def __init__(
        self, plan: Plan, tracks: SceneTracks, family: Any, queue: Any, compiler: Compiler, together: int
    ) -> None:
        super().__init__(plan, tracks, family, queue, compiler, together)
        scatterers = tracks.scene.scatterers
        self._motions = [scatterer.trajectory for scatterer in scatterers]
        radii = [scatterer.shape.radius for scatterer in scatterers]
        swiftest = max(filters.swiftness for filters in plan.source_filters)
        # Either leg changes by as much as a scatterer moves.
        tolerance = 10 ** (plan.motion_error_db / 20) * tracks.scene.air.speed_of_sound / (4.0 * math.pi * swiftest)
        self._pose_rate = pose_rate(self._motions, radii, plan.duration, 0.5 * tolerance)
        self._of_shape = np.zeros(len(scatterers), dtype=SCATTERER_VIEW)
        for row, scatterer in zip(self._of_shape, scatterers, strict=True):
            shape = scatterer.shape
            row["shape"] = _SHAPES[shape.kind]
            row["strength"], row["semi_axes"] = getattr(shape, "strongest", 0.0), getattr(shape, "semi_axes", 0.0)
            if shape.kind == "capsule":
                row["semi_axes"] = shape.cylinder_radius, shape.cylinder_radius, 0.5 * shape.length
            row["turned"] = scatterer.trajectory.has_orientation and shape.radius > 0.0
        self._of_shape["thing"] = np.arange(len(scatterers))
        self._transitions: list[dict[str, Any]] = []
        if CAPSULE in self._of_shape["shape"]:
            self._transitions = [self._transition(filters.basis) for filters in plan.source_filters]

    def _kinds(self) -> dict[str, int]:
        return {"SCATTERERS": 1, "MORE": 6}

    def nodes(
        self, chunk: DeviceChunk, start: int, block: int, blocks: int, meanwhile: Callable[[], None] | None = None
    ) -> DeviceNodes:
        """Make the polynomials of `blocks` blocks from a sample on.

        Raises
        ------
        InputError
            If a scatterer is not seen from both ends.
        """
        made = super().nodes(chunk, start, block, blocks, meanwhile)
        if made.shortest < _NO_WAY:
            begin, end = (sample / self._plan.sampling_rate for sample in (start, start + block * blocks))
            raise InputError(
                "scatterers",
                f"must be seen from both ends, but no way by one of them was found from {begin:.6g} to {end:.6g} s",
            )
        return made

    def _images(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        family = self._family
        views = self._of_shape[family.scatterer[rows]]
        for end, side in (("source", "before"), ("receiver", "after")):
            views[f"{end}_turn"] = getattr(family, f"{side}_matrix")[rows].reshape(-1, 9)
            views[f"{end}_shift"] = getattr(family, f"{side}_offset")[rows]
        return self._uploaded(views=views) | {"image_matrix": None, "image_offset": None}

    def _bounces(self, source: int, rows: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        return self._surroundings[source].bounces_of_sides(*self._family.walls_of_sides(rows))

    def _field(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        of_capsules = self._transitions[source] if self._transitions else {}
        return super()._field(source, rows) | of_capsules

    def _poses(self, start: float, end: float) -> dict[str, Any]:
        knots, cells, first = pose_knots(self._motions, start, end, self._pose_rate)
        count = {"pose_count": cells.shape[1] - 1, "first_pose": first, "pose_rate": self._pose_rate}
        return self._uploaded(poses=knots, pose_cells=cells) | count
