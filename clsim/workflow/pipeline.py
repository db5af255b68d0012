"""From a scene file to its paths and the plan of rendering them, for all commands alike."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import ClsimWarning, InputError
from clsim.paths.find_paths import find_paths
from clsim.render.planning import plan_render
from clsim.scene_file import referenced_files
from clsim.workflow.console import progress

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from clsim.paths.path_set import PathSet
    from clsim.paths.path_table import PathTable
    from clsim.render.plan import Plan
    from clsim.scene_file import SceneFile


def planned(file: SceneFile, overrides: dict[str, Any]) -> tuple[PathSet, Plan]:
    """Return the paths of a scene file and the plan of rendering them, with overrides of its ``[render]``."""
    paths = found_paths(file, overrides)
    try:
        return paths, plan_render(paths, **(file.render | overrides))
    except InputError as error:
        if error.field.split("[")[0] in ("room", "sources", "receivers"):
            raise
        raise error.within("render") from error


def found_paths(file: SceneFile, overrides: dict[str, Any]) -> PathSet:
    """Return the paths of a scene file, with overrides of its ``[render]``."""
    search = file.paths | {name: overrides[name] for name in ("engine", "device") if name in overrides}
    try:
        with progress("finding paths", 1.0) as advance:
            paths = find_paths(file.scene, **search, progress=shares(advance))
    except InputError as error:
        raise error.within("paths") from error
    except MemoryError as error:
        raise InputError("paths.max_order", "must be smaller: there is not enough memory for so many paths") from error
    for i in np.setdiff1d(np.arange(len(file.scene.receivers)), paths.receiver):
        name = file.scene.receivers[i].name
        warnings.warn(f"receivers[{i}]: no path reaches {name!r}; it will hear nothing", ClsimWarning, stacklevel=2)
    return paths


def read_files(scene: Path, file: SceneFile) -> list[Path]:
    """Return all files that a scene is read from: its own, and those that it names."""
    return [scene, *referenced_files(file)]


def shares(advance: Callable[[float], None]) -> Callable[[float], None]:
    """Return a function that takes the share of the work that is done, for one that takes what was done since."""
    done = 0.0

    def report(share: float) -> None:
        nonlocal done
        advance(share - done)
        done = share

    return report


def path_table(paths: PathSet, plan: Plan, times: Any) -> PathTable:
    """Return the table of paths at times of reception, s, delayed and weakened as the plan renders them."""
    return paths.table(times, plan.options.motion, plan.options.amplitude)
