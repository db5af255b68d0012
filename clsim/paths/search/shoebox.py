"""Image sources of a shoebox, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_count, read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain
from clsim.paths.legs.static import image_columns
from clsim.paths.options import PathOptions
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.scene import Scene

LARGEST_ORDER = 60


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """Images of one source: isometries of its trajectory, the same wherever it is."""

    order: NDArray[np.int32]  # (images,) number of reflections
    walls: NDArray[np.int8]  # (images, max_order) walls from the source's side, filled up with -1
    matrix: Floats  # (images, 3, 3) orthogonal matrix A of ``x -> A x + b``
    offset: Floats  # (images, 3) offset b, m


def shoebox_paths(scene: Scene, room: Shoebox, search: PathOptions) -> Chain:
    """Return every path of a shoebox up to an order: each image is active all the time."""
    order = as_count("max_order", search.max_order, at_most=LARGEST_ORDER)
    pairs, images = len(scene.sources) * len(scene.receivers), shoebox_image_count(order)
    if images * pairs > search.path_limit:
        raise InputError(
            "max_order",
            f"must give at most {search.path_limit} paths (path_limit), but {order} gives {images} images "
            f"for each of {pairs} pairs of source and receiver",
        )
    found = shoebox_images(room.size, order)
    source, receiver = np.divmod(np.repeat(np.arange(pairs, dtype=np.int32), images), len(scene.receivers))
    ends = [read_only(which.astype(np.int32, copy=False)) for which in (source, receiver)]
    begin, end = np.broadcast_to(-np.inf, images * pairs), np.broadcast_to(np.inf, images * pairs)
    walls, orders = read_only(np.tile(found.walls, (pairs, 1))), read_only(np.tile(found.order, pairs))
    matrix, offset = read_only(np.tile(found.matrix, (pairs, 1, 1))), read_only(np.tile(found.offset, (pairs, 1)))
    return Chain(scene, ends[0], ends[1], orders, begin, end, **image_columns(walls, matrix, offset))


def shoebox_image_count(max_order: int) -> int:
    """Return the number of images of a shoebox up to an order: ``1 + 2 N (2 N^2 + 3 N + 4) / 3``."""
    n = max_order
    return 1 + 2 * n * (2 * n * n + 3 * n + 4) // 3


def shoebox_images(size: Floats, max_order: int) -> Images:
    """Return every image of a shoebox up to an order, sorted by order.

    Shapes: size (3,) m.

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
    return Images(order.astype(np.int32), _walls(grid, max_order), matrix, offset)


def _walls(grid: NDArray[np.int64], max_order: int) -> NDArray[np.int8]:
    """List the walls of every image: along an axis they alternate and end on the side of the cell."""
    walls = np.full((len(grid), max_order), -1, dtype=np.int8)
    before = np.zeros(len(grid), dtype=np.int64)
    for axis in range(3):
        count = np.abs(grid[:, axis])
        last = 2 * axis + (grid[:, axis] > 0)
        for step in range(max_order):
            row = np.flatnonzero(step < count)
            # The last reflection is on `last`; each one before it is on the opposite wall of the next.
            walls[row, before[row] + step] = last[row] ^ ((count[row] - 1 - step) % 2)
        before += count
    return walls
