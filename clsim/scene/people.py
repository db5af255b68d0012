"""People as scatterers: hands, and walking people with ellipsoids on the joints of a published gait.

R. Boulic, N. Magnenat-Thalmann and D. Thalmann, A global human walking model with real-time kinematic personification,
The Visual Computer 6 (1990), 344-358: from experiments, for speeds up to 3 leg lengths a second. Angles that the paper
draws go through its control points, with the values that V. C. Chen reads from them (The Micro-Doppler Effect in
Radar, 2011, section 4.1), as monotone cubics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from clsim.arrays import Floats, as_floats, as_number, read_only
from clsim.errors import InputError, check_kind, inside
from clsim.numerics.quaternions import quaternion_product, rotate
from clsim.scene.motion.curves import spline_through
from clsim.scene.motion.motion import turning_between
from clsim.scene.motion.trajectory import Trajectory, as_increasing
from clsim.scene.scatterer import Scatterer

Pose = dict[str, tuple[Floats, tuple[Floats, Floats, Floats]]]


_TURNS, _EVERY = 1000.0, 4  # Hz of orientations; positions are splines through every fourth


def pose_times(start: float, end: float) -> Floats:
    """Return instants (n,) of poses, s: one per millisecond, at least 17.

    >>> len(pose_times(0.0, 2.0))
    2001
    """
    count = _EVERY * max(4, math.ceil((end - start) * _TURNS / _EVERY))
    return np.linspace(start, end, count + 1)


def through_poses(times: Floats, places: Floats, quaternions: Floats) -> Trajectory:
    """Return the motion through poses; times (n,) s; places (n, 3) m; quaternions (n, 4)."""
    curve = spline_through(times[::_EVERY], places[::_EVERY], "not-a-knot")
    turning = turning_between(read_only(times), quaternions)
    return Trajectory(curve, float(times[0]), float(times[-1]), turning)


def quaternions_along(along: Floats, aside: Floats | None = None) -> Floats:
    """Return orientations (n, 4), x y z w, with z along one direction and y in the plane of a second one.

    Shapes: along (n, 3); aside (n, 3).

    aside: what is not along it counts. Left out for what is round: it then turns about itself as little as it can.

    >>> quaternions_along(np.array([[0.0, 0.0, 2.0]]), np.array([[0.0, 1.0, 0.5]])).tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    z = along / np.linalg.norm(along, axis=1, keepdims=True)
    if aside is None:
        y = np.empty_like(z)
        side = np.eye(3)[np.argmin(np.abs(z[0]))]
        for i, direction in enumerate(z):  # carried along from one to the next
            side = side - direction * (direction @ side)
            side = side / np.linalg.norm(side)
            y[i] = side
    else:
        y = aside - z * np.sum(aside * z, axis=1, keepdims=True)
        y = y / np.linalg.norm(y, axis=1, keepdims=True)
    return np.asarray(scipy.spatial.transform.Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=2)).as_quat())


SLOWEST, FASTEST = 0.1, 3.0  # leg lengths a second
_SPEEDS = 25  # between which angles are linear, over the range of speeds of a walk


@dataclass(frozen=True, slots=True, eq=False)
class Gait:
    """A walk at n instants; angles in rad, right side in row 0, left in row 1, translations in leg lengths."""

    hip: Floats  # (2, n) flexion, that of the ankle with the toes up
    knee: Floats  # likewise
    ankle: Floats  # likewise
    shoulder: Floats  # likewise
    elbow: Floats  # likewise
    lean: Floats  # (n,) of the trunk: backwards, and its turn to the left
    thorax: Floats  # likewise
    turn: Floats  # (n,) of the pelvis: to the left, and how far its left is above its right
    tilt: Floats  # likewise
    forward: Floats  # (n,) where the pelvis is, from where one walks at an even speed and a height
    left: Floats  # likewise
    up: Floats  # likewise


