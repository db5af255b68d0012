"""The scene: a room, its air, sources and receivers, scatterers and bodies; which direct sound scatterers shade."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import FARTHEST, Floats, as_count, as_number, row_name, short_repr
from clsim.errors import InputError, check_kind, inside, settle
from clsim.numerics.quaternions import rotate
from clsim.pictures import view_page
from clsim.scene import placement
from clsim.scene.air import Air
from clsim.scene.body import Body, check_bodies, with_carriers
from clsim.scene.ends import End, Receiver, Source
from clsim.scene.material.material import Material
from clsim.scene.motion.motion import seen_by
from clsim.scene.room.protocol import Room, checked_room
from clsim.scene.scatterer import Scatterer

Ends = Sequence[tuple[str, End | Scatterer]]  # as `Scene.named_ends` and `named_scatterers` give them
Bodies = Sequence[tuple[str, Body]]

_TRAIL = 400  # points of a drawn trajectory


def known_until(ends: Sequence[tuple[str, End | Scatterer | Body]]) -> float:
    """Return end of the time in which all trajectories are defined, s; 0 for a static scene."""
    finite = [item.trajectory.end for _, item in ends if np.isfinite(item.trajectory.end)]
    return float(min(finite, default=0.0))


def frame_times(ends: Sequence[tuple[str, End | Scatterer | Body]], duration: float, frames: int) -> Floats:
    """Return instants (F,) of a page, s; one for a static scene."""
    moves = any(np.isfinite(item.trajectory.end) for _, item in ends)
    return np.linspace(0.0, duration, frames) if moves and frames > 1 else np.zeros(1)


def viewed_walls(room: Room) -> list[view_page.ViewedWall]:
    """Return the walls of a room as they are drawn."""
    mesh = room.as_mesh()
    names = {id(m): m.name or m.describe() for m in mesh.faces.materials}
    corners = mesh.vertices[mesh.triangles]
    walls = []
    for w, name in enumerate(mesh.faces.names):
        mine = corners[mesh.walls.of_triangle == w]
        walls.append(view_page.ViewedWall(name, names[id(mesh.faces.materials[w])], mine, mesh.walls.edges_of(w)))
    return walls


def viewed_flaws(room: Room) -> view_page.ViewedFlaws:
    """Find where a mesh was healed, and its open edges, through which energy escapes."""
    mesh = room.as_mesh()
    healed_at = np.empty((0, 3)) if mesh.healed_at is None else mesh.healed_at
    return view_page.ViewedFlaws(healed_at, mesh.shape.open_edges)


def viewed_ends(ends: Ends, times: Floats) -> list[view_page.ViewedEnd]:
    """Return sources and receivers with their positions at times (F,), s, as they are drawn."""
    found = []
    for field, item in ends:
        first, last = item.time_range
        trail = item.trajectory.position(np.linspace(first, max(last, first), _TRAIL if last > first else 1))
        at = item.trajectory.position(np.clip(times, first, last) if np.isfinite(item.trajectory.end) else times)
        aims = _aims(item, np.clip(times, first, last))
        found.append(
            view_page.ViewedEnd(item.name, field.split("s[")[0], np.atleast_2d(at), np.atleast_2d(trail), aims)
        )
    return found


def viewed_bodies(bodies: Bodies, times: Floats) -> list[view_page.ViewedBody]:
    """Return bodies with their poses at times (F,), s, as they are drawn."""
    found = []
    for _, body in bodies:
        origin = body.placed(np.zeros(3), times)
        axes = np.stack([body.placed(axis, times) - origin for axis in np.eye(3)], axis=1)
        vertices, triangles = body.mesh.vertices, body.mesh.triangles
        found.append(view_page.ViewedBody(body.name, vertices, triangles, origin, axes))
    return found


def _aims(item: End | Scatterer, times: Floats) -> Floats | None:
    """Return the unit vectors (F, 3) in which the axis of a source or receiver points, None for one that has no aim."""
    aim: Floats | None = getattr(item, "aim", None)
    if aim is not None:
        return np.broadcast_to(aim / np.linalg.norm(aim), (len(times), 3))
    if not item.trajectory.has_orientation:
        return None
    return rotate(item.trajectory.orientation(times), (1.0, 0.0, 0.0))


_MOST_LISTED = 64  # sources and receivers in a table
_NEAREST = 1e-6  # m, least bound of the distance between ends


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A room, its air, sources and receivers, scatterers and bodies.

    Parameters
    ----------
    room : Room
        A `Shoebox`, a `MeshRoom`, or any other `Room`.
    air : Air
        The air in it.
    sources, receivers : sequence
        At least one of each, with unique names.
    min_distance : float
        Distance below which a source may not come to a receiver, and neither to a scatterer, m.
    scatterers : sequence of Scatterer
        Scatterers, at rest or moving, with unique names.
    bodies : sequence of Body
        Moving bodies that reflect and shadow sound, with unique names.

    Raises
    ------
    InputError
        If the room lacks what a `Room` has, a name is used twice, or a trajectory leaves the room, comes too close to
        another one or reaches the speed of sound, a body goes through a wall or meets an end or a scatterer, or an end
        is outside a closed room that others are in; the message gives time and place.

    Warns
    -----
    ClsimWarning
        If all ends are outside a closed mesh, or some outside one with small holes, the room's size or a signal's
        frequency look like another unit, a directional end moves without orientation or aim, or a sphere reaches into a
        wall.
    """

    room: Room
    air: Air
    sources: Sequence[Source]
    receivers: Sequence[Receiver]
    min_distance: float = 0.01
    scatterers: Sequence[Scatterer] = ()
    bodies: Sequence[Body] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        settle(self, bodies=_checked_list("bodies", self.bodies, Body))
        for name, kind in (("sources", Source), ("receivers", Receiver)):
            given = _checked_list(name, getattr(self, name), kind)
            if not given:
                raise InputError(name, "must hold at least one, but is empty")
            settle(self, **{name: with_carriers(given, self.bodies)})
        _check_rows(self.receivers)
        distance = as_number("min_distance", self.min_distance, at_least=_NEAREST, at_most=FARTHEST, unit="m")
        checked_room(self.room)
        check_kind("air", self.air, Air, "an Air")
        (_, _, low), (_, _, high) = self.room.extent
        scatterers = _checked_list("scatterers", self.scatterers, Scatterer)
        settle(self, min_distance=distance, air=self.air.between(float(low), float(high)), scatterers=scatterers)
        ends = self.named_ends()
        placement.check_motions(self.room, [*ends, *self.named_scatterers()], self.air.slowest)
        placement.check_sides(self.room, ends)
        placement.warn_of_units(self.room, self.sources)
        placement.warn_of_roles(self.sources, self.receivers)
        placement.warn_of_facing(ends)
        for i, source in enumerate(self.sources):
            placement.check_distances(f"sources[{i}]", source, self.receivers, distance)
            placement.check_lasts(f"sources[{i}]", source.trajectory, source.end, "the signal, which ends")
        placement.check_scatterers(self.named_scatterers(), ends, distance, self.air.slowest)
        placement.warn_of_walls(self.room, self.named_scatterers())
        check_bodies(self.room, self.named_bodies(), [*ends, *self.named_scatterers()], self.air.slowest)
        _check_bands(self)

    def named_ends(self) -> list[tuple[str, End]]:
        """Return every source and receiver with the name of its field, e.g. ``"sources[0]"``."""
        sources = [(f"sources[{i}]", s) for i, s in enumerate(self.sources)]
        receivers = [(f"receivers[{i}]", r) for i, r in enumerate(self.receivers)]
        return [*sources, *receivers]

    def named_scatterers(self) -> list[tuple[str, Scatterer]]:
        """Return every scatterer with the name of its field, e.g. ``"scatterers[0]"``."""
        return [(f"scatterers[{i}]", s) for i, s in enumerate(self.scatterers)]

    def named_bodies(self) -> list[tuple[str, Body]]:
        """Return every body with the name of its field, e.g. ``"bodies[0]"``."""
        return [(f"bodies[{i}]", body) for i, body in enumerate(self.bodies)]

    @property
    def materials(self) -> tuple[Material, ...]:
        """Materials of the walls of the room, and then of the faces of bodies.

        Where any wall lets sound pass, all follow once more as what they are for sound that passes: a wall's number
        there is its own and half of the length.
        """
        own = (*self.room.faces.materials, *(m for body in self.bodies for m in body.mesh.faces.materials))
        if not self.panels:
            return own
        passing = {m: m.passing if m.transmission else m for m in dict.fromkeys(own)}
        return (*own, *(passing[m] for m in own))

    @property
    def panels(self) -> tuple[int, ...]:
        """Walls of the room through which sound passes."""
        return tuple(i for i, m in enumerate(self.room.faces.materials) if m.transmission is not None)

    def show(self, frames: int = 120, height: int = 600) -> Any:
        """Return the viewer page of the room and its moving objects, for a notebook.

        Parameters
        ----------
        frames : int
            Instants to choose from, until the first trajectory ends, 1 to 10 000.
        height : int
            Pixels, 100 to 10 000.
        """
        frames = as_count("frames", frames, at_least=1, at_most=10_000)
        height = as_count("height", height, at_least=100, at_most=10_000)
        ends, bodies = [*self.named_ends(), *self.named_scatterers()], self.named_bodies()
        times = frame_times([*ends, *bodies], known_until([*ends, *bodies]), frames)
        page = view_page.page_text(
            title="scene", walls=viewed_walls(self.room), ends=viewed_ends(ends, times), times=times,
            frames=[view_page.ViewedPaths.none()] * len(times), bodies=viewed_bodies(bodies, times),
            flaws=viewed_flaws(self.room),
        )  # fmt: skip
        return view_page.inline_page(page, height)

    def _repr_html_(self) -> str:
        ends = []
        for field, item in self.named_ends()[:_MOST_LISTED]:
            place = ", ".join(f"{x:.3f}" for x in item.trajectory.position(item.time_range[0]))
            ends.append((field, item.name, "static" if item.trajectory.is_static else "moves", place))
        more = len(self.named_ends()) - len(ends)
        notes = [*([f"and {more} more"] if more else []), *self.room.describe(), *self.air.describe()]
        return view_page.html_table("Scene", ("", "name", "motion", "position at 0 s (m)"), ends, notes)

    def describe(self) -> list[str]:
        """Return a description of room, air and bodies, a line each; in a closed room also the sides of ends at 0 s."""
        lines = [*self.room.describe(), *self.air.describe()[1:]]
        for source in self.sources if self.air.dispersion else ():
            centre = source.emitted.centre_frequency
            note = f"air disperses: what {source.name!r} sends about {centre:.6g} Hz goes "
            note += f"{self.air.group_speed_at(centre):.3f} m/s, its phase at {self.air.speed_at(centre):.3f} m/s; "
            lines.append(f"{note}{self.air.speed_of_sound:.3f} m/s at 0 Hz")
        for field_name, item in [] if self.room.is_convex or not self.room.is_closed else self.named_ends():
            inside = self.room.contains(placement.first_place(self.room, item)[None])[0]
            lines.append(f"{field_name}: {item.name!r} is {'inside' if inside else 'outside'} at 0 s")
        return lines + [line for body in self.bodies for line in body.describe()]


