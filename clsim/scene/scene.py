"""Sources, receivers and the scene that holds them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.geometry import quaternion_from_direction
from clsim.arrays import FARTHEST, Floats, as_number
from clsim.errors import InputError
from clsim.scene.air import Air
from clsim.scene.directivity import AnyDirectivity, Directivity, Omni, SphericalDirectivity
from clsim.scene.electronics import Electronics
from clsim.scene.mesh_contact import NEAREST, first_contact
from clsim.scene.mesh_room import MeshRoom
from clsim.scene.room import Shoebox
from clsim.scene.trajectory import Trajectory
from clsim.scene.trajectory_checks import as_direction
from clsim.scene.transducer import Transducer

if TYPE_CHECKING:
    from clsim.scene.signal import Signal

_SCAN_RATE = 1000.0  # Hz, at which trajectories are checked against the room and the speed of sound
_SCAN_BLOCK = 65536  # instants checked at a time
_NEAREST = 1e-6  # m, least bound of the distance between ends


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A source of sound.

    Parameters
    ----------
    name : str
        Unique among the scene's sources.
    signal : Signal
        Sound pressure at 1 m on the source's axis in free field, Pa; with a transducer the voltage that drives it, V.
    trajectory : Trajectory
        Where it is and how it is turned.
    directivity : Directivity or SphericalDirectivity
        Gain by direction, 1 on the axis.
    aim : array_like (3,), optional
        A fixed direction in which the axis points; for trajectories without orientations of their own.
    start : float
        Time at which the signal begins, s, at least 0.
    transducer : Transducer, optional
        Response on the axis, Pa at 1 m per V.

    Attributes
    ----------
    emitted : Signal
        Sound pressure at 1 m on the axis: the signal, or what the transducer makes of it, ring-down included.
    """

    name: str
    signal: Signal
    trajectory: Trajectory
    directivity: AnyDirectivity = field(default_factory=Omni)
    aim: Any = None
    start: float = 0.0
    transducer: Transducer | None = None
    emitted: Signal = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "aim", _checked_ends(self))
        object.__setattr__(self, "start", as_number("start", self.start, at_least=0.0, unit="s"))
        emitted = self.signal if self.transducer is None else self.transducer.drive(self.signal)
        object.__setattr__(self, "emitted", emitted)

    @property
    def end(self) -> float:
        """Time at which the signal ends, s; a transducer rings on."""
        return self.start + self.signal.duration

    def orientation(self, times: Floats) -> Floats:
        """Return unit quaternions x y z w at `times` (n,), shape (n, 4)."""
        return _orientation(self, times)


