"""Recordings as MCAP files of ROS 2 messages, written without ROS: sound, poses, tf and ranges on one clock."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_count, as_number
from clsim.errors import InputError
from clsim.exchange import truth_times
from clsim.files.atomic import atomic_path
from clsim.files.names import file_names
from clsim.packages import check_packages
from clsim.paths.ground_truth import direct_path
from clsim.recording import as_recording

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

    from clsim.paths.path_set import PathSet
    from clsim.recording import Recording
    from clsim.scene.ends import Receiver, Source

    Message = tuple[int, str, str, Any]  # nanoseconds, topic, kind, content

_CHUNK = 0.05  # s of sound in a message
_NANOSECONDS = 1_000_000_000
_MOST_RANGES = 64  # pairs whose ranges are written
_ULTRASOUND = 0  # sensor_msgs/Range: radiation_type
_RULE = "=" * 80
_TIME = "int32 sec\nuint32 nanosec\n"
_PARTS = {
    "builtin_interfaces/Time": _TIME,
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "audio_common_msgs/AudioData": "uint8[] data\n",
}
_KINDS = {
    "audio_common_msgs/msg/AudioDataStamped": "std_msgs/Header header\naudio_common_msgs/AudioData audio\n",
    "audio_common_msgs/msg/AudioInfo": (
        "uint8 channels\nuint32 sample_rate\nstring sample_format\nuint32 bitrate\nstring coding_format\n"
    ),
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "sensor_msgs/msg/Range": (
        "std_msgs/Header header\nuint8 radiation_type\nfloat32 field_of_view\nfloat32 min_range\nfloat32 max_range\n"
        "float32 range\n"
    ),
}
_SOUND, _INFO, _POSE, _TF, _RANGE = _KINDS


def write_mcap(
    recording: Recording, path: str | PathLike[str], *, start: int = 0, rate: float = 100.0, frame: str = "map"
) -> None:
    """Write a recording as an MCAP file of ROS 2 messages (CDR), readable without clsim and without ROS.

    Parameters
    ----------
    recording : Recording
        With its paths, so that positions are known.
    path : path-like
        Of the file.
    start : int
        Stamp of time 0, nanoseconds since 1970, at least 0.
    rate : float
        Of poses, tf and ranges, Hz.
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
    (sensor_msgs/Range: speed of sound times the true delay of the direct sound, inf where it is not heard) for at most
    64 pairs. In baseband samples are real and imaginary parts in turn. Names are as files have them.
    """
    check_packages("write_mcap", "an MCAP file", "ros", "mcap", "mcap_ros2")
    from mcap_ros2.writer import Writer

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
        kinds = {name: writer.register_msgdef(name, _definition(name)) for name in _KINDS}
        streams = [_sound(recording, begin), _poses(recording.paths, times, begin, frame)]
        streams.append(_ranges(recording.paths, times, begin, frame))
        for count, (stamp, topic, kind, content) in enumerate(heapq.merge(*streams, key=lambda found: found[0])):
            writer.write_message(topic, kinds[kind], content, log_time=stamp, publish_time=stamp, sequence=count)
        writer.finish()


def _definition(kind: str) -> str:
    """Return the text of a message's definition with all that it is made of."""
    parts = dict.fromkeys(_parts_of(_KINDS[kind]))
    return _KINDS[kind] + "".join(f"{_RULE}\nMSG: {part}\n{_PARTS[part]}" for part in parts)


def _parts_of(definition: str) -> Iterator[str]:
    """Yield the types of the fields of a message that are messages themselves, each before its own."""
    for line in definition.splitlines():
        part = line.split()[0].removesuffix("[]")
        if part in _PARTS:
            yield part
            yield from _parts_of(_PARTS[part])


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
