"""People from motion capture: parts between joints of a file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from clsim.arrays import FARTHEST, Floats, as_choice, as_number, read_only
from clsim.errors import InputError
from clsim.files.input_files import LARGEST_TEXT, read_file
from clsim.numerics.quaternions import rotate as turned
from clsim.scene.motion.curves import spline_through
from clsim.scene.motion.motion import LONGEST
from clsim.scene.motion.trajectory import Trajectory, as_increasing, as_path, as_places, as_quaternions
from clsim.scene.people import PARTS, SHANK, THIGH, pose_times, quaternions_along, through_poses
from clsim.scene.scatterer import Scatterer

Segments = Sequence[tuple[str, str, float]]

_FEWEST_FRAMES = 4  # of a spline
_AXES = {"X": 0, "Y": 1, "Z": 2}
_COLUMN = re.compile(r"(.+)[ ._]([xyz])", re.IGNORECASE)
SHAPES, UPS = ("ellipsoid", "capsule"), ("x", "y", "z")
_SHORTEST = 1e-3  # m, of a part
# What joints are called in files, of one side without its name: the first that a file has is taken.
_NAMES = {
    "hips": ("hips", "pelvis", "root"), "neck": ("neck", "neck1", "upperneck"), "head": ("head",),
    "shoulder": ("upperarm", "arm", "shoulder", "humerus"), "elbow": ("forearm", "elbow", "lowerarm", "radius"),
    "wrist": ("hand", "wrist"), "hip": ("upleg", "thigh", "upperleg", "hip", "femur"),
    "knee": ("leg", "knee", "shin", "lowerleg", "tibia"), "ankle": ("foot", "ankle"),
    "toe": ("toebase", "toe", "toes", "footend"),
}  # fmt: skip
_SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toe")
_LIMBS = {
    "upper arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"), "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"), "foot": ("ankle", "toe"),
}  # fmt: skip
# Between which joints, what is aside, and at which share of the way from one to the other.
_TRUNK = (
    ("head", ("neck", "head"), "shoulder", 1.0), ("chest", ("hips", "neck"), "shoulder", 0.62),
    ("pelvis", ("hips", "neck"), "hip", 0.05),
)  # fmt: skip
_HEAD = 0.04  # of the height, from its joint to the middle of the head


@dataclass(frozen=True, slots=True, eq=False)
class Joints:
    """Positions of joints over time."""

    names: tuple[str, ...]  # as in the file; the end of a chain without a name of its own is "NAME end"
    times: Floats  # (T,) s, from 0
    positions: Floats  # (joints, T, 3) in the file's axes and unit of length
    up: str  # the axis that goes up, by the custom of the format


def read_joints(path: Path) -> Joints:
    """Read a file: one that begins with HIERARCHY is BVH, any other a table."""
    # The header of a table names ``t`` (or ``time``), s, and ``NAME x``, ``NAME y``, ``NAME z`` of every joint, in any
    # order, with a blank, a point or an underscore before the axis; lines that begin with ``#`` are skipped.
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
        problem = f"must be the last of {_FEWEST_FRAMES} rows at least, not of {len(rows)}"
        raise InputError(f"line {lines[-1][0]}", problem)
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
        problem = "must be Frames: N and Frame Time: seconds, one below the other"
        raise InputError(f"line {begin + 2}", problem) from None
    width = sum(len(bone.channels) for bone in bones)
    rows = np.array([_numbers(i, " ".join(words), width) for i, words in head[2:]]).reshape(-1, width)
    if len(rows) != count or count < _FEWEST_FRAMES:
        raise InputError(
            f"line {begin + 2}",
            f"must be the number of frames that follow, {len(rows)}, and at least {_FEWEST_FRAMES}, but is {count}",
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
        problem = f"must be CHANNELS, their number and their names, but has {' '.join(words)!r:.60}"
        raise InputError(f"line {number}", problem)
    return found


def _posed(bones: list[_Bone], rows: Floats) -> Floats:
    """Return positions of joints (joints, T, 3), each turned about its own axes in the order of its channels."""
    turns: list[scipy.spatial.transform.Rotation] = []
    places, first = np.empty((len(bones), len(rows), 3)), 0
    for i, bone in enumerate(bones):
        own = rows[:, first : first + len(bone.channels)]
        first += len(bone.channels)
        offset, turn = np.tile(bone.offset, (len(rows), 1)), scipy.spatial.transform.Rotation.identity(len(rows))
        for channel, values in zip(bone.channels, own.T, strict=True):
            if channel.endswith("position"):
                offset[:, _AXES[channel[0]]] = values if bone.parent < 0 else offset[:, _AXES[channel[0]]] + values
            else:
                turn = turn * scipy.spatial.transform.Rotation.from_rotvec(
                    np.radians(values)[:, None] * np.eye(3)[_AXES[channel[0]]]
                )
        if bone.parent < 0:
            places[i], turned = offset, turn
        else:
            places[i] = places[bone.parent] + turns[bone.parent].apply(offset)
            turned = turns[bone.parent] * turn
        turns.append(turned)
    return places


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A part of a body: its name, size along x, y and z (3,) m, centre (n, 3) m, and directions of its z and y."""

    name: str
    size: Floats
    centre: Floats
    along: Floats
    aside: Floats | None


