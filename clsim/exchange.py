"""Recordings as other programs take them: FLAC, .mat files of MATLAB and GNU Octave, MCAP files, signals of arrays."""

from __future__ import annotations

import heapq
import io
import math
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import LOUDEST, Floats, as_count, as_number, texts
from clsim.errors import InputError, check_packages
from clsim.files.atomic import atomic_path, not_written
from clsim.files.input_files import file_names
from clsim.files.sound import as_frames
from clsim.paths.ground_truth import direct_path
from clsim.paths.path_set import PathSet
from clsim.recording import Recording, as_recording
from clsim.scene.ends import Receiver, Source
from clsim.scene.receiver_array import array_elements, row_receivers
from clsim.scene.scene import Scene
from clsim.version import __version__

Message = tuple[int, str, str, Any]  # nanoseconds, topic, kind, content

_STEPS = 2**23  # of 24 bits, on either side of 0
_FINEST = 65_535  # Hz up to which the format's frames hold any whole rate; beyond, tens
_FASTEST = 655_350  # Hz
_CHANNELS = 8  # of a file at most
_BLOCK = 2**20  # samples converted at a time
_LARGEST = 2**31 - 2**16  # bytes of a variable in a file of version 5
_KEPT = ("delay", "doppler_factor", "line_of_sight", "radial_speed")
_CHUNK = 0.05  # s of sound in a message
_NANOSECONDS = 1_000_000_000
_MOST_RANGES = 64  # pairs whose ranges are written
_ULTRASOUND = 0  # sensor_msgs/Range: radiation_type
_AUDIO = {  # messages of sound, which are not among those that come with ROS 2
    "audio_common_msgs/msg/AudioData": "uint8[] data",
    "audio_common_msgs/msg/AudioDataStamped": "std_msgs/Header header\naudio_common_msgs/AudioData audio",
    "audio_common_msgs/msg/AudioInfo": (
        "uint8 channels\nuint32 sample_rate\nstring sample_format\nuint32 bitrate\nstring coding_format"
    ),
}
_, _SOUND, _INFO = _AUDIO
_POSE, _TF, _RANGE = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/Range"


