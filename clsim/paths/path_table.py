"""Table of what every path does over time, its columns as pandas and xarray take them, and a page that shows it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, short_repr, texts
from clsim.errors import check_packages, old_names
from clsim.files.atomic import atomic_path
from clsim.paths.family import DIFFRACTION, SPECULAR
from clsim.pictures.view_page import ViewedPaths, page_text
from clsim.scene.room.edges import Edges
from clsim.scene.scene import frame_times, viewed_bodies, viewed_ends, viewed_flaws, viewed_walls

_OVER_TIME = ("delay", "doppler_factor", "doppler_shift", "gain")
_DIRECTIONS = ("departure", "arrival")


@old_names("0.3", heard="audible", name_way="name_objects")
@dataclass(frozen=True, slots=True, eq=False)
class PathTable:
    """Delay, Doppler factor, gain and directions of P paths at T times.

    Attributes
    ----------
    times : ndarray (T,)
        Times of reception, s.
    source, receiver, order : ndarray (P,) int
        Indices in the scene, and number of interactions.
    interactions : ndarray (P, N) int
        Interactions in order from the source: 0 reflection by a wall, 1 diffraction, 2 scattering, 3
        reflection by a body, 4 transmission through a wall; filled up with -1.
    objects : ndarray (P, N) int
        Objects of the interactions, as indices of `object_names`, walls first; filled up with -1.
    direct : ndarray (P,) bool
        Whether it is the direct path.
    delay : ndarray (P, T)
        From emission to reception, s; NaN while the path is not active. In air that disperses, the group delay at
        the centre frequency of the source's signal.
    doppler_factor : ndarray (P, T)
        Received over emitted frequency; in air that disperses of the centre frequency.
    doppler_shift : ndarray (P, T)
        Received less emitted frequency at the centre frequency of the source's signal, Hz.
    gain : ndarray (P, T)
        Received over emitted pressure at the signal's centre frequency but for the delay, signed; complex where walls,
        directivities or air have phases.
    departure, arrival : ndarray (P, T, 3)
        Unit vectors: from the source along the path, and from the receiver back along it.
    source_names, receiver_names, object_names : tuple of str
        Names that the indices refer to.
    """

    times: Floats
    source: NDArray[np.int32]
    receiver: NDArray[np.int32]
    order: NDArray[np.int32]
    interactions: NDArray[np.signedinteger[Any]]
    objects: NDArray[np.signedinteger[Any]]
    direct: NDArray[np.bool_]
    delay: Floats
    doppler_factor: Floats
    doppler_shift: Floats
    gain: Floats | Complexes
    departure: Floats
    arrival: Floats
    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]
    object_names: tuple[str, ...]

    __repr__ = short_repr

    @property
    def walls(self) -> NDArray[np.signedinteger[Any]]:
        """Walls of reflections (P, N) from the source's side, -1 elsewhere."""
        return np.where(self.interactions == SPECULAR, self.objects, -1)

    def name_objects(self, path: int | np.integer[Any]) -> str:
        """Return names of what the `path` of a row meets, from the source's side; "direct" if it meets nothing."""
        return ", ".join(self.object_names[i] for i in self.objects[path] if i >= 0) or "direct"

    def to_dataframe(self) -> Any:
        """Return it as a pandas DataFrame, with one row per path and time at which it is active.

        Returns
        -------
        pandas.DataFrame
            Columns as in a Parquet file of it, texts as categories, a complex gain as it is; ``attrs["units"]`` tells
            the units.
        """
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        return labelled_frame(long_columns(self, range(len(self.source)), categories))

    def to_xarray(self) -> Any:
        """Return it as an xarray Dataset with dimensions ``path``, ``times`` and ``axis``, coordinates and units.

        Returns
        -------
        xarray.Dataset
            Variables over paths and times, NaN while a path is not active; properties of paths are coordinates.
        """
        said = {
            "source": [self.source_names[i] for i in self.source],
            "receiver": [self.receiver_names[i] for i in self.receiver],
            "interactions": [_listed(row) for row in self.interactions.tolist()],
            "objects": [self.name_objects(p) for p in range(len(self.source))],
        }
        of_paths: dict[str, Any] = {name: ("path", texts(values)) for name, values in said.items()}
        of_paths |= {"order": ("path", self.order), "direct": ("path", self.direct)}
        over_time = {name: (("path", "times"), getattr(self, name)) for name in _OVER_TIME}
        directions = {name: (("path", "times", "axis"), getattr(self, name)) for name in _DIRECTIONS}
        of_paths |= {"times": ("times", self.times), "axis": ("axis", list("xyz"))}
        return labelled_dataset(over_time | directions, of_paths)

    @property
    def audible(self) -> NDArray[np.bool_]:
        """Whether each path is active (P, T): it exists, and its gain is not 0."""
        return np.asarray(np.isfinite(self.delay) & (self.gain != 0.0))


