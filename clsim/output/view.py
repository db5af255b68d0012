"""From a scene and its paths to an interactive page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.output.view_page import ViewedEnd, ViewedPaths, ViewedWall, write_page
from clsim.scene.mesh_room import MeshRoom

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from clsim.arrays import Floats
    from clsim.paths.path_set import PathSet
    from clsim.scene.material import Material
    from clsim.scene.scene import Scene

_TRAIL = 400  # points of a drawn trajectory


def view_scene(
    paths: PathSet,
    page: Path,
    *,
    duration: float,
    frames: int = 120,
    limit: int = 300,
    title: str = "scene",
    motion: str = "retarded",
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a page that shows the room, the trajectories and the paths over time.

    Parameters
    ----------
    paths : PathSet
        What is shown, with its scene.
    page : Path
        Of the HTML file.
    duration : float
        Of the run, s.
    frames : int
        Instants between 0 and `duration` to choose from; one if nothing moves.
    limit : int
        Paths that are drawn at a time, the strongest.
    title : str
        Above the picture.
    motion : {"retarded", "quasi-static"}
        As in `render`.
    progress : callable, optional
        Called with 1 for every frame.
    """
    scene = paths.scene
    moves = any(np.isfinite(item.trajectory.end) for _, item in scene.named_ends())
    times = np.linspace(0.0, duration, frames) if moves and frames > 1 else np.zeros(1)
    shown = []
    for time in times:
        shown.append(_paths_at(paths, float(time), limit, motion))
        if progress is not None:
            progress(1.0)
    write_page(page, title=title, walls=_walls(scene), ends=_ends(scene, times), times=times, frames=shown)


def _paths_at(paths: PathSet, time: float, limit: int, motion: str) -> ViewedPaths:
    """Return the strongest paths that are heard at a time."""
    table = paths.table(np.array([time]), motion)
    heard = np.flatnonzero(np.isfinite(table.delay[:, 0]))
    level = 20.0 * np.log10(np.maximum(np.abs(table.gain[heard, 0]), 1e-15))
    heard = heard[np.argsort(-level, kind="stable")[:limit]]
    corners = paths.corners(time, motion)[heard]
    names = [
        f"{table.source_names[table.source[p]]} to {table.receiver_names[table.receiver[p]]}, "
        + (", ".join(table.wall_names[w] for w in table.walls[p] if w >= 0) or "direct")
        + f": {table.delay[p, 0] * 1e3:.3f} ms, {20.0 * np.log10(max(abs(table.gain[p, 0]), 1e-15)):.1f} dB"
        for p in heard
    ]
    order = table.order[heard]
    return ViewedPaths(tuple(c[: n + 2] for c, n in zip(corners, order, strict=True)), order, tuple(names))


def _walls(scene: Scene) -> list[ViewedWall]:
    room = scene.room
    mesh = room if isinstance(room, MeshRoom) else MeshRoom.joined([room])
    names = {id(m): _material_name(m) for m in mesh.wall_materials}
    corners = mesh.vertices[mesh.triangles]
    walls = []
    for w, name in enumerate(mesh.wall_names):
        mine = corners[mesh.walls.of_triangle == w]
        walls.append(ViewedWall(name, names[id(mesh.wall_materials[w])], mine, mesh.walls.edges_of(w)))
    return walls


def _material_name(material: Material) -> str:
    if material.name:
        return material.name
    if material.reflection is not None:
        return f"reflection {material.reflection:g}"
    return "absorption table"


def _ends(scene: Scene, times: Floats) -> list[ViewedEnd]:
    found = []
    for field, item in scene.named_ends():
        first, last = scene.span(item)
        trail = item.trajectory.position(np.linspace(first, max(last, first), _TRAIL if last > first else 1))
        at = item.trajectory.position(np.clip(times, first, last) if np.isfinite(item.trajectory.end) else times)
        found.append(ViewedEnd(item.name, field.split("s[")[0], np.atleast_2d(at), np.atleast_2d(trail)))
    return found