def cycle_duration(relative_speed: Floats) -> Floats:
    """Return the duration of two steps, ``1.346 / sqrt(v)`` s, at v leg lengths a second (n,)."""
    return np.asarray(1.346 / np.sqrt(relative_speed))


def gait_at(phase: Floats, relative_speed: Floats) -> Gait:
    """Return the walk at phases and speeds; phase (n,); relative_speed (n,)."""
    v, both = relative_speed, np.stack([phase, phase + 0.5]) % 1.0
    slow, wave = np.minimum(v, 0.5), 2.0 * np.pi * phase
    duration = cycle_duration(v)
    support = 0.752 - 0.143 / duration
    lean = np.radians(8.0 * slow - 8.0 * slow**2) * (1.0 - np.sin(2.0 * wave - 0.2 * np.pi))
    ahead = -(0.084 * slow - 0.084 * slow**2) * np.sin(2.0 * (wave + 2.0 * np.pi * (0.625 - support)))
    return Gait(
        _joint("hip", both, v), _joint("knee", both, v), _joint("ankle", both, v),
        np.radians(3.0 - 9.88 * v * (0.5 + np.cos(2.0 * np.pi * both))), _joint("elbow", both, v), lean,
        -_joint("thorax", both[:1], v)[0], np.radians(4.0 * v * np.cos(wave)),
        np.radians(1.66 * v * _tilt(phase % 1.0)),
        ahead, -(0.128 * slow - 0.128 * slow**2) * np.sin(wave - 0.2 * np.pi),
        0.015 * v * (np.sin(2.0 * wave - 0.7 * np.pi) - 1.0),
    )  # fmt: skip


def _tilt(phase: Floats) -> Floats:
    """Return the tilt of the pelvis over its amplitude, at phases 0 to 1: down on the side that swings."""
    half = phase % 0.5
    first = np.cos(2.0 * np.pi * half * 10.0 / 3.0) - 1.0
    then = -np.cos(2.0 * np.pi * (half - 0.15) * 10.0 / 7.0) - 1.0
    return np.where(phase < 0.5, 1.0, -1.0) * np.where(half < 0.15, first, then)


def _joint(name: str, phase: Floats, speed: Floats) -> Floats:
    """Return an angle (m, n), rad, at phases (m, n) of 0 to 1 and speeds (n,)."""
    low, high = float(speed.min()), float(speed.max())
    speeds = np.linspace(low, high, _SPEEDS if high - low > 1e-6 else 1)
    at = (speed - low) / max(high - low, 1e-6) * (len(speeds) - 1)
    total = np.zeros(phase.shape)
    for i, one in enumerate(speeds.tolist()):
        share = np.maximum(1.0 - np.abs(at - i), 0.0)
        here = np.flatnonzero(share)
        total[:, here] += share[here] * _cubics(_control_points(name, one), phase[:, here])
    return np.asarray(np.radians(total))


def _cubics(points: list[tuple[float, float]], phase: Floats) -> Floats:
    """Return the values of monotone cubics of period 1 through points."""
    once = np.array(sorted(points))
    every = np.concatenate([once + np.array([shift, 0.0]) for shift in (-2.0, -1.0, 0.0, 1.0, 2.0)])
    return np.asarray(scipy.interpolate.PchipInterpolator(*every.T)(phase))


