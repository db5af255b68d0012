"""Parameters by which received signals are differentiated: their names, units, and scenes a step away."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.errors import InputError
from clsim.paths.family import BODY, DIFFRACTION, SCATTERING, SHADOW, SPECULAR, TRANSMISSION, PathFamily
from clsim.paths.path_set import PathSet
from clsim.scene.directivity.patterns import Omni
from clsim.scene.motion.curves import Curve, Piecewise, Static, Straight, legs_through, spline_through
from clsim.scene.scene import Scene
from clsim.scene.transducer import Electronics
from clsim.sensitivity.displaced import Knot, displaced, turned, varied, with_wall

Moved = Callable[[Scene, float], Scene]

_AXES = "xyz"
_STEP = 1e-5  # m: a phase of 0.7 mrad at 40 kHz; rounding of delays is then below 1e-7 of their derivative
_DAMP = 1e-6  # step of the humidity, and what it is away from 0 and 1 at least
_OF_AIR = {
    "temperature_celsius": ("°C", 1e-3), "relative_humidity": ("1", _DAMP), "pressure": ("Pa", 10.0),
    "speed_of_sound": ("m/s", 1e-3), "wind": ("m/s", 1e-3),
}  # fmt: skip
_OF_ELECTRONICS = {"clock_ppm": ("ppm", 0.1), "clock_offset": ("s", 1e-7), "gain_db": ("dB", 1e-3)}
_END = re.compile(r"(sources|receivers|scatterers|bodies)\[(\d+)\]\.(.+)")
_WALL = re.compile(r"room\.walls\.(.+)\.(reflection|displacement)")


@dataclass(frozen=True, slots=True, eq=False)
class Parameter:
    """One real parameter of a scene."""

    name: str  # as in errors and scene files
    unit: str
    step: float  # by which it is varied to both sides, in its unit
    moved: Moved  # takes a scene and a step; returns the scene with the parameter larger by that
    source: int | None = None  # the only source whose paths depend on it; None for all
    receiver: int | None = None  # likewise
    gain_db: float = 0.0  # by how many dB per unit all these paths get louder
    acts: str = "scene"  # "shift", "turn", "clock", "start" or "gain" of an end, a "wall", its "reflection", the "air"
    shift: Curve | None = None  # displacement of an end per unit
    wall: int | None = None

    @property
    def kind(self) -> str:
        """The name without things and axes: what responses by parameters of one kind have in common."""
        if self.acts == "shift":
            return "shift"
        return re.sub(r"\[\d+\]|\.[xyz]$|(?<=walls).*(?=\.)", "", self.name)

    def touched(self, paths: PathFamily) -> NDArray[np.bool_]:
        """Test which paths (P,) may change."""
        mine = np.ones(len(paths), dtype=bool)
        for own, index in ((paths.source, self.source), (paths.receiver, self.receiver)):
            mine &= True if index is None else own == index
        scene, kinds = paths.scene, paths.interactions
        if self.wall is not None:
            by_wall = (paths.objects == self.wall) & ((kinds == SPECULAR) | (kinds == TRANSMISSION))
            mine &= np.any(by_wall | (kinds == DIFFRACTION), axis=1)
        if self.acts == "turn":
            end = scene.sources[self.source] if self.source is not None else scene.receivers[self.receiver or 0]
            mine &= not isinstance(end.directivity, Omni)
        if self.name.startswith("scatterers"):
            mine &= np.any((kinds == SCATTERING) | (kinds == SHADOW), axis=1)
        if self.name.startswith("bodies"):
            mine &= np.any((kinds == BODY) | (kinds == DIFFRACTION) | (kinds == SCATTERING), axis=1)
        return mine


def parameters_of(paths: PathSet, wrt: Sequence[str]) -> list[Parameter]:
    """Return the parameters of names; a name of a vector gives all of its components."""
    check_names(wrt)
    found = [parameter for name in wrt for parameter in _named(paths, name)]
    check_once([parameter.name for parameter in found])
    return found


def check_names(wrt: Any) -> None:
    """Raise an InputError if something is no list of names."""
    if isinstance(wrt, str) or not wrt or not all(isinstance(name, str) for name in wrt):
        raise InputError("wrt", f"must be a list of names, but is {wrt!r:.80}")


def check_once(names: Sequence[str]) -> None:
    """Raise an InputError if a name comes twice."""
    for name in names:
        if names.count(name) > 1:
            raise InputError("wrt", f"must name each parameter once, but names {name} twice")


def _named(paths: PathSet, name: str) -> Iterator[Parameter]:
    scene = paths.scene
    if name.removeprefix("air.") in _OF_AIR and name.startswith("air."):
        yield from _of_air(name, name.removeprefix("air."))
    elif wall := _WALL.fullmatch(name):
        yield _of_wall(paths, name, *wall.groups())
    elif (end := _END.fullmatch(name)) and int(end[2]) < len(getattr(scene, end[1])):
        yield from _of_thing(scene, name, end[1], int(end[2]), end[3])
    else:
        raise InputError(
            "wrt",
            f'must name parameters of the scene, such as "sources[0].position" or "air.temperature_celsius", but has '
            f"{name!r:.80}",
        )


def _of_air(name: str, field: str) -> Iterator[Parameter]:
    unit, step = _OF_AIR[field]
    if field != "wind":
        yield Parameter(name, unit, step, partial(_with_air, field), acts="air")
        return
    for axis in range(3):
        yield Parameter(f"{name}.{_AXES[axis]}", unit, step, partial(_with_wind, axis))


def _with_air(field: str, scene: Scene, by: float) -> Scene:
    air, requested = scene.air, "_requested_speed" if field == "speed_of_sound" else field
    value: Any = getattr(air, field)
    within = (_DAMP, 1.0 - _DAMP) if field == "relative_humidity" else (-math.inf, math.inf)
    larger: Any = _Raised(value, by, within)
    if not callable(value):
        larger = tuple(larger.of(np.array(value)).tolist()) if isinstance(value, tuple) else float(larger.of(value))
    return varied(scene, air=replace(air, **{requested: larger}))


@dataclass(frozen=True, slots=True)
class _Raised:
    """Values or a function of the height, within bounds, plus a number; equal ones are the same air."""

    own: Any
    by: float
    within: tuple[float, float]

    def __call__(self, heights: Any) -> Any:
        return self.of(self.own(heights))

    def of(self, values: Any) -> Any:
        """Return values plus the number."""
        return np.clip(values, *self.within) + self.by


def _with_wind(axis: int, scene: Scene, by: float) -> Scene:
    wind = np.zeros(3) if scene.air.wind is None else np.array(scene.air.wind)
    return varied(scene, air=varied(scene.air, wind=tuple((wind + by * np.eye(3)[axis]).tolist())))


def _of_wall(paths: PathSet, name: str, wall: str, what: str) -> Parameter:
    names = paths.scene.room.faces.names
    if wall not in names:
        raise InputError("wrt", f"must name a wall of the room ({', '.join(names[:12])}), but has {name!r:.80}")
    index = names.index(wall)

    def changed(scene: Scene, by: float) -> Scene:
        return varied(scene, room=with_wall(scene.room, index, **{"along" if what == "displacement" else what: by}))

    if what == "reflection":
        return Parameter(name, "1", 1e-6, changed, acts="reflection", wall=index)
    if bool((paths.interactions == DIFFRACTION).any()):
        raise InputError("wrt", f"must not have {name!r} in scenes with diffracted paths: edges move with walls")
    return Parameter(name, "m", _STEP, changed, acts="wall", wall=index)


def _of_thing(scene: Scene, name: str, kind: str, index: int, what: str) -> Iterator[Parameter]:
    own: dict[str, Any] = {kind[:-1]: index} if kind in ("sources", "receivers") else {}
    thing, prefix = getattr(scene, kind)[index], f"{kind}[{index}]"
    with_thing = partial(_with_thing, kind, index)
    acts = "shift" if own else "scene"
    if what == "position":
        for axis in range(3):
            yield _shifted(f"{name}.{_AXES[axis]}", Static(np.eye(3)[axis]), with_thing, acts, own)
    elif what == "trajectory":
        for number, knot in _knots(name, thing.trajectory.curve):
            label = f"{prefix}.trajectory.positions[{number}].{_AXES[knot.axis]}"
            yield _shifted(label, knot, with_thing, acts, own)
    elif what == "orientation" and own:
        for axis in range(3):
            change = partial(with_thing, lambda thing, by, axis=axis: turned(thing, axis, math.radians(by)))
            yield Parameter(f"{name}.{_AXES[axis]}", "°", 1e-3, change, **own, acts="turn")
    elif what == "start" and kind == "sources":
        later = partial(with_thing, lambda thing, by: varied(thing, start=thing.start + by))
        yield Parameter(name, "s", 1e-7, later, **own, acts="start")
    elif what == "gain_db" and kind == "sources":
        yield Parameter(name, "dB", 1e-3, lambda scene, by: scene, **own, gain_db=1.0, acts="gain")
    elif what.removeprefix("electronics.") in _OF_ELECTRONICS and kind == "receivers":
        field = what.removeprefix("electronics.")
        unit, step = _OF_ELECTRONICS[field]
        if field == "gain_db":
            yield Parameter(name, unit, step, lambda scene, by: scene, **own, gain_db=1.0, acts="gain")
        else:
            yield Parameter(name, unit, step, partial(with_thing, partial(_clocked, field)), **own, acts="clock")
    else:
        raise InputError("wrt", f"must name parameters that have a derivative, but has {name!r:.80}")


def _shifted(name: str, shift: Curve, with_thing: Any, acts: str, own: dict[str, Any]) -> Parameter:
    change = partial(with_thing, lambda end, by: varied(end, trajectory=displaced(end.trajectory, shift, by)))
    return Parameter(name, "m", _STEP, change, **own, acts=acts, shift=shift)


def trajectories(parameters: Sequence[Parameter]) -> list[NDArray[np.int64]]:
    """Numbers (points, 3) of the parameters of each trajectory by points."""
    found: dict[int, list[int]] = {}
    for j, parameter in enumerate(parameters):
        if isinstance(parameter.shift, Knot):
            found.setdefault(id(parameter.shift.spread), []).append(j)
    return [np.reshape(js, (-1, 3)) for js in found.values()]


def with_spread(parameter: Parameter, spread: Piecewise) -> Parameter:
    """Return the displacement of a trajectory by a curve of another spread in place of that of a point."""
    assert isinstance(parameter.shift, Knot)
    return _of_end(parameter, parameter.name, replace(parameter.shift, spread=spread))


def along(parameter: Parameter, begin: float | None = None) -> Parameter:
    """Return the displacement of all of a trajectory in place of that of a point, or one that grows from a time, s."""
    if not isinstance(parameter.shift, Knot):
        return parameter
    axis = np.eye(3)[parameter.shift.axis]
    shift = Static(axis) if begin is None else Straight(-begin * axis, axis)
    name = f"{parameter.name.partition('.')[0]}.position.{_AXES[parameter.shift.axis]}"
    return _of_end(parameter, name, shift)


def _of_end(parameter: Parameter, name: str, shift: Curve) -> Parameter:
    """Return another displacement of the same end."""
    kind = "receivers" if parameter.source is None else "sources"
    index = int(parameter.receiver or 0) if parameter.source is None else parameter.source
    own = {"source": parameter.source, "receiver": parameter.receiver}
    return _shifted(name, shift, partial(_with_thing, kind, index), "shift", own)


def _knots(name: str, curve: Curve) -> Iterator[tuple[int, Knot]]:
    """Yield numbers of knots, and the curves by which the motion changes as one of their coordinates does."""
    if not isinstance(curve, Piecewise):
        raise InputError("wrt", f"must name positions, not the trajectory, of what has no knots, but has {name!r:.80}")
    times = curve.polynomial.x[1:-1]  # without what it is continued by
    straight, each = not np.any(curve.polynomial.c[:2]), np.eye(len(times))
    spread = legs_through(times, each) if straight else spline_through(times, each, "not-a-knot")
    for number in range(len(times)):
        for axis in range(3):
            yield number, Knot(spread, number, axis)


def _with_thing(kind: str, index: int, change: Callable[[Any, float], Any], scene: Scene, by: float) -> Scene:
    things = list(getattr(scene, kind))
    things[index] = change(things[index], by)
    return varied(scene, **{kind: tuple(things)})


def _clocked(field: str, thing: Any, by: float) -> Any:
    end = thing.electronics or Electronics()
    return varied(thing, electronics=varied(end, **{field: getattr(end, field) + by}))
