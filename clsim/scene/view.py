"""From a scene to what a page shows of it: walls, and the ways of sources and receivers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.quaternions import rotate
from clsim.pictures.view_page import ViewedBody, ViewedEnd, ViewedPaths, ViewedWall, page_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.arrays import Floats
    from clsim.scene.body import Body
    from clsim.scene.ends import End
    from clsim.scene.room.protocol import Room
    from clsim.scene.scatterer import Scatterer

    Ends = Sequence[tuple[str, End | Scatterer]]  # as `Scene.named_ends` and `named_scatterers` give them
    Bodies = Sequence[tuple[str, Body]]

_TRAIL = 400  # points of a drawn trajectory


def scene_page(room: Room, ends: Ends, bodies: Bodies, frames: int, title: str) -> str:
    """Return the page of a room and of what moves in it: frames from 0 s until the first trajectory ends."""
    moving = [*ends, *bodies]
    times = frame_times(moving, known_until(moving), frames)
    nothing = ViewedPaths.none()
    return page_text(
        title=title, walls=viewed_walls(room), ends=viewed_ends(ends, times), times=times,
        frames=[nothing] * len(times), bodies=viewed_bodies(bodies, times),
    )  # fmt: skip


def known_until(ends: Sequence[tuple[str, End | Scatterer | Body]]) -> float:
    """Return until when all trajectories are known, s; 0 where nothing moves."""
    finite = [item.trajectory.end for _, item in ends if np.isfinite(item.trajectory.end)]
    return float(min(finite, default=0.0))


def frame_times(ends: Sequence[tuple[str, End | Scatterer | Body]], duration: float, frames: int) -> Floats:
    """Return the instants (F,) of a page, s: one where nothing moves."""
    moves = any(np.isfinite(item.trajectory.end) for _, item in ends)
    return np.linspace(0.0, duration, frames) if moves and frames > 1 else np.zeros(1)


def viewed_walls(room: Room) -> list[ViewedWall]:
    """Return the walls of a room as they are drawn."""
    mesh = room.as_mesh()
    names = {id(m): m.name or m.describe() for m in mesh.faces.materials}
    corners = mesh.vertices[mesh.triangles]
    walls = []
    for w, name in enumerate(mesh.faces.names):
        mine = corners[mesh.walls.of_triangle == w]
        walls.append(ViewedWall(name, names[id(mesh.faces.materials[w])], mine, mesh.walls.edges_of(w)))
    return walls


def viewed_ends(ends: Ends, times: Floats) -> list[ViewedEnd]:
    """Return sources and receivers with their positions at times (F,), s, as they are drawn."""
    found = []
    for field, item in ends:
        first, last = item.time_range
        trail = item.trajectory.position(np.linspace(first, max(last, first), _TRAIL if last > first else 1))
        at = item.trajectory.position(np.clip(times, first, last) if np.isfinite(item.trajectory.end) else times)
        aims = _aims(item, np.clip(times, first, last))
        found.append(ViewedEnd(item.name, field.split("s[")[0], np.atleast_2d(at), np.atleast_2d(trail), aims))
    return found


def viewed_bodies(bodies: Bodies, times: Floats) -> list[ViewedBody]:
    """Return bodies with their poses at times (F,), s, as they are drawn."""
    found = []
    for _, body in bodies:
        origin = body.placed(np.zeros(3), times)
        axes = np.stack([body.placed(axis, times) - origin for axis in np.eye(3)], axis=1)
        vertices, triangles = body.mesh.vertices, body.mesh.triangles
        found.append(ViewedBody(body.name, vertices, triangles, origin, axes))
    return found


def _aims(item: End | Scatterer, times: Floats) -> Floats | None:
    """Return the unit vectors (F, 3) in which the axis of a source or receiver points, None for one that has no aim."""
    aim: Floats | None = getattr(item, "aim", None)
    if aim is not None:
        return np.broadcast_to(aim / np.linalg.norm(aim), (len(times), 3))
    if not item.trajectory.has_orientation:
        return None
    return rotate(item.trajectory.orientation(times), (1.0, 0.0, 0.0))
