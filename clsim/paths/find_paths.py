"""From a scene to its paths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_count, as_number, ranges, read_only
from clsim.errors import InputError, warn
from clsim.keywords import keywords_of
from clsim.paths.chain import Chain
from clsim.paths.family import BODY, SPECULAR, PathFamily
from clsim.paths.legs.legs import image_columns
from clsim.paths.options import DirectSound, FamilyFinder, PathOptions, RoomFinder
from clsim.paths.path_set import PathSet
from clsim.paths.response import QUASI_STATIC
from clsim.paths.search.bodies import BodySearch
from clsim.paths.search.body_edge_ends import moving_end_paths
from clsim.paths.search.body_edge_pairs import moving_edge_pair_paths, moving_gap_paths
from clsim.paths.search.body_edges import moving_edge_paths
from clsim.paths.search.edge_ends import end_edge_paths
from clsim.paths.search.edge_gaps import gap_edge_paths
from clsim.paths.search.edge_scatterers import as_met, edge_scatterer_paths
from clsim.paths.search.edge_thirds import third_edge_paths
from clsim.paths.search.edges import EdgePaths
from clsim.paths.search.fades import Fading
from clsim.paths.search.mesh import mesh_paths, report, resolution_of
from clsim.paths.search.same_events import at_one_time
from clsim.paths.search.scatterers import Side, scattered_paths, sides
from clsim.paths.search.shades import shaded_paths
from clsim.paths.vertices.scatterer_pair import scatterer_pair_paths
from clsim.paths.without_edges import warn_without_edges, warn_without_shadows
from clsim.plugins import PATH_FAMILIES, ROOMS, with_plugins
from clsim.scene.placement import together
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.scene import Scene, hidden_by_several


@keywords_of(PathOptions, Scene)
def find_paths(scene: Scene, options: PathOptions) -> PathSet:
    """Return every path of a scene up to an order.

    Parameters
    ----------
    scene : Scene
        Room, air, sources and receivers.
    options : PathOptions
        Each is a keyword, but for the first, the largest order.

    Returns
    -------
    PathSet
        Paths sorted by source, receiver and order. In a shoebox every image is always active; in a mesh a path has
        one row for every interval in which it is active, and emission times decide.

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
    levels, search = direct_levels(scene, options.direct), _Search(scene, options)
    found = (*search.unscattered, *search.scattered())
    paths = PathSet(scene, found if np.all(levels == 1.0) else with_direct(found, levels))
    if scene.scatterers:
        warn_without_shadows(paths, options.scattering_order)
    if not options.diffraction:
        again = partial(find_paths, engine=options.engine, device=options.device)
        warn_without_edges(paths, options.max_order, again)
    return paths


