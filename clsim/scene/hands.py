"""Hands: a palm and five fingers that open and close."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import as_floats, as_number, read_only
from clsim.errors import InputError
from clsim.numerics.quaternions import rotate
from clsim.scene.motion.checks import as_increasing
from clsim.scene.motion.orientation import quaternion_product
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.posing import pose_times, through_poses
from clsim.scene.scatterer import Scatterer

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clsim.arrays import Floats

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


def hand(name: str, trajectory: Trajectory, length: float = 0.19, opening: ArrayLike | float = 1.0) -> list[Scatterer]:
    """Return what a hand scatters by: an ellipsoid, the palm, and two capsules for each finger.

    Parameters
    ----------
    name : str
        Before the names of the parts: "name palm", "name index", "name index tip" and so on.
    trajectory : Trajectory
        Where the middle of the palm is, and how it is turned: its own x goes out of the palm, y towards the thumb and z
        along the fingers.
    length : float
        Of the open hand, m.
    opening : float or array_like (n, 2)
        1 for an open hand, 0 for a fist; or times, s, with the share at each. From one to the next it goes smoothly,
        and rests there for a moment.

    Returns
    -------
    list of Scatterer
        For the `scatterers` of a `Scene`; where the trajectory rests and the opening changes, from 0 s or before to the
        last of its times.

    Raises
    ------
    InputError
        If a value is of another kind or out of bounds, or times do not increase.

    Examples
    --------
    >>> from clsim import Trajectory, hand
    >>> wave = hand("hand", Trajectory.fixed((2.0, 1.0, 1.0)), opening=[(0.0, 1.0), (0.4, 0.0), (0.8, 1.0)])
    >>> len(wave), wave[1].name, wave[1].trajectory.end
    (11, 'hand thumb', 0.8)
    """
    size = as_number("length", length, above=0.0, at_most=10.0, unit="m")
    if not isinstance(trajectory, Trajectory):
        raise InputError("trajectory", f"must be a Trajectory, but is {trajectory!r:.80}")
    times, shares = _opening(opening)
    if trajectory.is_static and not trajectory.turns and len(times) == 1:
        instants = np.zeros(1)
    elif math.isinf(trajectory.end):
        instants = pose_times(min(float(times[0]), 0.0), max(float(times[-1]), 0.0))
    else:
        instants = pose_times(trajectory.start, trajectory.end)
    share = np.full(len(instants), shares[0]) if len(times) == 1 else _between(times, shares, instants)
    still = np.zeros((len(instants), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(instants), 1))
    made = [Scatterer.ellipsoid(f"{name} palm", size * np.array(PALM), _moved(trajectory, instants, *still))]
    for finger, numbers in FINGERS.items():
        for i, (place, turn) in enumerate(_bent(finger, numbers, share)):
            way = _moved(trajectory, instants, size * place, turn)
            part = f"{name} {finger}" + (" tip" if i else "")
            made.append(Scatterer.capsule(part, size * RADIUS, size * numbers[3 + i], way))
    return made


def _opening(opening: ArrayLike | float) -> tuple[Floats, Floats]:
    """Return times (n,), s, and how open a hand is at each (n,), 0 to 1."""
    if isinstance(opening, int | float | np.integer | np.floating):
        return np.zeros(1), np.array([as_number("opening", opening, at_least=0.0, at_most=1.0)])
    rows = as_floats("opening", opening, (None, 2))
    for i, share in enumerate(rows[:, 1].tolist()):
        as_number(f"opening[{i}][1]", share, at_least=0.0, at_most=1.0)
    try:
        return as_increasing(rows[:, 0]), rows[:, 1]
    except InputError as error:
        raise error.within("opening") from error


def _between(times: Floats, shares: Floats, instants: Floats) -> Floats:
    """Return how open a hand is at instants (n,): from one share to the next as ``6 u^5 - 15 u^4 + 10 u^3``."""
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
    """Return the motion of what is at places (n, 3), m, of a frame, turned by quaternions (n, 4)."""
    frame = trajectory.orientation(times)
    places = trajectory.position(times) + rotate(frame, places)
    turned = quaternion_product(frame, turns)
    if len(times) == 1:
        return Trajectory.fixed(read_only(places[0]), turned[0])
    return through_poses(times, places, turned)
