"""Tangents of paths: how responses change with parameters, at the delays of the paths themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.paths.family import PairPaths, PathFamily, Rows
from clsim.paths.response import NEPERS, Arrivals, Kinematics, SceneResponse
from clsim.scene.scene import Scene
from clsim.sensitivity.displaced import Knot, TangentResponse, members_of
from clsim.sensitivity.images import Images, in_closed_form, is_simple, turned_back
from clsim.sensitivity.parameters import Parameter, along

Terms = list[tuple[Any, Any]]  # weights (P, T) or numbers, and responses (C, P, T, F)

_CLOSED = ("shift", "clock", "wall", "air")  # what parameters act on by which images have closed derivatives
_BESIDE = 1e-6  # s, to either side, between which responses change evenly


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """Derivatives of the responses of a pair's paths at times of reception (T,), by channel of the receiver."""

    # The received signal is the sum of ``R(f, θ) exp(-2j pi f tau(θ))`` times the spectrum of what is emitted, so that
    # the response of its derivative is ``dR/dθ - 2j pi f dtau/dθ R``. Of images both derivatives are in closed form. Of
    # others they are central differences of the delay and the response of each path, which are smooth, in scenes a step
    # of the parameter to both sides.
    paths: PairPaths
    times: Floats
    found: Arrivals
    at: TangentResponse
    kinematics: Kinematics
    own: Floats | Complexes  # (C, P, T, F) responses of the paths themselves
    known: dict[Any, Any] = field(default_factory=dict)  # what several parameters share, by name

    @classmethod
    def of(cls, paths: PairPaths, times: Floats, found: Arrivals, at: TangentResponse, kinematics: Kinematics) -> Self:
        """Take the responses of the paths from their arrivals."""
        at = at.beside(paths, times, kinematics)
        return cls(paths, times, found, at, kinematics, paths.responses(found, times, at))

    def by(self, parameter: Parameter) -> Complexes:
        """Return the responses (C, P, T, F) of the derivative, per unit of the parameter."""
        out = np.zeros(self.own.shape, dtype=np.complex128)
        for weight, response in self.terms(parameter):
            out += np.asarray(weight)[..., None] * response
        return out

    def terms(self, parameter: Parameter) -> Terms:
        """List the same as products of weights with responses, which parameters share."""
        acts, family = parameter.acts, self.paths.family
        if acts in ("gain", "start"):
            return [(NEPERS * parameter.gain_db, self.own)] if acts == "gain" else [(1.0, self._turned())]
        closed = in_closed_form(family) and acts in _CLOSED
        if acts == "shift" and isinstance(parameter.shift, Knot) and not (closed and self._simple):
            return self._of_knot(parameter, parameter.shift)
        if closed:
            return self._of_image(parameter)
        if acts == "clock":
            return [(clock_change(parameter, family.scene, self.times), self._once("time", self._by_time))]
        return [(1.0, self._difference(parameter))]

    def of_place(self, parameter: Parameter) -> Complexes:
        """Responses of the derivative by an end's place along the axis of a point's displacement."""
        one = along(parameter)
        found: Complexes = self._once(one.name, lambda: self.by(one))
        return found

    def of_velocity(self, parameter: Parameter) -> Complexes:
        """Responses of the derivative by a source's velocity at the time of emission, along the same axis."""
        middle = float(np.mean(self.times))
        ramp = along(parameter, middle)

        def made() -> Complexes:
            return self.by(ramp) - (self.found.emission_time - middle)[..., None] * self.of_place(parameter)

        found: Complexes = self._once((ramp.name, "velocity"), made)
        return found

    def _of_knot(self, parameter: Parameter, shift: Knot) -> Terms:
        """List the terms of a point of a motion: by the place and the velocity of the end."""
        if parameter.source is None:
            return [(shift.position(self.times)[:, shift.axis], self.of_place(parameter))]
        when = self.found.emission_time
        each = shift.position(when), shift.velocity(when)
        place, velocity = (values[..., shift.axis] for values in each)
        return [(place, self.of_place(parameter)), (velocity, self.of_velocity(parameter))]

    def part(self, rows: NDArray[np.int64]) -> Tangents:
        """Return those of some paths."""
        paths, found, at = self.paths.part(rows), self.found.part(rows), self.at.part(rows)
        return replace(self, paths=paths, found=found, at=at, own=self.own[:, rows], known={})

    @property
    def _simple(self) -> bool:
        return is_simple(self.paths.family, self.paths.index, self.at)

    def _once(self, name: Any, make: Callable[[], Any]) -> Any:
        if name not in self.known:
            self.known[name] = make()
        return self.known[name]

    def _turned(self) -> Complexes:
        """Responses of a delay that grows by a second."""
        turned: Complexes = self._once("turned", lambda: -2j * np.pi * self.at.turning * self.own)
        return turned

    def _by_time(self) -> Complexes:
        """Responses of the derivative by the time of reception."""
        ahead, behind = (self._beside(self.paths.family, sign * _BESIDE) for sign in (1.0, -1.0))
        return self._quotient(ahead, behind, 2.0 * _BESIDE)

    def _difference(self, parameter: Parameter) -> Complexes:
        """Responses of the derivative, by scenes a step to either side; paths that do not change are left out."""
        touched = parameter.touched(self.paths.family)[self.paths.index]
        if not touched.all():
            out = np.zeros(self.own.shape, dtype=np.complex128)
            if touched.any():
                out[:, touched] = self.part(np.flatnonzero(touched))._difference(parameter)
            return out
        part = self.paths.family.part(self.paths.index)
        scenes = (parameter.moved(part.scene, sign * parameter.step) for sign in (1.0, -1.0))
        ahead, behind = (self._beside(part.in_scene(scene), 0.0, slice(None)) for scene in scenes)
        return self._quotient(ahead, behind, 2.0 * parameter.step)

    def _quotient(self, ahead: tuple[Any, Any], behind: tuple[Any, Any], steps: float) -> Complexes:
        turns = ((ahead[1] - behind[1]) / steps)[..., None] * self._turned()
        return np.asarray((ahead[0] - behind[0]) / steps + turns)

    def _beside(self, family: PathFamily, later: float, rows: Any = None) -> tuple[Any, Floats]:
        """Return responses and delays of the same paths in another scene, of samples that are taken some s later."""
        paths = replace(self.paths, family=family, rows=self.paths.rows if rows is None else rows)
        when = self.times + later
        found = paths.arrivals(when, self.kinematics)
        at = self.at.in_scene(family.scene)
        return paths.responses(found, when, at), delays_of(paths, found, when) - later

    def _of_image(self, parameter: Parameter) -> Terms:
        """List the terms of images."""
        images: Images = self._once("images", self._images)
        causes, acts = self._causes(parameter), parameter.acts
        change = images.change(**causes)
        if acts != "air" and self._simple:
            lossy = self._once("lossy", lambda: self.at.nepers * self.own)
            return [(images.level(change), self.own), (change.delay, self._turned()), (-change.length, lossy)]
        beside, steps = [], 2.0 * parameter.step
        for step in (parameter.step, -parameter.step):
            paths, scene = self.paths, self.paths.family.scene
            if acts == "air":
                scene = parameter.moved(scene, step)
                paths = replace(paths, family=paths.family.in_scene(scene))
            there = self.at.in_scene(scene)
            when, moved = self.times + step * causes.get("later", 0.0), images.moved(change, step)
            beside.append((paths.responses(moved, when, there), delays_of(paths, moved, when)))
        late = change.delay + (beside[0][1] - beside[1][1]) / steps  # of channels behind the centre
        return [(1.0, (beside[0][0] - beside[1][0]) / steps), (late, self._turned())]

    def _images(self) -> Images:
        return Images.of(self.paths, self.times, self.found, self.kinematics)

    def _causes(self, parameter: Parameter) -> dict[str, Any]:
        """Return the changes of what images depend on, as `Images.change` takes them."""
        times, images, scene = self.times, self._once("images", self._images), self.paths.family.scene
        if parameter.acts == "shift" and parameter.shift is not None:
            if parameter.receiver is not None:
                places, swifter = parameter.shift.position(times), parameter.shift.velocity(times)
                return {"apart": turned_back(images.matrix, places), "swifter": turned_back(images.matrix, swifter)}
            when = self.found.emission_time
            return {"apart": -parameter.shift.position(when), "velocity": parameter.shift.velocity(when)}
        if parameter.acts == "clock":
            return {"later": clock_change(parameter, scene, times)}
        part: Any = self.paths.family.part(self.paths.index)
        families = [part.in_scene(parameter.moved(scene, sign * parameter.step)) for sign in (1.0, -1.0)]
        if parameter.acts == "wall":
            offset = (families[0].legs[0].offset - families[1].legs[0].offset) / (2.0 * parameter.step)
            return {"apart": -turned_back(images.matrix, offset[:, None])}
        speeds = [family.medium(self.paths.source).speed_of_sound for family in families]
        return {"speed": (speeds[0] - speeds[1]) / (2.0 * parameter.step)}