def captured_person(
    name: str, path: str | PathLike[str], *, segments: Segments | None = None, shape: str = "ellipsoid",
    scale: float = 1.0, up: str | None = None, rotate: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    translate: ArrayLike = (0.0, 0.0, 0.0), time_offset: float = 0.0, shadow: bool = True,
) -> list[Scatterer]:  # fmt: skip
    r"""Return the scatterers of a person from a motion-capture file: one for each part between two joints.

    Parameters
    ----------
    name : str
        Before the names of the parts: "name head", "name left shank" and so on.
    path : path-like
        BVH, or a table (CSV) whose header names ``t``, s, and ``NAME x``, ``NAME y``, ``NAME z`` of every joint.
    segments : sequence of (str, str, float), optional
        Two joints, by their names in the file, and the radius of what is between them, m. When left out, the parts of
        `walking_person` whose joints have usual names, such as LeftUpLeg or left knee, as thick as there.
    shape : {"ellipsoid", "capsule"}
        Shape of limbs and of segments.
    scale : float
        Metres in the file's unit of length: 0.01 for centimetres.
    up : {"x", "y", "z"}, optional
        The file's upward axis; y for BVH and z for tables when left out. The file's next axis (z after y)
        becomes x in the room.
    rotate, translate : array_like (4,), array_like (3,)
        Then turned by a unit quaternion x y z w, and moved, m.
    time_offset : float
        Time of the file's first row, 0 or before, s.
    shadow : bool
        Whether every part casts a shadow, see `Scatterer.ellipsoid`.

    Notes
    -----
    Joints go on C2 splines through the rows, so that the noise of markers appears as motion: smooth them before.
    Parts stay as long as they are in the mean.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder) / "arm.csv"
    ...     rows = [f"{t},1,2,1.4,1.3,2,{1.4 - t}" for t in (0.0, 0.1, 0.2, 0.3)]
    ...     _ = file.write_text("\n".join(["t,elbow x,elbow y,elbow z,wrist x,wrist y,wrist z", *rows]))
    ...     parts = captured_person("Ada", file, segments=[("elbow", "wrist", 0.04)])
    >>> parts[0].name, parts[0].trajectory.position(0.2).round(3).tolist()
    ('Ada elbow to wrist', [1.15, 2.0, 1.3])
    """
    joints = read_joints(as_path(path))
    as_choice("shape", shape, SHAPES)
    scale = as_number("scale", scale, at_least=1e-9, at_most=1e9)
    axes = {"x": [1, 2, 0], "y": [2, 0, 1], "z": [0, 1, 2]}[joints.up if up is None else as_choice("up", up, UPS)]
    turn, shift = as_quaternions("rotate", rotate, (4,)), as_places("translate", translate, (3,))
    start = as_number("time_offset", time_offset, at_least=-LONGEST, at_most=0.0, unit="s")
    times = pose_times(0.0, float(joints.times[-1]))
    curves = [
        spline_through(joints.times, turned(turn, scale * x[:, axes]) + shift, "not-a-knot") for x in joints.positions
    ]
    known = dict(zip(joints.names, (curve.position(times) for curve in curves), strict=True))
    parts = _usual(joints, known) if segments is None else _between(known, segments)
    return [_scatterer(f"{name} {part.name}", part, start + times, shape, shadow) for part in parts]


