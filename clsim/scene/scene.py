"""Sources, receivers and the scene that holds them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import FARTHEST, Floats, as_number
from clsim.errors import InputError
from clsim.numerics.quaternions import quaternion_from_direction
from clsim.scene.air import Air
from clsim.scene.directivity.patterns import AxialPattern, DirectionalPattern, Directivity, Omni
from clsim.scene.flush import checked_flush
from clsim.scene.motion.checks import LONGEST, as_direction
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.placement import check_distances, check_motions, check_sides
from clsim.scene.plausibility import warn_of_units
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.transducer.electronics import Electronics
from clsim.scene.transducer.transducer import Transducer

if TYPE_CHECKING:
    from clsim.scene.signal.signal import Signal

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
        Time at which the signal begins, s, from 0 to 1e9.
    transducer : Transducer, optional
        Response on the axis, Pa at 1 m per V.
    flush : bool or array_like (3,)
        Whether it sits in a wall: True on the side of the room, or a direction off the wall to the side that it is on,
        as a mesh that is open needs it.

    Attributes
    ----------
    emitted : Signal
        Sound pressure at 1 m on the axis: the signal, or what the transducer makes of it, ring-down included.
    """

    name: str
    signal: Signal
    trajectory: Trajectory
    directivity: Directivity = field(default_factory=Omni)
    aim: Any = None
    start: float = 0.0
    transducer: Transducer | None = None
    flush: Any = False
    emitted: Signal = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "aim", _checked_ends(self))
        object.__setattr__(self, "flush", checked_flush(self.flush))
        object.__setattr__(self, "start", as_number("start", self.start, at_least=0.0, at_most=LONGEST, unit="s"))
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
    flush : bool or array_like (3,)
        Whether it sits in a wall; as of a `Source`.
    """

    name: str
    trajectory: Trajectory
    directivity: Directivity = field(default_factory=Omni)
    aim: Any = None
    transducer: Transducer | None = None
    electronics: Electronics | None = None
    flush: Any = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "aim", _checked_ends(self))
        object.__setattr__(self, "flush", checked_flush(self.flush))
        if self.electronics is not None and not isinstance(self.electronics, Electronics):
            raise InputError("electronics", f"must be Electronics, but is {self.electronics!r:.80}")

    @property
    def unit(self) -> str:
        """Unit of what it records: ``"Pa"``, or ``"V"`` with a transducer."""
        return "Pa" if self.transducer is None else "V"

    @property
    def clock_rate(self) -> float:
        """True seconds per second told by the receiver's clock."""
        return 1.0 if self.electronics is None else 1.0 + 1e-6 * self.electronics.clock_ppm

    def clock_error(self, times: Floats) -> Floats:
        """Return how much later than told by the receiver's clock its samples are taken (n,), s."""
        return np.zeros_like(times) if self.electronics is None else self.electronics.clock_error(times)

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
        the speed of sound, or an end is outside a watertight mesh that others are in; the message gives time and place.

    Warns
    -----
    ClsimWarning
        If all ends are outside a watertight mesh, or the room's size or a signal's frequency look like another unit.
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
        check_motions(self)
        check_sides(self)
        warn_of_units(self)
        for i, source in enumerate(self.sources):
            check_distances(self, i, source)
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


def _checked_ends(item: Source | Receiver) -> Floats | None:
    """Check name, trajectory, directivity and aim of a source or receiver; return the aim as an array."""
    if not isinstance(item.name, str) or not item.name.strip():
        raise InputError("name", f"must be a text that is not empty, but is {item.name!r:.80}")
    if not isinstance(item.trajectory, Trajectory):
        raise InputError("trajectory", f"must be a Trajectory, but is {item.trajectory!r:.80}")
    if not isinstance(item.directivity, Omni | AxialPattern | DirectionalPattern):
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