def _control_points(name: str, v: float) -> list[tuple[float, float]]:
    """Return phases and angles, in degrees, between which a joint moves."""
    s, fast = 2.0 * min(v, 0.5), max(v - 1.3, 0.0) / 1.7
    quick = min(max(v - 0.5, 0.0) / 0.8, 1.0)
    support = 0.752 - 0.143 / float(cycle_duration(np.array(v)))
    if name == "hip":
        again = [(0.2 * fast - 0.1, 25.0 + 5.0 * fast)] if fast > 0.0 else []
        return [*again, (0.5, -15.0 * s), (0.9, 25.0 * s + 6.0 * fast)]
    if name == "knee":
        return [
            (0.17 - 0.05 * fast, 3.0 + 22.0 * fast), (0.4, 3.0), (0.75 - 0.05 * fast, 70.0 * s - 5.0 * fast),
            (1.0 - 0.03 * fast, 3.0 + 3.0 * fast),
        ]  # fmt: skip
    if name == "ankle":
        return [
            (0.0, -3.0 + 5.0 * fast), (0.08, -3.0 - 15.0 * s + 4.0 * fast),
            (0.5 - 0.1 * fast, -3.0 + 11.0 * s - 3.0 * fast),
            (support, -3.0 - 17.0 * s - 8.0 * fast), (0.85, -3.0 + 5.0 * fast),
        ]  # fmt: skip
    if name == "thorax":
        return [(0.1, 4.0 * v / 3.0), (0.4, -1.5 * v), (0.6, -4.0 * v / 3.0), (0.9, 1.5 * v)]
    return [
        (0.05, 3.0 + 3.0 * s + 8.0 * quick - 6.0 * fast),
        (0.5 + 0.01 * quick + 0.04 * fast, 3.0 + 17.0 * s + 24.0 * quick + 26.0 * fast),
        (0.9 - 0.1 * fast, 3.0 + 5.0 * s + 9.0 * quick - 6.0 * fast),
    ]  # fmt: skip


# Lengths over the height of a person: R. Drillis and R. Contini, Body segment parameters (New York University, 1966).
LEG, THIGH, SHANK, _FOOT_HEIGHT, _FOOT = 0.53, 0.245, 0.246, 0.039, 0.152
_UPPER_ARM, _FOREARM, _SHOULDERS, _HIPS, _TRUNK = 0.186, 0.2, 0.129, 0.0955, 0.288
_HEEL = 0.04  # behind the ankle

# Semi-axes forward, aside and along, over the height: our own choice.
PARTS = {
    "head": (0.055, 0.045, 0.065), "chest": (0.065, 0.1, 0.11), "pelvis": (0.06, 0.095, 0.07),
    "upper arm": (0.028, 0.028, 0.5 * _UPPER_ARM), "forearm": (0.022, 0.022, 0.5 * _FOREARM),
    "thigh": (0.045, 0.045, 0.5 * THIGH), "shank": (0.032, 0.032, 0.5 * SHANK), "foot": (0.5 * _FOOT, 0.025, 0.02),
}  # fmt: skip


def walking_person(name: str, height: float, trajectory: Trajectory, shadow: bool = True) -> list[Scatterer]:
    """Return the scatterers of a walking person: 13 ellipsoids on the gait of Boulic and Thalmann.

    Parameters
    ----------
    name : str
        Before the names of the parts: "name head", "name left shank" and so on.
    height : float
        m, above 0.
    trajectory : Trajectory
        Path of the person on the ground, at the height of the soles. Its speed decides how long steps
        are and how far limbs swing, its direction where the person looks; an orientation is not used. It is 0.1 to 3
        leg lengths (of 0.53 heights) a second, as was measured.
    shadow : bool
        Whether every part casts a shadow, see `Scatterer.ellipsoid`. Shadows of walls' echoes need as high a
        `scattering_order` as their number of reflections.

    Notes
    -----
    R. Boulic, N. Magnenat-Thalmann and D. Thalmann, The Visual Computer 6 (1990), 344-358. Two steps take
    ``1.346 / sqrt(v)`` s at v leg lengths a second. Soles are on the ground in the mean of a walk, and within 3 cm
    up to 1.4 leg lengths a second; feet slide a little, as the model has it. Where the speed changes within
    a step, angles follow at once. Lengths of limbs are those of R. Drillis and R. Contini (1966).

    Examples
    --------
    >>> parts = walking_person("Ada", 1.75, Trajectory.line((1, 2, 0), (4, 2, 0), 3.0))
    >>> len(parts), parts[0].name
    (13, 'Ada head')
    """
    tall = as_number("height", height, above=0.0, at_most=10.0, unit="m")
    times, phase, speed, heading = _walk(trajectory, LEG * tall)
    made, pose = [], _posed(gait_at(phase, speed))
    ground = np.mean(_lowest(pose))
    for part, (place, angles) in pose.items():
        turned = heading[:, None] * [0, 0, 1] + np.stack(angles[::-1], axis=1)
        places = trajectory.position(times) + _turned(tall * (place - [0.0, 0.0, ground]), heading)
        x, y, z = (_about(axis, turned[:, axis]) for axis in range(3))
        quaternions = quaternion_product(z, quaternion_product(y, x))
        moved = through_poses(times, places, quaternions)
        axes = tall * np.array(PARTS[part.removeprefix("left ").removeprefix("right ")])
        made.append(Scatterer.ellipsoid(f"{name} {part}", axes, moved, shadow=shadow))
    return made


