"""Tracks of paths by bodies, computed on the device from the walls at rest, as images, and from faces that move."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.moving.face_cubics import face_knots, face_rate
from clsim.paths.moving.mirrors import ROOM
from clsim.render.opencl.device_nodes import DeviceTracks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.opencl.compiler import Compiler
    from clsim.paths.family import Rows
    from clsim.paths.moving.family import BodyPaths
    from clsim.render.plan import Plan
    from clsim.tracks.tracks import SceneTracks

_SHARE = 0.1  # of what sources may be wrong by: mirrors that are off displace images by twice as much, each of them
# A mirror as a path sees it, as in nodes/views.h.
BODY_VIEW = np.dtype([("turn", "f8", 9), ("shift", "f8", 3), ("most", "f8"), ("face", "i4"), ("unused", "i4")])


class BodyTracks(DeviceTracks):
    """Makes block polynomials of `BodyPaths` with ``tracks.cl``."""

    _family: BodyPaths

    def __init__(
        self, plan: Plan, tracks: SceneTracks, family: Any, queue: Any, compiler: Compiler, together: int
    ) -> None:
        mirrors, scene = family.mirrors, tracks.scene
        still = np.array([body.is_static for body in mirrors.bodies])
        # In wind everything moves through the air.
        self._moves = (mirrors.owner != ROOM) & ~still[mirrors.owner] | (scene.air.wind is not None)
        of_paths = self._moving(family.surfaces)
        self._most = max(int(of_paths.sum(axis=1).max(initial=0)), 1)  # mirrors that move on a path
        self._faces = np.unique(family.surfaces[of_paths])
        every, nothing = np.arange(len(mirrors.owner)), np.zeros((len(mirrors.owner), 1))
        planes = mirrors.planes(every, nothing, nothing, None)  # of those at rest; the last row is that of no mirror
        self._normal = np.concatenate([np.where(self._moves[:, None], 0.0, planes.normal[:, 0]), np.zeros((1, 3))])
        self._offset = np.append(np.where(self._moves, 0.0, planes.offset[:, 0]), 0.0)
        peak = np.array([body.peak_speed for body in mirrors.bodies])[mirrors.owner]
        c = float(family.speed_range.slowest)
        self._peak = np.where(mirrors.owner == ROOM, 0.0, np.minimum(2.0 * peak, 0.5 * (peak + c)))
        swiftest = max(filters.swiftness for filters in plan.source_filters)
        tolerance = 10 ** (plan.motion_error_db / 20) * c / (2.0 * math.pi * swiftest)
        self._face_rate = face_rate(mirrors, plan.duration, _SHARE * tolerance)
        super().__init__(plan, tracks, family, queue, compiler, together)

    def _moving(self, surfaces: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return a mask (P, N) of the mirrors of paths that move."""
        return np.asarray((surfaces >= 0) & self._moves[surfaces])

    def _kinds(self) -> dict[str, int]:
        return {"BODIES": self._most, "MORE": 4 * self._most}

    def _met(self, rows: Rows) -> NDArray[np.signedinteger[Any]]:
        return self._family.surfaces[rows]

    def _images(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        matrix, offset, views, _ = self._seen(self._family.surfaces[rows])
        columns = {"image_matrix": matrix.reshape(-1, 9).T, "image_offset": offset.T, "views": views}
        return self._uploaded(**columns)

    def _seen(self, surfaces: NDArray[np.int32]) -> tuple[Floats, Floats, NDArray[Any], Floats]:
        """Return the views of paths by mirrors (P, N) from the source's own room: of the receiver, and of mirrors.

        Shapes: result (P, 3, 3), (P, BODIES), (P, N, 3).
        """
        count, every = len(surfaces), np.arange(len(surfaces))
        matrix, offset = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        views, filled = np.zeros((count, self._most), dtype=BODY_VIEW), np.zeros(count, dtype=np.int64)
        views["face"] = -1
        normal = np.zeros((*surfaces.shape, 3))
        moving = self._moving(surfaces)
        for bounce, met in enumerate(surfaces.T):
            here = every[moving[:, bounce]]
            view = np.zeros(len(here), dtype=BODY_VIEW)
            view["turn"], view["shift"] = matrix[here].reshape(-1, 9), offset[here]
            view["most"], view["face"] = self._peak[met[here]], np.searchsorted(self._faces, met[here])
            views[here, filled[here]] = view
            filled[here] += 1
            wall, height = self._normal[met], self._offset[met]
            normal[:, bounce] = np.einsum("pji,pj->pi", matrix, wall)
            matrix = matrix - 2.0 * wall[:, :, None] * np.einsum("pi,pij->pj", wall, matrix)[:, None]
            offset = offset - 2.0 * (np.sum(wall * offset, axis=1) - height)[:, None] * wall
        return matrix, offset, views, normal

    def _bounces(self, source: int, rows: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return mirrors that depend on the angle, see ``body_gains.h``, with the normals of those at rest."""
        around, surfaces = self._surroundings[source], self._family.surfaces[rows]
        wall_of, columns = around.no_bounces(len(rows))
        if not around.angular:
            return wall_of, columns
        table, moving, normal = around.tables_of(surfaces), self._moving(surfaces), self._seen(surfaces)[3]
        before, filled = np.zeros(len(rows), dtype=np.int64), np.zeros(len(rows), dtype=np.int64)
        for bounce in range(surfaces.shape[1]):
            here = np.flatnonzero(table[:, bounce] >= 0)
            code = table[here, bounce] * (self._most + 1) + before[here]
            wall_of[filled[here], here] = 2 * code + moving[here, bounce]
            columns[filled[here], :, here] = normal[here, bounce]
            filled[here] += 1
            before += moving[:, bounce]
        return wall_of, columns

    def _poses(self, start: float, end: float) -> dict[str, Any]:
        knots, first = face_knots(self._family.mirrors, self._faces, start, end, self._face_rate)
        told = {"pose_cells": None, "pose_count": knots.shape[1], "first_pose": first, "pose_rate": self._face_rate}
        return self._uploaded(poses=knots) | told
