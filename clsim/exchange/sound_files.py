"""Recordings as FLAC (24-bit integers without loss of level) and as .mat files for MATLAB and GNU Octave."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import LOUDEST, as_number, texts
from clsim.errors import InputError
from clsim.exchange import truth_times
from clsim.files.atomic import atomic_path, not_written
from clsim.files.names import file_names
from clsim.files.sound import as_frames
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

_STEPS = 2**23  # of 24 bits, on either side of 0
_FINEST = 65_535  # Hz up to which the format's frames hold any whole rate; beyond, tens
_FASTEST = 655_350  # Hz
_BLOCK = 2**20  # samples converted at a time
_LARGEST = 2**31 - 2**16  # bytes of a variable in a file of version 5
_KEPT = ("delay", "doppler_factor", "line_of_sight", "radial_speed")


def write_flac(recording: Recording, folder: str | PathLike[str], *, full_scale: float | None = None) -> list[Path]:
    """Write a recording as FLAC files of 24 bits, one for each receiver.

    Parameters
    ----------
    recording : Recording
        Of a sampling rate up to 65 535 Hz in whole Hz, or up to 655 350 Hz in tens of Hz: FLAC holds no other.
    folder : path-like
        Where ``NAME.flac`` are put; it is made where it is not there. Names are as a run's WAV files have them.
    full_scale : float, optional
        What 1 means in a file, Pa or V; by default, for each unit, the least power of two above all its samples, so
        that receivers compare.

    Returns
    -------
    list of Path
        One per receiver.

    Raises
    ------
    InputError
        If the format does not hold the sampling rate, or a sample is beyond full scale: nothing is clipped.
    OSError
        If a file cannot be written; nothing is left of that one then.

    Notes
    -----
    A WAV file holds floats in Pa or V; FLAC holds integers, here those nearest to sample / full scale x 2^23, wrong by
    2^-24 of full scale at most (-144 dB). A file's comment says its full scale (``full_scale=2 Pa``), its title the
    receiver. In baseband there are two channels, real part (I) before imaginary part (Q).
    """
    rate = _rate(as_recording(recording).sampling_rate)
    scales = _full_scales(recording, full_scale)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.flac" for name in file_names(recording.receiver_names)]
    rows = zip(paths, recording.samples, recording.receiver_names, recording.units, strict=True)
    for path, samples, name, unit in rows:
        _write(path, as_frames(samples[None]), rate, scales[unit], (name, unit))
    return paths


def _rate(value: float) -> int:
    step = 1 if value <= _FINEST else 10
    if not (1.0 <= value <= _FASTEST and float(value / step).is_integer()):
        raise InputError(
            "recording",
            f"must have, for FLAC, a sampling rate of whole Hz up to {_FINEST} or of tens of Hz up to {_FASTEST}, "
            f"but has {value!r} Hz: save() writes WAV",
        )
    return int(value)


def _full_scales(recording: Recording, given: float | None) -> dict[str, float]:
    """Return the full scale of each unit, above all samples in it."""
    if given is not None:
        given = as_number("full_scale", given, above=0.0, at_most=LOUDEST)
    found = {}
    for unit in sorted(set(recording.units)):
        rows = [row for row, own in zip(recording.samples, recording.units, strict=True) if own == unit]
        peak = max(_peak(row) for row in rows)
        if not math.isfinite(peak):
            raise InputError("recording", "must be finite for FLAC, but holds a sample that is not")
        if given is not None and round(peak / given * _STEPS) >= _STEPS:
            raise InputError(
                "full_scale", f"must be above all samples, whose largest is {peak:g} {unit}, but is {given:g}"
            )
        found[unit] = given if given is not None else _power_above(peak)
    return found


def _peak(row: NDArray[Any]) -> float:
    parts = (row.real, row.imag) if np.iscomplexobj(row) else (row,)
    return max(float(np.abs(part).max(initial=0.0)) for part in parts)


def _power_above(peak: float) -> float:
    """Return the least power of two whose integers hold a peak; 1 for silence."""
    if not peak:
        return 1.0
    power = 2.0 ** math.frexp(peak)[1]
    return power if round(peak / power * _STEPS) < _STEPS else 2.0 * power


def _write(path: Path, frames: NDArray[np.float32], rate: int, scale: float, what: tuple[str, str]) -> None:
    import soundfile

    with atomic_path(path) as temporary:
        try:
            with soundfile.SoundFile(
                temporary, "w", samplerate=rate, channels=frames.shape[1], subtype="PCM_24", format="FLAC"
            ) as file:
                file.title, file.comment = what[0], f"full_scale={scale:.17g} {what[1]}"
                for first in range(0, len(frames), _BLOCK):
                    part = np.rint(frames[first : first + _BLOCK].astype(np.float64) * (_STEPS / scale))
                    file.write(part.astype(np.int32) << 8)  # 24 bits are the upper ones of 32
        except (RuntimeError, AssertionError) as error:  # libsndfile reports a full disk as a short write
            raise not_written(path, error) from error


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