def write_flac(recording: Recording, folder: str | PathLike[str], *, full_scale: float | None = None) -> list[Path]:
    """Write a recording as FLAC files of 24 bits, one for each receiver.

    Parameters
    ----------
    recording : Recording
        Recording at a sampling rate up to 65 535 Hz in whole Hz, or up to 655 350 Hz in tens of Hz: FLAC has no other.
    folder : path-like
        Folder of the files ``NAME.flac``; it is created if missing. Names are as a run's WAV files have them.
    full_scale : float, optional
        Value of 1 in a file, Pa or V; by default, for each unit, the least power of two above all its samples, so
        that receivers compare.

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


def flac_bytes(frames: NDArray[np.float32], rate: float) -> tuple[bytes, float]:
    """Return frames (n, channels) as a FLAC file of 24 bits, and its full scale."""
    import soundfile

    if frames.shape[1] > _CHANNELS:
        raise InputError("format", f"must be wav for more than {_CHANNELS} channels, but there are {frames.shape[1]}")
    buffer, scale = io.BytesIO(), _power_above(_peak(frames))
    part = np.rint(frames.astype(np.float64) * (_STEPS / scale)).astype(np.int32) << 8
    soundfile.write(buffer, part, _rate(rate), subtype="PCM_24", format="FLAC")
    return buffer.getvalue(), scale


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
        Path of the file.
    rate : float
        Rate of the ground truth's times, Hz.

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
    3), m. ``samples`` has a row for each channel; ``receivers`` is the receiver of each row, from 1.
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
        content["receivers"] = 1 + row_receivers(recording.paths.scene.receivers)
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


def write_mcap(
    recording: Recording, path: str | PathLike[str], *, start: int = 0, rate: float = 100.0, frame: str = "map"
) -> None:
    """Write a recording as an MCAP file of ROS 2 messages (CDR), readable without clsim and without ROS.

    Parameters
    ----------
    recording : Recording
        With its paths, so that positions are known.
    path : path-like
        Path of the file.
    start : int
        Stamp of time 0, nanoseconds since 1970, at least 0.
    rate : float
        Rate of poses, tf and ranges, Hz.
    frame : str
        Frame of the room's axes.

    Raises
    ------
    InputError
        If the recording has no paths, its sampling rate is no whole number, a value is out of bounds, or a package is
        missing.
    OSError
        If the file cannot be written; nothing is left of it then.

    Notes
    -----
    Topics: ``/NAME/audio`` (audio_common_msgs/AudioDataStamped: float32 samples, little endian, 50 ms a message,
    stamped with the time of their first sample by the receiver's clock) and ``/NAME/audio_info`` for each receiver,
    ``/NAME/pose`` (geometry_msgs/PoseStamped) for each end, ``/tf``, and ``/SOURCE/RECEIVER/range``
    (sensor_msgs/Range: speed of sound times the true delay of the direct sound, inf where it is not active) for at most
    64 pairs. In baseband samples are real and imaginary parts in turn. Names are as files have them.
    """
    check_packages("write_mcap", "an MCAP file", "ros", "mcap", "mcap_ros2", "rosbags")
    from mcap_ros2.writer import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    recording = as_recording(recording)
    if recording.paths is None:
        raise InputError("recording", "must have its paths for MCAP, but has none: load_recording(…, paths=True)")
    if not float(recording.sampling_rate).is_integer():
        raise InputError("recording", f"must have a whole sampling rate for MCAP, but has {recording.sampling_rate} Hz")
    begin = as_count("start", start, at_most=2**31 * _NANOSECONDS)
    rate = as_number("rate", rate, above=0.0, at_most=10e3, unit="Hz")
    times = truth_times(recording, recording.paths.scene, rate)
    with atomic_path(path) as temporary, temporary.open("wb") as out:
        writer: Any = Writer(out)  # its methods have no types
        types: Any = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in _AUDIO.items():
            types.register(get_types_from_msg(text, name))
        kinds = {
            name: writer.register_msgdef(name, types.generate_msgdef(name, ros_version=2)[0])
            for name in (_SOUND, _INFO, _POSE, _TF, _RANGE)
        }
        streams = [_sound(recording, begin), _poses(recording.paths, times, begin, frame)]
        streams.append(_ranges(recording.paths, times, begin, frame))
        for count, (stamp, topic, kind, content) in enumerate(heapq.merge(*streams, key=lambda found: found[0])):
            writer.write_message(topic, kinds[kind], content, log_time=stamp, publish_time=stamp, sequence=count)
        writer.finish()


def _stamp(begin: int, time: float) -> int:
    """Return a time, s, as nanoseconds; whole seconds apart, so that long runs lose nothing."""
    whole = int(time)
    return begin + whole * _NANOSECONDS + round((time - whole) * _NANOSECONDS)


def _header(stamp: int, frame: str) -> dict[str, Any]:
    seconds, rest = divmod(stamp, _NANOSECONDS)
    return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": frame}


def _sound(recording: Recording, begin: int) -> Iterator[Message]:
    """Yield messages of every receiver's samples, chunk by chunk."""
    rate, names = int(recording.sampling_rate), file_names(recording.receiver_names)
    channels = 1 if recording.carrier is None else 2
    info = {
        "channels": channels, "sample_rate": rate, "sample_format": "F32LE", "bitrate": 32 * channels * rate,
        "coding_format": "wave",
    }  # fmt: skip
    for name in names:
        yield begin, f"/{name}/audio_info", _INFO, info
    step, count = max(1, round(_CHUNK * rate)), recording.samples.shape[1]
    kind = "<f4" if recording.carrier is None else "<c8"
    for first in range(0, count, step):
        seconds, samples = divmod(first, rate)
        stamp = begin + seconds * _NANOSECONDS + (samples * _NANOSECONDS + rate // 2) // rate
        for name, row in zip(names, recording.samples, strict=True):
            data = np.ascontiguousarray(row[first : first + step], dtype=kind).tobytes()
            yield stamp, f"/{name}/audio", _SOUND, {"header": _header(stamp, name), "audio": {"data": data}}


def _poses(paths: PathSet, times: Floats, begin: int, frame: str) -> Iterator[Message]:
    """Yield poses of all ends, and the same as transforms."""
    ends: list[Source | Receiver] = [item for _, item in paths.scene.named_ends()]
    names = file_names(tuple(end.name for end in ends))
    places = [end.trajectory.position(times) for end in ends]
    turns = [end.orientation(times) for end in ends]
    for t, time in enumerate(times.tolist()):
        stamp = _stamp(begin, time)
        header, transforms = _header(stamp, frame), []
        for name, place, turn in zip(names, places, turns, strict=True):
            at = dict(zip("xyz", place[t].tolist(), strict=True))
            quaternion = dict(zip("xyzw", turn[t].tolist(), strict=True))
            pose = {"position": at, "orientation": quaternion}
            yield stamp, f"/{name}/pose", _POSE, {"header": header, "pose": pose}
            transform = {"translation": at, "rotation": quaternion}
            transforms.append({"header": header, "child_frame_id": name, "transform": transform})
        yield stamp, "/tf", _TF, {"transforms": transforms}


def _ranges(paths: PathSet, times: Floats, begin: int, frame: str) -> Iterator[Message]:
    """Yield true ranges by the direct sound."""
    scene = paths.scene
    found = direct_path(paths, times)
    ranges = np.where(found.line_of_sight, scene.air.speed_of_sound * found.delay, np.inf)
    names = file_names((*found.source_names, *found.receiver_names))
    sources, receivers = names[: len(scene.sources)], names[len(scene.sources) :]
    pairs = [(s, r) for s in range(len(sources)) for r in range(len(receivers))][:_MOST_RANGES]
    known = {"radiation_type": _ULTRASOUND, "field_of_view": float(np.pi), "min_range": 0.0, "max_range": float("inf")}
    for t, time in enumerate(times.tolist()):
        stamp = _stamp(begin, time)
        for s, r in pairs:
            content = {"header": _header(stamp, frame), **known, "range": float(ranges[s, r, t])}
            yield stamp, f"/{sources[s]}/{receivers[r]}/range", _RANGE, content


def truth_times(recording: Recording, scene: Scene, rate: float) -> Floats:
    """Return the times (T,) of written truth, s: at `rate` (Hz) from 0 to the end of the sound or of a trajectory."""
    duration = recording.samples.shape[1] / recording.sampling_rate
    times = np.arange(int(duration * rate) + 1) / rate
    last = min(end.trajectory.end for _, end in scene.named_ends())
    return np.asarray(times[times <= last])


def array_signals(recording: Recording, array: str | None = None) -> tuple[NDArray[np.float32], Floats]:
    """Return the samples of an array's elements and their positions, as pyroomacoustics and others take them.

    Parameters
    ----------
    recording : Recording
        Recording of sound, with its paths.
    array : str, optional
        Name of the array, from `receiver_array`; the only one when left out.

    Returns
    -------
    signals : ndarray (n, samples)
        Pa or V.
    positions : ndarray (n, 3)
        In the array's own frame, m; pyroomacoustics takes the transpose.

    Raises
    ------
    InputError
        If the recording is of envelopes or has no such array.
    """
    if as_recording(recording).carrier is not None:
        raise InputError("recording", f"must be sound, but is the envelope about {recording.carrier:g} Hz")
    receivers = () if recording.paths is None else recording.paths.scene.receivers
    elements = [receivers[i].element for i in array_elements(receivers, array)]
    known = [element for element in elements if element is not None]
    samples = recording.samples[recording.rows_of(known[0].array)]
    return samples, np.array([element.position for element in known])


def write_acoular(recording: Recording, path: str | PathLike[str], array: str | None = None) -> tuple[Path, Path]:
    """Write the samples and the geometry of an array as Acoular reads them.

    Parameters
    ----------
    recording : Recording
        Recording of sound, with its paths.
    path : path-like
        Path of the samples, ending in ``.h5``; the geometry stands beside it, with the ending ``.xml``.
    array : str, optional
        Name of the array, from `receiver_array`; the only one when left out.

    Returns
    -------
    samples, geometry : Path
        For ``acoular.TimeSamples(file=samples)`` and ``acoular.MicGeom(file=geometry)``.

    Raises
    ------
    InputError
        If the ending is another one, h5py is missing, or the recording is of envelopes or has no such array.
    OSError
        If a file cannot be written; nothing is left of that one then.

    Notes
    -----
    The dataset ``time_data`` (samples, n) has the attribute ``sample_freq``, Hz; ``<pos x= y= z=>`` are positions in
    the array's own frame, m.
    """
    samples, geometry = Path(path), Path(path).with_suffix(".xml")
    if samples.suffix != ".h5":
        raise InputError("path", f"must end in .h5, but is {str(path)!r:.80}")
    signals, positions = array_signals(recording, array)
    check_packages("write_acoular", "an HDF5 file", "store", "h5py")
    import h5py

    with atomic_path(samples) as partial, h5py.File(partial, "w") as file:
        file.create_dataset("time_data", data=signals.T).attrs["sample_freq"] = float(recording.sampling_rate)
    points = [
        f'  <pos Name="Point {i}" x="{x!r}" y="{y!r}" z="{z!r}"/>' for i, (x, y, z) in enumerate(positions.tolist(), 1)
    ]
    lines = ['<?xml version="1.0" encoding="utf-8"?>', '<MicArray name="array">', *points, "</MicArray>", ""]
    with atomic_path(geometry) as partial:
        partial.write_text("\n".join(lines), "utf-8")
    return samples, geometry
