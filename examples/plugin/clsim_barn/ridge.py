"""A path family: sound over one straight edge.

The law is a toy: delays by the shortest length over the edge, spreading times a constant gain.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

import clsim
from clsim.arrays import Floats
from clsim.paths.family import DIFFRACTION, PathFamily, Rows
from clsim.paths.options import PathOptions
from clsim.paths.propagation import arrivals_by, straight
from clsim.paths.response import RETARDED, Arrivals, Kinematics, SceneResponse

POINT, ALONG = np.array([4.0, 3.0, 2.0]), np.array([0.6, 0.8, 0.0])
GAIN = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class RidgePaths(PathFamily):
    """Paths over one straight edge through a point (3,), along a unit vector (3,)."""

    point: Floats
    along: Floats
    gain: float

    object_names: ClassVar[tuple[str, ...]] = ("ridge",)

    def apex(self, source: Floats, receiver: Floats) -> Floats:
        """Points of the edge (..., 3), m, on the shortest lengths between two places (..., 3)."""
        (z_s, r_s), (z_r, r_r) = (self._cylindrical(x) for x in (source, receiver))
        return self.point + ((z_s * r_r + z_r * r_s) / (r_s + r_r))[..., None] * self.along

    def arrivals(self, rows: Rows, times: Floats, kinematics: Kinematics = RETARDED) -> Arrivals:
        source, receiver = (end.trajectory for end in self.ends(rows))
        times = np.asarray(times, dtype=np.float64)
        count = len(self.source[rows])
        return arrivals_by(
            lambda heard_at: WaysOver(self, count, heard_at),
            self.medium(0),
            (source, receiver),
            times,
            kinematics,
        )

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Any:
        response = self.gain * at.air(found) * (found.mach_factor / found.length)[..., None]
        at.apply_directivities(response, self.ends(rows), found, times)
        return response

    def vertices(self, rows: Rows, time: float, kinematics: Kinematics = RETARDED) -> Floats:
        source, receiver = (end.trajectory for end in self.ends(rows))
        found = self.arrivals(rows, np.array([time]), kinematics)
        emitted_at = source.position(found.emission_time[:, 0])
        heard_at = np.broadcast_to(receiver.position(np.array([time])), emitted_at.shape)
        return np.stack([emitted_at, self.apex(emitted_at, heard_at), heard_at], axis=1)

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        apex = self.apex(source, receiver)
        return straight(source, apex)[0] + straight(apex, receiver)[0]

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        return np.full((len(self.source[rows]), len(at.frequencies)), self.gain)

    def _cylindrical(self, place: Floats) -> tuple[Floats, Floats]:
        z = (place - self.point) @ self.along
        return z, np.linalg.norm(place - self.point - z[..., None] * self.along, axis=-1)


@dataclass(frozen=True, slots=True)
class WaysOver:
    """Ways over the edge to a receiver at places (T, 3), the same for all paths."""

    paths: RidgePaths
    count: int
    heard_at: Floats

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        heard_at = np.broadcast_to(self.heard_at, (self.count, *self.heard_at.shape))[p, t]
        start = np.broadcast_to(start, heard_at.shape)
        apex = self.paths.apex(start, heard_at)
        (first, direction), (second, _) = straight(start, apex), straight(apex, heard_at)
        return first + second, direction

    def arrive(self, start: Floats) -> Floats:
        heard_at = np.broadcast_to(self.heard_at, start.shape)
        return straight(self.paths.apex(start, heard_at), heard_at)[1]

    def bends(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        raise NotImplementedError  # the air is the same everywhere

    def seen(self) -> Floats:
        raise NotImplementedError  # and still


def find_ridge(scene: clsim.Scene, search: PathOptions) -> RidgePaths:
    """Find one path over the ridge for every source and receiver, in rooms that hold the ridge."""
    pairs = len(scene.sources) * len(scene.receivers) if scene.room.contains(POINT[None])[0] else 0
    source, receiver = np.divmod(np.arange(pairs), len(scene.receivers))
    count = len(source)
    return RidgePaths(
        scene=scene,
        source=source.astype(np.int32),
        receiver=receiver.astype(np.int32),
        order=np.ones(count, dtype=np.int32),
        start=np.full(count, -np.inf),
        end=np.full(count, np.inf),
        interactions=np.full((count, 1), DIFFRACTION, dtype=np.int8),
        objects=np.zeros((count, 1), dtype=np.int8),
        point=POINT,
        along=ALONG,
        gain=GAIN,
    )
