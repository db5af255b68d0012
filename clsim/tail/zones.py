"""Zones of places that share a tail, and how a moving end goes from one to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.quaternions import rotate
from clsim.scene.directivity.patterns import Omni

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.arrays import Floats
    from clsim.scene.ends import End
    from clsim.scene.room.protocol import Room

_OF_FREE_PATH = 0.25  # a zone's radius over the mean free path of rays
_LEAST, _MOST = 0.1, 4.0  # m, of the radius
_REACH = 1.5  # radii within which a zone is heard
_ANGLE = math.radians(30.0)  # by which a beam turns within a zone
_RATE, _MOST_TIMES = 50.0, 200_000  # Hz, and instants at which ways are looked at


@dataclass(frozen=True, eq=False)
class Zones:
    """Zones along the trajectories of some ends."""

    radius: float  # m
    poses: Floats  # (Z, 3) their middles over the radius, and, where beams turn, two axes over 30 degrees
    beams: bool  # whether beams turn
    turns: Floats  # (Z, 4) orientation in the middle, unit quaternions

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def centres(self) -> Floats:
        """Middles (Z, 3), m."""
        return np.asarray(self.poses[:, :3] * self.radius)

    @property
    def reach(self) -> float:
        """Radius of a zone about its middle, m."""
        return _REACH * self.radius

    @classmethod
    def along(cls, ends: Sequence[End], room: Room, until: float, *, beams: bool) -> Zones:
        """Return zones that cover the trajectories of ends from 0 s to a time, s; with `beams`, turning counts too."""
        return cls._covering([(end, _instants(end, until)) for end in ends], room, beams=beams)

    @classmethod
    def frozen(cls, ends: Sequence[End], room: Room, at: float, *, beams: bool) -> Zones:
        """Return zones that hold ends as they are at a time, s."""
        return cls._covering([(end, np.array([at])) for end in ends], room, beams=beams)

    @classmethod
    def _covering(cls, ends: Sequence[tuple[End, Floats]], room: Room, *, beams: bool) -> Zones:
        """Return zones that hold ends as they are at times (T,), s."""
        radius = zone_radius(room)
        found: list[Floats] = []
        turns: list[Floats] = []
        for end, times in ends:
            turning = beams and not isinstance(end.directivity, Omni)
            poses, orientation = _poses(end, times, radius, turning=turning, beams=beams), end.orientation(times)
            left = np.ones(len(times), np.bool_)
            for centre in found:
                left &= np.linalg.norm(poses - centre, axis=1) > 1.0
            while left.any():
                first = int(left.argmax())
                found.append(poses[first])
                turns.append(orientation[first])
                left &= np.linalg.norm(poses - poses[first], axis=1) > 1.0
        return cls(radius, np.array(found), beams, np.array(turns))

    def weights(self, end: End, times: Floats) -> Floats:
        """Return the shares (Z, T) of amplitude of an end at times (T,), s; their squares add up to 1.

        What stands still is in one zone; what moves goes smoothly from one to the next.
        """
        turning = self.beams and not isinstance(end.directivity, Omni)
        if is_static(end, turning=turning):
            pose = _poses(end, np.zeros(1), self.radius, turning=turning, beams=self.beams)[0]
            nearest = np.arange(len(self)) == np.linalg.norm(self.poses - pose, axis=1).argmin()
            return np.asarray(np.repeat(nearest[:, None].astype(np.float64), len(times), axis=1))
        poses = _poses(end, times, self.radius, turning=turning, beams=self.beams)
        apart = np.linalg.norm(poses - self.poses[:, None], axis=2)
        share = np.maximum(1.0 - apart / _REACH, 0.0)
        return np.asarray(share / np.sqrt(np.maximum(np.sum(share**2, axis=0), 1e-12)))


def zone_radius(room: Room) -> float:
    """Return the radius of zones in a room, m: a quarter of the mean free path, 0.1 to 4 m.

    The volume of an open room is that of the box about it.
    """
    low, high = room.extent
    volume = float(np.prod(high - low)) if room.volume is None else room.volume
    return float(np.clip(_OF_FREE_PATH * 4.0 * volume / room.surface_area, _LEAST, _MOST))


def is_static(end: End, *, turning: bool) -> bool:
    """Test whether an end never moves, and never turns where that matters."""
    return end.trajectory.is_static and not (turning and end.trajectory.turns)


def _instants(end: End, until: float) -> Floats:
    last = min(end.trajectory.end, until)
    if (end.trajectory.is_static and not end.trajectory.turns) or not 0.0 < last < math.inf:
        return np.zeros(1)
    return np.linspace(0.0, last, min(math.ceil(last * _RATE) + 1, _MOST_TIMES))


def _poses(end: End, times: Floats, radius: float, *, turning: bool, beams: bool) -> Floats:
    places = end.trajectory.position(times) / radius
    if not beams:
        return np.asarray(places)
    axes = np.zeros((len(times), 6))
    if turning:
        orientation = end.orientation(times)
        size = 1.0 / (2.0 * math.sin(0.5 * _ANGLE))
        axes = size * np.concatenate([rotate(orientation, axis) for axis in np.eye(3)[:2]], axis=1)
    return np.concatenate([places, axes], axis=1)