def _walk(trajectory: Trajectory, leg: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return instants (n,), s, phases in cycles, speeds in legs a second, and headings, rad."""
    check_kind("trajectory", trajectory, Trajectory, "a Trajectory")
    if trajectory.is_static:
        raise InputError("trajectory", "must move, for a person to walk, but is at rest")
    times = pose_times(trajectory.start, trajectory.end)
    velocity = trajectory.velocity(times)[:, :2]
    speed = np.linalg.norm(velocity, axis=1) / leg
    for i in np.flatnonzero((speed < SLOWEST) | (speed > FASTEST))[:1]:
        allowed = f"{SLOWEST * leg:.3g} to {FASTEST * leg:.3g} m/s"
        problem = f"must walk at {allowed}, but is at {speed[i] * leg:.3g} m/s at {times[i]:.6g} s"
        raise InputError("trajectory", problem)
    rate = 1.0 / cycle_duration(speed)
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(times)
    phase = np.concatenate([[0.0], np.cumsum(steps)])
    return times, phase, speed, np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))


def _posed(gait: Gait) -> Pose:
    """Return places (n, 3) of parts, in heights, x forward and z from the ground, and angles about z, y and x, rad."""
    none = np.zeros_like(gait.up)
    root = LEG * np.stack([gait.forward, gait.left, 1.0 + gait.up], axis=1)
    trunk = gait.thorax, -gait.lean, none
    made = {
        "head": (root + _frame(trunk, 0.0, 0.0, _TRUNK + 0.11), trunk),
        "chest": (root + _frame(trunk, 0.0, 0.0, 0.19), trunk),
        "pelvis": (root + _frame((gait.turn, none, gait.tilt), 0.0, 0.0, 0.02), (gait.turn, none, gait.tilt)),
    }
    for row, (side, aside) in enumerate((("right", -1.0), ("left", 1.0))):
        shoulder = root + _frame(trunk, 0.0, aside * _SHOULDERS, _TRUNK)
        hip = root + _frame((gait.turn, none, gait.tilt), 0.0, aside * _HIPS, 0.0)
        for begin, names, lengths, swings in (
            (shoulder, ("upper arm", "forearm"), (_UPPER_ARM, _FOREARM), (gait.shoulder, gait.shoulder + gait.elbow)),
            (hip, ("thigh", "shank"), (THIGH, SHANK), (gait.hip, gait.hip - gait.knee)),
        ):
            for part, length, swing in zip(names, lengths, swings, strict=True):
                angles = none, -swing[row], none
                made[f"{side} {part}"] = begin + _frame(angles, 0.0, 0.0, -0.5 * length), angles
                begin = begin + _frame(angles, 0.0, 0.0, -length)
        angles = none, gait.knee[row] - gait.hip[row] - gait.ankle[row], none
        made[f"{side} foot"] = begin + _frame(angles, 0.5 * _FOOT - _HEEL, 0.0, 0.02 - _FOOT_HEIGHT), angles
    return made


def _lowest(pose: Pose) -> Floats:
    """Return height of the lower sole (n,), in body heights."""
    ends = []
    for side in ("right", "left"):
        place, angles = pose[f"{side} foot"]
        ends += [place + _frame(angles, x, 0.0, -0.02) for x in (-0.5 * _FOOT, 0.5 * _FOOT)]
    return np.asarray(np.min(ends, axis=0)[:, 2])


def _frame(angles: tuple[Floats, Floats, Floats], x: float, y: float, z: float) -> Floats:
    """Return position (n, 3) of a point of a frame turned about x, then y, then z by angles (n,)."""
    about_z, about_y, about_x = angles
    aside, up = y * np.cos(about_x) - z * np.sin(about_x), y * np.sin(about_x) + z * np.cos(about_x)
    ahead, up = x * np.cos(about_y) + up * np.sin(about_y), up * np.cos(about_y) - x * np.sin(about_y)
    return _turned(np.stack([ahead, aside, up], axis=1), about_z)


def _turned(places: Floats, heading: Floats) -> Floats:
    """Return places (n, 3) turned about z by angles (n,)."""
    x, y, c, s = places[:, 0], places[:, 1], np.cos(heading), np.sin(heading)
    return np.stack([c * x - s * y, s * x + c * y, places[:, 2]], axis=1)


def _about(axis: int, angle: Floats) -> Floats:
    """Return quaternions (n, 4) that turn about an axis by angles (n,)."""
    made = np.zeros((len(angle), 4))
    made[:, axis], made[:, 3] = np.sin(0.5 * angle), np.cos(0.5 * angle)
    return made


# All over the length of the hand, which is 0.108 of the height of a person (R. Drillis and R. Contini, 1966); our own
# choice. The palm's semi-axes: its thickness (x), towards the thumb (y), along the fingers (z).
PALM = (0.075, 0.22, 0.27)
RADIUS = 0.045  # of fingers
# Knuckle (y, z) from the middle of the palm, direction in the palm's plane from z to y, rad, both parts' lengths.
FINGERS = {
    "thumb": (0.17, -0.1, 0.8, 0.16, 0.14), "index": (0.13, 0.24, 0.1, 0.21, 0.17),
    "middle": (0.04, 0.26, 0.0, 0.23, 0.19), "ring": (-0.05, 0.25, -0.08, 0.21, 0.18),
    "little": (-0.13, 0.21, -0.2, 0.16, 0.14),
}  # fmt: skip
_BENT, _THUMB = 0.5 * math.pi, 0.6  # rad by which each joint of a closed hand is bent; of which a thumb does a share


def hand(
    name: str, trajectory: Trajectory, length: float = 0.19, opening: ArrayLike | float = 1.0, shadow: bool = True
) -> list[Scatterer]:
    """Return the scatterers of a hand: an ellipsoid for the palm, and two capsules for each finger.

    Parameters
    ----------
    name : str
        Before the names of the parts: "name palm", "name index", "name index tip" and so on.
    trajectory : Trajectory
        Position and orientation of the palm's middle. Its own x points out of the palm, y towards the thumb and z
        along the fingers.
    length : float
        Length of the open hand, m.
    opening : float or array_like (n, 2)
        1 for an open hand, 0 for a fist; or times, s, with the share at each. From one to the next it goes smoothly,
        and rests there for a moment.
    shadow : bool
        Whether every part casts a shadow, see `Scatterer.ellipsoid` and `Scatterer.capsule`.

    Examples
    --------
    >>> wave = hand("hand", Trajectory.fixed((2.0, 1.0, 1.0)), opening=[(0.0, 1.0), (0.4, 0.0), (0.8, 1.0)])
    >>> len(wave), wave[1].name, wave[1].trajectory.end
    (11, 'hand thumb', 0.8)
    """
    size = as_number("length", length, above=0.0, at_most=10.0, unit="m")
    check_kind("trajectory", trajectory, Trajectory, "a Trajectory")
    times, shares = _opening(opening)
    resting = trajectory.is_static and (not trajectory.turns or math.isinf(trajectory.end))  # in one orientation
    if resting and len(times) == 1:
        instants = np.zeros(1)
    elif math.isinf(trajectory.end):
        instants = pose_times(min(float(times[0]), 0.0), max(float(times[-1]), 0.0))
    else:
        instants = pose_times(trajectory.start, trajectory.end)
    share = np.full(len(instants), shares[0]) if len(times) == 1 else _between(times, shares, instants)
    still = np.zeros((len(instants), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(instants), 1))
    moved = _moved(trajectory, instants, *still)
    made = [Scatterer.ellipsoid(f"{name} palm", size * np.array(PALM), moved, shadow=shadow)]
    for finger, numbers in FINGERS.items():
        for i, (place, turn) in enumerate(_bent(finger, numbers, share)):
            moved = _moved(trajectory, instants, size * place, turn)
            part = f"{name} {finger}" + (" tip" if i else "")
            made.append(Scatterer.capsule(part, size * RADIUS, size * numbers[3 + i], moved, shadow=shadow))
    return made


def _opening(opening: ArrayLike | float) -> tuple[Floats, Floats]:
    """Return times (n,), s, and the opening of a hand at each (n,), 0 to 1."""
    if isinstance(opening, int | float | np.integer | np.floating):
        return np.zeros(1), np.array([as_number("opening", opening, at_least=0.0, at_most=1.0)])
    rows = as_floats("opening", opening, (None, 2))
    for i, share in enumerate(rows[:, 1].tolist()):
        as_number(f"opening[{i}][1]", share, at_least=0.0, at_most=1.0)
    with inside("opening"):
        return as_increasing(rows[:, 0]), rows[:, 1]


def _between(times: Floats, shares: Floats, instants: Floats) -> Floats:
    """Return opening of a hand at instants (n,), from one value to the next as ``6 u^5 - 15 u^4 + 10 u^3``."""
    piece = np.clip(np.searchsorted(times, instants, side="right") - 1, 0, len(times) - 2)
    u = np.clip((instants - times[piece]) / (times[piece + 1] - times[piece]), 0.0, 1.0)
    return np.asarray(shares[piece] + (shares[piece + 1] - shares[piece]) * u**3 * (10.0 + u * (6.0 * u - 15.0)))


def _bent(finger: str, numbers: tuple[float, ...], share: Floats) -> list[tuple[Floats, Floats]]:
    """Return the middles (n, 3), in lengths of the hand, and orientations (n, 4) of both parts of a finger."""
    aside, up, angle, *lengths = numbers
    about_x = np.array([math.sin(-0.5 * angle), 0.0, 0.0, math.cos(0.5 * angle)])  # from z towards y
    bend = _BENT * (_THUMB if finger == "thumb" else 1.0) * (1.0 - share)
    place = np.tile([0.0, aside, up], (len(share), 1))
    made = []
    for joint, length in enumerate(lengths):
        half = 0.5 * (joint + 1) * bend
        about_y = np.stack([0.0 * half, np.sin(half), 0.0 * half, np.cos(half)], axis=1)  # from z towards x
        turn = quaternion_product(np.broadcast_to(about_x, about_y.shape), about_y)
        along = rotate(turn, np.array([0.0, 0.0, length]))
        made.append((place + 0.5 * along, turn))
        place = place + along
    return made


def _moved(trajectory: Trajectory, times: Floats, places: Floats, turns: Floats) -> Trajectory:
    """Return motion of a part at positions (n, 3), m, of a frame, turned by quaternions (n, 4)."""
    frame = trajectory.orientation(times)
    places = trajectory.position(times) + rotate(frame, places)
    turned = quaternion_product(frame, turns)
    if len(times) == 1:
        return Trajectory.fixed(read_only(places[0]), turned[0])
    return through_poses(times, places, turned)
