"""From a scene to what a page shows of it: walls, and the ways of sources and receivers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.pictures.view_page import ViewedEnd, ViewedPaths, ViewedWall, page_text

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.scene import Scene

_TRAIL = 400  # points of a drawn trajectory


def scene_page(scene: Scene, frames: int, title: str) -> str:
    """Return the page of a scene without paths: frames from 0 s until the first trajectory ends."""
    times = frame_times(scene, known_until(scene), frames)
    nothing = ViewedPaths((), np.zeros(0, dtype=np.int32), ())
    ends = viewed_ends(scene, times)
    return page_text(title=title, walls=viewed_walls(scene), ends=ends, times=times, frames=[nothing] * len(times))


def known_until(scene: Scene) -> float:
    """Return until when all trajectories are known, s; 0 where nothing moves."""
    ends = [item.trajectory.end for _, item in scene.named_ends() if np.isfinite(item.trajectory.end)]
    return float(min(ends, default=0.0))


def frame_times(scene: Scene, duration: float, frames: int) -> Floats:
    """Return the instants (F,) of a page, s: one where nothing moves."""
    moves = any(np.isfinite(item.trajectory.end) for _, item in scene.named_ends())
    return np.linspace(0.0, duration, frames) if moves and frames > 1 and duration > 0.0 else np.zeros(1)


def viewed_walls(scene: Scene) -> list[ViewedWall]:
    """Return the walls of a scene as they are drawn."""
    mesh = scene.room.as_mesh()
    names = {id(m): m.name or m.describe() for m in mesh.faces.materials}
    corners = mesh.vertices[mesh.triangles]
    walls = []
    for w, name in enumerate(mesh.faces.names):
        mine = corners[mesh.walls.of_triangle == w]
        walls.append(ViewedWall(name, names[id(mesh.faces.materials[w])], mine, mesh.walls.edges_of(w)))
    return walls


def viewed_ends(scene: Scene, times: Floats) -> list[ViewedEnd]:
    """Return sources and receivers with their positions at times (F,), s, as they are drawn."""
    found = []
    for field, item in scene.named_ends():
        first, last = item.time_range
        trail = item.trajectory.position(np.linspace(first, max(last, first), _TRAIL if last > first else 1))
        at = item.trajectory.position(np.clip(times, first, last) if np.isfinite(item.trajectory.end) else times)
        found.append(ViewedEnd(item.name, field.split("s[")[0], np.atleast_2d(at), np.atleast_2d(trail)))
    return found
