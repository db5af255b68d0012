"""What is asked of a search for paths, of any kind and in any room."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clsim.paths.family import PathFamily
    from clsim.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class PathSearch:
    """The arguments of `find_paths`, checked."""

    max_order: int  # largest number of reflections; at least 0, and how many there may be is the finder's to say
    diffraction: int  # largest number of edges that a path turns round, 0 to 2
    diffraction_model: str  # of the field at an edge
    scattering_order: int  # largest number of reflections before a scatterer, and of those after it
    body_order: int | None  # largest number of reflections of paths by bodies; `max_order` when None
    body_step: float  # how far all that moves goes from one look at paths by and behind bodies to the next, m
    path_limit: int  # number of paths of a kind above which the search is refused or given up
    finder: str  # how wall sequences are found in a mesh
    resolution: float | None  # to which ends of intervals are found, s; chosen by the finder when None
    engine: str  # what validates paths
    device: str | None  # likewise
    progress: Callable[[float], None]  # takes the share of the work that is done


RoomFinder = Callable[["Scene", Any, PathSearch], "PathFamily"]  # scene, its room, what is asked
FamilyFinder = Callable[["Scene", PathSearch], "PathFamily"]
