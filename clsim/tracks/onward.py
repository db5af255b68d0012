"""Tracks and turnings that go on beyond a run."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.numerics.quaternions import quaternion_product
from clsim.scene.ends import Receiver, Source
from clsim.scene.motion.curves import CONTINUATION, onward
from clsim.scene.motion.motion import Motion, Turning
from clsim.tracks.tracks import SceneTracks

LEAST_JUMP = 1e-4  # rad/s, of the angular velocity, below which it counts as smooth


@dataclass(frozen=True, slots=True, eq=False)
class OnwardTurning:
    """A turning that goes on at its last angular velocity beyond two times, s."""

    turning: Turning
    first: float
    last: float

    turns = property(lambda self: self.turning.turns)
    peak = property(lambda self: self.turning.peak)
    breaks = property(lambda self: self.turning.breaks)

    def lever(self, points: Floats) -> float:
        return self.turning.lever(points)

    def orientation(self, time: Floats) -> Floats:
        known = np.clip(time, self.first, self.last)
        half = 0.5 * self.angular_velocity(time) * (time - known)[..., None]
        angle = np.linalg.norm(half, axis=-1, keepdims=True)
        turn = np.concatenate([np.sinc(angle / math.pi) * half, np.cos(angle)], axis=-1)
        return quaternion_product(turn, self.turning.orientation(known))

    def angular_velocity(self, time: Floats) -> Floats:
        return self.turning.angular_velocity(np.clip(time, self.first, np.nextafter(self.last, -np.inf)))


def turn_jumps(motion: Motion, least: float = LEAST_JUMP) -> Floats:
    """Return times (k,) between start and end at which the angular velocity jumps by at least so much, rad/s, s."""
    times = np.empty(0) if motion.turning is None else motion.turning.breaks
    times = times[(times > motion.start) & (times < motion.end)]
    before, after = (motion.angular_velocity(at) for at in (np.nextafter(times, -np.inf), times))
    return np.asarray(times[np.linalg.norm(after - before, axis=-1) > least])


def continued(tracks: SceneTracks, seconds: float) -> SceneTracks:
    """Return the same tracks between ends that move on at either side, s: silent, they may leave the room."""
    ends: dict[str, Any] = {"sources": tracks.scene.sources, "receivers": tracks.scene.receivers}
    return tracks.with_ends(**{name: [_end(end, seconds) for end in some] for name, some in ends.items()})


def _end(end: Source | Receiver, seconds: float) -> Source | Receiver:
    """Return an end that moves on: on lines and circles as they are, on others straight beyond their continuation."""
    made, motion = copy(end), end.trajectory
    if motion.end != np.inf:
        curve = onward(motion.curve, motion.start - CONTINUATION, motion.end + CONTINUATION)
        turning = None if motion.turning is None else OnwardTurning(motion.turning, motion.start, motion.end)
        begin, stop = motion.start - seconds, motion.end + seconds
        longer = replace(motion, curve=curve, turning=turning, start=begin, end=stop)
        object.__setattr__(made, "trajectory", longer)
    return made