def delays_of(paths: PairPaths, found: Arrivals, times: Floats) -> Floats:
    """Delays (P, T), s, of channels that have one of their own with it."""
    if paths.reach == 0.0:
        return found.delay
    return np.asarray(found.delay + paths.emission_lateness(found, times)[..., paths.only_channel])


def clock_change(parameter: Parameter, scene: Scene, times: Floats) -> Floats:
    """Change of the true times of samples that a receiver takes at true times, by a parameter of its clock."""
    assert parameter.receiver is not None
    own = scene.receivers[parameter.receiver]
    given = (times - own.clock_error(np.zeros(1))) / own.clock_rate
    ahead, behind = (
        parameter.moved(scene, sign * parameter.step).receivers[parameter.receiver].clock_error(given)
        for sign in (1.0, -1.0)
    )
    return np.asarray((ahead - behind) / (2.0 * parameter.step))


@dataclass(frozen=True, slots=True, eq=False)
class TangentPaths(PathFamily):
    """Derivatives by one parameter of paths, as paths whose responses filters are designed for."""

    base: PathFamily  # the paths
    parameter: Parameter
    kinematics: Kinematics  # of the rendering
    at_centre: bool  # whether it takes responses at the centre frequency
    arrivals, vertices, lengths = members_of("base", "arrivals", "vertices", "lengths")
    delay_bounds, max_rate, varies, moves = members_of("base", "delay_bounds", "max_rate", "varies", "moves")
    is_complex = True  # a derivative by time has a phase
    shapes_channels = True  # by the changes of their gains

    @classmethod
    def of(cls, base: PathFamily, parameter: Parameter, kinematics: Kinematics, at_centre: bool) -> Self:
        """Return the tangents of paths by a parameter."""
        own: dict[str, Any] = {f.name: getattr(base, f.name) for f in fields(PathFamily)}
        return cls(**own, base=base, parameter=parameter, kinematics=kinematics, at_centre=at_centre)

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Complexes:
        """Return the response (P, T, F) of the derivative, per unit of the parameter; of channels together."""
        pair = PairPaths(self, rows, int(self.source[rows][0]), int(self.receiver[rows][0]))
        each = self.of_channels(pair, found, times, at)
        return each[0] if len(each) == 1 else np.asarray(np.linalg.norm(each, axis=0))

    def of_channels(self, paths: PairPaths, found: Arrivals, times: Floats, at: SceneResponse) -> Complexes:
        """Return the same by channel of the receiver, (C, P, T, F)."""
        own = TangentResponse(self.scene, paths.source, at.frequencies, self.at_centre)
        return Tangents.of(replace(paths, family=self.base), times, found, own, self.kinematics).by(self.parameter)

    def hashed(self) -> Iterator[tuple[str, Any]]:
        """Yield names and values of the columns, and the parameter's name."""
        yield from self.base.hashed()
        yield "parameter", self.parameter.name

    def part(self, rows: Rows) -> Self:
        """Return some of the paths."""
        base = self.base.part(rows)
        return replace(self, **{f.name: getattr(base, f.name) for f in fields(PathFamily)}, base=base)
