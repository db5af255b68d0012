"""The ends of paths: sources and receivers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_choice, as_count, as_flag, as_floats, as_number, short_repr
from clsim.errors import InputError, check_kind, check_name, settle, with_field
from clsim.numerics.quaternions import normalised, quaternion_from_direction, quaternion_product, rotate
from clsim.scene.directivity.directivity import ChannelDirectivity, Directivity
from clsim.scene.directivity.head_related import EARS, HeadRelated, SphericalHead
from clsim.scene.directivity.patterns import HIGHEST, Ambisonic, Omni
from clsim.scene.motion.curves import CONTINUATION
from clsim.scene.motion.motion import LONGEST, Moved, turning_between
from clsim.scene.motion.trajectory import Trajectory, as_direction, as_places
from clsim.scene.room.faces import NEAREST, Mount
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.protocol import Room
from clsim.scene.scatterer import Scatterer
from clsim.scene.signal.signal import Signal
from clsim.scene.transducer import Electronics, Transducer

Directions = Callable[[Floats], tuple[Floats, NDArray[np.bool_]]]

_STEP = 1.0 / 32.0  # s, between the orientations that are tried first
_TOLERANCE = 1e-4  # rad, of the axis between two orientations
_WIDEST = 0.3  # rad, from one orientation to the next
_ROUNDS = 8  # halvings of the step
_SLOW = 0.02  # share of the top speed below which a motion has no direction: noise of measured rests is slower
_PAUSE = 0.2  # s, in which a motion may turn as it likes
_NEAREST = 1e-3  # m, to a point that is aimed at


def towards(motion: Trajectory, point: Floats) -> Trajectory:
    """Return a motion whose +x axis points at a point (3,) of its frame, m."""

    def directions(times: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return directions (T, 3) of any length, and a mask of known ones, here all."""
        away = point - motion.position(times)
        for time in times[np.linalg.norm(away, axis=1) < _NEAREST][:1]:
            raise InputError("aim_at", f"must be {_NEAREST:g} m away at least, but is where it aims from at {time:g} s")
        return away, np.ones(len(times), dtype=bool)

    if motion.is_static:
        return replace(motion, turning=turning_between(np.zeros(1), _level(directions(np.zeros(1))[0])))
    return replace(motion, turning=turning_between(*_sampled(motion, directions)))