def _checked_list(name: str, values: Any, kind: type[End | Body | Scatterer]) -> tuple[Any, ...]:
    """Return values of a kind, each with a name of its own."""
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise InputError(name, f"must be a list, but is {values!r:.80}")
    seen: dict[str, int] = {}
    for i, value in enumerate(values):
        check_kind(f"{name}[{i}]", value, kind, f"a {kind.__name__}")
        if value.name in seen:
            raise InputError(f"{name}[{i}].name", f"must be unique, but [{seen[value.name]}] is {value.name!r} too")
        seen[value.name] = i
    return tuple(values)


def _check_rows(receivers: Sequence[Receiver]) -> None:
    """Refuse receivers whose rows in recordings have the names of others: of an array, or of a channel."""
    arrays = {receiver.element.array for receiver in receivers if receiver.element is not None}
    seen: dict[str, int] = {}
    for i, receiver in enumerate(receivers):
        if receiver.element is None and receiver.name in arrays:
            raise InputError(f"receivers[{i}].name", f"must be unique, but an array is {receiver.name!r} too")
        for name in map(row_name, receiver.rows):
            if seen.setdefault(name, i) != i:
                problem = f"must be unique with its channel, but [{seen[name]}] has {name!r} too"
                raise InputError(f"receivers[{i}].name", problem)


