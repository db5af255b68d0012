"""From a scene file to its paths and the plan of rendering them, for all commands alike."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.commands.console import progress
from clsim.errors import ClsimWarning, InputError
from clsim.paths.find_paths import find_paths
from clsim.render.plan import Plan, plan_render
from clsim.scene.room import Shoebox

if TYPE_CHECKING:
    from clsim.paths.path_set import PathSet
    from clsim.paths.path_table import PathTable
    from clsim.scene.scene import Scene
    from clsim.scene_file import SceneFile


def planned(file: SceneFile, overrides: dict[str, Any]) -> tuple[PathSet, Plan]:
    """Return the paths of a scene file and the plan of rendering them, with overrides of its ``[render]``."""
    search = file.paths | {name: overrides[name] for name in ("engine", "device") if name in overrides}
    try:
        with progress("finding paths", 1.0) as advance:
            done = 0.0

            def report(share: float) -> None:
                nonlocal done
                advance(share - done)
                done = share

            paths = find_paths(file.scene, **search, progress=report)
    except InputError as error:
        raise error.within("paths") from error
    for i in np.setdiff1d(np.arange(len(file.scene.receivers)), paths.receiver):
        name = file.scene.receivers[i].name
        warnings.warn(f"receivers[{i}]: no path reaches {name!r}; it will hear nothing", ClsimWarning, stacklevel=2)
    try:
        plan = plan_render(file.scene, paths, **(file.render | overrides))
    except InputError as error:
        raise error.within("render") from error
    _check_materials(file.scene, plan)
    return paths, plan


def _check_materials(scene: Scene, plan: Plan) -> None:
    """Warn of walls that are not known at the frequencies at which they are rendered, or refuse them."""
    room = scene.room
    materials = dict.fromkeys(room.materials if isinstance(room, Shoebox) else room.wall_materials)
    for material in materials:
        for emission in plan.emissions:
            try:
                material.check_known(emission.basis.nodes)
            except InputError as error:
                raise InputError("room", f"frequency {error.problem}") from error


def path_table(paths: PathSet, plan: Plan, times: Any) -> PathTable:
    """Return the table of paths at times of reception, s, delayed and weakened as the plan renders them."""
    return paths.table(times, plan.tracks.motion, plan.tracks.amplitude)  # type: ignore[attr-defined]
