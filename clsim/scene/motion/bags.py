"""Poses from ROS bags, read without ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.errors import InputError, check_packages
from clsim.files.input_files import check_file

_LARGEST = 2**40  # bytes of a bag: pictures and clouds of points are passed over
_MOST = 5_000_000  # poses
_NANOSECONDS = 1_000_000_000
_POSES: dict[str, Callable[[Any], tuple[Any, Any]]] = {  # where each kind of message has its pose
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "nav_msgs/msg/Odometry": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation),
}


@dataclass(frozen=True, slots=True, eq=False)
class BagPoses:
    """Poses of one topic; positions (n, 3) m; orientations (n, 4)."""

    stamps: list[int]
    positions: Floats
    orientations: Floats
    frame: str


def read_bag(path: Path, topic: str) -> BagPoses:
    """Return the poses of a topic in the order in which the bag has them.

    topic: of messages PoseStamped, PoseWithCovarianceStamped, Odometry or TransformStamped.
    """
    check_packages("format", "a ROS bag", "ros", "rosbags")
    try:
        if not path.is_dir():
            check_file(path, _LARGEST)
        rows, frame = _rows(path, topic)
    except InputError:
        raise
    except OSError as error:
        raise InputError("path", f"{path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # of a damaged bag, the package raises what its parsers raise
        raise InputError("path", f"{path} must be a ROS bag, but cannot be read as one: {error!r:.200}") from error
    if not rows:
        raise InputError("topic", f"must be one with messages in {path.name}, but {topic} has none")
    numbers = np.array([row[1:] for row in rows], dtype=np.float64)
    return BagPoses([row[0] for row in rows], numbers[:, :3], numbers[:, 3:], frame)


def _rows(path: Path, topic: str) -> tuple[list[tuple[Any, ...]], str]:
    """Return stamp, position and quaternion of each message, and the first one's frame."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    rows: list[tuple[Any, ...]] = []
    frame = ""
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        chosen = [one for one in bag.connections if one.topic == topic]
        kinds = {one.topic: one.msgtype for one in bag.connections}
        fit = ", ".join(sorted(name for name, kind in kinds.items() if kind in _POSES)) or "none"
        if topic not in kinds:
            raise InputError("topic", f"must be one with poses in {path.name} ({fit:.200}), but is {topic!r:.80}")
        if kinds[topic] not in _POSES:
            wanted = ", ".join(kind.rpartition("/")[2] for kind in _POSES)
            problem = f"must be of {wanted}, but {topic} is of {kinds[topic]}; with poses are: {fit:.200}"
            raise InputError("topic", problem)
        if sum(one.msgcount for one in chosen) > _MOST:
            raise InputError("topic", f"must have at most {_MOST} messages, but {topic} has more")
        for connection, _, raw in bag.messages(chosen):
            message: Any = bag.deserialize(raw, connection.msgtype)
            place, turn = _POSES[connection.msgtype](message)
            stamp = message.header.stamp
            frame = frame or str(message.header.frame_id)
            clock = int(stamp.sec) * _NANOSECONDS + int(stamp.nanosec)
            rows.append((clock, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))
    return rows, frame