def _check_bands(scene: Scene) -> None:
    """Refuse a receiver whose transducer does not cover the band of a source."""
    for i, receiver in enumerate(scene.receivers):
        if receiver.transducer is None or math.isinf(receiver.transducer.model.band[1]):
            continue
        for source in scene.sources:
            with inside(f"receivers[{i}]"):
                receiver.transducer.check_coverage(source.emitted.band(), f"what {source.name!r} emits")


_INSTANTS = 1001  # of a run at which lines of sight are looked at
_PLACES = np.linspace(-1.0, 1.0, 33)[:, None]  # about the place nearest to a centre, in largest radii
_PAIRS = 8  # that are reported one by one
_SEEN_AT = 301  # of a signal at which several scatterers may stand in the line of sight at once


def shaded_pairs(scene: Scene, duration: float) -> list[str]:
    """Lines that say by which scatterers direct sound is shaded, and when, in the first `duration` s of a scene."""
    # A line of sight is shaded where a scatterer is nearer than the radius of the first Fresnel zone there.
    casting = [scatterer for scatterer in scene.scatterers if scatterer.shape.shadows]
    pairs = [(s, r) for s in scene.sources for r in scene.receivers] if casting else []
    lines: list[str] = []
    for i, (source, receiver) in enumerate(pairs):
        if len(lines) == _PAIRS:
            return [*lines, f"shadows: {len(pairs) - i} more pairs are not looked at"]
        wavelength = scene.air.speed_of_sound / source.emitted.centre_frequency
        found = [(one.name, _spans(source, receiver, one, (wavelength, duration))) for one in casting]
        by = [f"{name} {', '.join(spans)}" for name, spans in found if spans]
        if by:
            lines.append(f"shadows: {source.name} to {receiver.name} by {'; '.join(by)}")
    return lines


