"""What reflections alone leave out: the field of edges near paths, jumps at their ends, and shadows on echoes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import ClsimWarning, InputError, warn
from clsim.paths.family import BODY, DIFFRACTION, SPECULAR, PairPaths
from clsim.paths.path_set import PathSet
from clsim.scene.body import Body
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.room.walls import Walls
from clsim.scene.scene import Scene, known_until

_MOST_EVENTS = 64  # beginnings and ends of paths of a pair that are looked at
_LEAST_JUMP_DB, _LOUD_JUMP_DB = -60.0, -40.0  # re the strongest path: of what is reported, and warned of
_LEAST_EDGES_DB = -30.0  # likewise, of the field of edges that is warned of
_INSTANTS = (0.5, 0.1, 0.9)  # of the known time, at which it is looked for
_MOST_SOURCES, _MOST_LISTENERS, _MOST_RECEIVERS = 2, 4, 8
_MOST_FACES, _MOST_PAIRINGS = 40, 400  # of a scene whose edges are searched: faces, and edges times faces
_MOST_ROWS = 16  # paths by small faces of a pair that are looked at
_MOST_TESTED = 4  # faces of which it is found out whether they have edges that diffract
_SOFTEST_DB = -40.0  # re the free direct sound
_FARTHEST = 100.0  # m, of paths whose Fresnel zones matter
_SAME_EVENT = 1e-5  # s
_EVALUATIONS = np.linspace(0.0, 1.0, 9)  # of the known time, at which shadows are looked for
_MOST_ECHOES = 4096  # then


def warn_without_edges(paths: PathSet, max_order: int, find: Callable[..., PathSet]) -> None:
    """Warn once of what is missing without edges: their field near paths, as `find` finds it, or else jumps at edges.

    Both are looked for at the first receivers only, so that many cost no more. The field of edges is that of the room
    and of the bodies nearest to the lines of sight. Where some are left out, or all, as in rooms with many edges, faces
    that are smaller than Fresnel zones are looked for as well.
    """
    near = _searched_bodies(paths.scene)
    searched = near is not None and len(near) == len(paths.scene.bodies)
    level = None if near is None else neglected_db(paths.scene, near, max_order, find)
    if level is not None:
        field = f"the field of edges, which is left out, reaches {level:.0f} dB of the strongest path"
        warn(f"edges within or beside the Fresnel zones of paths: {field} (diffraction=1 adds it)")
        return
    if not searched and _warn_of_small_faces(paths):
        return
    jump = largest_jump_db(paths, _MOST_RECEIVERS)
    if jump is not None and jump > _LOUD_JUMP_DB:
        jumps = f"the pressure jumps by up to {jump:.0f} dB of the strongest path, and behind edges there is silence"
        warn(f"paths begin and end at edges: {jumps}, without paths over edges (diffraction=1)")


def _warn_of_small_faces(paths: PathSet) -> bool:
    """Warn of the loudest reflection by a face that is smaller than the Fresnel zone of the path over it.

    The radius of the first Fresnel zone is ``√(λ d₁ d₂ / (d₁ + d₂))`` for the lengths d₁ and d₂ of the path before and
    after the face (M. Born and E. Wolf, "Principles of Optics", section 8.2), at the centre frequency of the signal. A
    path is looked at in the middle of its interval.
    """
    widths = _widths(paths.scene)
    reports = [report for _, pair in paths.pairs() for report in _small_faces(pair, widths)] if len(widths) else []
    loudest = {report[-1]: report for report in sorted(reports)}  # of each face the last one
    for level, name, width, zone, wall in sorted(loudest.values(), reverse=True)[:_MOST_TESTED]:
        if not _diffracts(paths.scene, wall):
            continue
        wide = f"{1e3 * width:.3g} mm wide, the Fresnel zone of a path over it {1e3 * zone:.3g} mm"
        wrong = f"its reflection, {level:.0f} dB re the free direct sound, is wrong by several dB"
        warn(f"{name!r} is {wide}: {wrong} without edges (diffraction=1)")
        return True
    return False


def neglected_db(scene: Scene, bodies: list[Body], max_order: int, find: Callable[..., PathSet]) -> float | None:
    """Find the largest level of a pair's edge paths together, dB re its strongest path; None below -30 dB."""
    if not (bodies or len(scene.room.edges())):
        return None
    until = known_until([*scene.named_ends(), *scene.named_bodies()])
    levels = []
    with warnings.catch_warnings():  # what there is to say of room and signals was said
        warnings.simplefilter("ignore", ClsimWarning)
        for time in until * np.array(_INSTANTS if until > 0.0 else _INSTANTS[:1]):
            try:
                levels.append(_edges_db(find(_at_rest(scene, bodies, float(time)), min(max_order, 1), diffraction=1)))
            except InputError:  # too many paths, or ends that meet
                continue
    worst = max(levels, default=-np.inf)
    return worst if worst > _LEAST_EDGES_DB else None


