"""Poses over time from files: TUM, EuRoC, CSV and ROS bags, checked row by row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal, DecimalException
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import FARTHEST, ByRow, Floats
from clsim.errors import InputError, check_packages, warn
from clsim.files.input_files import LARGEST_TEXT, check_file, read_file
from clsim.scene.motion.motion import LONGEST

FORMATS = ("tum", "euroc", "csv", "rosbag")
REPAIRS = ("times", "gaps", "nan", "jumps")

POSE = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
# Other names of these in headers, whatever their case. A name with a unit is none: `columns` and `time_scale` say both.
_ALIASES = {
    "t": ("time", "timestamp"),
    **{axis: (f"pos_{axis}", f"position_{axis}", f"p{axis}") for axis in "xyz"},
    **{f"q{axis}": (f"q_{axis}", f"quat_{axis}", f"orientation_{axis}") for axis in "xyzw"},
}
_LONGEST_STEP = 5.0  # median steps, beyond which a step is a gap
_LONGEST_INVENTED = 1.0  # s of motion that gaps may make up without a warning
_SHORTEST_STEP = 1e-3  # median steps, below which two times are the same
_FEWEST_ROWS = 4
_MOST_DIGITS = 30  # of a time before the point
_UNIT_TOLERANCE = 1e-2  # largest error of a quaternion's norm that counts as rounding
_LARGEST_BAG = 2**40  # bytes of a bag: pictures and clouds of points are passed over
_MOST_POSES = 5_000_000  # poses
_POSE_OF: dict[str, Callable[[Any], tuple[Any, Any]]] = {  # where each kind of message has its pose
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "nav_msgs/msg/Odometry": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation),
}
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Poses(ByRow):
    """Rows of a file; lines (n,); stamps (n,); times (n,) s; positions (n, 3) m; orientations (n, 4)."""

    file: str
    lines: NDArray[np.int64]
    stamps: NDArray[np.str_]
    times: Floats
    positions: Floats
    orientations: Floats | None
    notes: tuple[str, ...] = ()
    row: str = "line"

    def where(self, row: int) -> str:
        """Return location of a row for a message."""
        return f"{self.file}, {self.row} {self.lines[row]}"

    def without(self, bad: Bools, what: str) -> Poses:
        """Return the poses without the bad rows, with a note that says which."""
        count, first = int(np.sum(bad)), int(np.argmax(bad))
        if 2 * count >= len(bad):
            raise InputError("repair", f"would drop {count} of {len(bad)} rows of {self.file} ({what})")
        note = f"Dropped {count} of {len(bad)} rows ({what}), the first in {self.row} {self.lines[first]}."
        return replace(self.part(~bad), notes=(*self.notes, note))


def read_poses(
    path: Any, form: str, *, topic: str | None, columns: Mapping[str, str] | None, time_scale: float, scale: float,
    repair: tuple[str, ...], max_speed: float, max_gap: float | None,
) -> Poses:  # fmt: skip
    """Read a file and check its rows, see `Trajectory.from_file`; lines that begin with ``#`` are skipped."""
    if form != "rosbag" and topic is not None:
        raise InputError("topic", f"must be left out for the format {form!r}, but is {topic!r:.80}")
    if form != "csv" and columns is not None:
        raise InputError("columns", f"must be left out for the format {form!r}, but is {columns!r:.80}")
    if form in ("euroc", "rosbag") and time_scale != 1.0:
        raise InputError("time_scale", f"must be 1 for the format {form!r}, whose unit is known, but is {time_scale:g}")
    drop = "nan" in repair
    if form == "rosbag":
        poses = _from_bag(Path(path), topic or form, drop)
    else:
        poses = _parse(Path(path), form, drop, columns or {}, Decimal(str(time_scale)))
    poses = replace(poses, positions=_scaled(poses, scale))
    poses = _with_unit_quaternions(poses)
    for name, check in (
        ("times", _check_times),
        ("jumps", lambda p, r: _check_jumps(p, r, max_speed)),
        ("gaps", lambda p, r: _check_gaps(p, r, max_gap)),
    ):
        _refuse_few(poses)
        poses = check(poses, name in repair)
    _refuse_few(poses)
    if poses.times[-1] > LONGEST:
        raise InputError("path", f"{poses.file} must not last longer than {LONGEST:g} s")
    return poses