def hidden_by_several(
    sources: Sequence[Source], receivers: Sequence[Receiver], scatterers: Sequence[Scatterer]
) -> str | None:
    """Words for the first line of sight in which a sphere by its series and another thing with a shadow stand at once.

    None for no such. Their shadows add up: the second takes the sound away that the first has taken already. Those of
    outlines multiply. The first eight pairs are looked at.
    """
    casting = [scatterer for scatterer in scatterers if scatterer.shape.shadows]
    series = np.array([not one.shape.outlined for one in casting])
    if len(casting) < 2 or not series.any():
        return None
    for source, receiver in [(s, r) for s in sources for r in receivers][:_PAIRS]:
        last = min(source.end, receiver.trajectory.end, *(one.trajectory.end for one in casting))
        times = np.linspace(max(source.start, 0.0), max(last, source.start, 0.0), _SEEN_AT)
        cut = np.array([_cut(source, receiver, one, times) for one in casting])
        several = np.flatnonzero((cut.sum(axis=0) > 1) & cut[series].any(axis=0))
        if len(several):
            names = " and ".join(
                repr(one.name) for one, is_cut in zip(casting, cut[:, several[0]], strict=True) if is_cut
            )
            at = f"from {source.name!r} to {receiver.name!r} at {times[several[0]]:.3g} s"
            return f"{names} stand in the line of sight {at}"
    return None


def _cut(source: Source, receiver: Receiver, scatterer: Scatterer, times: Floats) -> NDArray[np.bool_]:
    """Mask (T,) of times at which a scatterer stands in a line of sight."""
    begin, end = (seen_by(scatterer.trajectory, each.trajectory).position(times) for each in (source, receiver))
    return _in_zone(scatterer, begin, end, 0.0)


def _spans(source: Source, receiver: Receiver, scatterer: Scatterer, numbers: tuple[float, float]) -> list[str]:
    """Spans in which a scatterer is in the first Fresnel zone of a line of sight, by wavelength, m, and duration, s."""
    seen = [seen_by(scatterer.trajectory, end.trajectory) for end in (source, receiver)]
    times = np.linspace(max(0.0, *(m.start for m in seen)), min(numbers[1], *(m.end for m in seen)), _INSTANTS)
    shaded = _in_zone(scatterer, seen[0].position(times), seen[1].position(times), numbers[0])
    if shaded.all():
        return ["all the time"]
    turns = np.flatnonzero(np.diff(np.concatenate([[0], shaded.astype(np.int8), [0]])))
    return [f"from {times[a]:.3g} to {times[b - 1]:.3g} s" for a, b in zip(turns[::2], turns[1::2], strict=True)]


def _in_zone(scatterer: Scatterer, source: Floats, receiver: Floats, wavelength: float) -> NDArray[np.bool_]:
    """Mask (n,) of lines of sight (n, 3), in the scatterer's frame, whose first Fresnel zone it reaches into."""
    sight = receiver - source
    length = np.maximum(np.linalg.norm(sight, axis=1), 1e-9)
    sight = sight / length[:, None]
    nearest = -np.sum(source * sight, axis=1)
    before = np.clip(nearest, 0.0, length)
    zone = np.sqrt(wavelength * before * (length - before) / length)
    met = (nearest > 0.0) & (nearest < length)
    rows = np.flatnonzero(met)
    # Most of a run it is nowhere near: its shape is asked of lines of sight within its largest radius.
    foot = np.linalg.norm(source + nearest[:, None] * sight, axis=1)
    rows = rows[foot[rows] < scatterer.shape.radius + zone[rows]]
    met[:] = False
    for row in rows:
        places = source[row] + (nearest[row] + scatterer.shape.radius * _PLACES) * sight[row]
        met[row] = bool(scatterer.shape.holds(places, float(zone[row])).any())
    return np.asarray(met)
