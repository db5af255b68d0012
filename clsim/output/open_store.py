"""Reading stores."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

from clsim.errors import InputError
from clsim.output.raw_files import check_attributes, missing_chunks
from clsim.output.stores import STORE_FORMAT, STORES
from clsim.output.zarr_files import arrays_with_missing_chunks
from clsim.packages import check_packages
from clsim.recording import with_times


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
