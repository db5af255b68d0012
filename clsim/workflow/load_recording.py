"""Reading back what a run wrote: recordings and stores."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import as_flag, row_name
from clsim.errors import InputError, check_packages, not_one_of
from clsim.files.input_files import file_names
from clsim.files.sound import EnvelopeFile, SoundFile
from clsim.output.raw_files import arrays_with_missing_chunks, check_attributes, missing_chunks
from clsim.output.stores import STORE_FORMAT, STORES
from clsim.recording import Recording, with_times
from clsim.scene.receiver_array import row_receivers
from clsim.scene.scene import Scene
from clsim.scene_file import load_scene
from clsim.workflow.result_folder import COMPLETED, changed_results, load_record


def load_recording(
    folder: str | os.PathLike[str], receivers: Sequence[str] | None = None, *, paths: bool = False, verify: bool = False
) -> Recording:
    """Return the recording in a folder that ``clsim run`` wrote, whatever the store.

    Parameters
    ----------
    folder : path-like
        Folder of the results.
    receivers : sequence of str, optional
        Names of those that are wanted, or of arrays; all when left out.
    paths : bool
        Whether its paths are found again, from the completed scene: what scores ask for.
    verify : bool
        Whether the files that are read are compared with the digests in the folder's record. Damaged chunks of a Zarr
        store are refused without it, too.

    Raises
    ------
    InputError
        If the folder holds no finished run, a receiver is not in it, a package that reads the store is missing, or
        what was written has changed where that is seen.
    """
    folder = Path(folder)
    as_flag("paths", paths)
    as_flag("verify", verify)
    record = load_record(folder, "folder")
    if not (record.finished and (folder / COMPLETED).exists()):
        raise InputError("folder", f"must hold the results of a finished `clsim run`, but {folder} does not")
    file = load_scene(folder / COMPLETED)
    if isinstance(receivers, str):
        raise InputError("receivers", f"must be a list of names, but is {receivers!r:.80}")
    names = [receiver.name for receiver in file.scene.receivers]
    rows = [row for wanted in (names if receivers is None else receivers) for row in _rows(file.scene, wanted)]
    if not rows:
        raise InputError("receivers", "must name one at least, but is empty")
    baseband: Any = file.render["baseband"]
    carrier = None if baseband is None else float(baseband[0])
    stores = [name for kind in STORES.values() if kind.packages for name in kind.names([]) if name in record.files]
    sounds = [] if stores else _sounds(file.scene, rows)
    files = stores or list(dict.fromkeys(name for name, _ in sounds))
    if verify:
        wanted_files = [COMPLETED, *files]
        unknown = [name for name in wanted_files if name not in record.files]
        for name in [*unknown, *changed_results(folder, record, wanted_files)]:
            how = "was not written by clsim" if name in unknown else "has changed since it was written, or is missing"
            raise InputError("folder", f"must hold what was written, but {folder / name} {how}")
    chosen = [file.scene.receivers[r] for r in rows]
    channels = [row for end in chosen for row in end.rows]
    of_row = row_receivers(file.scene.receivers)
    samples, rate = (
        _stored(folder, [k for r in rows for k in np.flatnonzero(of_row == r).tolist()]) if stores
        else _read([(folder / name, channel) for name, channel in sounds], carrier)
    )  # fmt: skip
    found = None
    if paths:
        from clsim.workflow.pipeline import find_scene_paths  # late: pydantic takes longer to import than all else

        found = find_scene_paths(replace(file, scene=replace(file.scene, receivers=chosen)))
    return Recording(
        samples, rate, tuple(map(row_name, channels)), found, (f"read from {folder}",),
        tuple(end.unit for end in chosen for _ in end.directivity.channels), carrier=carrier, channels=tuple(channels),
    )  # fmt: skip


def _stored(folder: Path, rows: list[int]) -> tuple[NDArray[Any], float]:
    """Return the samples (rows, n) of a Zarr or HDF5 store, and their rate, Hz."""
    try:
        with open_store(folder) as store:
            return store["sound"][rows].values, float(store.attrs["sampling_rate"])
    except InputError as error:
        raise InputError("folder", error.problem) from error
    except (OSError, ValueError, RuntimeError, KeyError, TypeError) as error:  # of what unpacks a damaged chunk
        raise InputError("folder", f"must hold the sound that was written, but {error}") from error


def _sounds(scene: Scene, receivers: list[int]) -> list[tuple[str, int]]:
    """Return the WAV file and the channel in it of each row of some receivers of a scene."""
    count: dict[str, int] = {}
    places = []
    for end in scene.receivers:
        mine = []
        for name, _ in end.rows:
            mine.append((name, count.get(name, 0)))
            count[name] = count.get(name, 0) + 1
        places.append(mine)
    files = dict(zip(count, file_names(tuple(count)), strict=True))
    return [(f"{files[name]}.wav", channel) for r in receivers for name, channel in places[r]]


def _rows(scene: Scene, wanted: str) -> list[int]:
    """Find the receiver of a name, or the elements of an array."""
    names = [receiver.name for receiver in scene.receivers]
    arrays = [receiver.element.array if receiver.element else "" for receiver in scene.receivers]
    if wanted not in (*names, *filter(None, arrays)):
        raise InputError("receivers", not_one_of(wanted, names))
    return [i for i, (name, array) in enumerate(zip(names, arrays, strict=True)) if wanted in (name, array)]


def _read(sounds: list[tuple[Path, int]], carrier: float | None) -> tuple[NDArray[Any], float]:
    """Return the samples (rows, n) of channels of WAV files of one length, and their rate, Hz."""
    import soundfile

    try:
        kind = SoundFile if carrier is None else EnvelopeFile
        files = [kind(path, channel) for path, channel in sounds]
        samples = np.empty((len(files), len(files[0])), dtype=np.float32 if carrier is None else np.complex64)
        for row, sound in zip(samples, files, strict=True):
            row[:] = sound[0 : len(row)]
        return samples, float(soundfile.info(os.fsencode(sounds[0][0])).samplerate)
    except (OSError, ValueError, soundfile.LibsndfileError) as error:
        raise InputError("folder", f"must hold the sound that was written, but {error}") from error


def open_store(path: str | os.PathLike[str]) -> Any:
    """Open a recording that ``clsim run --store zarr`` or ``hdf5`` wrote.

    Parameters
    ----------
    path : path-like
        ``recording.zarr`` or ``recording.h5``, or the folder that holds one of them.

    Returns
    -------
    xarray.Dataset
        ``sound`` (receiver, time), float32, or complex64 in baseband, read only where it is used; coordinates
        ``receiver``, ``unit``, ``position`` (receiver, axis) at 0 s, m, and ``time``, s, by the receivers'
        clocks; attributes
        ``sampling_rate`` (Hz), ``carrier`` (Hz, in baseband), ``scene`` (the completed scene file), ``clsim_version``.

    Raises
    ------
    InputError
        If there is no store, or one of another format, a chunk of it is missing, or a package is.

    Notes
    -----
    ``xarray.open_zarr`` and ``xarray.open_dataset(engine="h5netcdf")`` open the same stores, without ``time`` (which
    would take twice the space of the sound): it is ``numpy.arange(samples) / sampling_rate``. Sound is read when it is
    used: a damaged chunk of it raises an error of the package that unpacks it then, and in `load_recording` an
    InputError.
    """
    path = Path(path)
    inside = [path / "recording.zarr", path / "recording.h5"]
    if not (path / "zarr.json").exists() and path.is_dir():
        path = next((p for p in inside if p.exists()), path)
    kind = "hdf5" if path.suffix == ".h5" else "zarr"
    check_packages("path", kind, "store", *STORES[kind].packages)
    import xarray

    try:
        if kind == "hdf5":
            check_attributes(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # metadata that are not gathered are only slower
            found = xarray.open_dataset(path, engine="h5netcdf") if kind == "hdf5" else xarray.open_zarr(path)
    except (OSError, ValueError, KeyError, RuntimeError, TypeError) as error:  # and what unpacks a damaged chunk
        raise InputError("path", f"must be a store of clsim, but {path} is none: {error}") from error
    try:
        check_format(found.attrs, path)
        _check_chunks(kind, path)
    except InputError:
        found.close()
        raise
    return with_times(found, found.attrs["sampling_rate"])


def _check_chunks(kind: str, path: Path) -> None:
    """Raise an InputError if chunks are missing, for which packages would read zeros."""
    try:
        missing = missing_chunks(path) if kind == "hdf5" else len(arrays_with_missing_chunks(path))
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError) as error:
        raise InputError("path", f"must be a store of clsim, but {path} cannot be read: {error}") from error
    if missing:
        raise InputError("path", f"must hold what was written, but chunks of {path} are missing")


def check_format(attributes: Any, path: Path) -> None:
    """Raise an InputError if a store is none of clsim's, or of another format."""
    version = attributes.get("clsim_store_format")
    if version is None:
        raise InputError("path", f"must be a store of clsim, but {path} does not say so")
    if version != STORE_FORMAT:
        raise InputError(
            "path",
            f"must be a store of format {STORE_FORMAT}, but {path} has format {version} "
            f"(clsim {attributes.get('clsim_version', 'unknown')} wrote it)",
        )