@dataclass(frozen=True, eq=False)
class _Search:
    """Looks for the paths of a scene, kind after kind."""

    scene: Scene
    options: PathOptions

    @cached_property
    def unscattered(self) -> tuple[PathFamily, ...]:
        """The paths that meet no scatterer."""
        scene, options, edges = self.scene, self.options, _KINDS[self.options.diffraction]
        finders = with_plugins(FAMILY_FINDERS, PATH_FAMILIES)
        steps = len(finders) + edges
        parts = _parts(options, steps + (steps + 1 if scene.bodies else 0))
        found = tuple(find(scene, next(parts)) for find in finders.values())
        if edges:
            of_room = EdgePaths(scene, options)
            for over_edges in OVER_EDGES[:edges]:
                found = (*found, over_edges(of_room, found, next(parts).notify))
            found = at_one_time(scene, found, resolution_of(scene, options.resolution))
        if scene.bodies:
            bodies = BodySearch(scene, options)
            found = tuple(bodies.unhidden(family, next(parts).notify) for family in found)
            found = (*found, bodies.paths(next(parts).notify))
            for of_bodies in OVER_BODIES[:edges]:
                found = (*found, of_bodies(bodies, found))
        if edges and options.edge_fades:
            found = Fading(found, options.direct is True).families
        return found

    def scattered(self) -> list[PathFamily]:
        """Find the paths by scatterers, by walls alone and with faces of bodies, and shadows on paths by walls."""
        scene, search = self.scene, self.options
        if not scene.scatterers:
            return []
        given = replace(search, max_order=search.scattering_order, progress=None)
        by_walls, by_bodies, over_edges, cut_off = [], [], [], False
        for side in sides(scene, scene.bodies):
            walls: Any = _specular_paths(side, given)
            cut_off |= bool(np.any(np.isfinite(walls.start) | np.isfinite(walls.end)))
            edges: Any = EdgePaths(side, given).over_one((walls,)) if search.edge_scattering else None
            if scene.bodies:
                bodies = BodySearch(side, given)
                walls = bodies.unhidden(walls)
                edges = edges and bodies.unhidden(edges)
                by_bodies.append(Side.of(walls, bodies.paths()))
            by_walls.append(Side.of(walls))
            over_edges.append(edges)
        both = (by_walls, by_bodies) if scene.bodies else (by_walls,)
        order, limit = search.scattering_order, search.path_limit
        found: list[PathFamily] = [scattered_paths(scene, before, after, order, limit) for before, after in both]
        first, second = by_walls
        several = hidden_by_several(scene.sources, scene.receivers, scene.scatterers)
        if several:
            what = "their shadows add up, and too much is heard behind them"
            warn(f'{several}: {what}; model="outline" of spheres mends it')
        if search.scatterers_in_row > 1:
            straight_on = partial(_unreflected, search=given)
            found.append(scatterer_pair_paths(scene, (first, second), straight_on, limit))
        if search.edge_scattering:
            twice = search.diffraction > 1
            over = edge_scatterer_paths(scene, (first, second), (over_edges[0], over_edges[1]), twice, limit)
            found[0], *over = as_met([found[0], *over])
            found += over
        elif search.diffraction and cut_off:
            warn("scatterers go behind edges, where their echoes end at once (edge_scattering=True lets them fade)")
        if any(scatterer.shape.outlined for scatterer in scene.scatterers):
            shaded = (shaded_paths(scene, cast("Any", each), order) for each in self.unscattered if each.is_specular)
            found += [paths for paths in shaded if len(paths)]
        return found


def _unreflected(scene: Scene, search: PathOptions) -> Side:
    """Find the paths that nothing reflects, where no body is in the way."""
    paths: Any = _specular_paths(scene, replace(search, max_order=0))
    if scene.bodies:
        paths = BodySearch(scene, search).unhidden(paths)
    return Side.of(paths)


def _parts(search: PathOptions, count: int) -> Iterator[PathOptions]:
    """Yield what is asked of each of several kinds of paths, whose shares of the work are even parts of all."""
    for i in range(count):
        yield replace(search, progress=partial(report, search.notify, i / count, (i + 1) / count))


def _specular_paths(scene: Scene, search: PathOptions) -> PathFamily:
    """Return the paths that walls reflect, by the finder of the kind of room."""
    rooms: dict[str, Any] = with_plugins({}, ROOMS)
    finders: dict[type, RoomFinder] = ROOM_FINDERS | {kind: kind.find_paths for kind in rooms.values()}
    find = next((finders[kind] for kind in type(scene.room).__mro__ if kind in finders), None)
    if find is None:
        kinds = " or ".join(kind.__name__ for kind in finders)
        raise InputError("scene.room", f"must be a {kinds} to find paths, but is {scene.room!r:.80}")
    return find(scene, scene.room, search)


@dataclass(frozen=True, slots=True, eq=False)
class ShoeboxImages:
    """Images of one source: isometries of its trajectory, the same wherever it is."""

    order: NDArray[np.int32]  # (images,) number of reflections
    walls: NDArray[np.int8]  # (images, max_order) walls from the source's side, filled up with -1
    matrix: Floats  # (images, 3, 3) orthogonal matrix A of ``x -> A x + b``
    offset: Floats  # (images, 3) offset b, m


