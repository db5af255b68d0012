"""The paths of a scene: one row per image and receiver."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_choice, as_floats
from clsim.errors import InputError
from clsim.paths.arrivals import AMPLITUDES, MOTIONS, PairPaths, arrivals, slices_of
from clsim.paths.path_table import PathTable
from clsim.paths.response import is_complex
from clsim.paths.vertices import path_vertices

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from clsim.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class PathSet:
    """Every path from a source to a receiver, as columns of equal length.

    Attributes
    ----------
    scene : Scene
        The scene in which they are.
    source, receiver, order : ndarray (paths,) int
        Indices in the scene, and number of reflections.
    walls : ndarray (paths, max_order) int
        Walls from the source's side, filled up with -1.
    image_matrix, image_offset : ndarray (paths, 3, 3), (paths, 3)
        The image of the source is at ``image_matrix @ x + image_offset``.
    start, end : ndarray (paths,)
        Interval of reception in which the path is heard, s.
    """

    scene: Scene
    source: NDArray[np.int32]
    receiver: NDArray[np.int32]
    order: NDArray[np.int32]
    walls: NDArray[np.signedinteger[Any]]
    image_matrix: Floats
    image_offset: Floats
    start: Floats
    end: Floats

    def __len__(self) -> int:
        return len(self.source)

    def groups(self) -> Iterator[tuple[NDArray[np.int64], PairPaths]]:
        """Yield the rows of every (source, receiver) that has paths, and what they are."""
        pair = self.source.astype(np.int64) * len(self.scene.receivers) + self.receiver
        in_order = bool(np.all(pair[1:] >= pair[:-1]))
        order = np.arange(len(pair)) if in_order else np.argsort(pair, kind="stable")
        bounds = np.searchsorted(
            pair if in_order else pair[order], np.arange(len(self.scene.sources) * len(self.scene.receivers) + 1)
        )
        for s in range(len(self.scene.sources)):
            for r in range(len(self.scene.receivers)):
                first = s * len(self.scene.receivers) + r
                part = slice(bounds[first], bounds[first + 1])
                rows = order[part]
                if len(rows):
                    which = part if in_order else rows  # a slice is no copy
                    group = PairPaths(s, r, self.image_matrix[which], self.image_offset[which], self.walls[which])
                    yield rows, group

    def heard_by(self, receiver: int) -> PathSet:
        """Return the paths to one receiver."""
        mine = self.receiver == receiver
        columns = {f.name: getattr(self, f.name)[mine] for f in fields(self) if f.name != "scene"}
        return PathSet(self.scene, **columns)

    def table(self, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation") -> PathTable:
        """Return what every path does at the given times.

        Parameters
        ----------
        times : array_like (T,)
            Times of reception, s.
        motion : {"retarded", "quasi-static"}
            As in `render`.
        amplitude : {"wave-equation", "static", "convective"}
            As in `render`.

        Raises
        ------
        InputError
            If a time is not finite, or motion or amplitude are no known words.
        """
        times = as_floats("times", times, (None,))
        as_choice("motion", motion, MOTIONS)
        as_choice("amplitude", amplitude, AMPLITUDES)
        shape = (len(self), len(times))
        delay, doppler_factor = (np.full(shape, np.nan) for _ in range(2))
        gain: Any = np.full(shape, np.nan, dtype=np.complex128 if is_complex(self.scene) else np.float64)
        departure, arrival = (np.full((*shape, 3), np.nan) for _ in range(2))
        for rows, group in self.groups():
            for part in slices_of(len(times), len(rows)):
                found = arrivals(self.scene, group, times[part], motion, amplitude)
                delay[rows, part], gain[rows, part] = found.delay, found.gain
                doppler_factor[rows, part] = 1.0 - found.delay_rate
                departure[rows, part], arrival[rows, part] = found.departure, found.arrival
        silent = (times[None, :] < self.start[:, None]) | (times[None, :] >= self.end[:, None])
        for column in (delay, doppler_factor, gain, departure, arrival):
            column[silent] = np.nan
        return PathTable(
            times, self.source, self.receiver, self.order, self.walls, self.order == 0,
            delay, doppler_factor, gain, departure, arrival,
            tuple(s.name for s in self.scene.sources), tuple(r.name for r in self.scene.receivers),
            self.scene.room.faces.names,
        )  # fmt: skip

    def vertices(self, time: float, motion: str = "retarded") -> Floats:
        """Return where every path leaves, is reflected and arrives, as it is heard at a time.

        Parameters
        ----------
        time : float
            Time of reception, s.
        motion : {"retarded", "quasi-static"}
            As in `render`.

        Returns
        -------
        ndarray (paths, max_order + 2, 3)
            Source, points of reflection and receiver, m; NaN behind the receiver of paths of fewer reflections, and for
            paths that are not heard at that time.
        """
        now = np.array([time])
        source, receiver = np.empty((len(self), 3)), np.empty((len(self), 3))
        for rows, group in self.groups():
            delay = 0.0 if motion == "quasi-static" else arrivals(self.scene, group, now, motion).delay[:, 0]
            source[rows] = self.scene.sources[group.source].trajectory.position(np.full(len(rows), time) - delay)
            receiver[rows] = self.scene.receivers[group.receiver].trajectory.position(now)
        faces = self.scene.room.faces
        vertices = path_vertices((faces.normals, faces.offsets), self.walls, source, receiver)
        vertices[~((self.start <= time) & (time < self.end))] = np.nan
        return vertices

    def __post_init__(self) -> None:
        count = len(self.source)
        for name in ("receiver", "order", "walls", "image_matrix", "image_offset", "start", "end"):
            if len(getattr(self, name)) != count:
                raise InputError(name, f"must have one row per path, {count}, but has {len(getattr(self, name))}")