def _from_bag(path: Path, topic: str, drop: bool) -> Poses:
    """Return the poses of a topic of a ROS bag, read without ROS; `drop` leaves out those that are not finite."""
    check_packages("format", "a ROS bag", "ros", "rosbags")
    try:
        if not path.is_dir():
            check_file(path, _LARGEST_BAG)
        rows, frame = _messages(path, topic)
    except InputError:
        raise
    except OSError as error:
        raise InputError("path", f"{path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # of a damaged bag, the package raises what its parsers raise
        raise InputError("path", f"{path} must be a ROS bag, but cannot be read as one: {error!r:.200}") from error
    if not rows:
        raise InputError("topic", f"must be one with messages in {path.name}, but {topic} has none")
    stamps, numbers = [row[0] for row in rows], np.array([row[1:] for row in rows], dtype=np.float64)
    times = np.array([(stamp - stamps[0]) / 10**9 for stamp in stamps])  # of whole numbers: rounded once
    poses = Poses(
        path.name, np.arange(1, len(times) + 1), np.array(stamps, dtype=np.str_), times, numbers[:, :3], numbers[:, 3:],
        (f"Poses of {topic} in the frame {frame!r}.",), "message",
    )  # fmt: skip
    bad = ~np.all(np.isfinite(numbers), axis=1)
    if not np.any(bad):
        return poses
    if not drop:
        raise InputError("path", f"{poses.where(int(np.argmax(bad)))}: must be a pose of finite numbers")
    poses = poses.without(bad, "no finite number")
    return replace(poses, times=poses.times - poses.times[0])


def _messages(path: Path, topic: str) -> tuple[list[tuple[Any, ...]], str]:
    """Return stamp, position and quaternion of each message, and the first one's frame."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    rows: list[tuple[Any, ...]] = []
    frame = ""
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        chosen = [one for one in bag.connections if one.topic == topic]
        kinds = {one.topic: one.msgtype for one in bag.connections}
        fit = ", ".join(sorted(name for name, kind in kinds.items() if kind in _POSE_OF)) or "none"
        if topic not in kinds:
            raise InputError("topic", f"must be one with poses in {path.name} ({fit:.200}), but is {topic!r:.80}")
        if kinds[topic] not in _POSE_OF:
            wanted = ", ".join(kind.rpartition("/")[2] for kind in _POSE_OF)
            problem = f"must be of {wanted}, but {topic} is of {kinds[topic]}; with poses are: {fit:.200}"
            raise InputError("topic", problem)
        if sum(one.msgcount for one in chosen) > _MOST_POSES:
            raise InputError("topic", f"must have at most {_MOST_POSES} messages, but {topic} has more")
        for connection, _, raw in bag.messages(chosen):
            message: Any = bag.deserialize(raw, connection.msgtype)
            place, turn = _POSE_OF[connection.msgtype](message)
            stamp = message.header.stamp
            frame = frame or str(message.header.frame_id)
            clock = int(stamp.sec) * 10**9 + int(stamp.nanosec)
            rows.append((clock, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))
    return rows, frame


def _parse(path: Path, form: str, drop: bool, names: Mapping[str, str], time_scale: Decimal) -> Poses:
    """Turn the file's text into numbers; `drop` leaves out rows that hold something else."""
    rows, columns, notes = _rows(path, form, names)
    clock, numbers, bad = [], [], np.zeros(len(rows), dtype=np.bool_)
    unit = Decimal("1e-9") if form == "euroc" else time_scale
    for i, (line, cells) in enumerate(rows):
        try:
            clock.append(_clock(cells[columns[0]], whole=form == "euroc") * unit)
            numbers.append([_number(name, cells[k]) for name, k in zip(POSE[1:], columns[1:], strict=False)])
        except ValueError as error:
            if not drop:
                raise InputError("path", f"{path.name}, line {line}: {error}") from None
            bad[i], clock[i:] = True, [Decimal(0)]
            numbers.append([np.nan] * (len(columns) - 1))
    begin = next((time for time, is_bad in zip(clock, bad, strict=True) if not is_bad), Decimal(0))
    values = np.array(numbers, dtype=np.float64).reshape(len(rows), len(columns) - 1)
    poses = Poses(
        path.name, np.array([line for line, _ in rows], dtype=np.int64),
        np.array([cells[columns[0]].strip() for _, cells in rows], dtype=np.str_),
        np.array([float(time - begin) for time in clock]), values[:, :3],
        values[:, 3:] if len(columns) == len(POSE) else None, notes,
    )  # fmt: skip
    return poses.without(bad, "no finite number") if bad.any() else poses


def _rows(
    path: Path, form: str, names: Mapping[str, str]
) -> tuple[list[tuple[int, list[str]]], list[int], tuple[str, ...]]:
    """Return numbered rows of cells, the columns of `POSE` (four without quaternions), and notes."""
    separator = None if form == "tum" else ","
    rows = [
        (number, text.split(separator))
        for number, text in enumerate(_text(path).splitlines(), start=1)
        if text.strip() and not text.lstrip().startswith("#")
    ]
    columns, notes, widths = list(range(8)), tuple[str, ...](), (8, 8)
    if form == "euroc":
        columns, widths = [0, 1, 2, 3, 5, 6, 7, 4], (8, 1000)
    elif form == "csv":
        if not rows:
            raise InputError("path", f"{path.name} must begin with a header such as t,x,y,z")
        line, header = rows.pop(0)
        columns, notes = _header(f"{path.name}, line {line}", header, names)
        widths = (len(header), len(header))
    for line, cells in rows:
        if not widths[0] <= len(cells) <= widths[1]:
            wanted = f"{widths[0]}" if widths[0] == widths[1] else f"at least {widths[0]}"
            raise InputError("path", f"{path.name}, line {line}: must have {wanted} columns, but has {len(cells)}")
    return rows, columns, notes


def _text(path: Path) -> str:
    try:
        text = read_file(path, LARGEST_TEXT).decode("utf-8-sig")
    except OSError as error:
        raise InputError("path", f"{path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError("path", f"{path} must be a text file (UTF-8): {error}") from error
    if "\0" in text:
        raise InputError("path", f"{path} must be a text file, but holds a zero byte")
    return text


def _header(where: str, header: list[str], given: Mapping[str, str]) -> tuple[list[int], tuple[str, ...]]:
    """Columns of a CSV header, of which `given` names some, and a note of those that are not used."""
    names = [name.strip().strip('"').strip() for name in header]
    found = {name: _column(where, names, name, given) for name in POSE}
    missing = [name for name in POSE if found[name] is None]
    if any(name in missing for name in POSE[:4]) or len(missing) not in (0, 4):
        raise InputError(
            "path",
            f"{where}: the header must name t,x,y,z and either all or none of qx,qy,qz,qw (or columns= say what they "
            f"are called), but is {','.join(names)!r:.80}",
        )
    columns = [column for column in found.values() if column is not None]
    others = [name for i, name in enumerate(names) if i not in columns]
    notes = (f"Columns not used: {', '.join(others)}.",) if others else ()
    return columns, notes


def _column(where: str, names: list[str], wanted: str, given: Mapping[str, str]) -> int | None:
    """Column of one of `POSE`: as given, by its own name, or by an alias."""
    own = [i for i, name in enumerate(names) if name == given.get(wanted, wanted)]
    if wanted in given and not own:
        raise InputError(f"columns.{wanted}", f"{where}: must name a column, but {given[wanted]!r:.40} is none of them")
    found = own or [i for i, name in enumerate(names) if name.lower() in (wanted, *_ALIASES[wanted])]
    if len(found) > 1:
        listed = ", ".join(names[i] for i in found)
        raise InputError("path", f"{where}: the header must name {wanted} once, but names it as {listed}")
    return found[0] if found else None


def _number(name: str, cell: str) -> float:
    try:
        number = float(cell) if "_" not in cell else np.nan
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise ValueError(f"{name} must be a finite number, but is {cell.strip()!r:.40}")
    return number


def _clock(cell: str, whole: bool) -> Decimal:
    """Return an exact time: nanoseconds since 1970 have more digits than float64."""
    try:
        time = Decimal(cell.strip()) if "_" not in cell else Decimal("nan")
    except DecimalException:
        time = Decimal("nan")
    if not time.is_finite() or time.adjusted() > _MOST_DIGITS:
        raise ValueError(f"t must be a finite number, but is {cell.strip()!r:.40}")
    if whole and time != time.to_integral_value():
        raise ValueError(f"t must be whole nanoseconds, but is {cell.strip()!r:.40}")
    return time


def _scaled(poses: Poses, scale: float) -> Floats:
    far = np.flatnonzero(np.any(np.abs(poses.positions) > FARTHEST / scale, axis=1))
    if len(far):
        value = np.abs(poses.positions[far[0]]).max()
        problem = f"{poses.where(far[0])}: positions must be within {FARTHEST:g} m, but one is {value:g}"
        raise InputError("path", problem)
    return poses.positions * scale


def _with_unit_quaternions(poses: Poses) -> Poses:
    if poses.orientations is None:
        return poses
    norm = np.linalg.norm(np.clip(poses.orientations, -1e100, 1e100), axis=1)
    off = np.flatnonzero(np.abs(norm - 1.0) > _UNIT_TOLERANCE)
    if len(off):
        problem = f"{poses.where(off[0])}: must have a unit quaternion, but its norm is {norm[off[0]]:.6g}"
        raise InputError("path", problem)
    return replace(poses, orientations=poses.orientations / norm[:, None])


def _refuse_few(poses: Poses) -> None:
    if len(poses.times) < _FEWEST_ROWS:
        raise InputError("path", f"{poses.file} must hold at least {_FEWEST_ROWS} rows, but holds {len(poses.times)}")


def _check_times(poses: Poses, repair: bool) -> Poses:
    """Return mask of times that do not exceed all earlier ones."""
    steps = np.diff(poses.times)
    least = _SHORTEST_STEP * float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    last = np.maximum.accumulate(poses.times)[:-1]
    bad = np.append(False, poses.times[1:] - last < max(least, 0.5e-9))
    if not np.any(bad):
        return poses
    if repair:
        poses = poses.without(bad, "time does not increase")
        return replace(poses, times=poses.times - poses.times[0])
    i = int(np.argmax(bad))
    problem = f"{poses.where(i)}: time must increase strictly (by {max(least, 0.5e-9):.3g} s at least), "
    raise InputError("path", f"{problem}but {poses.stamps[i]} follows {poses.stamps[i - 1]}")


def _check_jumps(poses: Poses, repair: bool, max_speed: float) -> Poses:
    """Return mask of positions that cannot be reached from the last good one."""
    x, t = poses.positions, poses.times
    distance = np.linalg.norm(np.diff(x, axis=0), axis=1)
    speed = distance / np.diff(t)
    if not np.any(speed > max_speed):
        return poses
    i = int(np.argmax(speed > max_speed)) + 1
    if not repair:
        problem = f"{poses.where(i)}: must not be faster than {max_speed:g} m/s (max_speed), but is "
        problem += f"{distance[i - 1]:.4g} m away from {poses.row} {poses.lines[i - 1]} after {t[i] - t[i - 1]:.4g} s, "
        raise InputError("path", f"{problem}{speed[i - 1]:.4g} m/s")
    bad, good = np.zeros(len(t), dtype=np.bool_), i - 1
    for row in range(i, len(t)):
        bad[row] = np.linalg.norm(x[row] - x[good]) > max_speed * (t[row] - t[good])
        good = good if bad[row] else row
    return poses.without(bad, f"faster than {max_speed:g} m/s")


def _check_gaps(poses: Poses, repair: bool, max_gap: float | None) -> Poses:
    """Find steps of time that are too long."""
    steps = np.diff(poses.times)
    longest = _LONGEST_STEP * float(np.median(steps)) if max_gap is None else max_gap
    wide = np.flatnonzero(steps > longest * (1.0 + 1e-9))
    if not len(wide):
        return poses
    i = int(wide[0]) + 1
    if not repair:
        rule = f"{_LONGEST_STEP:g} median steps" if max_gap is None else "max_gap"
        problem = f"{poses.where(i)}: must follow within {longest:.4g} s ({rule}), but {poses.stamps[i]} is "
        problem += f"{steps[i - 1]:.4g} s after {poses.stamps[i - 1]}; bridge it by max_gap= or repair=('gaps',)"
        raise InputError("path", problem)
    made_up = float(steps[wide].sum())
    if made_up > _LONGEST_INVENTED:
        note = f'{poses.file}: repair=("gaps",) makes up {made_up:.4g} s of motion, the most of it '
        note += f"{steps.max():.4g} s before {poses.row} {poses.lines[int(np.argmax(steps)) + 1]}; "
        warn(f"{note}leave that part out, or measure it again")
    gaps = "1 gap" if len(wide) == 1 else f"{len(wide)} gaps"
    note = (
        f"Bridged {gaps} longer than {longest:.4g} s, the first before {poses.row} {poses.lines[i]}, "
        f"the longest {steps.max():.4g} s."
    )
    return replace(poses, notes=(*poses.notes, note))
