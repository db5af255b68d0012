"""Tracks of paths by scatterers, computed on the device from both sides' isometries and the poses of scatterers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.sphere import sphere_modes
from clsim.errors import InputError
from clsim.paths.pose_cubics import pose_knots, pose_rate
from clsim.render.opencl.device_nodes import DeviceTracks
from clsim.render.opencl.lookup_tables import field_tables, transition_table
from clsim.render.opencl.path_kinds import CAPSULE, ELLIPSOID, NO_WAY, POINT, SPHERE

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.opencl.compiler import Compiler
    from clsim.render.opencl.device_nodes import DeviceChunk, DeviceNodes
    from clsim.render.plan import Plan
    from clsim.tracks.basis import Basis
    from clsim.tracks.tracks import SceneTracks

_SHAPES = {"point": POINT, "ellipsoid": ELLIPSOID, "capsule": CAPSULE, "sphere": SPHERE}
# A scatterer as both ends are seen by it, as in nodes/views.h.
SCATTERER_VIEW = np.dtype(
    [("source_turn", "f8", 9), ("source_shift", "f8", 3), ("receiver_turn", "f8", 9), ("receiver_shift", "f8", 3),
     ("semi_axes", "f8", 3), ("strength", "f8"), ("thing", "i4"), ("turned", "i4"), ("shape", "i4"),
     ("first_mode", "i4"), ("modes", "i4"), ("least", "i4")]
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
            row["strength"], row["semi_axes"] = getattr(shape, "strongest", 0.0), shape.semi_axes
            row["turned"] = scatterer.trajectory.has_orientation and shape.radius > 0.0
        self._of_shape["thing"] = np.arange(len(scatterers))
        self._shapes = [self._of_shape.copy() for _ in plan.source_filters]
        self._tables = [
            self._tables_of(views, f.basis) for views, f in zip(self._shapes, plan.source_filters, strict=True)
        ]

    def _kinds(self) -> dict[str, int]:
        return {"SCATTERERS": 1, "MORE": 6}

    def nodes(
        self, chunk: DeviceChunk, start: int, block: int, blocks: int, meanwhile: Callable[[], None] | None = None
    ) -> DeviceNodes:
        """Make the polynomials of `blocks` blocks from a sample on."""
        made = super().nodes(chunk, start, block, blocks, meanwhile)
        if made.shortest < 0.5 * NO_WAY:  # less a clock's error
            begin, end = (sample / self._plan.sampling_rate for sample in (start, start + block * blocks))
            raise InputError(
                "scatterers",
                f"must be seen from both ends, but no way by one of them was found from {begin:.6g} to {end:.6g} s",
            )
        return made

    def _tables_of(self, views: NDArray[Any], basis: Basis) -> dict[str, Any]:
        """Return the tables of capsules and spheres, as of `_field`; where those of spheres begin stands in views."""
        if views["shape"].max() < CAPSULE:
            return {}
        waves = basis.nodes / self._tracks.scene.air.speed_of_sound
        table, middle = transition_table(waves, basis.parts)
        parts: list[Floats] = [np.zeros((0, len(waves)))]
        for view in np.flatnonzero(views["shape"] == SPHERE):
            modes = sphere_modes(tuple((2.0 * np.pi * waves * views["semi_axes"][view, 0]).tolist()))
            factors = np.stack([modes.step, modes.back, modes.weight.real, modes.weight.imag], axis=1)
            views["first_mode"][view] = sum(part.size for part in parts)
            views["modes"][view], views["least"][view] = len(factors), math.ceil(float(modes.ka.max()))
            parts += [modes.ka[None], factors.reshape(-1, len(waves))]
        known = np.concatenate(parts)
        found = self._uploaded(field_tables=field_tables(waves, table))
        return found | {"middle": middle, "modes": self._upload(known) if known.size else None}

    def _images(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        family = self._family
        views = self._shapes[source][family.scatterer[rows]]
        for end, side in (("source", "before"), ("receiver", "after")):
            views[f"{end}_turn"] = getattr(family, f"{side}_matrix")[rows].reshape(-1, 9)
            views[f"{end}_shift"] = getattr(family, f"{side}_offset")[rows]
        return self._uploaded(views=views) | {"image_matrix": None, "image_offset": None}

    def _bounces(self, source: int, rows: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        return self._surroundings[source].bounces_of_sides(*self._family.walls_of_sides(rows))

    def _field(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        return super()._field(source, rows) | self._tables[source]

    def _poses(self, start: float, end: float) -> dict[str, Any]:
        knots, cells, first = pose_knots(self._motions, start, end, self._pose_rate)
        count = {"pose_count": cells.shape[1] - 1, "first_pose": first, "pose_rate": self._pose_rate}
        return self._uploaded(poses=knots, pose_cells=cells) | count