def _between(known: dict[str, Floats], segments: Any) -> list[_Part]:
    """Return the parts between the given pairs of joints."""
    if isinstance(segments, str) or not isinstance(segments, Sequence) or not segments:
        raise InputError("segments", f"must be a list of (joint, joint, radius), but is {segments!r:.80}")
    parts = []
    for i, segment in enumerate(segments):
        if isinstance(segment, str) or not isinstance(segment, Sequence) or len(segment) != 3:
            raise InputError(f"segments[{i}]", f"must be (joint, joint, radius), but is {segment!r:.80}")
        for joint in segment[:2]:
            if joint not in known:
                listed = ", ".join(list(known)[:40])
                raise InputError(f"segments[{i}]", f"must name joints of the file ({listed}), but names {joint!r:.80}")
        radius = as_number(f"segments[{i}].radius", segment[2], above=0.0, unit="m")
        part = _limb(f"{segment[0]} to {segment[1]}", known[segment[0]], known[segment[1]], radius)
        if part is None:
            problem = f"must have a length, but {segment[0]!r} and {segment[1]!r} are at one place"
            raise InputError(f"segments[{i}]", problem)
        parts.append(part)
    return parts


def _limb(name: str, begin: Floats, end: Floats, radius: float, flat: float | None = None) -> _Part | None:
    """Return the limb between two joints (n, 3); None if they coincide at any time."""
    away = end - begin
    if np.linalg.norm(away, axis=1).min() < _SHORTEST:
        return None
    half = 0.5 * float(np.linalg.norm(away, axis=1).mean())
    return _Part(name, np.array([flat or radius, radius, half]), 0.5 * (begin + end), away, None)


def _usual(joints: Joints, known: dict[str, Floats]) -> list[_Part]:
    """Return the parts of a person whose joints have usual names."""
    own = {re.sub(r"^mixamorig", "", re.sub("[^a-z0-9]", "", name.lower())): name for name in reversed(joints.names)}
    at: dict[str, Floats] = {}
    for joint, names in _NAMES.items():
        for side in ("left", "right") if joint in _SIDED else ("",):
            spelt = [w for n in names for w in ((f"{side}{n}", f"{side[0]}{n}", f"{n}{side[0]}") if side else (n,))]
            found = next((own[word] for word in spelt if word in own), None)
            if found is not None:
                at[f"{side} {joint}".strip()] = known[found]
    needed = [f"left {joint}" for joint in ("hip", "knee", "ankle", "shoulder") if f"left {joint}" not in at]
    if needed:
        listed = ", ".join(joints.names[:40])
        raise InputError("path", f"must have a joint for the {needed[0]}, or segments given; its joints are {listed}")
    lengths = [np.linalg.norm(at["left knee"] - at[f"left {joint}"], axis=1).mean() for joint in ("hip", "ankle")]
    tall = float(sum(lengths)) / (THIGH + SHANK)
    parts = _trunk(at, tall)
    for side in ("right", "left"):
        for part, (one, other) in _LIMBS.items():
            ends = [at.get(f"{side} {joint}") for joint in (one, other)]
            if ends[0] is None or ends[1] is None:
                continue
            size = tall * np.sort(PARTS[part])
            limb = _limb(f"{side} {part}", ends[0], ends[1], float(size[1]), float(size[0]))
            parts += [] if limb is None else [limb]
    return parts


def _trunk(at: dict[str, Floats], tall: float) -> list[_Part]:
    """Return head, chest and pelvis of a person of a height, m, as far as their joints are known."""
    parts = []
    wide = {
        joint: at[f"left {joint}"] - at[f"right {joint}"] for joint in ("shoulder", "hip") if f"right {joint}" in at
    }
    for part, (low, high), joint, share in _TRUNK:
        if low in at and high in at and joint in wide:
            along = at[high] - at[low]
            centre = at[low] + share * along
            if part == "head":
                centre = centre + _HEAD * tall * along / np.linalg.norm(along, axis=1, keepdims=True)
            parts.append(_Part(part, tall * np.array(PARTS[part]), centre, along, wide[joint]))
    return parts


def _scatterer(name: str, part: _Part, times: Floats, shape: str, shadow: bool) -> Scatterer:
    """Return a part as a scatterer."""
    moved: Trajectory = through_poses(times, part.centre, quaternions_along(part.along, part.aside))
    if part.aside is None and shape == "capsule":
        return Scatterer.capsule(name, float(part.size[1]), 2.0 * float(part.size[2]), moved, shadow=shadow)
    return Scatterer.ellipsoid(name, part.size, moved, shadow=shadow)
