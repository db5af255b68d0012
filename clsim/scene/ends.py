"""The ends of paths: sources and receivers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_floats, as_number, short_repr
from clsim.errors import InputError
from clsim.numerics.quaternions import quaternion_from_direction
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.motion.checks import LONGEST, as_direction
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
    aim : array_like (3,), optional
        A fixed direction in which the axis points; for trajectories without orientations of their own.
    start : float
        Time at which the signal begins, s, from 0 to 1e9.
    transducer : Transducer, optional
        Response on the axis, Pa at 1 m per V.
    flush : bool or array_like (3,)
        Whether it sits in a wall: True on the side of the room, or a direction off the wall to the side that it is on,
        as a mesh that is open needs it.
    mounted_on : str, optional
        Name of the body of the scene that carries it: trajectory and aim are then told in the body's own coordinates.
        The ends of a `Scene` have trajectories in the room, and nothing here.

    Attributes
    ----------
    emitted : Signal
        Sound pressure at 1 m on the axis: the signal, or what the transducer makes of it, ring-down included.

    Raises
    ------
    InputError
        If a value is of another kind or out of bounds.
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
    emitted: Signal = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "aim", _checked_end(self))
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
    aim : array_like (3,), optional
        A fixed direction in which the axis points; for trajectories without orientations of their own.
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

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "aim", _checked_end(self))
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


def _checked_end(item: End) -> Floats | None:
    """Check name, trajectory, directivity and aim of a source or receiver; return the aim as an array."""
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
    if item.aim is None:
        return None
    if item.trajectory.has_orientation:
        raise InputError("aim", "must be left out, because the trajectory has orientations of its own")
    return as_direction("aim", item.aim)


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
