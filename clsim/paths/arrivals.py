"""Delay, gain and directions of every path, in float64 at any time: the definition of right.

The OpenCL tracks are the small twin of this file.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from clsim.paths.response import Responses

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.scene.scene import Scene

Motion = Literal["retarded", "quasi-static"]
Amplitude = Literal["wave-equation", "static", "convective"]
MOTIONS: tuple[str, ...] = get_args(Motion)
AMPLITUDES: tuple[str, ...] = get_args(Amplitude)
MACH_EXPONENT = {"static": 0, "wave-equation": 1, "convective": 2}

_TOGETHER = 16384  # arrivals of paths at times that are computed at a time, where they are many
_NEWTON_LIMIT = 60
_CONVERGED = 1e-15  # s


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """What P paths bring at T times, each array (P, T) or (P, T, 3).

    Attributes
    ----------
    delay : ndarray (P, T)
        From emission to reception, s.
    delay_rate : ndarray (P, T)
        Its derivative by the time of reception; the Doppler factor is ``1 - delay_rate``.
    gain : ndarray (P, T)
        Received over emitted pressure (at 1 m) at the centre of the source's band; complex where a wall or beam is.
    departure, arrival : ndarray (P, T, 3)
        Unit vectors: from the real source along the path, and from the receiver towards the image.
    distance : ndarray (P, T)
        Length of the path, m.
    emitted : ndarray (P, T)
        Times of emission, s.
    stretch : ndarray (P, T)
        Factor of the amplitude by the source's motion.
    """

    delay: Floats
    delay_rate: Floats
    gain: Floats | Complexes
    departure: Floats
    arrival: Floats
    distance: Floats
    emitted: Floats
    mach_factor: Floats

    def part(self, rows: NDArray[np.int64], times: slice = slice(None)) -> Arrivals:
        """Return what some of the paths bring at some of the times."""
        return Arrivals(**{f.name: getattr(self, f.name)[rows, times] for f in fields(self)})


@dataclass(frozen=True, slots=True, eq=False)
class PairPaths:
    """Paths between one source and one receiver.

    Attributes
    ----------
    source, receiver : int
        Indices in the scene.
    matrix, offset : ndarray (P, 3, 3), (P, 3)
        Isometry of every image.
    walls : ndarray (P, N) int
        Walls of each path, filled up with -1.
    """

    source: int
    receiver: int
    matrix: Floats
    offset: Floats
    walls: NDArray[np.signedinteger[Any]]

    def part(self, rows: NDArray[np.int64]) -> PairPaths:
        """Return some of the paths."""
        return PairPaths(self.source, self.receiver, self.matrix[rows], self.offset[rows], self.walls[rows])


def arrivals(
    scene: Scene, group: PairPaths, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
) -> Arrivals:
    """Return delay, gain and directions of a group of paths.

    Parameters
    ----------
    scene : Scene
        Holds trajectories, air and directivities.
    group : PairPaths
        P paths.
    times : ndarray (T,)
        Times of reception, s.
    motion : {"retarded", "quasi-static"}
        Whether the image is where it was at emission, or where it is at reception.
    amplitude : {"wave-equation", "static", "convective"}
        Exponent 1, 0 or 2 of ``1 / (1 - M)``; quasi-static motion has none.

    Notes
    -----
    The delay solves ``delay = |x_r(t) - A x_s(t - delay) - b| / c`` by Newton's method from the quasi-static value.
    A point source of the linear wave equation is received as ``s(t - delay) / (d (1 - M))``, M the Mach number of
    the image towards the receiver at emission (Morse and Ingard, Theoretical Acoustics, 1968, section 11.2).
    """
    source, receiver = scene.sources[group.source], scene.receivers[group.receiver]
    c = scene.air.speed_of_sound
    times = np.asarray(times, dtype=np.float64)
    at = receiver.trajectory.position(times)
    # Seen from the image's room the receiver stands at A^T (x_r - b): one mirrored receiver per path.
    mirrored = np.einsum("pji,ptj->pti", group.matrix, at[None] - group.offset[:, None, :])
    if motion == "quasi-static":
        emitted = np.broadcast_to(times, mirrored.shape[:2])
        delay = np.linalg.norm(mirrored - source.trajectory.position(times), axis=-1) / c
    else:
        delay = _solve_delay(source.trajectory, mirrored, times, c)
        emitted = times - delay
    apart = mirrored - _at(source.trajectory.position, emitted)
    distance = np.linalg.norm(apart, axis=-1)
    departure = apart / distance[..., None]
    mach = np.sum(departure * _at(source.trajectory.velocity, emitted), axis=-1) / c
    moving = np.einsum("pji,tj->pti", group.matrix, receiver.trajectory.velocity(times))
    receding = np.sum(departure * moving, axis=-1) / c
    retarded = motion == "retarded"
    arrival = -np.einsum("pij,ptj->pti", group.matrix, departure)
    mach_factor = (1.0 - mach) ** -MACH_EXPONENT[amplitude] if retarded else np.ones_like(mach)
    rate = (receding - mach) / (1.0 - mach) if retarded else receding - mach
    found = Arrivals(delay, rate, np.empty(0), departure, arrival, distance, emitted, mach_factor)
    gain = Responses(scene, np.array([source.emitted.centre_frequency])).along(group, found, times)[..., 0]
    return replace(found, gain=gain)


def slices_of(times: int, paths: int) -> list[slice]:
    """Return slices of so many times that the arrivals of so many paths take little memory."""
    step = max(1, _TOGETHER // max(paths, 1))
    return [slice(i, i + step) for i in range(0, times, step)]


def _solve_delay(trajectory: object, mirrored: Floats, times: Floats, c: float) -> Floats:
    """Solve ``delay = |x - x_s(t - delay)| / c`` for every mirrored receiver position x (P, T, 3)."""
    position, velocity = trajectory.position, trajectory.velocity  # type: ignore[attr-defined]
    delay = np.linalg.norm(mirrored - position(times), axis=-1) / c
    active: NDArray[np.bool_] = np.ones(delay.shape, dtype=bool)
    if np.isinf(trajectory.end):  # type: ignore[attr-defined]
        return np.asarray(delay)  # a fixed source was where it is
    for _ in range(_NEWTON_LIMIT):
        p, t = np.nonzero(active)
        if not len(p):
            break
        emitted = times[t] - delay[p, t]
        apart = mirrored[p, t] - position(emitted)
        distance = np.linalg.norm(apart, axis=-1)
        mach = np.sum(apart * velocity(emitted), axis=-1) / (np.maximum(distance, 1e-300) * c)
        step = (distance / c - delay[p, t]) / (1.0 - mach)
        delay[p, t] += step
        active[p, t] = np.abs(step) > _CONVERGED + 4e-16 * np.abs(times[t])
    return np.asarray(delay)


def _at(function: object, times: Floats) -> Floats:
    """Evaluate a trajectory's function at times of any shape."""
    values: Floats = function(times.ravel())  # type: ignore[operator]
    return values.reshape(*times.shape, values.shape[-1])
