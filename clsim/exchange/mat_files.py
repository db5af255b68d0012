"""Recordings as .mat files for MATLAB and GNU Octave: samples and ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_number, texts
from clsim.errors import InputError
from clsim.exchange import truth_times
from clsim.files.atomic import atomic_path
from clsim.paths.ground_truth import direct_path
from clsim.recording import as_recording
from clsim.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.path_set import PathSet
    from clsim.recording import Recording

_LARGEST = 2**31 - 2**16  # bytes of a variable in a file of version 5
_KEPT = ("delay", "doppler_factor", "line_of_sight", "radial_speed")


def write_mat(recording: Recording, path: str | PathLike[str], *, rate: float = 100.0) -> None:
    """Write a recording as a .mat file (version 5), which ``load`` of MATLAB and Octave and scipy read.

    Parameters
    ----------
    recording : Recording
        With its paths, ground truth is written, too.
    path : path-like
        Of the file.
    rate : float
        Of the ground truth's times, Hz.

    Raises
    ------
    InputError
        If samples or ground truth take 2 GiB or more, which the format does not hold, or the rate is out of bounds.
    OSError
        If the file cannot be written; nothing is left of it then.

    Notes
    -----
    ``samples`` (receivers, samples), single, Pa or V, complex in baseband; ``sampling_rate``, Hz; cells of texts
    ``receiver_names`` and ``units``; ``carrier``, Hz, in baseband; ``clsim_version``. With paths: ``source_names``,
    ``times`` (1, T), s, and at these ``delay``, ``doppler_factor``, ``line_of_sight`` and ``radial_speed`` (sources,
    receivers, T), as in `DirectPath`, ``source_positions`` (sources, T, 3) and ``receiver_positions`` (receivers, T,
    3), m.
    """
    rate = as_number("rate", rate, above=0.0, at_most=10e3, unit="Hz")
    content: dict[str, Any] = {
        "samples": as_recording(recording).samples,
        "sampling_rate": float(recording.sampling_rate),
        "receiver_names": _cells(recording.receiver_names),
        "units": _cells(recording.units),
        "clsim_version": __version__,
    }
    if recording.carrier is not None:
        content["carrier"] = float(recording.carrier)
    if recording.paths is not None:
        content |= _ground_truth(recording.paths, truth_times(recording, recording.paths.scene, rate))
    for name, values in content.items():
        if isinstance(values, np.ndarray) and values.nbytes > _LARGEST:
            raise InputError(
                "recording",
                f"must have less than 2 GiB of {name} for .mat, but has {values.nbytes / 2**30:.1f} GiB: "
                "a run with --store hdf5 writes what MATLAB reads, too",
            )
    from scipy.io import savemat

    with atomic_path(path) as temporary:
        savemat(str(temporary), content, appendmat=False, oned_as="row")


def _cells(words: Sequence[str]) -> NDArray[Any]:
    """Return texts as a cell array (n, 1)."""
    return texts(words).reshape(-1, 1)


def _ground_truth(paths: PathSet, times: Floats) -> dict[str, Any]:
    """Return the ground truth at times (T,), s."""
    scene, found = paths.scene, direct_path(paths, times)
    content: dict[str, Any] = {name: getattr(found, name) for name in _KEPT}
    content |= {"times": times, "source_names": _cells(found.source_names)}
    for name, ends in (("source_positions", scene.sources), ("receiver_positions", scene.receivers)):
        content[name] = np.stack([end.trajectory.position(times) for end in ends])
    return content