def long_columns(table: PathTable, rows: range, words: Callable[[Sequence[str], Any], Any]) -> dict[str, Any]:
    """Return the columns of some paths, a row per path and time at which it is received."""
    part = slice(rows.start, rows.stop)
    count = len(table.times)
    audible = np.isfinite(table.delay[part]).ravel()
    joined = [",".join(table.object_names[i] for i in row if i >= 0) for row in table.objects[part]]
    kinds = [_listed(row) for row in table.interactions[part].tolist()]

    def per_path(values: Any) -> Any:
        """Return a column of one value per path, repeated at the instants at which it is heard."""
        return np.repeat(np.asarray(values), count)[audible]

    columns = {
        "times": np.tile(table.times, len(rows))[audible], "path": per_path(np.arange(rows.start, rows.stop)),
        "source": words(table.source_names, per_path(table.source[part])),
        "receiver": words(table.receiver_names, per_path(table.receiver[part])), "order": per_path(table.order[part]),
        "interactions": words(kinds, per_path(np.arange(len(rows)))),
        "objects": words(joined, per_path(np.arange(len(rows)))), "direct": per_path(table.direct[part]),
    }  # fmt: skip
    for name in _OVER_TIME:
        columns[name] = getattr(table, name)[part].ravel()[audible]
    for name in _DIRECTIONS:
        for axis in range(3):
            columns[f"{name}_{'xyz'[axis]}"] = getattr(table, name)[part, :, axis].ravel()[audible]
    return columns


def _listed(kinds: list[int]) -> str:
    """Return kinds of interactions as a text."""
    return ",".join(str(kind) for kind in kinds if kind >= 0)


_OF_RECEPTION = {"units": "s", "long_name": "time of reception"}
ATTRIBUTES: dict[str, dict[str, str]] = {
    "times": _OF_RECEPTION,
    "delay": {"units": "s", "long_name": "delay from emission to reception"},
    "doppler_factor": {"units": "1", "long_name": "received over emitted frequency"},
    "doppler_shift": {"units": "Hz", "long_name": "received less emitted frequency at the signal's centre"},
    "gain": {"units": "1", "long_name": "received over emitted pressure at 1 m, at the signal's centre frequency"},
    "departure": {"units": "1", "long_name": "unit vector from the source along the path"},
    "arrival": {"units": "1", "long_name": "unit vector from the receiver back along the path"},
    "local_arrival": {"units": "1", "long_name": "the same in the receiver's axes, +x where it faces"},
    "reception_time": {"units": "s", "long_name": "time of reception"},
    "source_position": {"units": "m", "long_name": "position of the source at emission"},
    "receiver_position": {"units": "m", "long_name": "position of the receiver at reception"},
    "radial_speed": {"units": "m/s", "long_name": "speed at which the direct path grows"},
    "line_of_sight": {"long_name": "whether the direct sound is received"},
    "order": {"long_name": "number of interactions"},
    "objects": {"long_name": "what the path meets, from the source's side"},
    "interactions": {"long_name": "0 reflection, 1 diffraction, 2 scattering, 3 body, 4 transmission, 5 shadow"},
}


def categories(values: Sequence[str], which: NDArray[np.integer[Any]]) -> Any:
    """Return a categorical column of pandas: the texts of `values` in the rows `which`."""
    import pandas

    kinds, code = np.unique(texts(values), return_inverse=True)
    return pandas.Categorical.from_codes(code[which], kinds)


def labelled_frame(columns: dict[str, Any]) -> Any:
    """Return columns as a pandas DataFrame with what is known of their units."""
    import pandas

    frame = pandas.DataFrame(columns)
    units = {name: ATTRIBUTES.get(re.sub("_[xyz]$", "", name), {}).get("units", "") for name in columns}
    frame.attrs["units"] = {name: unit for name, unit in units.items() if unit}
    return frame