def _searched_bodies(scene: Scene) -> list[Body] | None:
    """Select bodies near lines of sight whose edge paths are found in a second; None where the room has too many."""
    faces, edges = len(scene.room.faces.names), len(scene.room.edges())
    if not _is_searched(faces, edges):
        return None
    found: list[Body] = []
    for body in sorted(scene.bodies, key=lambda each: _detour(scene, each)):
        faces, edges = faces + len(body.mesh.faces.names), edges + len(body.mesh.edges())
        if not _is_searched(faces, edges):
            break
        found.append(body)
    return found


def _is_searched(faces: int, edges: int) -> bool:
    return faces <= _MOST_FACES and edges * faces <= _MOST_PAIRINGS


def _detour(scene: Scene, body: Body) -> float:
    """Length of the shortest detour over a body's origin between the first ends, m, half-way through the known time."""
    times = np.array([0.5 * known_until([*scene.named_ends(), *scene.named_bodies()])])
    origin, sources, receivers = (
        np.concatenate([item.trajectory.position(times) for item in items])
        for items in ([body], scene.sources[:_MOST_SOURCES], scene.receivers[:_MOST_LISTENERS])
    )
    before, after = (np.linalg.norm(places - origin, axis=-1) for places in (sources, receivers))
    straight = np.linalg.norm(sources[:, None] - receivers, axis=-1)
    return float(np.min(before[:, None] + after - straight))


def _at_rest(scene: Scene, bodies: list[Body], time: float) -> Scene:
    """Make a scene of the first ends and some bodies as they are at a time, s."""

    def still(item: Any) -> Any:
        trajectory, now = item.trajectory, np.array([time])
        turn = trajectory.orientation(now)[0] if trajectory.has_orientation else None
        return replace(item, trajectory=Trajectory.fixed(trajectory.position(now)[0], turn))

    return replace(
        scene, sources=[still(s) for s in scene.sources[:_MOST_SOURCES]],
        receivers=[still(r) for r in scene.receivers[:_MOST_LISTENERS]],
        bodies=[still(b) for b in bodies], scatterers=(),
    )  # fmt: skip


def _edges_db(paths: PathSet) -> float:
    """Compute the largest level of a pair's edge paths together, dB re its strongest path."""
    table = paths.table(np.zeros(1))
    frequency = np.array([source.emitted.centre_frequency for source in paths.scene.sources])[paths.source]
    phasors = np.nan_to_num(table.gain[:, 0] * np.exp(-2j * np.pi * frequency * table.delay[:, 0]))
    pair = paths.source * len(paths.scene.receivers) + paths.receiver
    over_edges = np.any(paths.interactions == DIFFRACTION, axis=1)
    total: NDArray[Any] = np.zeros(int(pair.max(initial=0)) + 1, np.complex128)
    strongest = np.zeros(len(total))
    np.add.at(total, pair[over_edges], phasors[over_edges])
    np.maximum.at(strongest, pair, np.abs(phasors))
    return float(20.0 * np.log10(np.max(np.abs(total) / np.maximum(strongest, 1e-300)) + 1e-300))


def largest_jump_db(paths: PathSet, most: int | None = None) -> float | None:
    """Find the largest jump of pressure as paths begin and end, dB re the strongest; None below -60 dB."""
    receivers = range(len(paths.scene.receivers))[:most]
    jumps = [jump for receiver in receivers for jump in _jumps(paths.at_receiver(receiver))]
    worst = 20.0 * np.log10(max(jumps, default=0.0) + 1e-300)
    return float(worst) if worst > _LEAST_JUMP_DB else None


def _widths(scene: Scene) -> Floats:
    """List the least widths of walls of the room and of faces of bodies (n,), m; none where all are large."""
    parts = [np.full(len(scene.room.faces.names), np.inf)]
    if not scene.room.is_convex:
        parts = [_least_widths(scene.room.as_mesh().walls)]
    parts += [_least_widths(body.mesh.walls) for body in scene.bodies]
    found = np.concatenate(parts)
    longest = float(scene.air.speed_of_sound / min(source.emitted.centre_frequency for source in scene.sources))
    return found if np.any(found < _zone(longest, _FARTHEST)) else found[:0]


def _least_widths(walls: Walls) -> Floats:
    found = np.empty(len(walls))
    for wall in range(len(walls)):
        outline = walls.edges_of(wall)
        along = outline[:, 1] - outline[:, 0]
        across = np.cross(walls.normal[wall], along / np.linalg.norm(along, axis=1)[:, None])
        found[wall] = np.ptp(outline.reshape(-1, 3) @ across.T, axis=0).min()
    return found


def _diffracts(scene: Scene, wall: int) -> bool:
    """Tell whether a face has an edge that diffracts: without one its images make it whole."""
    if wall >= len(scene.room.faces.names):
        return True
    return bool(np.any(scene.room.as_mesh().edges(wall).faces == wall))


def _zone(wave: float, length: float) -> float:
    """Width of the first Fresnel zone half-way along a path, m: an upper bound elsewhere."""
    return float(np.sqrt(wave * length))