def shoebox_paths(scene: Scene, room: Shoebox, search: PathOptions) -> Chain:
    """Return every path of a shoebox up to an order: each image is active all the time."""
    order = as_count("max_order", search.max_order, at_most=_LARGEST_ORDER)
    pairs, images = len(scene.sources) * len(scene.receivers), shoebox_image_count(order)
    if images * pairs > search.path_limit:
        raise InputError(
            "max_order",
            f"must give at most {search.path_limit} paths (path_limit), but {order} gives {images} images "
            f"for each of {pairs} pairs of source and receiver",
        )
    found = shoebox_images(room.size, order)
    source, receiver = np.divmod(np.repeat(np.arange(pairs, dtype=np.int32), images), len(scene.receivers))
    begin, end = np.broadcast_to(-np.inf, images * pairs), np.broadcast_to(np.inf, images * pairs)
    ends = [read_only(which.astype(np.int32, copy=False)) for which in (source, receiver)]
    walls, orders = read_only(np.tile(found.walls, (pairs, 1))), read_only(np.tile(found.order, pairs))
    matrix, offset = read_only(np.tile(found.matrix, (pairs, 1, 1))), read_only(np.tile(found.offset, (pairs, 1)))
    return Chain(scene, ends[0], ends[1], orders, begin, end, **image_columns(walls, matrix, offset))


def shoebox_image_count(max_order: int) -> int:
    """Return the number of images of a shoebox up to an order: ``1 + 2 N (2 N^2 + 3 N + 4) / 3``."""
    n = max_order
    return 1 + 2 * n * (2 * n * n + 3 * n + 4) // 3


def shoebox_images(size: Floats, max_order: int) -> ShoeboxImages:
    """Return every image of a shoebox of a size (3,), m, up to an order, sorted by order.

    Along one axis, cell m of the mirrored rooms holds the image ``m L + x`` for even m and ``(m + 1) L - x`` for odd m,
    after ``|m|`` reflections: on the maximum wall last for m > 0, on the minimum wall last for m < 0 (Allen and
    Berkley, J. Acoust. Soc. Am. 65, 1979). Reflections are listed axis by axis, x first: in which order a path meets
    walls of different axes depends on where its ends are.
    """
    cells = np.arange(-max_order, max_order + 1)
    grid = np.stack(np.meshgrid(cells, cells, cells, indexing="ij"), axis=-1).reshape(-1, 3)
    order = np.abs(grid).sum(axis=1)
    grid, order = grid[order <= max_order], order[order <= max_order]
    rank = np.lexsort((grid[:, 2], grid[:, 1], grid[:, 0], order))
    grid, order = grid[rank], order[rank]
    odd = grid % 2 != 0
    matrix = np.zeros((len(grid), 3, 3))
    matrix[:, range(3), range(3)] = np.where(odd, -1.0, 1.0)
    offset = np.where(odd, grid + 1, grid) * np.asarray(size, dtype=np.float64)
    return ShoeboxImages(order.astype(np.int32), _walls(grid, max_order), matrix, offset)


def _walls(grid: NDArray[np.int64], max_order: int) -> NDArray[np.int8]:
    """List the walls of every image: along an axis they alternate and end on the side of the cell."""
    walls = np.full((len(grid), max_order), -1, dtype=np.int8)
    before = np.zeros(len(grid), dtype=np.int64)
    for axis in range(3):
        count = np.abs(grid[:, axis])
        image, step = ranges(np.zeros_like(count), count)
        # The last reflection is on the side of the cell; each one before it is on the opposite wall of the next.
        last = 2 * axis + (grid[image, axis] > 0)
        walls[image, before[image] + step] = last ^ ((count[image] - 1 - step) % 2)
        before += count
    return walls


_KINDS = 0, 1, 4, 5  # of paths over edges, by `diffraction`
OVER_EDGES = EdgePaths.over_one, EdgePaths.over_pairs, gap_edge_paths, end_edge_paths, third_edge_paths
OVER_BODIES = moving_edge_paths, moving_edge_pair_paths, moving_gap_paths, moving_end_paths
ROOM_FINDERS: dict[type, RoomFinder] = {Shoebox: shoebox_paths, MeshRoom: mesh_paths}
FAMILY_FINDERS: dict[str, FamilyFinder] = {"specular": _specular_paths}  # in the order of the rows of a PathSet


