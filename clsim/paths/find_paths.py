"""From a scene to its paths."""

from __future__ import annotations

import numpy as np

from clsim.arrays import as_count, read_only
from clsim.errors import InputError
from clsim.paths.path_set import PathSet
from clsim.paths.shoebox_images import shoebox_image_count, shoebox_images
from clsim.scene.scene import Scene

LARGEST_ORDER = 60
DEFAULT_PATH_LIMIT = 20_000_000


def find_paths(scene: Scene, max_order: int, *, path_limit: int = DEFAULT_PATH_LIMIT) -> PathSet:
    """Return every path of a scene up to an order.

    Parameters
    ----------
    scene : Scene
        What sounds where.
    max_order : int
        Largest number of reflections, 0 for the direct sound alone.
    path_limit : int
        Number of paths above which the search is refused rather than begun.

    Returns
    -------
    PathSet
        Paths sorted by source, receiver and order. In a shoebox every image is heard all the time.

    Raises
    ------
    InputError
        If the order is out of range or the paths would be more than `path_limit`.

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
    order = as_count("max_order", max_order, at_least=0, at_most=LARGEST_ORDER)
    pairs = len(scene.sources) * len(scene.receivers)
    images = shoebox_image_count(order)
    if images * pairs > path_limit:
        raise InputError(
            "max_order",
            f"must give at most {path_limit} paths (path_limit), but {order} gives {images} images "
            f"for each of {pairs} pairs of source and receiver",
        )
    found = shoebox_images(scene.room.size, order)
    source, receiver = np.divmod(np.repeat(np.arange(pairs), images), len(scene.receivers))
    return PathSet(
        scene=scene,
        source=read_only(source.astype(np.int32)),
        receiver=read_only(receiver.astype(np.int32)),
        order=read_only(np.tile(found.order, pairs)),
        walls=read_only(np.tile(found.walls, (pairs, 1))),
        image_matrix=read_only(np.tile(found.matrix, (pairs, 1, 1))),
        image_offset=read_only(np.tile(found.offset, (pairs, 1))),
        start=read_only(np.full(images * pairs, -np.inf)),
        end=read_only(np.full(images * pairs, np.inf)),
    )
