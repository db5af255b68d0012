"""Paths that faces of moving bodies reflect, among walls."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from clsim.arrays import read_only
from clsim.paths.arrivals import MACH_EXPONENT, Arrivals
from clsim.paths.family import BODY, NONE, SPECULAR
from clsim.paths.moving.events import find_events
from clsim.paths.moving.moving_paths import MovingPaths
from clsim.paths.propagation import UniformAir

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.family import Instant, Rows
    from clsim.paths.moving.events import Events
    from clsim.paths.response import SceneResponse

_AT_A_TIME = 16384  # nodes that are looked at together: what is worked on stays in the cache


@dataclass(frozen=True, slots=True, eq=False)
class BodyArrivals(Arrivals):
    """What paths by bodies bring, with what their responses need."""

    cosine: Floats  # (P, T, N) of the angle of incidence at each mirror


@dataclass(frozen=True, eq=False)
class BodyPaths(MovingPaths):
    """Paths by mirrors of which one or more are faces of bodies.

    Attributes
    ----------
    surfaces : ndarray (paths, N) int
        Mirrors from the source's side, filled up with -1: walls of the room, and behind them the faces of bodies.
    """

    interactions: NDArray[np.signedinteger[Any]] = field(init=False, repr=False)
    objects: NDArray[np.signedinteger[Any]] = field(init=False, repr=False)
    surfaces: NDArray[np.int32]

    columns: ClassVar[tuple[str, ...]] = ("surfaces",)

    def __post_init__(self) -> None:
        walls = len(self.scene.room.faces)
        of_body = self.surfaces >= walls
        kinds = np.where(self.surfaces < 0, np.int8(NONE), np.where(of_body, np.int8(BODY), np.int8(SPECULAR)))
        object.__setattr__(self, "interactions", read_only(kinds))
        object.__setattr__(self, "objects", read_only(self.surfaces - walls * of_body))
        super().__post_init__()

    @property
    def device(self) -> str:
        """The program for images of events."""
        return "bodies"

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the faces of bodies."""
        return tuple(name for body in self.scene.bodies for name in body.faces)

    def events(self, rows: Rows, times: Floats, motion: str = "retarded") -> Events:
        """Events of reflection of paths between one source and one receiver.

        Shapes: rows (P,); times (T,) s.
        """
        source, receiver = self.ends(rows)
        medium = self.medium(int(self.source[rows][0]))
        assert isinstance(medium, UniformAir)
        ends = source.trajectory, receiver.trajectory
        return find_events(self.mirrors, self.surfaces[rows], ends, medium, times, motion == "retarded")

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver.

        The pressure is that of the image of the source: it falls with the distance d from the image event, and by the
        time of reception over that of emission, ``s(t - delay) / (d dt/dt_e)``, in which the Doppler factors of the
        source and of all mirrors are. Other conditions on moving faces differ by the order of their Mach number.
        """
        times, index = np.asarray(times, dtype=np.float64), np.arange(len(self))[rows]
        parts = -(-len(times) * len(index) // _AT_A_TIME)
        found = [self._arrivals(index, some, motion, amplitude) for some in np.array_split(times, max(parts, 1))]
        names = [f.name for f in fields(BodyArrivals) if f.name != "means"]
        columns: dict[str, Any] = {name: np.concatenate([each[name] for each in found], axis=1) for name in names}
        return BodyArrivals(**columns, means=None)

    def _arrivals(self, index: NDArray[np.int64], times: Floats, motion: str, amplitude: str) -> dict[str, Floats]:
        events, retarded = self.events(index, times, motion), motion == "retarded"
        mach = events.mach if retarded else np.zeros_like(events.mach)
        stretch = events.stretch / events.carried if retarded else np.ones_like(events.stretch)
        return {
            "delay": events.delay, "delay_rate": events.rate, "departure": events.departure, "arrival": events.arrival,
            "length": events.distance * events.carried, "through": events.distance,
            "emission_time": times - events.delay if retarded else np.broadcast_to(times, events.delay.shape),
            "mach_factor": stretch ** -MACH_EXPONENT[amplitude], "frequency_ratio": 1.0 / (1.0 - mach),
            "cosine": events.cosine,
        }  # fmt: skip

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): spreading, air, walls, faces and directivities."""
        surfaces, cosine = self.surfaces[rows], cast("BodyArrivals", found).cosine
        response: Any = at.air(found) * at.reflection(surfaces)[:, None, :]
        response *= (found.mach_factor / found.length)[..., None]
        for bounce, met in enumerate(surfaces.T):
            for wall in np.unique(met[at.angular[met]]).tolist():
                here = np.flatnonzero(met == wall)
                response[here] *= at.reflection_at(wall, cosine[here, :, bounce])
        at.apply_directivities(response, self.ends(rows), found, times)
        return cast("Floats", response)

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        """Return source, points of reflection and receiver (P, N + 2, 3) of paths of one pair."""
        found = np.array(self.events(rows, np.array([time]), motion).place[:, 0])
        found[np.arange(found.shape[1]) > self.order[rows][:, None] + 1] = np.nan
        return found

    def _lengths(self, index: NDArray[np.int64], source: Floats, receiver: Floats, times: Instant) -> Floats:
        return self.mirrors.distances(self.surfaces[index], source, receiver, times)

    @cached_property
    def speeds(self) -> Floats:
        """Sums (paths,) of the bounds of the speeds of the bodies on each path's way, m/s."""
        peak = np.array([body.peak_speed for body in self.scene.bodies])
        owner = np.append(self.mirrors.owner, -1)[self.surfaces]
        return read_only(np.where(owner >= 0, np.append(peak, 0.0)[owner], 0.0).sum(axis=1))

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F), 1 where they depend on the angle."""
        return at.largest_reflection(self.surfaces[rows])
