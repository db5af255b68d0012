"""The ends of paths: sources and receivers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_choice, as_floats, as_number, short_repr
from clsim.errors import InputError
from clsim.numerics.quaternions import quaternion_from_direction
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.motion.checks import LONGEST, as_direction, as_places
from clsim.scene.motion.facing import forward, towards
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.transducer.electronics import Electronics
from clsim.scene.transducer.transducer import Transducer

if TYPE_CHECKING:
    from clsim.scene.signal.signal import Signal


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
    directivity : Directivity
        Gain by direction, 1 on the axis.
    aim : array_like (3,) or "forward", optional
        A fixed direction in which the axis points, or ``"forward"`` for that of the motion; for trajectories without
        orientations of their own.
    aim_at : array_like (3,), optional
        A point at which the axis points from wherever the trajectory is, m; in place of `aim`.
    start : float
        Time at which the signal begins, s, from 0 to 1e9.
    transducer : Transducer, optional
        Response on the axis, Pa at 1 m per V.
    flush : bool or array_like (3,)
        Whether it sits in a wall: True on the side of the room, or a direction off the wall to the side that it is on,
        as a mesh that is open needs it.
    mounted_on : str, optional
        Name of the body of the scene that carries it: trajectory and aim are then given in the body's own coordinates.
        The ends of a `Scene` have trajectories in the room, and nothing here.

    Attributes
    ----------
    emitted : Signal
        Sound pressure at 1 m on the axis: the signal, or what the transducer makes of it, ring-down included.

    Raises
    ------
    InputError
        If a value is of another kind or out of bounds, nothing moves ``"forward"``, or its direction jumps.

    Notes
    -----
    ``aim="forward"`` and `aim_at` become orientations of `trajectory`, without roll: the +y axis stays horizontal. They
    hold the axis within 1e-4 rad. Where a motion rests (below a fiftieth of its top speed) ``"forward"`` turns evenly
    from one direction to the next.
    """

    name: str
    signal: Signal
    trajectory: Trajectory
    directivity: Directivity = field(default_factory=Omni)
    aim: Any = None
    start: float = 0.0
    transducer: Transducer | None = None
    flush: Any = False
    mounted_on: str | None = None
    aim_at: Any = None
    emitted: Signal = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        _check_end(self)
        _settle_aim(self)
        object.__setattr__(self, "flush", _checked_flush(self.flush))
        object.__setattr__(self, "start", as_number("start", self.start, at_least=0.0, at_most=LONGEST, unit="s"))
        emitted = self.signal if self.transducer is None else self.transducer.drive(self.signal)
        object.__setattr__(self, "emitted", emitted)

    @property
    def end(self) -> float:
        """Time at which the signal ends, s; a transducer rings on."""
        return self.start + self.signal.duration

    @property
    def time_range(self) -> tuple[float, float]:
        """The finite part of the trajectory that matters, s: from 0 to its end, or that of the signal."""
        return 0.0, self.end if math.isinf(self.trajectory.end) else self.trajectory.end

    def orientation(self, times: Floats) -> Floats:
        """Return unit quaternions x y z w at `times` (n,), shape (n, 4).

        Parameters
        ----------
        times : ndarray (n,)
            s.

        Returns
        -------
        ndarray (n, 4)
            1.
        """
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
    directivity : Directivity
        Gain by direction, 1 on the axis.
    aim : array_like (3,) or "forward", optional
        A fixed direction in which the axis points, or ``"forward"`` for that of the motion; for trajectories without
        orientations of their own.
    aim_at : array_like (3,), optional
        A point at which the axis points from wherever the trajectory is, m; in place of `aim`.
    transducer : Transducer, optional
        Response on the axis, V per Pa.
    electronics : Electronics, optional
        Noise, filters, amplifier, converter and clock.
    flush : bool or array_like (3,)
        Whether it sits in a wall; as of a `Source`.
    mounted_on : str, optional
        Name of the body that carries it; as of a `Source`.

    Raises
    ------
    InputError
        If a value is of another kind or out of bounds.
    """

    name: str
    trajectory: Trajectory
    directivity: Directivity = field(default_factory=Omni)
    aim: Any = None
    transducer: Transducer | None = None
    electronics: Electronics | None = None
    flush: Any = False
    mounted_on: str | None = None
    aim_at: Any = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        _check_end(self)
        _settle_aim(self)
        object.__setattr__(self, "flush", _checked_flush(self.flush))
        if self.electronics is not None and not isinstance(self.electronics, Electronics):
            raise InputError("electronics", f"must be Electronics, but is {self.electronics!r:.80}")

    @property
    def unit(self) -> str:
        """Unit of what it records: ``"Pa"``, or ``"V"`` with a transducer."""
        return "Pa" if self.transducer is None else "V"

    @property
    def clock_rate(self) -> float:
        """True seconds per second of the receiver's clock."""
        return 1.0 if self.electronics is None else 1.0 + 1e-6 * self.electronics.clock_ppm

    def clock_error(self, times: Floats) -> Floats:
        """Return the error of the receiver's clock at its times (n,), s: how much later samples are taken.

        Parameters
        ----------
        times : ndarray (n,)
            By the receiver's clock, s.

        Returns
        -------
        ndarray (n,)
            s.
        """
        return np.zeros_like(times) if self.electronics is None else self.electronics.clock_error(times)

    @property
    def time_range(self) -> tuple[float, float]:
        """The finite part of the trajectory that matters, s: from 0 to its end, or to 0 at a fixed point."""
        return 0.0, 0.0 if math.isinf(self.trajectory.end) else self.trajectory.end

    def orientation(self, times: Floats) -> Floats:
        """Return unit quaternions x y z w at `times` (n,), shape (n, 4).

        Parameters
        ----------
        times : ndarray (n,)
            s.

        Returns
        -------
        ndarray (n, 4)
            1.
        """
        return _orientation(self, times)