@dataclass(frozen=True, slots=True, eq=False)
class Receiver:
    """A receiver of sound; its output is the sound pressure weighted by its directivity, or a voltage.

    Parameters
    ----------
    name : str
        Unique among the scene's receivers.
    trajectory : Trajectory
        Where it is and how it is turned.
    directivity : Directivity or SphericalDirectivity
        Gain by direction, 1 on the axis.
    aim : array_like (3,), optional
        A fixed direction in which the axis points; for trajectories without orientations of their own.
    transducer : Transducer, optional
        Response on the axis, V per Pa.
    electronics : Electronics, optional
        Noise, filters, amplifier, converter and clock.
    """

    name: str
    trajectory: Trajectory
    directivity: AnyDirectivity = field(default_factory=Omni)
    aim: Any = None
    transducer: Transducer | None = None
    electronics: Electronics | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "aim", _checked_ends(self))
        if self.electronics is not None and not isinstance(self.electronics, Electronics):
            raise InputError("electronics", f"must be Electronics, but is {self.electronics!r:.80}")

    @property
    def unit(self) -> str:
        """Unit of what it records: ``"Pa"``, or ``"V"`` with a transducer."""
        return "Pa" if self.transducer is None else "V"

    @property
    def pace(self) -> float:
        """True seconds per second told by the receiver's clock."""
        return 1.0 if self.electronics is None else 1.0 + 1e-6 * self.electronics.clock_ppm

    def clock_ahead(self, times: Floats) -> Floats:
        """Return how much later than told by the receiver's clock its samples are taken (n,), s."""
        return np.zeros_like(times) if self.electronics is None else self.electronics.clock_ahead(times)

    def orientation(self, times: Floats) -> Floats:
        """Return unit quaternions x y z w at `times` (n,), shape (n, 4)."""
        return _orientation(self, times)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A room, its air, and what sounds and listens in it.

    Parameters
    ----------
    room : Shoebox or MeshRoom
        The room.
    air : Air
        The air in it.
    sources, receivers : sequence
        At least one of each, with unique names.
    min_distance : float
        Distance below which a source may not come to a receiver, m.

    Raises
    ------
    InputError
        If a name is used twice, or a trajectory leaves the room, comes too close to another one or reaches
        the speed of sound; the message gives time and place.
    """

    room: Shoebox | MeshRoom
    air: Air
    sources: Sequence[Source]
    receivers: Sequence[Receiver]
    min_distance: float = 0.01

    def __post_init__(self) -> None:
        object.__setattr__(self, "sources", _checked_list("sources", self.sources, Source))
        object.__setattr__(self, "receivers", _checked_list("receivers", self.receivers, Receiver))
        distance = as_number("min_distance", self.min_distance, at_least=_NEAREST, at_most=FARTHEST, unit="m")
        object.__setattr__(self, "min_distance", distance)
        if not isinstance(self.room, Shoebox | MeshRoom):
            raise InputError("room", f"must be a Shoebox or a MeshRoom, but is {self.room!r:.80}")
        if not isinstance(self.air, Air):
            raise InputError("air", f"must be an Air, but is {self.air!r:.80}")
        for field_name, item in self.named_ends():
            _check_motion(self, field_name, item)
        for i, source in enumerate(self.sources):
            for receiver in self.receivers:
                _check_distance(self, i, source, receiver)
            if source.end > source.trajectory.end * (1 + 1e-12) + 1e-9:
                raise InputError(
                    f"sources[{i}].trajectory",
                    f"must last as long as the signal, which ends at {source.end:g} s, "
                    f"but ends at {source.trajectory.end:g} s",
                )
        _check_bands(self)

    def named_ends(self) -> list[tuple[str, Source | Receiver]]:
        """Return every source and receiver with the name of its field, e.g. ``"sources[0]"``."""
        sources = [(f"sources[{i}]", s) for i, s in enumerate(self.sources)]
        receivers = [(f"receivers[{i}]", r) for i, r in enumerate(self.receivers)]
        return [*sources, *receivers]

    def span(self, item: Source | Receiver) -> tuple[float, float]:
        """Return the finite part of an end's trajectory that matters, s: from 0 to its end."""
        last = item.trajectory.end
        if math.isinf(last):
            last = item.end if isinstance(item, Source) else 0.0
        return 0.0, last


def scan_times(start: float, end: float) -> list[Floats]:
    """Return the instants (1 ms apart or closer) from `start` to `end`, in blocks of bounded size."""
    count = max(2, math.ceil((end - start) * _SCAN_RATE) + 1)
    step = (end - start) / (count - 1)
    return [
        start + step * np.arange(i, min(i + _SCAN_BLOCK, count), dtype=np.float64) for i in range(0, count, _SCAN_BLOCK)
    ]


def _checked_ends(item: Source | Receiver) -> Floats | None:
    """Check name, trajectory, directivity and aim of a source or receiver; return the aim as an array."""
    if not isinstance(item.name, str) or not item.name.strip():
        raise InputError("name", f"must be a text that is not empty, but is {item.name!r:.80}")
    if not isinstance(item.trajectory, Trajectory):
        raise InputError("trajectory", f"must be a Trajectory, but is {item.trajectory!r:.80}")
    if not isinstance(item.directivity, Directivity | SphericalDirectivity):
        raise InputError("directivity", f"must be a directivity, but is {item.directivity!r:.80}")
    if item.transducer is not None and not isinstance(item.transducer, Transducer):
        raise InputError("transducer", f"must be a Transducer, but is {item.transducer!r:.80}")
    if item.trajectory.start > 0.0:
        raise InputError("trajectory", f"must begin at 0 s or before, but begins at {item.trajectory.start:g} s")
    if item.aim is None:
        return None
    if item.trajectory.has_orientation:
        raise InputError("aim", "must be left out, because the trajectory has orientations of its own")
    return as_direction("aim", item.aim)


def _orientation(item: Source | Receiver, times: Floats) -> Floats:
    if item.aim is None:
        return item.trajectory.orientation(times)
    return np.broadcast_to(quaternion_from_direction(item.aim), (len(times), 4))


