"""Position, velocity and orientation over time, with a beginning and an end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import Floats, as_number, read_only
from clsim.scene.motion.curves import CONTINUATION, Curve, is_static
from clsim.scene.motion.instants import Instants

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from clsim.scene.motion.instants import Indices
    from clsim.scene.motion.orientation import Turning

_SAME = 1e-9  # relative difference of speeds that does not matter


def _no_breaks() -> Floats:
    return read_only(np.empty(0))


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A motion from `start` to `end`.

    Shortly before its start and after its end, by 0.05 s, it goes on smoothly (lines and circles as
    they are, splines by a parabola with the end's velocity and acceleration), because sound received at the
    start was emitted before it. Beyond that everything stands still.

    Parameters
    ----------
    curve : Curve
        Position and velocity.
    start, end : float
        First and last time, s; -inf and inf for a fixed point.
    turning : Turning, optional
        Orientation over time; identity where left out.
    notes : tuple of str
        What was found, smoothed or repaired in the making, a sentence each.
    breaks : ndarray (k,)
        Times at which the velocity jumps, s; empty for smooth trajectories.
    residual : ndarray (3,), optional
        Root mean square by which smoothing moved the points along x, y and z, m.
    """

    curve: Curve
    start: float
    end: float
    turning: Turning | None = None
    notes: tuple[str, ...] = ()
    breaks: Floats = field(default_factory=_no_breaks)
    residual: Floats | None = None
    # By range and rate: every scene that the motion is in asks, and each of its scatterers' ways.
    _peaks: dict[tuple[float, float, float], tuple[float, float]] = field(default_factory=dict, init=False, repr=False)

    @property
    def duration(self) -> float:
        """`end` less `start`, s; infinite for a fixed point."""
        return self.end - self.start

    @property
    def has_orientation(self) -> bool:
        """Whether the trajectory gives the transducer's orientation."""
        return self.turning is not None

    @property
    def is_static(self) -> bool:
        """Whether it never moves; it may turn."""
        return is_static(self.curve)

    @property
    def turns(self) -> bool:
        """Whether the orientation changes."""
        return self.turning is not None and self.turning.turns

    def position(self, t: ArrayLike) -> Floats:
        """Return positions, m.

        Parameters
        ----------
        t : array_like
            Times, s, of any shape and in any order.

        Returns
        -------
        ndarray
            Shape of `t` and 3 more columns: ``(n, 3)`` for ``(n,)``, ``(3,)`` for a number.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> Trajectory.line((0, 0, 1), (2, 0, 1), duration=4.0).position([1.0, 3.0])
        array([[0.5, 0. , 1. ],
               [1.5, 0. , 1. ]])
        """
        time = np.asarray(t, dtype=np.float64)
        if self.end < np.inf:
            time = np.clip(time, self.start - CONTINUATION, self.end + CONTINUATION)
        return self.curve.position(time)

    def velocity(self, t: ArrayLike) -> Floats:
        """Return velocities, m/s, shaped as in `position`; at a break the one after it.

        Parameters
        ----------
        t : array_like (...)
            Times, s.

        Returns
        -------
        ndarray
            Shape of `t` and 3 more columns.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> Trajectory.line((0, 0, 1), (2, 0, 1), duration=4.0).velocity(1.0)
        array([0.5, 0. , 0. ])
        """
        time = np.asarray(t, dtype=np.float64)
        first, last = self.start - CONTINUATION, self.end + CONTINUATION
        velocity = self.curve.velocity(np.clip(time, first, last))
        velocity[(time < first) | (time > last)] = 0.0
        return velocity

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        """Return upper bounds of the speed between two times (n,), m/s; tighter for shorter intervals.

        Parameters
        ----------
        begin, end : ndarray (n,)
            Times, s.

        Returns
        -------
        ndarray (n,)
            m/s.

        Examples
        --------
        >>> import numpy as np
        >>> from clsim import Trajectory
        >>> push = Trajectory.line((0, 0, 1), (2, 0, 1), duration=4.0)
        >>> push.speed_over(np.array([1.0, 9.0]), np.array([1e6, 1e6]))
        array([0.5, 0. ])
        """
        first, last = self.start - CONTINUATION, self.end + CONTINUATION
        speed = self.curve.speed_over(np.clip(begin, first, last), np.clip(end, first, last))
        return np.where((begin > last) | (end < first), 0.0, speed * (1.0 + 1e-12))

    def orientation(self, t: ArrayLike) -> Floats:
        """Return unit quaternions x y z w whose sign does not jump; identity without orientation.

        Parameters
        ----------
        t : array_like (...)
            Times, s. Before the first and after the last orientation given, that one is held.

        Returns
        -------
        ndarray
            Shape of `t` and 4 more columns.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> Trajectory.fixed((1, 1, 1)).orientation(0.0)
        array([0., 0., 0., 1.])
        """
        time = np.asarray(t, dtype=np.float64)
        if self.turning is None:
            return np.tile([0.0, 0.0, 0.0, 1.0], (*time.shape, 1))
        return self.turning.orientation(time)

    def angular_velocity(self, t: ArrayLike) -> Floats:
        """Return angular velocities in the room, rad/s, shaped as in `position`; 0 without orientation.

        Parameters
        ----------
        t : array_like (...)
            Times, s; where the turning changes, the angular velocity after it.

        Returns
        -------
        ndarray
            Shape of `t` and 3 more columns.

        Examples
        --------
        >>> import numpy as np
        >>> from clsim import Trajectory
        >>> turn = [[0, 0, 0, 1], [0, 0, np.sin(0.5), np.cos(0.5)]]
        >>> Trajectory.waypoints([0, 2], [[1, 1, 1], [2, 1, 1]], turn).angular_velocity(1.0).round(9)
        array([0. , 0. , 0.5])
        """
        time = np.asarray(t, dtype=np.float64)
        if self.turning is None:
            return np.zeros((*time.shape, 3))
        return self.turning.angular_velocity(time)

    @property
    def peak_turn(self) -> float:
        """Bound of the angular velocity, rad/s."""
        return 0.0 if self.turning is None else self.turning.peak

    def peak_speed(self, start: float, end: float, rate: float = 1000.0) -> tuple[float, float]:
        """Return the largest speed at evenly spaced instants to nine digits, and when it is reached.

        Instants between which no speed can be larger are left out, so that long rests and even motions cost nothing.

        Parameters
        ----------
        start, end : float
            First and last instant, s.
        rate : float
            Instants per second, at least; above 0, Hz.

        Returns
        -------
        speed, time : float
            m/s and s.

        Raises
        ------
        InputError
            If the range is not finite or ends before it starts, or the rate is not above 0.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> Trajectory.line((0, 0, 0), (3, 4, 0), duration=2.0).peak_speed(0.0, 2.0)
        (2.5, 0.0)
        """
        start = as_number("start", start, unit="s")
        end = as_number("end", end, at_least=start, unit="s")
        key = (start, end, as_number("rate", rate, above=0.0, unit="Hz"))
        if key not in self._peaks:
            self._peaks[key] = self._peak_at(Instants(*key))
        return self._peaks[key]

    def _peak_at(self, instants: Instants) -> tuple[float, float]:
        """Return the largest speed at some instants to nine digits, m/s, and when it is reached, s."""
        best = (float(np.linalg.norm(self.velocity(instants.start))), instants.start)

        def probe(first: Indices, middle: Indices, last: Indices) -> tuple[Indices, NDArray[np.bool_]]:
            """Return no hits, and a mask of ranges that may contain a speed above the best so far."""
            nonlocal best
            times = instants.times(middle)
            speed = np.linalg.norm(self.velocity(times), axis=1)
            i = int(np.argmax(speed))
            if speed[i] > best[0] * (1.0 + _SAME):
                best = (float(speed[i]), float(times[i]))
            bound = self.speed_over(instants.times(first), instants.times(last))
            return np.full(len(first), -1), bound > best[0] * (1.0 + _SAME)

        instants.first(probe)
        return best
