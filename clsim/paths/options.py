"""The options of a search for paths: their types, defaults, bounds and docstring."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

from clsim.arrays import as_choice, as_count, as_flag, as_number
from clsim.paths.family import PathFamily
from clsim.scene.scene import Scene

DEFAULT_PATH_LIMIT = 10_000_000  # about 1.5 GiB
DIFFRACTION_MODELS = ("utd", "btm")
LARGEST_DIFFRACTION = 3
LARGEST_SCATTERING_ORDER = 3
LARGEST_ROW = 2
FINDERS = ("auto", "beam-tree", "shooting")
ENGINES = ("opencl", "reference")

DirectSound = bool | float | Mapping[tuple[str, str], bool | float]


@dataclass(frozen=True, slots=True)
class PathOptions:
    """Options of a search for paths, checked as a whole.

    Parameters
    ----------
    max_order : int
        Largest number of reflections, 0 for the direct sound alone.
    diffraction : int
        Largest number of edges of a path: 0 to 3. With 1, paths have one edge, of the room or of a body, and up to
        `max_order` reflections before and after it. With 2, paths over two edges are found as well: over two of one
        face, or with air and reflections between them. With 3, paths over three edges of the room are found as well,
        each of which shares a face with the next. Paths by bodies have at most two edges.
    diffraction_model : {"utd", "btm"}
        Law of the field at an edge. "utd" is the uniform theory of diffraction, for some 5 kHz and more. "btm" is the
        exact field of a wedge (Biot, Tolstoy, Medwin, Svensson), for audio and for ends near an edge. Paths over two
        edges are those of "utd".
    scattering_order : int
        Largest number of reflections on the way to a scatterer, and of those on the way from it, 0 to 3. An echo of N
        walls has the shadow of a sphere if it is at least N.
    scatterers_in_row : int
        Largest number of scatterers that a path meets one after another, 1 or 2. Paths by two go straight from the
        first to the second, with up to `scattering_order` reflections by walls before and after them.
    edge_scattering : bool
        Whether paths over one edge of the room and by one scatterer are found, in either order. They have up to
        `scattering_order` reflections by walls before the scatterer and after it. With `diffraction` 2 there may be an
        edge on either side of it.
    body_order : int, optional
        Largest number of reflections of paths by bodies; `max_order`, which it does not exceed, when left out.
    body_step : float
        Largest movement of bodies, source and receiver together from one evaluation to the next, 10 um to 1 m. It
        applies to paths over edges and by scatterers that bodies may hide, and to others for which no bound holds.
        Changes between two evaluations are missed.
    direct : bool, float or mapping
        Whether direct paths are among them. False leaves out the direct sound from a sonar's own source. A number is
        their level relative to the free direct sound, dB, as behind a baffle. A mapping of (source, receiver), by their
        names, to either is for these pairs alone. The
        reflection in a face that both ends sit in counts as direct sound. It must be False for a source and a receiver
        at the same place, such as a transducer that receives its own echo.
    path_limit : int
        Number of paths above which the search is refused or given up.
    finder : {"auto", "beam-tree", "shooting"}
        Search for wall sequences in a mesh. A tree of beams misses none. Shooting rays can miss small walls and
        needs embreex. "auto" shoots only where the tree would be far too large, with a warning.
    resolution : float, optional
        To which ends of intervals are found in a mesh, s; 1/16 sample of the fastest sampled signal when left out.
    engine : {"opencl", "reference"}
        Where paths in a mesh are validated: a device with float64, or NumPy, taken (with a warning) where there is no
        such device.
    device : str, optional
        As in `render`.
    progress : callable, optional
        Called now and then with the share of the work that is done, 0 to 1.
    """

    max_order: int
    _: KW_ONLY
    diffraction: int = 0
    diffraction_model: str = "utd"
    scattering_order: int = 0
    scatterers_in_row: int = 1
    edge_scattering: bool = False
    body_order: int | None = None
    body_step: float = 0.01
    direct: DirectSound = True
    path_limit: int = DEFAULT_PATH_LIMIT
    finder: str = "auto"
    resolution: float | None = None
    engine: str = "opencl"
    device: str | None = None
    progress: Callable[[float], None] | None = None

    def __post_init__(self) -> None:
        as_choice("finder", self.finder, FINDERS)
        as_choice("engine", self.engine, ENGINES)
        checked: dict[str, Any] = {"max_order": as_count("max_order", self.max_order)}
        if self.resolution is not None:
            checked["resolution"] = as_number("resolution", self.resolution, at_least=1e-9, at_most=1.0, unit="s")
        checked["path_limit"] = as_count("path_limit", self.path_limit, at_least=1)
        as_choice("diffraction_model", self.diffraction_model, DIFFRACTION_MODELS)
        checked["diffraction"] = as_count("diffraction", self.diffraction, at_most=LARGEST_DIFFRACTION)
        most = LARGEST_SCATTERING_ORDER
        checked["scattering_order"] = as_count("scattering_order", self.scattering_order, at_most=most)
        most = LARGEST_ROW
        checked["scatterers_in_row"] = as_count("scatterers_in_row", self.scatterers_in_row, at_least=1, at_most=most)
        checked["edge_scattering"] = as_flag("edge_scattering", self.edge_scattering)
        if self.body_order is not None:
            checked["body_order"] = as_count("body_order", self.body_order)
        checked["body_step"] = as_number("body_step", self.body_step, at_least=1e-5, at_most=1.0, unit="m")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def notify(self, share: float) -> None:
        """Report the share of the work that is done, 0 to 1."""
        if self.progress is not None:
            self.progress(share)


RoomFinder = Callable[["Scene", Any, PathOptions], "PathFamily"]  # scene, its room, options
FamilyFinder = Callable[["Scene", PathOptions], "PathFamily"]