def _checked_list(name: str, values: Any, kind: type[Source] | type[Receiver]) -> tuple[Any, ...]:
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise InputError(name, f"must be a list, but is {values!r:.80}")
    if not values:
        raise InputError(name, "must hold at least one, but is empty")
    seen: dict[str, int] = {}
    for i, value in enumerate(values):
        if not isinstance(value, kind):
            raise InputError(f"{name}[{i}]", f"must be a {kind.__name__}, but is {value!r:.80}")
        if value.name in seen:
            raise InputError(f"{name}[{i}].name", f"must be unique, but [{seen[value.name]}] is {value.name!r} too")
        seen[value.name] = i
    return tuple(values)


def _check_motion(scene: Scene, field_name: str, item: Source | Receiver) -> None:
    """Refuse a trajectory that leaves the room, meets a wall, or is as fast as sound, with time and place."""
    speed_of_sound = scene.air.sound_speed
    before = np.empty((0, 3))
    for times in scan_times(*scene.span(item)):
        positions = item.trajectory.position(times)
        check = _check_inside if isinstance(scene.room, Shoebox) else _check_walls
        check(scene, field_name, item.name, np.concatenate([before, positions]), times)
        before = positions[-1:]
        speed = np.linalg.norm(item.trajectory.velocity(times), axis=1)
        i = int(np.argmax(speed))
        if speed[i] >= speed_of_sound:
            raise InputError(
                f"{field_name}.trajectory",
                f"must stay below the speed of sound, {speed_of_sound:.6g} m/s, "
                f"but {item.name!r} moves at {speed[i]:.6g} m/s at {times[i]:.6g} s",
            )


def _check_inside(scene: Scene, field_name: str, name: str, positions: Floats, times: Floats) -> None:
    """Refuse positions outside a shoebox; the last ones are those at `times`."""
    outside = np.flatnonzero(~scene.room.contains(positions))
    if len(outside):
        raise InputError(
            f"{field_name}.trajectory",
            f"must stay inside the room, but {name!r} is at {_place(positions, times, int(outside[0]))}",
        )


def _check_walls(scene: Scene, field_name: str, name: str, positions: Floats, times: Floats) -> None:
    """Refuse positions on a wall of a mesh, and motions through one; the last positions are those at `times`."""
    assert isinstance(scene.room, MeshRoom)
    contact = first_contact(scene.room.walls, positions)
    if contact is not None:
        i, wall = contact
        raise InputError(
            f"{field_name}.trajectory",
            f"must stay {NEAREST:g} m away from every wall and walk through none, but {name!r} meets the wall "
            f"{scene.room.wall_names[wall]!r} at {_place(positions, times, i)}",
        )


def _place(positions: Floats, times: Floats, i: int) -> str:
    where = ", ".join(f"{x:.6g}" for x in positions[i])
    return f"({where}) m at {times[max(i - len(positions) + len(times), 0)]:.6g} s"


def _check_bands(scene: Scene) -> None:
    """Refuse a receiver whose transducer is not known over the band of a source."""
    for i, receiver in enumerate(scene.receivers):
        if receiver.transducer is None or math.isinf(receiver.transducer.model.band[1]):
            continue
        for source in scene.sources:
            try:
                receiver.transducer.check_covers(source.emitted.band(), f"what {source.name!r} emits")
            except InputError as error:
                raise error.within(f"receivers[{i}]") from error


def _check_distance(scene: Scene, index: int, source: Source, receiver: Receiver) -> None:
    """Refuse a source that comes closer to a receiver than the scene allows, with the time."""
    last = min(scene.span(source)[1], receiver.trajectory.end)
    for times in scan_times(0.0, last):
        apart = receiver.trajectory.position(times) - source.trajectory.position(times)
        moving = receiver.trajectory.velocity(times) - source.trajectory.velocity(times)
        speed_squared = np.maximum(np.sum(moving**2, axis=1), 1e-300)
        # Nearest point of straight relative motion within half a scan step of each instant.
        half = 0.5 * (times[1] - times[0])
        shift = np.clip(-np.sum(apart * moving, axis=1) / speed_squared, -half, half)
        distance = np.linalg.norm(apart + shift[:, None] * moving, axis=1)
        i = int(np.argmin(distance))
        if distance[i] < scene.min_distance:
            raise InputError(
                f"sources[{index}].trajectory",
                f"must stay at least {scene.min_distance:g} m away from every receiver (min_distance), "
                f"but {source.name!r} comes within {distance[i]:.3g} m of {receiver.name!r} "
                f"at {times[i] + shift[i]:.6g} s",
            )