def labelled_dataset(variables: dict[str, Any], coordinates: dict[str, Any]) -> Any:
    """Return variables, each (dimensions, values), with coordinates and what is known of the units of both."""
    check_packages("to_xarray", "a Dataset", "tables", "xarray")
    import xarray

    def given(what: dict[str, Any]) -> dict[str, Any]:
        """Return variables, each with the attributes of its name."""
        return {name: (*value, ATTRIBUTES.get(name, {})) for name, value in what.items()}

    return xarray.Dataset(given(variables), given(coordinates))


_SEEN = 1e-4  # m, to which the page rounds


def view_scene(paths: Any, page: Path, *, title: str = "scene", **options: Any) -> None:
    """Write a page that shows the room, the trajectories and the paths over time."""
    text = paths_page(paths, title=title, **options)
    with atomic_path(page) as temporary:
        temporary.write_text(text, "utf-8")


def paths_page(paths: Any, *, title: str, **options: Any) -> str:
    """Return the text of that page; what is given is as in `view_scene`."""
    return page_text(title=title, **viewed(paths, **options))


def viewed(
    paths: Any, *, duration: float, frames: int = 120, limit: int = 300, motion: str = "retarded",
    amplitude: str = "wave-equation", progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the room, the trajectories and the paths of a `PathSet` over time, as `page_text` draws them."""
    scene = paths.scene
    things = [*scene.named_ends(), *scene.named_scatterers()]
    times = frame_times([*things, *scene.named_bodies()], duration, frames)
    ends, bodies = viewed_ends(things, times), viewed_bodies(scene.named_bodies(), times)
    shown: list[ViewedPaths] = []
    kept: list[int] = []
    for i, time in enumerate(times):
        now = _paths_at(paths, float(time), limit, motion, amplitude)
        rests = bool(kept) and all(_alike(end.positions[i], end.positions[kept[-1]]) for end in ends)
        rests = rests and all(_alike(body.corners(i), body.corners(kept[-1])) for body in bodies)
        if not (rests and _same(now, shown[-1])):
            shown.append(now)
            kept.append(i)
        if progress is not None:
            progress(1.0)
    most = max(len(frame.order) for frame in shown)
    edges = scene.room.edges() if np.any(paths.interactions == DIFFRACTION) else Edges.none()
    return {
        "walls": tuple(viewed_walls(scene.room)),
        "ends": tuple(replace(end, positions=end.positions[kept]) for end in ends),
        "times": times[kept],
        "frames": tuple(shown),
        "notes": (f"Only the {limit} strongest paths are drawn and counted.",) if most == limit else (),
        "edges": np.stack([edges.start, edges.stop], axis=1),
        "bodies": tuple(replace(body, places=body.places[kept], axes=body.axes[kept]) for body in bodies),
        "flaws": viewed_flaws(scene.room),
    }


def _alike(one: Floats, other: Floats) -> bool:
    """Test if points coincide with others, as far as the page shows."""
    return bool(np.all(np.abs(one - other) < _SEEN))


def _same(one: ViewedPaths, other: ViewedPaths) -> bool:
    """Test if two frames show the same paths."""
    return one.labels == other.labels and all(map(_alike, one.vertices, other.vertices))


def _paths_at(paths: Any, time: float, limit: int, motion: str, amplitude: str) -> ViewedPaths:
    """Return the strongest paths that are heard at a time."""
    table = paths.table(np.array([time]), motion, amplitude)
    audible = np.flatnonzero(table.audible[:, 0])
    gain = np.abs(table.gain[audible, 0])
    level = 20.0 * np.log10(gain / gain.max(initial=0.0))
    strongest = np.argsort(-level, kind="stable")[:limit]
    audible, level = audible[strongest], level[strongest]
    vertices = paths.vertices(time, motion)[audible]
    names = [
        f"{table.source_names[table.source[p]]} to {table.receiver_names[table.receiver[p]]}, "
        + table.name_objects(p)
        + f": {table.delay[p, 0] * 1e3:.3f} ms, {decibels + 0.0:.1f} dB"
        for p, decibels in zip(audible, level, strict=True)
    ]
    order = table.order[audible]
    pairs = tuple((table.source_names[table.source[p]], table.receiver_names[table.receiver[p]]) for p in audible)
    drawn = tuple(c[: n + 2] for c, n in zip(vertices, order, strict=True))
    return ViewedPaths(drawn, order, tuple(names), pairs, level)
