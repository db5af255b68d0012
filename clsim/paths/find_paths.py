"""From a scene to its paths."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import as_choice, as_count, as_number, read_only
from clsim.errors import InputError
from clsim.paths.path_set import PathSet
from clsim.paths.specular.mesh import FINDERS, MeshSearch, image_isometries, report
from clsim.paths.specular.shoebox import shoebox_image_count, shoebox_images
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Callable

LARGEST_ORDER = 60
LARGEST_MESH_ORDER = 20
DEFAULT_PATH_LIMIT = 10_000_000  # about 1.5 GiB
ENGINES = ("opencl", "reference")


def find_paths(
    scene: Scene,
    max_order: int,
    *,
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
    limit = as_count("path_limit", path_limit, at_least=1)
    if isinstance(scene.room, Shoebox):
        return _shoebox_paths(scene, scene.room, as_count("max_order", max_order, at_most=LARGEST_ORDER), limit)
    order = as_count("max_order", max_order, at_most=LARGEST_MESH_ORDER)
    if not isinstance(scene.room, MeshRoom):
        raise InputError("scene.room", f"must be a Shoebox or a MeshRoom to find paths, but is {scene.room!r:.80}")
    search = MeshSearch(order, finder, resolution, limit, engine, device)
    return _mesh_paths(scene, scene.room, search, progress or (lambda share: None))


def _shoebox_paths(scene: Scene, room: Shoebox, order: int, path_limit: int) -> PathSet:
    pairs = len(scene.sources) * len(scene.receivers)
    images = shoebox_image_count(order)
    if images * pairs > path_limit:
        raise InputError(
            "max_order",
            f"must give at most {path_limit} paths (path_limit), but {order} gives {images} images "
            f"for each of {pairs} pairs of source and receiver",
        )
    found = shoebox_images(room.size, order)
    source, receiver = np.divmod(np.repeat(np.arange(pairs, dtype=np.int32), images), len(scene.receivers))
    return PathSet(
        scene=scene,
        source=read_only(source.astype(np.int32, copy=False)),
        receiver=read_only(receiver.astype(np.int32, copy=False)),
        order=read_only(np.tile(found.order, pairs)),
        walls=read_only(np.tile(found.walls, (pairs, 1))),
        image_matrix=read_only(np.tile(found.matrix, (pairs, 1, 1))),
        image_offset=read_only(np.tile(found.offset, (pairs, 1))),
        start=np.broadcast_to(-np.inf, images * pairs),
        end=np.broadcast_to(np.inf, images * pairs),
    )


def _mesh_paths(scene: Scene, room: MeshRoom, search: MeshSearch, progress: Callable[[float], None]) -> PathSet:
    count = len(scene.sources)
    found = [
        search.paths(scene, source, partial(report, progress, i / count, (i + 1) / count))
        for i, source in enumerate(scene.sources)
    ]
    walls = np.concatenate([f.walls for f in found])
    if len(walls) > search.path_limit:
        raise InputError("path_limit", f"must hold all paths, but is {search.path_limit} and they are {len(walls)}")
    matrix, offset = image_isometries(room.walls, walls)
    return PathSet(
        scene=scene,
        source=read_only(np.repeat(np.arange(count, dtype=np.int32), [len(f.order) for f in found])),
        receiver=read_only(np.concatenate([f.receiver for f in found]).astype(np.int32)),
        order=read_only(np.concatenate([f.order for f in found]).astype(np.int32)),
        walls=read_only(walls),
        image_matrix=read_only(matrix),
        image_offset=read_only(offset),
        start=read_only(np.concatenate([f.begin for f in found])),
        end=read_only(np.concatenate([f.end for f in found])),
    )