End = Source | Receiver


def _check_end(item: End) -> None:
    """Refuse a source or receiver whose name, trajectory, directivity or carrier is none."""
    if not isinstance(item.name, str) or not item.name.strip():
        raise InputError("name", f"must be a text that is not empty, but is {item.name!r:.80}")
    if not isinstance(item.trajectory, Trajectory):
        raise InputError("trajectory", f"must be a Trajectory, but is {item.trajectory!r:.80}")
    if not isinstance(item.directivity, Directivity):
        raise InputError("directivity", f"must be a Directivity, but is {item.directivity!r:.80}")
    if item.transducer is not None and not isinstance(item.transducer, Transducer):
        raise InputError("transducer", f"must be a Transducer, but is {item.transducer!r:.80}")
    if item.mounted_on is not None and (not isinstance(item.mounted_on, str) or item.flush is not False):
        raise InputError("mounted_on", f"must name a body, and flush be left out, but is {item.mounted_on!r:.80}")
    if item.trajectory.start > 0.0:
        raise InputError("trajectory", f"must begin at 0 s or before, but begins at {item.trajectory.start:g} s")


def _settle_aim(item: End) -> None:
    """Make the aim of a source or receiver an array, or orientations of its trajectory."""
    for name in ("aim", "aim_at"):
        if getattr(item, name) is not None and item.trajectory.has_orientation:
            raise InputError(name, "must be left out, because the trajectory has orientations of its own")
    aim, trajectory = item.aim, item.trajectory
    if item.aim_at is not None:
        if aim is not None:
            raise InputError("aim_at", "must be left out where aim is given")
        trajectory = towards(trajectory, as_places("aim_at", item.aim_at, (3,)))
    elif isinstance(aim, str):
        as_choice("aim", aim, ("forward",))
        aim, trajectory = None, forward(trajectory)
    elif aim is not None:
        aim = as_direction("aim", aim)
    for name, value in (("aim", aim), ("aim_at", None), ("trajectory", trajectory)):
        object.__setattr__(item, name, value)


def _orientation(item: End, times: Floats) -> Floats:
    if item.aim is None:
        return item.trajectory.orientation(times)
    return np.broadcast_to(quaternion_from_direction(item.aim), (len(times), 4))


def _checked_flush(value: Any) -> bool | Floats:
    """Return False, True, or a unit vector."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    side = as_floats("flush", value, (3,))
    length = float(np.linalg.norm(side))
    if not length > 0.0:
        raise InputError("flush", "must be True, False or a direction off the wall, but is 0, 0, 0")
    return np.asarray(side / length)
