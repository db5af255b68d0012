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
    """The arguments of `find_paths`, checked.

    Attributes
    ----------
    max_order : int
        Largest number of reflections; at least 0, and how many there may be is the finder's to say.
    diffraction : int
        Largest number of edges that a path turns round, 0 to 2.
    diffraction_model : str
        Of the field at an edge.
    scattering_order : int
        Largest number of reflections before a scatterer, and of those after it.
    body_order : int or None
        Largest number of reflections of paths by bodies; `max_order` when None.
    body_step : float
        How far all that moves goes from one look at paths by and behind bodies to the next, m.
    path_limit : int
        Number of paths of a kind above which the search is refused or given up.
    finder : str
        How wall sequences are found in a mesh.
    resolution : float or None
        To which ends of intervals are found, s; chosen by the finder when None.
    engine, device : str, str or None
        What validates paths.
    progress : callable
        Takes the share of the work that is done.
    """

    max_order: int
    diffraction: int
    diffraction_model: str
    scattering_order: int
    body_order: int | None
    body_step: float
    path_limit: int
    finder: str
    resolution: float | None
    engine: str
    device: str | None
    progress: Callable[[float], None]


RoomFinder = Callable[["Scene", Any, PathSearch], "PathFamily"]  # scene, its room, what is asked
FamilyFinder = Callable[["Scene", PathSearch], "PathFamily"]
