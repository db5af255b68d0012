"""Path tables, ground truth and impulse responses as files."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.errors import InputError, check_packages
from clsim.files.atomic import atomic_path, not_written
from clsim.files.input_files import file_names
from clsim.files.sound import write_wav
from clsim.impulse_responses import ImpulseResponses
from clsim.numerics.quaternions import rotate
from clsim.paths.ground_truth import DirectPath, EchoTruth
from clsim.paths.path_table import PathTable, long_columns
from clsim.scene.ends import Receiver, Source
from clsim.scene.receiver_array import row_receivers
from clsim.scene.room.protocol import Room
from clsim.scene.scene import Scene
from clsim.version import __version__

_NAMES = ("source_names", "receiver_names", "object_names")
_ROW_GROUP = 100_000  # rows of a Parquet file written at a time, or those of one path where it has more
_REPEATING = ["times", "path", "source", "receiver", "order", "objects"]  # columns worth a dictionary


def write_table(table: PathTable, path: str | os.PathLike[str]) -> None:
    """Write a path table as ``.npz`` (arrays as in `PathTable`) or ``.parquet`` (a row per path and time)."""
    # A complex gain is two columns in Parquet: magnitude, and ``gain_phase`` in rad.
    check_table(str(path))
    if Path(path).suffix == ".npz":
        with atomic_path(path) as temporary:
            columns: dict[str, Any] = {f.name: getattr(table, f.name) for f in dataclasses.fields(table)}
            write: Any = np.savez_compressed
            write(temporary, **{k: np.array(v) if k in _NAMES else v for k, v in columns.items()})
    else:
        _write_parquet(table, path)


def check_table(name: str, field: str = "path") -> None:
    """Raise if a path table of this name cannot be written; an error names `field`."""
    suffix = Path(name).suffix
    if name and suffix not in (".npz", ".parquet"):
        raise InputError(field, f"must end in .npz or .parquet, but is {name!r}")
    if suffix == ".parquet":
        check_packages(field, "Parquet", "parquet", "pyarrow")


def write_ground_truth(found: DirectPath, path: str | os.PathLike[str], echoes: Sequence[EchoTruth] = ()) -> None:
    """Write ground truth as ``.npz``: arrays as in `DirectPath`, ``scatterer_…`` and ``body_…``."""
    columns: dict[str, Any] = {f.name: getattr(found, f.name) for f in dataclasses.fields(found)}
    columns = {name: np.array(value) if name in _NAMES else value for name, value in columns.items()}
    for echo in echoes:
        columns |= {f"{echo.KIND}_{name}": getattr(echo, name) for name in echo.MEASURES}
        columns[f"{echo.KIND}_names"] = np.array(echo.names)
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **columns)


def _write_parquet(table: PathTable, path: str | os.PathLike[str]) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    def words(texts: Sequence[str], which: Any) -> Any:
        # Not NumPy's text, where every row is as wide as the longest and four bytes a character.
        return pa.array(texts, pa.string()).take(pa.array(which, pa.int64()))

    step = max(1, _ROW_GROUP // max(1, len(table.times)))
    with atomic_path(path) as temporary:
        writer = None
        try:
            for first in range(0, max(1, len(table.source)), step):
                rows = range(first, min(first + step, len(table.source)))
                columns = long_columns(table, rows, words)
                if np.iscomplexobj(table.gain):  # a type that Parquet does not know
                    columns |= {"gain": np.abs(columns["gain"]), "gain_phase": np.angle(columns["gain"])}
                piece = pa.table(columns)
                writer = writer or parquet.ParquetWriter(temporary, piece.schema, use_dictionary=_REPEATING)
                writer.write_table(piece)
        finally:
            if writer is not None:
                writer.close()


def response_names(source_names: Sequence[str], receiver_names: Sequence[str]) -> list[str]:
    """Return the names of the WAV files of all pairs, receivers fastest."""
    return [f"{name}.wav" for name in file_names(tuple(f"{s}_{r}" for s in source_names for r in receiver_names))]


def write_response_sounds(responses: ImpulseResponses, folder: str | os.PathLike[str]) -> list[Path]:
    """Write ``SOURCE_RECEIVER.wav`` of 32-bit floats for every pair, none before all are whole; return their paths."""
    sources, receivers, count = responses.samples.shape
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    made = [folder / name for name in response_names(responses.source_names, responses.receiver_names)]
    with ExitStack() as stack:
        for path, taps in zip(made, responses.samples.reshape(sources * receivers, count), strict=True):
            write_wav(stack.enter_context(atomic_path(path)), responses.sampling_rate, taps)
    return made


def write_responses(responses: ImpulseResponses, path: str | os.PathLike[str]) -> None:
    """Write impulse responses as ``.npz``, or as ``.sofa``: a SingleRoomSRIR (AES69), receivers fastest."""
    suffix = Path(path).suffix
    if suffix == ".npz":
        with atomic_path(path) as temporary:
            write: Any = np.savez_compressed
            write(temporary, **_columns(responses))
    elif suffix == ".sofa":
        _write_sofa(responses, path)
    else:
        raise InputError("path", f"must end in .npz or .sofa, but is {str(path)!r}")


def _columns(responses: ImpulseResponses) -> dict[str, Any]:
    scene, at = responses.scene, responses.at
    names = ("samples", "sampling_rate", "lead", "at", "band", "first_arrivals", "cut_db", *_NAMES[:2])
    return {name: np.asarray(getattr(responses, name)) for name in names} | {
        "source_positions": _positions(scene.sources, at),
        "receiver_positions": _positions(scene.receivers, at)[row_receivers(scene.receivers)],
        "source_orientations": _orientations(scene.sources, at),
        "receiver_orientations": _orientations(scene.receivers, at)[row_receivers(scene.receivers)],
    }


def _positions(ends: Sequence[Source | Receiver], at: float) -> Floats:
    """Return positions (n, 3), m."""
    return np.stack([end.trajectory.position(at) for end in ends])


def _orientations(ends: Sequence[Source | Receiver], at: float) -> Floats:
    """Return unit quaternions x y z w (n, 4)."""
    return np.concatenate([end.orientation(np.array([at])) for end in ends])


def _write_sofa(responses: ImpulseResponses, path: str | os.PathLike[str]) -> None:
    check_packages("path", "SOFA", "sofa", "sofar")
    import sofar

    sources, receivers, count = responses.samples.shape
    sofa = sofar.Sofa("SingleRoomSRIR")
    sofa.GLOBAL_Title = f"Impulse responses at {responses.at:g} s"
    sofa.GLOBAL_Origin = "simulated by image sources"
    sofa.GLOBAL_ApplicationName, sofa.GLOBAL_ApplicationVersion = "clsim", __version__
    _describe_room(sofa, responses.scene)
    sofa.GLOBAL_Comment = (
        f"sources {', '.join(responses.source_names)}; receivers {', '.join(responses.receiver_names)}; "
        f"exact from {responses.band[0]:g} to {responses.band[1]:g} Hz; Pa per Pa at 1 m on the axis"
    )
    pairs: tuple[tuple[str, Sequence[Source | Receiver], Any], ...] = (
        ("Source", responses.scene.sources, np.repeat(np.arange(sources), receivers)),
        ("Listener", responses.scene.receivers, np.tile(row_receivers(responses.scene.receivers), sources)),
    )
    fields = {f"{name}Position": np.zeros((1, 3)) for name in ("Receiver", "Emitter")}  # at the ends' own origins
    for name, ends, rows in pairs:
        turned = _orientations(ends, responses.at)[rows]
        fields[f"{name}Position"] = _positions(ends, responses.at)[rows]
        fields[f"{name}View"] = rotate(turned, np.array([1.0, 0.0, 0.0]))
        setattr(sofa, f"{name}Up", rotate(turned, np.array([0.0, 0.0, 1.0])))
    for name, values in fields.items():
        setattr(sofa, name, values)
        setattr(sofa, f"{name}_Type", "cartesian")
        setattr(sofa, f"{name}_Units", "metre")
    sofa.Data_IR = responses.samples.reshape(sources * receivers, 1, count)
    sofa.Data_SamplingRate = responses.sampling_rate
    sofa.Data_Delay = np.full((1, 1), 0.0 - responses.lead)
    with atomic_path(path) as temporary:
        try:
            sofar.write_sofa(str(temporary), sofa)
        except (OSError, RuntimeError) as error:  # netCDF calls a full disk "Permission denied", or "HDF error"
            raise not_written(path, error) from error


def _describe_room(sofa: Any, scene: Scene) -> None:
    """Fill in the room and the air, and take out fields that stand for nothing that is known."""
    unknown = [
        "ReceiverDescriptions", "EmitterDescriptions", "MeasurementDate", "RoomVolume", "RoomVolume_Units",
        "RoomCorners", "RoomCorners_Type", "RoomCorners_Units",
    ]  # fmt: skip
    sofa.RoomTemperature = scene.air.state[0] + 273.15
    sofa.RoomTemperature_Units = "kelvin"
    if _is_box(scene.room):
        sofa.GLOBAL_RoomType = "shoebox"
        sofa.RoomCornerA, sofa.RoomCornerB = (corner[None] for corner in scene.room.extent)
        unknown = unknown[:-2]
    else:
        sofa.GLOBAL_RoomType = "reverberant"
        unknown += ["RoomCornerA", "RoomCornerB"]
    for name in unknown:
        sofa.delete(name)


def _is_box(room: Room) -> bool:
    """Test whether a room is a box along the axes."""
    across = np.sort(np.abs(room.faces.normals), axis=1)
    return room.is_convex and np.array_equal(across, np.tile([0.0, 0.0, 1.0], (6, 1)))