_LARGEST_ORDER = 60  # of a shoebox
_FLUSH = 5e-6  # m over a face, up to which an end sits in it


def direct_levels(scene: Scene, direct: DirectSound) -> Floats:
    """Return the pressure of the direct sound (sources, receivers) over that in the open, as it is wanted."""
    levels = np.ones((len(scene.sources), len(scene.receivers)))
    if not isinstance(direct, Mapping):
        levels[:] = _pressure("direct", direct)
        return _checked(scene, levels)
    names = [[end.name for end in ends] for ends in (scene.sources, scene.receivers)]
    for pair, value in direct.items():
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise InputError("direct", f"must have pairs (source, receiver) of names for keys, but has {pair!r:.80}")
        for kind, name, known in zip(("source", "receiver"), pair, names, strict=True):
            if name not in known:
                listed = ", ".join(map(repr, known[:8])) + (", ..." if len(known) > 8 else "")
                raise InputError("direct", f"must name a {kind} of the scene ({listed}), but names {name!r:.80}")
        place = names[0].index(pair[0]), names[1].index(pair[1])
        levels[place] = _pressure(f"direct[{pair[0]}, {pair[1]}]", value)
    return _checked(scene, levels)


def _checked(scene: Scene, levels: Floats) -> Floats:
    """Refuse direct sound from a source to a receiver at the same place, which would be infinite."""
    for s, r in np.argwhere(levels != 0.0).tolist():
        source, receiver = scene.sources[s], scene.receivers[r]
        if together(source, receiver):
            raise InputError(
                "direct",
                f"must be False for {source.name!r} and {receiver.name!r}, which are at the same place, "
                f"but is {True if levels[s, r] == 1.0 else float(20.0 * np.log10(levels[s, r]))!r:.20}",
            )
    return levels


def with_direct(families: tuple[PathFamily, ...], levels: Floats) -> tuple[PathFamily, ...]:
    """Return paths with direct ones scaled by levels (sources, receivers): 1 changes nothing, 0 leaves them out."""
    free: list[PathFamily] = []
    leaks: list[PathFamily] = []
    for family in families:
        level = np.where(_is_direct(family, levels), levels[family.source, family.receiver], 1.0)
        free.append(family.part(np.flatnonzero(level == 1.0)))
        rows = np.flatnonzero((level != 0.0) & (level != 1.0))
        if len(rows):
            leaks.append(replace(cast("Any", family.part(rows)), level=read_only(level[rows])))
    return (*(family for family in free if len(family) or not family.adds), *leaks)


def _is_direct(family: PathFamily, levels: Floats) -> NDArray[np.bool_]:
    """Return a mask of paths that meet nothing, or, between scaled pairs, only the face that both ends sit in.

    With heights h over a face its reflection has the length L, and ``4 h1 h2 = L^2 - d^2`` with the distance d.
    """
    direct: NDArray[np.bool_] = np.equal(family.order, 0)
    scene = family.scene
    for p in np.flatnonzero((family.order == 1) & (levels[family.source, family.receiver] != 1.0)).tolist():
        if family.interactions[p, 0] not in (SPECULAR, BODY):
            continue
        source, receiver = scene.sources[family.source[p]], scene.receivers[family.receiver[p]]
        now = np.array([np.clip(max(family.start[p], 0.0), source.trajectory.start, source.trajectory.end)])
        length = float(family.arrivals(np.array([p]), now, QUASI_STATIC).length[0, 0])
        apart = receiver.trajectory.position(now) - source.trajectory.position(now)
        direct[p] = length**2 - float(np.sum(apart**2)) < 4.0 * _FLUSH**2
    return direct


def _pressure(field: str, value: Any) -> float:
    """Return the pressure that a level, dB, stands for; True is 1 and False 0."""
    if isinstance(value, bool | np.bool_):
        return float(value)
    if not isinstance(value, int | float | np.integer | np.floating) or not value < 0.0:  # neither 1 nor 0 is a level
        raise InputError(field, f"must be True, False or a level below 0 dB, but is {value!r:.80}")
    return float(10.0 ** (as_number(field, value) / 20.0))