def forward(motion: Trajectory) -> Trajectory:
    """Return a motion whose +x axis points along its velocity; in rests it turns evenly between directions."""
    if motion.is_static:
        raise InputError("aim", 'must be a direction, or aim_at given, where nothing moves, but is "forward"')
    top = motion.peak_speed(motion.start, motion.end)[0]

    def directions(times: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return velocities (T, 3), and a mask of instants in motion."""
        velocity = motion.velocity(np.clip(times, motion.start, motion.end))
        return velocity, np.linalg.norm(velocity, axis=1) > _SLOW * top

    times, turned = _sampled(motion, directions)
    axes = rotate(turned, (1.0, 0.0, 0.0))
    angle = _angle(axes[:-1], axes[1:])
    for i in np.flatnonzero((angle > 2.0 * _WIDEST) & (np.diff(times) < _PAUSE))[:1]:
        raise InputError(
            "aim",
            f'must not be "forward" where the direction of motion jumps, but it turns by {np.degrees(angle[i]):.0f} '
            f"degrees at {times[i]:.3f} s: join the points smoothly, or give orientations",
        )
    return replace(motion, turning=turning_between(times, turned))


def _sampled(motion: Trajectory, directions: Directions) -> tuple[Floats, Floats]:
    """Return times (n,) and orientations (n, 4) between which great arcs hold the axis within `_TOLERANCE`."""
    inner = np.linspace(motion.start, motion.end, int(np.ceil(motion.duration / _STEP)) + 1)
    times = np.concatenate([[motion.start - CONTINUATION], inner, [motion.end + CONTINUATION]])
    found, known = directions(times)
    for _ in range(_ROUNDS):
        middle = 0.5 * (times[:-1] + times[1:])
        there, clear = directions(middle)
        first, second = _level(found[:-1]), _level(found[1:])
        sign = np.where(np.sum(first * second, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
        between = rotate(normalised(first + sign * second), (1.0, 0.0, 0.0))  # in the middle of great arcs
        bent = _angle(between, _unit(there)) > _TOLERANCE
        wide = _angle(_unit(found[:-1]), _unit(found[1:])) > _WIDEST
        new = ((bent | wide) & clear & known[:-1] & known[1:]) | (known[:-1] != known[1:])
        if not new.any():
            break
        order = np.argsort(np.concatenate([times, middle[new]]), kind="stable")
        both = ((times, middle), (found, there), (known, clear))
        times, found, known = (np.concatenate([old, more[new]])[order] for old, more in both)
    return times[known], _level(found[known])


def _level(directions: Floats) -> Floats:
    """Return quaternions (n, 4) that turn +x to directions (n, 3) and leave +y horizontal: no roll."""
    x, y, z = np.moveaxis(directions, -1, 0)
    heading, elevation, none = 0.5 * np.arctan2(y, x), 0.5 * np.arctan2(z, np.hypot(x, y)), np.zeros_like(x)
    about_z = np.stack([none, none, np.sin(heading), np.cos(heading)], axis=-1)
    about_y = np.stack([none, -np.sin(elevation), none, np.cos(elevation)], axis=-1)
    return quaternion_product(about_z, about_y)


def _unit(directions: Floats) -> Floats:
    return np.asarray(directions / np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1e-300))


def _angle(first: Floats, second: Floats) -> Floats:
    """Return the angles (n,) between unit vectors (n, 3), rad."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(first - second, axis=-1), 1.0)))


class _End(Moved):
    """Base class of sources and receivers."""

    __slots__ = ()
    aim: Any

    def orientation(self, times: Floats) -> Floats:
        """Return unit quaternions x y z w (n, 4) at `times` (n,), s."""
        if self.aim is None:
            return self.trajectory.orientation(times)
        return np.broadcast_to(quaternion_from_direction(self.aim), (len(times), 4))


@dataclass(frozen=True, slots=True, eq=False)
class Source(_End):
    """A source of sound.

    Parameters
    ----------
    name : str
        Unique among the scene's sources.
    signal : Signal
        Sound pressure at 1 m on the source's axis in free field, Pa; with a transducer the voltage that drives it, V.
    trajectory : Trajectory
        Position and orientation over time.
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
        as a mesh that is open needs it. With `mounted_on` it rests in a face of the body: True on its outer side, or a
        direction in the body's coordinates, as sheets need it.
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
        _settle_end(self)
        check_kind("signal", self.signal, Signal, "a Signal")
        if isinstance(self.directivity, ChannelDirectivity):
            raise InputError("directivity", "must have one channel, for several are of receivers")
        settle(self, start=as_number("start", self.start, at_least=0.0, at_most=LONGEST, unit="s"))
        settle(self, emitted=self.signal if self.transducer is None else self.transducer.drive(self.signal))

    @property
    def end(self) -> float:
        """Time at which the signal ends, s; a transducer rings on."""
        return self.start + self.signal.duration

    @property
    def time_range(self) -> tuple[float, float]:
        """The finite part of the trajectory that matters, s: from 0 to its end, or that of the signal."""
        return 0.0, self.end if math.isinf(self.trajectory.end) else self.trajectory.end


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """Place of a receiver in an array of several, which is one receiver in recordings.

    Attributes
    ----------
    array, name : str
        Names of the array, and of the element in it.
    position : ndarray (3,)
        In the array's own frame, m.
    """

    array: str
    name: str
    position: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Receiver(_End):
    """A receiver of sound; its output is the sound pressure weighted by its directivity, or a voltage.

    Parameters
    ----------
    name : str
        Unique among the scene's receivers.
    trajectory, directivity, aim, aim_at, flush, mounted_on
        As of a `Source`.
    transducer : Transducer, optional
        Response on the axis, V per Pa.
    electronics : Electronics, optional
        Noise, filters, amplifier, converter and clock.
    element : Element, optional
        Place in an array; `receiver_array` sets it.
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
    element: Element | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        _settle_end(self)
        if self.element is not None and len(self.directivity.channels) > 1:
            raise InputError("directivity", f"must have one channel in an array, but is {self.directivity!r:.80}")
        check_kind("electronics", self.electronics, Electronics | None, "Electronics")

    @staticmethod
    def ambisonic(
        name: str, trajectory: Trajectory, order: int = 1, normalization: str = "SN3D", *, fixed: bool = False,
        **options: Any,
    ) -> Receiver:  # fmt: skip
        """Return an ideal ambisonic microphone.

        Parameters
        ----------
        name : str
            Unique among the scene's receivers.
        trajectory : Trajectory
            Position and orientation over time.
        order : int
            1 to 7: of ``(order + 1)²`` channels in ACN order.
        normalization : {"SN3D", "N3D"}
            Normalization of the components; AmbiX files have SN3D.
        fixed : bool
            Whether the components keep the room's axes although the microphone turns.
        **options : Any
            Others of `Receiver`, without `directivity`.
        """
        as_count("order", order, at_least=1, at_most=HIGHEST)
        if as_flag("fixed", fixed):
            for field_name in ("aim", "aim_at", "mounted_on"):
                if options.get(field_name) is not None:
                    raise InputError(field_name, "must be left out of what is fixed to the room's axes")
            if isinstance(trajectory, Trajectory):
                trajectory = replace(trajectory, turning=None)
            options["aim"] = (1.0, 0.0, 0.0)
        return Receiver(name, trajectory, Ambisonic(order, normalization), **options)

    @staticmethod
    def binaural(
        name: str, trajectory: Trajectory, hrtf: str | PathLike[str] | ChannelDirectivity | None = None, **options: Any
    ) -> Receiver:
        """Return a head with the channels "left" and "right", turned by its trajectory: front +x, left +y, up +z.

        Parameters
        ----------
        name : str
            Unique among the scene's receivers.
        trajectory : Trajectory
            Position of the head's centre, and its orientation.
        hrtf : path-like or HeadRelated or SphericalHead, optional
            A SOFA file of head-related responses, as of `HeadRelated.from_sofa`, or a directivity with two channels; a
            rigid sphere when left out.
        **options : Any
            Others of `Receiver`, without `directivity`.
        """
        ears = SphericalHead() if hrtf is None else hrtf
        if isinstance(ears, str | PathLike):
            with with_field("hrtf"):
                ears = HeadRelated.from_sofa(ears)
        if not isinstance(ears, ChannelDirectivity) or ears.channels != EARS:
            raise InputError("hrtf", f"must be a SOFA file or a directivity of two ears, but is {ears!r:.80}")
        return Receiver(name, trajectory, ears, **options)

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """Names of the receiver, or of its array, and of the channel for each of its rows in recordings."""
        if self.element is not None:
            return ((self.element.array, self.element.name),)
        return tuple((self.name, channel) for channel in self.directivity.channels)

    @property
    def unit(self) -> str:
        """Unit of its samples: ``"Pa"``, or ``"V"`` with a transducer."""
        return "Pa" if self.transducer is None else "V"

    @property
    def clock_rate(self) -> float:
        """True seconds per second of the receiver's clock."""
        return 1.0 if self.electronics is None else 1.0 + 1e-6 * self.electronics.clock_ppm

    def clock_error(self, times: Floats) -> Floats:
        """Return the error (n,) of the receiver's clock at its own `times` (n,), s: the lateness of samples."""
        return np.zeros_like(times) if self.electronics is None else self.electronics.clock_error(times)


End = Source | Receiver


def _settle_end(item: End) -> None:
    """Check what sources and receivers share; convert the aim to an array, or to orientations of the trajectory."""
    check_name(item.name)
    check_kind("trajectory", item.trajectory, Trajectory, "a Trajectory")
    check_kind("directivity", item.directivity, Directivity, "a Directivity")
    check_kind("transducer", item.transducer, Transducer | None, "a Transducer")
    if item.mounted_on is not None and not isinstance(item.mounted_on, str):
        raise InputError("mounted_on", f"must name a body, but is {item.mounted_on!r:.80}")
    item.trajectory.check_start()
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
    settle(item, aim=aim, aim_at=None, trajectory=trajectory, flush=_checked_flush(item.flush))


def _checked_flush(value: Any) -> bool | Floats:
    """Return False, True, or a unit vector."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    side = as_floats("flush", value, (3,))
    length = float(np.linalg.norm(side))
    if not length > 0.0:
        raise InputError("flush", "must be True, False or a direction off the wall, but is 0, 0, 0")
    return np.asarray(side / length)


_ALONG = 1e-6  # cosine below which a direction runs along a wall


def find_mount(room: Room, end: End | Scatterer) -> Mount | None:
    """Return wall and side of a flush-mounted source or receiver; None if it is not flush."""
    if end.flush is False:
        return None
    sides, place, where = _sides(room, end, "")
    if not isinstance(end.flush, bool):
        return _facing(room, sides, end.flush)
    if room.is_convex:
        return sides[0]
    inside = [side for side in sides if room.is_closed and room.contains(side.lifted(place))[0]]
    if len(inside) != 1:
        name = room.faces.names[sides[0].wall]
        reason = "both sides are inside" if inside else "the mesh is open, or neither side is inside"
        raise InputError("flush", f"must be a direction off the wall {name!r} for {where}, because {reason}")
    return inside[0]


def in_face(mesh: MeshRoom, end: End) -> Trajectory:
    """Return the trajectory of an end in a body's coordinates two steps in front of the face that it sits in."""
    own = end.trajectory
    if end.flush is False:
        return own
    if not own.is_static:
        raise InputError("flush", f"must be left out where {end.name!r} moves in its body's coordinates")
    sides, place, where = _sides(mesh, end, " of its body")
    if isinstance(end.flush, bool):
        sides = [side for side in sides if mesh.is_closed and not mesh.contains(side.lifted(place))[0]]
        if len(sides) != 1:
            raise InputError("flush", f"must be a direction off the face for {where}, which has no inside")
    side = sides[0] if isinstance(end.flush, bool) else _facing(mesh, sides, end.flush)
    return replace(Trajectory.fixed(side.lifted(place, 2.0)[0]), turning=own.turning)


def _sides(room: Room, end: End | Scatterer, of: str) -> tuple[list[Mount], Floats, str]:
    """Return both sides of the one wall that an end is on, its place (1, 3), m, and words for that."""
    place = np.asarray(end.trajectory.position(np.zeros(1)))
    where = f"{end.name!r} at ({', '.join(f'{x:.6g}' for x in place[0])}) m{of}"
    found, (low, high) = room.walls_at(place[0]), room.extent
    if not len(found):
        raise InputError("flush", f"must be left out, because {where} is on no wall (within {NEAREST:g} m)")
    if len(found) > 1:
        listed = " and ".join(repr(room.faces.names[w]) for w in found)
        raise InputError("flush", f"must be on one wall, but {where} is on an edge of {listed}")
    size = float(np.linalg.norm(high - low))
    return [Mount.on(room.faces, int(found[0]), sign, size) for sign in (1.0, -1.0)], place, where


def _facing(room: Room, sides: Sequence[Mount], direction: Floats) -> Mount:
    """Return the side of a wall that a direction (3,) points to."""
    cosine, name = float(sides[0].normal @ direction), room.faces.names[sides[0].wall]
    given = ", ".join(f"{x:.3g}" for x in direction)
    if room.is_convex and not cosine > 0.0:
        raise InputError("flush", f"must point into the room from {name}, but is {given}")
    if not room.is_convex and abs(cosine) < _ALONG:
        raise InputError("flush", f"must point off the wall {name!r}, but {given} runs along it")
    return sides[0] if cosine > 0.0 else sides[1]
