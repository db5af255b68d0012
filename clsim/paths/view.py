"""From a scene and its paths to an interactive page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.files.atomic import atomic_path
from clsim.paths.family import DIFFRACTION
from clsim.paths.path_table import PathTable
from clsim.pictures.view_page import ViewedBody, ViewedEnd, ViewedFlaws, ViewedPaths, ViewedWall, page_text
from clsim.scene.room.edges import Edges
from clsim.scene.scene import Scene, frame_times, viewed_bodies, viewed_ends, viewed_flaws, viewed_walls

_SEEN = 1e-4  # m, to which the page rounds


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What a page shows: walls, ends, bodies, and the paths at F times, s; see `view_page`. Notes tell what is not.

    Edges (E, 2, 3) m are those that diffract, where paths over edges were looked for.
    """

    walls: tuple[ViewedWall, ...]
    ends: tuple[ViewedEnd, ...]
    times: Floats
    frames: tuple[ViewedPaths, ...]
    notes: tuple[str, ...]
    edges: Floats
    bodies: tuple[ViewedBody, ...]
    flaws: ViewedFlaws


class Viewable(Protocol):
    """What a page asks of a `PathSet`, which shows itself by this file."""

    @property
    def scene(self) -> Scene:
        """Where the paths are."""

    @property
    def interactions(self) -> NDArray[np.signedinteger[Any]]:
        """What happens on each path's way (paths, N)."""

    def table(self, times: Floats, motion: str, amplitude: str) -> PathTable:
        """Table of every path."""

    def vertices(self, time: float, motion: str) -> Floats:
        """Return the vertices of every path (paths, N + 2, 3), m."""


def view_scene(paths: Viewable, page: Path, *, title: str = "scene", **options: Any) -> None:
    """Write a page that shows the room, the trajectories and the paths over time."""
    text = paths_page(paths, title=title, **options)
    with atomic_path(page) as temporary:
        temporary.write_text(text, "utf-8")


def paths_page(paths: Viewable, *, title: str, **options: Any) -> str:
    """Return the text of that page; what is given is as in `view_scene`."""
    view = viewed(paths, **options)
    return page_text(
        title=title, walls=view.walls, ends=view.ends, times=view.times, frames=view.frames, notes=view.notes,
        edges=view.edges, bodies=view.bodies, flaws=view.flaws,
    )  # fmt: skip


def viewed(
    paths: Viewable,
    *,
    duration: float,
    frames: int = 120,
    limit: int = 300,
    motion: str = "retarded",
    amplitude: str = "wave-equation",
    progress: Callable[[float], None] | None = None,
) -> View:
    """Return the room, the trajectories and the paths over time, as they are drawn.

    frames: instants between 0 and `duration` to choose from; of those between which nothing moves only the first is
    kept.

    limit: paths that are drawn at a time, the strongest; levels are told against the strongest of them.
    """
    scene = paths.scene
    things = [*scene.named_ends(), *scene.named_scatterers()]
    times = frame_times([*things, *scene.named_bodies()], duration, frames)
    ends, bodies = viewed_ends(things, times), viewed_bodies(scene.named_bodies(), times)
    shown: list[ViewedPaths] = []
    kept: list[int] = []
    for i, time in enumerate(times):
        now = _paths_at(paths, float(time), limit, motion, amplitude)
        rests = bool(kept) and all(_alike(end.positions[i], end.positions[kept[-1]]) for end in ends)
        rests = rests and all(_alike(body.corners(i), body.corners(kept[-1])) for body in bodies)
        if not (rests and _same(now, shown[-1])):
            shown.append(now)
            kept.append(i)
        if progress is not None:
            progress(1.0)
    still = tuple(replace(end, positions=end.positions[kept]) for end in ends)
    most = max(len(frame.order) for frame in shown)
    notes = (f"Only the {limit} strongest paths are drawn and counted.",) if most == limit else ()
    edges = scene.room.edges() if np.any(paths.interactions == DIFFRACTION) else Edges.none()
    return View(
        tuple(viewed_walls(scene.room)),
        still,
        times[kept],
        tuple(shown),
        notes,
        np.stack([edges.start, edges.stop], axis=1),
        tuple(replace(body, places=body.places[kept], axes=body.axes[kept]) for body in bodies),
        viewed_flaws(scene.room),
    )


def _alike(one: Floats, other: Floats) -> bool:
    """Test if points coincide with others, as far as the page shows."""
    return bool(np.all(np.abs(one - other) < _SEEN))


def _same(one: ViewedPaths, other: ViewedPaths) -> bool:
    """Test if two frames show the same paths."""
    return one.labels == other.labels and all(map(_alike, one.vertices, other.vertices))


def _paths_at(paths: Viewable, time: float, limit: int, motion: str, amplitude: str) -> ViewedPaths:
    """Return the strongest paths that are heard at a time."""
    table = paths.table(np.array([time]), motion, amplitude)
    audible = np.flatnonzero(table.audible[:, 0])
    gain = np.abs(table.gain[audible, 0])
    level = 20.0 * np.log10(gain / gain.max(initial=0.0))
    strongest = np.argsort(-level, kind="stable")[:limit]
    audible, level = audible[strongest], level[strongest]
    vertices = paths.vertices(time, motion)[audible]
    names = [
        f"{table.source_names[table.source[p]]} to {table.receiver_names[table.receiver[p]]}, "
        + table.name_objects(p)
        + f": {table.delay[p, 0] * 1e3:.3f} ms, {decibels + 0.0:.1f} dB"
        for p, decibels in zip(audible, level, strict=True)
    ]
    order = table.order[audible]
    pairs = tuple((table.source_names[table.source[p]], table.receiver_names[table.receiver[p]]) for p in audible)
    drawn = tuple(c[: n + 2] for c, n in zip(vertices, order, strict=True))
    return ViewedPaths(drawn, order, tuple(names), pairs, level)
