"""Joints over time from motion capture: BVH, and tables of positions (CSV)."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import FARTHEST, read_only
from clsim.errors import InputError
from clsim.files.input_files import LARGEST_TEXT, read_file
from clsim.scene.motion.checks import as_increasing

if TYPE_CHECKING:
    from pathlib import Path

    from clsim.arrays import Floats

_FEWEST_FRAMES = 4  # of a spline
_AXES = {"X": 0, "Y": 1, "Z": 2}
_COLUMN = re.compile(r"(.+)[ ._]([xyz])", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class Joints:
    """Positions of joints over time."""

    names: tuple[str, ...]  # as in the file; the end of a chain without a name of its own is "NAME end"
    times: Floats  # (T,) s, from 0
    positions: Floats  # (joints, T, 3) in the file's axes and unit of length
    up: str  # the axis that goes up, by the custom of the format


def read_joints(path: Path) -> Joints:
    """Read a file: one that begins with HIERARCHY is BVH, any other a table.

    path: text. The header of a table names ``t`` (or ``time``), s, and ``NAME x``, ``NAME y``, ``NAME z`` of every
    joint, in any order, with a blank, a point or an underscore before the axis; lines that begin with ``#`` are
    skipped.
    """
    try:
        text = read_file(path, LARGEST_TEXT).decode("utf-8-sig")
    except OSError as error:
        raise InputError("path", f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError("path", f"{path.name} must be text, but is none") from error
    try:
        found = _bvh(text) if text.lstrip().upper().startswith("HIERARCHY") else _table(text)
    except InputError as error:
        raise InputError("path", f"{path.name}, {error}") from error
    if not np.all(np.isfinite(found.positions)) or np.abs(found.positions).max(initial=0.0) > FARTHEST:
        joint, frame = np.argwhere(~(np.abs(found.positions) <= FARTHEST))[0, :2]
        raise InputError("path", f"{path.name}, frame {frame + 1}: {found.names[joint]!r} must be at a finite place")
    return found


# --- tables -----------------------------------------------------------------------------------------------------------


def _table(text: str) -> Joints:
    """Return the joints of a table."""
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError("line 1", "must name the columns, but there is none")
    number, header = lines[0]
    columns = [name.strip().strip('"') for name in header.split(",")]
    clock = [i for i, name in enumerate(columns) if name.lower() in ("t", "time")]
    joints: dict[str, list[int | None]] = {}
    for i, name in enumerate(columns):
        found = _COLUMN.fullmatch(name)
        if found:
            joints.setdefault(found[1], [None] * 3)["xyz".index(found[2].lower())] = i
    lacking = next((name for name, axes in joints.items() if None in axes), None)
    if len(clock) != 1 or not joints or lacking is not None:
        what = f"{lacking!r} lacks one" if lacking is not None else f"it has {header.strip()!r:.80}"
        raise InputError(f"line {number}", f"must name t and NAME x, NAME y, NAME z of every joint, but {what}")
    rows = np.array([_numbers(i, line, len(columns)) for i, line in lines[1:]]).reshape(-1, len(columns))
    if len(rows) < _FEWEST_FRAMES:
        raise InputError(
            f"line {lines[-1][0]}", f"must be the last of {_FEWEST_FRAMES} rows at least, not of {len(rows)}"
        )
    try:
        times = as_increasing(rows[:, clock[0]])
    except InputError as error:
        raise InputError(f"column {columns[clock[0]]}", f"{error}") from error
    positions = np.stack([rows[:, [int(i or 0) for i in axes]] for axes in joints.values()])
    return Joints(tuple(joints), read_only(times - times[0]), read_only(positions), "z")


def _numbers(line: int, text: str, count: int) -> list[float]:
    """Return the numbers of a line, `count` of them."""
    cells = text.split(",") if "," in text else text.split()
    try:
        if len(cells) != count:
            raise ValueError
        return [float(cell) for cell in cells]
    except ValueError:
        raise InputError(f"line {line}", f"must hold {count} numbers, but is {text.strip()!r:.60}") from None


# --- BVH --------------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Bone:
    """A joint of a hierarchy: parent, offset from it, and channels."""

    name: str
    parent: int
    offset: list[float] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)


def _bvh(text: str) -> Joints:
    """Return the joints of a BVH file."""
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.strip().upper() == "MOTION"), None)
    if begin is None:
        raise InputError(f"line {len(lines)}", "must come after MOTION, but there is none")
    bones = _hierarchy(lines[:begin])
    head = [(i, line.split()) for i, line in enumerate(lines[begin + 1 :], begin + 2) if line.strip()]
    try:
        (_, frames), (_, step) = head[0], head[1]
        count, period = int(frames[-1]), float(step[-1])
        if (
            frames[0].lower() != "frames:"
            or [word.lower() for word in step[:2]] != ["frame", "time:"]
            or not period > 0.0
        ):
            raise ValueError
    except (ValueError, IndexError):
        raise InputError(
            f"line {begin + 2}", "must be Frames: N and Frame Time: seconds, one below the other"
        ) from None
    width = sum(len(bone.channels) for bone in bones)
    rows = np.array([_numbers(i, " ".join(words), width) for i, words in head[2:]]).reshape(-1, width)
    if len(rows) != count or count < _FEWEST_FRAMES:
        raise InputError(
            f"line {begin + 2}", f"must tell of {len(rows)} frames, {_FEWEST_FRAMES} at least, but tells {count}"
        )
    names, times = tuple(bone.name for bone in bones), read_only(period * np.arange(count))
    return Joints(names, times, read_only(_posed(bones, rows)), "y")


def _hierarchy(lines: list[str]) -> list[_Bone]:
    """Return the joints of a hierarchy, parents before children."""
    bones: list[_Bone] = []
    open_ones: list[int] = []
    for number, line in enumerate(lines[1:], 2):
        words = line.replace("{", " { ").replace("}", " } ").split()
        while words:
            word = words.pop(0).upper()
            if word in ("ROOT", "JOINT", "END"):
                parent = open_ones[-1] if open_ones else -1
                name = f"{bones[parent].name} end" if word == "END" else " ".join(w for w in words if w != "{")
                bones.append(_Bone(name, parent))
                words = [w for w in words if w == "{"]
            elif word == "{" and bones:
                open_ones.append(len(bones) - 1)
            elif word == "}" and open_ones:
                open_ones.pop()
            elif word == "OFFSET" and open_ones:
                bones[open_ones[-1]].offset, words = _numbers(number, " ".join(words), 3), []
            elif word == "CHANNELS" and open_ones:
                bones[open_ones[-1]].channels, words = _channels(number, words), []
            else:
                raise InputError(f"line {number}", f"must go on with the hierarchy, but is {line.strip()!r:.60}")
    if not bones or open_ones or any(len(bone.offset) != 3 for bone in bones):
        raise InputError(f"line {len(lines)}", "must end a hierarchy whose joints all have an OFFSET")
    return bones


def _channels(number: int, words: list[str]) -> list[str]:
    """Return the channels of a joint, such as Xposition, in order."""
    found = [word.capitalize() for word in words[1:]]
    known = all(word[:1] in _AXES and word[1:] in ("position", "rotation") for word in found)
    if not known or words[:1] != [str(len(found))]:
        raise InputError(
            f"line {number}", f"must be CHANNELS, their number and their names, but has {' '.join(words)!r:.60}"
        )
    return found


def _posed(bones: list[_Bone], rows: Floats) -> Floats:
    """Return positions of joints (joints, T, 3), each turned about its own axes in the order of its channels."""
    from scipy.spatial.transform import Rotation

    turns: list[Rotation] = []
    places, first = np.empty((len(bones), len(rows), 3)), 0
    for i, bone in enumerate(bones):
        own = rows[:, first : first + len(bone.channels)]
        first += len(bone.channels)
        offset, turn = np.tile(bone.offset, (len(rows), 1)), Rotation.identity(len(rows))
        for channel, values in zip(bone.channels, own.T, strict=True):
            if channel.endswith("position"):
                offset[:, _AXES[channel[0]]] = values if bone.parent < 0 else offset[:, _AXES[channel[0]]] + values
            else:
                turn = turn * Rotation.from_rotvec(np.radians(values)[:, None] * np.eye(3)[_AXES[channel[0]]])
        if bone.parent < 0:
            places[i], turned = offset, turn
        else:
            places[i] = places[bone.parent] + turns[bone.parent].apply(offset)
            turned = turns[bone.parent] * turn
        turns.append(turned)
    return places
