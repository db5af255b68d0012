"""From a scene to its paths."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from clsim.arrays import as_choice, as_count, as_number
from clsim.errors import InputError
from clsim.paths.options import FamilyFinder, PathSearch, RoomFinder
from clsim.paths.path_set import PathSet
from clsim.paths.search.bodies import BodySearch
from clsim.paths.search.body_edges import moving_edge_paths
from clsim.paths.search.body_scatterers import body_scattered_paths
from clsim.paths.search.cross_talk import direct_levels, with_direct
from clsim.paths.search.edges import double_edge_paths, edge_paths
from clsim.paths.search.mesh import FINDERS, mesh_paths, report
from clsim.paths.search.scatterers import LARGEST_SCATTERING_ORDER, scattered_paths, sides
from clsim.paths.search.shoebox import shoebox_paths
from clsim.paths.vertices.edge import LAWS
from clsim.paths.visibility.hidden import behind_bodies
from clsim.paths.without_edges import warn_without_edges
from clsim.plugins import PATH_FAMILIES, ROOMS, with_plugins
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from clsim.paths.chain import Chain
    from clsim.paths.family import PathFamily
    from clsim.paths.search.cross_talk import DirectSound

DEFAULT_PATH_LIMIT = 10_000_000  # about 1.5 GiB
LARGEST_DIFFRACTION = 2
ENGINES = ("opencl", "reference")


def find_paths(
    scene: Scene,
    max_order: int,
    *,
    diffraction: int = 0,
    diffraction_model: str = "utd",
    scattering_order: int = 0,
    body_order: int | None = None,
    body_step: float = 0.01,
    direct: DirectSound = True,
    path_limit: int = DEFAULT_PATH_LIMIT,
    finder: str = "auto",
    resolution: float | None = None,
    engine: str = "opencl",
    device: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> PathSet:
    """Return every path of a scene up to an order.

    Parameters
    ----------
    scene : Scene
        What sounds where.
    max_order : int
        Largest number of reflections, 0 for the direct sound alone.
    diffraction : int
        Largest number of edges that a path turns round: 0, 1 for paths with one edge and up to `max_order` reflections
        before and after it, of the room or of bodies, or 2 for those over two edges of one face of the room as well.
    diffraction_model : {"utd", "btm"}
        Of the field at an edge: the uniform theory of diffraction, for some 5 kHz and more, or the exact field of a
        wedge (Biot, Tolstoy, Medwin, Svensson), for audio and for ends near an edge. Paths over two edges are those of
        "utd".
    scattering_order : int
        Largest number of reflections on the way to a scatterer, and of those on the way from it, 0 to 3. An echo of N
        walls has the shadow of a sphere if it is at least N.
    body_order : int, optional
        Largest number of reflections of paths by bodies; `max_order`, which it does not exceed, when left out.
    body_step : float
        How far bodies, source and receiver together go from one look to the next at paths over edges and by
        scatterers that bodies may hide, and at others where no bound holds, 10 um to 1 m; what comes and goes between
        two looks is missed.
    direct : bool, float or mapping
        Whether paths by nothing are among them; without them a sonar hears no cross-talk of its own source, and with
        `max_order` 0 nothing but echoes of scatterers. A number is their level relative to the free direct sound, dB,
        as behind a baffle; a mapping of (source, receiver), by their names, to either is for these pairs alone.
    path_limit : int
        Number of paths above which the search is refused or given up.
    finder : {"auto", "beam-tree", "shooting"}
        How wall sequences are found in a mesh: by a tree of beams, which misses none, or by rays, which can miss small
        walls and needs embreex; "auto" shoots only where the tree would be far too large, with a warning.
    resolution : float, optional
        To which ends of intervals are found in a mesh, s; 1/16 sample of the fastest sampled signal when left out.
    engine : {"opencl", "reference"}
        What validates paths in a mesh: a device with float64, or NumPy, also taken (with a warning) where there is no
        such device.
    device : str, optional
        As in `render`.
    progress : callable, optional
        Called now and then with the share of the work that is done, 0 to 1.

    Returns
    -------
    PathSet
        Paths sorted by source, receiver and order. In a shoebox every image is heard all the time; in a mesh a path has
        one row for every interval in which it is heard, and emission times decide.

    Raises
    ------
    InputError
        If the order is out of range, the paths would be more than `path_limit`, or their search would take too long;
        the message says what to change.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.1, sampling_rate=192e3)
    >>> robot = clsim.Source("robot", tone, clsim.Trajectory.fixed((4.0, 3.0, 1.5)))
    >>> ceiling = clsim.Receiver("ceiling", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))
    >>> len(clsim.find_paths(clsim.Scene(room, clsim.Air(), [robot], [ceiling]), max_order=3))
    63
    """
    if not isinstance(scene, Scene):
        raise InputError("scene", f"must be a Scene, but is {scene!r:.80}")
    as_choice("finder", finder, FINDERS)
    as_choice("engine", engine, ENGINES)
    if resolution is not None:
        resolution = as_number("resolution", resolution, at_least=1e-9, at_most=1.0, unit="s")
    limit, levels = as_count("path_limit", path_limit, at_least=1), direct_levels(scene, direct)
    as_choice("diffraction_model", diffraction_model, tuple(LAWS))
    edges = as_count("diffraction", diffraction, at_most=LARGEST_DIFFRACTION)
    tell = progress or (lambda share: None)
    legs = as_count("scattering_order", scattering_order, at_most=LARGEST_SCATTERING_ORDER)
    by_bodies = None if body_order is None else as_count("body_order", body_order)
    step = as_number("body_step", body_step, at_least=1e-5, at_most=1.0, unit="m")
    search = PathSearch(
        max_order, edges, diffraction_model, legs, by_bodies, step, limit, finder, resolution, engine, device, tell
    )
    finders = with_plugins(FAMILY_FINDERS, PATH_FAMILIES)
    steps = len(finders) + edges
    parts = _parts(search, steps + (steps + 1 if scene.bodies else 0))
    found = tuple(find(scene, next(parts)) for find in finders.values())
    for kind in (edge_paths, double_edge_paths)[:edges]:
        found = (*found, kind(scene, next(parts), found))
    if scene.bodies:
        bodies = BodySearch(scene, search)
        found = tuple(behind_bodies(bodies, family, next(parts).progress) for family in found)
        found = (*found, bodies.paths(next(parts).progress))
        if edges:
            found = (*found, moving_edge_paths(bodies, found))
    if scene.scatterers:
        found = (*found, *_scattered(scene, search))
    paths = PathSet(scene, with_direct(found, levels))
    if not edges:
        warn_without_edges(paths, search.max_order, partial(find_paths, engine=engine, device=device))
    return paths


def _scattered(scene: Scene, search: PathSearch) -> list[PathFamily]:
    """Return the paths by scatterers: of walls alone, and with faces of bodies where there are any."""
    asked = replace(search, max_order=search.scattering_order, progress=lambda share: None)
    legs, by_bodies = [], []
    for side in sides(scene, scene.bodies):
        found = _specular_paths(side, asked)
        if scene.bodies:
            bodies = BodySearch(side, asked)
            found = behind_bodies(bodies, found)
            by_bodies.append(bodies.paths())
        legs.append(cast("Chain", found))
    both: list[PathFamily] = [scattered_paths(scene, search, *legs)]
    if scene.bodies:
        both.append(body_scattered_paths(scene, search, *zip(legs, by_bodies, strict=True)))
    return both


def _parts(search: PathSearch, count: int) -> Iterator[PathSearch]:
    """Yield what is asked of each of several kinds of paths, whose shares of the work are even parts of all."""
    for i in range(count):
        yield replace(search, progress=partial(report, search.progress, i / count, (i + 1) / count))


def _specular_paths(scene: Scene, search: PathSearch) -> PathFamily:
    """Return the paths that walls reflect, by the finder of the kind of room."""
    rooms: dict[str, Any] = with_plugins({}, ROOMS)
    finders: dict[type, RoomFinder] = ROOM_FINDERS | {kind: kind.find_paths for kind in rooms.values()}
    find = next((finders[kind] for kind in type(scene.room).__mro__ if kind in finders), None)
    if find is None:
        kinds = " or ".join(kind.__name__ for kind in finders)
        raise InputError("scene.room", f"must be a {kinds} to find paths, but is {scene.room!r:.80}")
    return find(scene, scene.room, search)


ROOM_FINDERS: dict[type, RoomFinder] = {Shoebox: shoebox_paths, MeshRoom: mesh_paths}
FAMILY_FINDERS: dict[str, FamilyFinder] = {"specular": _specular_paths}  # in the order of the rows of a PathSet