def _small_faces(pair: PairPaths, widths: Floats) -> Iterator[tuple[float, str, float, float, int]]:
    """Yield level, name of the face, widths of the face and of the Fresnel zone, and the face."""
    family, rows, scene = pair.family, pair.index, pair.family.scene
    kinds, objects = family.interactions[rows], family.objects[rows]
    face = np.where(kinds == SPECULAR, objects, objects + len(scene.room.faces.names))
    met = (kinds == SPECULAR) | (kinds == BODY)
    width = np.where(met, widths[np.where(met, face, 0)], np.inf)
    wave = scene.air.speed_of_sound / scene.sources[pair.source].emitted.centre_frequency
    until = known_until([*scene.named_ends(), *scene.named_scatterers(), *scene.named_bodies()])
    for row in np.flatnonzero(width.min(axis=1, initial=np.inf) < _zone(wave, _FARTHEST))[:_MOST_ROWS].tolist():
        start, end = family.start[rows[row]], family.end[rows[row]]
        time = 0.5 * (max(start, 0.0) + min(end, max(until, start, 0.0)))
        places = family.vertices(rows[row : row + 1], time)[0]
        before = np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))
        length = before[np.isfinite(before)][-1]
        for k in np.flatnonzero(met[row]).tolist():
            zone = 2.0 * np.sqrt(wave * before[k] * (length - before[k]) / length)
            if width[row, k] < zone:
                level = _level_db(pair.part(np.array([row])), time)
                names = scene.room.faces.names if kinds[row, k] == SPECULAR else family.object_names
                if level > _SOFTEST_DB:
                    yield level, names[objects[row, k]], float(width[row, k]), float(zone), int(face[row, k])


def _level_db(pair: PairPaths, time: float) -> float:
    """Level of a path re the free direct sound, at the centre frequency of the signal."""
    scene, times = pair.family.scene, np.array([time])
    source, receiver = scene.sources[pair.source], scene.receivers[pair.receiver]
    strength = np.abs(pair.gain(pair.arrivals(times), times)).max()
    apart = np.linalg.norm(receiver.trajectory.position(times) - source.trajectory.position(times))
    return float(20.0 * np.log10(strength * apart + 1e-300))


def _jumps(paths: PathSet) -> Iterator[float]:
    """Yield jumps of the pressure of one receiver over the strongest path, by sources."""
    scene = paths.scene
    until = known_until([*scene.named_ends(), *scene.named_scatterers(), *scene.named_bodies()])
    for source in range(len(scene.sources)):
        pairs = [pair for _, pair in paths.pairs() if pair.source == source and not pair.family.adds]
        if not pairs:
            continue
        start, end = (np.concatenate([getattr(p.family, x)[p.index] for p in pairs]) for x in ("start", "end"))
        events = np.unique(np.concatenate([start, end]))
        events = events[(events > 0.0) & (events < until)]
        if not len(events):
            continue
        events = events[np.unique(np.linspace(0, len(events) - 1, _MOST_EVENTS).astype(int))]
        found = [(pair, pair.arrivals(events)) for pair in pairs]  # also where they are not active
        frequency = scene.sources[source].emitted.centre_frequency
        terms = np.concatenate([p.gain(x, events) * np.exp(-2j * np.pi * frequency * x.delay) for p, x in found])
        for which, event in enumerate(events.tolist()):
            born, gone = (np.abs(x - event) < _SAME_EVENT for x in (start, end))
            strongest = np.abs(np.where((start <= event) & (end >= event), terms[:, which], 0.0)).max()
            yield float(np.abs(np.sum(terms[born, which]) - np.sum(terms[gone, which])) / max(strongest, 1e-300))


def warn_without_shadows(paths: PathSet, scattering_order: int) -> None:
    """Warn of the first scatterer with a shadow that stands in an echo of more than `scattering_order` walls."""
    scene = paths.scene
    casting = [scatterer for scatterer in scene.scatterers if scatterer.shape.shadows]
    echoes = next((family for family in paths.families if family.is_specular), None)
    if not casting or echoes is None or not np.any(high := echoes.order > scattering_order):
        return
    until = known_until([*scene.named_ends(), *scene.named_scatterers()])
    for time in (until * (_EVALUATIONS if until > 0.0 else _EVALUATIONS[:1])).tolist():
        rows = np.flatnonzero(high & (echoes.start <= time) & (echoes.end > time))[:_MOST_ECHOES]
        places = echoes.vertices(rows, time)
        for scatterer in casting:
            centre, least = scatterer.trajectory.position(np.array([time]))[0], float(np.min(scatterer.shape.semi_axes))
            if len(rows) and _least_apart(places, centre) < least:
                why = f"scattering_order is {scattering_order}, and echoes of N walls have shadows from N on"
                stands = f"{scatterer.name!r} stands in the way of echoes at {time:.3g} s"
                warn(f"{stands} and casts no shadow on them: {why}")
                return


def _least_apart(places: Floats, centre: Floats) -> float:
    """Least distance of a point from paths by places (P, N, 3), m, NaN beyond the receiver."""
    begin, along = places[:, :-1], np.diff(places, axis=1)
    squared = np.sum(along**2, axis=2)
    share = np.clip(np.sum((centre - begin) * along, axis=2) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    return float(np.nanmin(np.linalg.norm(begin + share[..., None] * along - centre, axis=2)))
