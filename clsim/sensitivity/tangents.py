"""Tangents of paths: how the response of each path changes with a parameter, at the delays of the paths themselves."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from clsim.paths.arrivals import RETARDED
from clsim.paths.family import PathFamily
from clsim.paths.response import NEPERS, SceneResponse
from clsim.sensitivity.images import Images, in_closed_form, is_simple, turned_back

if TYPE_CHECKING:
    from collections.abc import Iterator

    from clsim.arrays import Complexes, Floats
    from clsim.paths.arrivals import Arrivals, Kinematics
    from clsim.paths.family import Rows
    from clsim.scene.scene import Scene
    from clsim.sensitivity.parameters import Parameter

_ENDS_ALONE = ("shift", "clock", "start", "gain")  # what parameters act on that change nothing between the ends


@dataclass(frozen=True, slots=True, eq=False)
class TangentPaths(PathFamily):
    """Derivatives by one parameter θ of paths, as paths of the same delays τ and of another response.

    The received signal is the sum of ``R(f, θ) exp(-2j pi f tau(θ))`` times the spectrum of what is emitted, so that
    the response of its derivative is ``dR/dθ - 2j pi f dtau/dθ R``. Of images both derivatives are in closed form. Of
    others they are central differences of the delay and the response of each path, which are smooth, in scenes a step
    of the parameter to both sides.
    """

    base: PathFamily  # the paths
    ahead: PathFamily  # the same where the parameter is larger by a step, and smaller
    behind: PathFamily  # likewise
    parameter: Parameter
    kinematics: Kinematics  # of the rendering

    @classmethod
    def of(cls, base: PathFamily, parameter: Parameter, kinematics: Kinematics) -> Self:
        """Return the tangents of paths by a parameter."""
        own: dict[str, Any] = {f.name: getattr(base, f.name) for f in fields(PathFamily)}
        ahead = behind = base
        if not (in_closed_form(base) and parameter.acts in _ENDS_ALONE):
            ahead, behind = (base.in_scene(parameter.moved(base.scene, sign * parameter.step)) for sign in (1.0, -1.0))
        return cls(**own, base=base, ahead=ahead, behind=behind, parameter=parameter, kinematics=kinematics)

    def arrivals(self, rows: Rows, times: Floats, kinematics: Kinematics = RETARDED) -> Arrivals:
        """Return the arrivals of the paths themselves."""
        return self.base.arrivals(rows, times, kinematics)

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Complexes:
        """Return the response (P, T, F) of the derivative, per unit of the parameter."""
        return self.beside(rows, self.base.response(rows, found, times, at), found, times, at)

    def beside(
        self, rows: Rows, own: Floats | Complexes, found: Arrivals, times: Floats, at: SceneResponse
    ) -> Complexes:
        """Return the same from the arrivals and the responses (P, T, F) of the paths themselves."""
        if in_closed_form(self.base) and self.parameter.acts != "scene":
            return self._image(rows, own, found, times, at)
        source, step = int(self.source[rows][0]), self.parameter.step
        delays, responses = [], []
        for family in (self.ahead, self.behind):
            later = self._later(family, rows, times)
            there = family.arrivals(rows, times + later, self.kinematics)
            beside = SceneResponse(family.scene, source, at.frequencies)
            responses.append(family.response(rows, there, times + later, beside))
            started = family.scene.sources[source].start - self.scene.sources[source].start
            delays.append(there.delay - later + started)
        gain_rate = (responses[0] - responses[1]) / (2.0 * step) + NEPERS * self.parameter.gain_db * own
        delay_rate = (delays[0] - delays[1]) / (2.0 * step)
        return np.asarray(gain_rate - 2j * np.pi * at.frequencies * delay_rate[..., None] * own)

    def _image(
        self, rows: Rows, own: Floats | Complexes, found: Arrivals, times: Floats, at: SceneResponse
    ) -> Complexes:
        """Return the same of images."""
        parameter, images = self.parameter, Images.of(self.base, rows, times, found, self.kinematics)
        causes, acts = self._causes(images, rows, times), parameter.acts
        change = images.change(**causes)
        delay, level = change.delay + float(acts == "start"), NEPERS * parameter.gain_db
        turning = -2j * np.pi * at.frequencies * delay[..., None] * own
        if acts in (*_ENDS_ALONE, "wall") and is_simple(self.base, rows, at):
            louder = (images.level(change) + level)[..., None] - change.length[..., None] * at.nepers
            return np.asarray(louder * own + turning)
        beside = []
        for family, step in ((self.ahead, parameter.step), (self.behind, -parameter.step)):
            there = SceneResponse(family.scene, int(self.source[rows][0]), at.frequencies)
            when = times + step * causes.get("later", 0.0)
            beside.append(family.response(rows, images.moved(change, step), when, there))
        return np.asarray((beside[0] - beside[1]) / (2.0 * parameter.step) + level * own + turning)

    def vertices(self, rows: Rows, time: float, kinematics: Kinematics = RETARDED) -> Floats:
        """Return the vertices of the paths themselves."""
        return self.base.vertices(rows, time, kinematics)

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Return the lengths of the paths themselves."""
        return self.base.lengths(rows, source, receiver)

    def delay_bounds(self, rows: Rows, start: Any, end: Any, speeds: Any) -> tuple[Floats, Floats]:
        """Return the bounds of the paths themselves."""
        return self.base.delay_bounds(rows, start, end, speeds)

    def max_rate(self, source_speed: float, receiver_speed: float) -> float:
        """Return the bound of the paths themselves."""
        return self.base.max_rate(source_speed, receiver_speed)

    @property
    def is_complex(self) -> bool:
        """Whether responses have phases: that of a derivative by time."""
        return True

    @property
    def varies(self) -> bool:
        """Whether those of the paths do."""
        return self.base.varies

    @property
    def costly(self) -> bool:
        """Whether those of the paths do."""
        return self.base.costly

    @property
    def moves(self) -> bool:
        """Whether the paths do."""
        return self.base.moves

    def hashed(self) -> Iterator[tuple[str, Any]]:
        """Yield names and values of the columns, and the parameter's name."""
        yield from self.base.hashed()
        yield "parameter", self.parameter.name

    def part(self, rows: Rows) -> Self:
        """Return some of the paths."""
        base, ahead, behind = (family.part(rows) for family in (self.base, self.ahead, self.behind))
        own = {f.name: getattr(base, f.name) for f in fields(PathFamily)}
        return replace(self, **own, base=base, ahead=ahead, behind=behind)

    def _causes(self, images: Images, rows: Rows, times: Floats) -> dict[str, Any]:
        """Return the changes of what images depend on, as `Images.change` takes them."""
        parameter, step = self.parameter, self.parameter.step
        if parameter.acts == "shift" and parameter.shift is not None:
            if parameter.receiver is not None:
                return {"apart": turned_back(images.matrix, parameter.shift.position(times))}
            when = images.found.emission_time
            return {"apart": -parameter.shift.position(when), "velocity": parameter.shift.velocity(when)}
        if parameter.acts == "clock":
            return {"later": clock_change(parameter, self.scene, times)}
        families: Any = self.ahead, self.behind
        if parameter.acts == "wall":
            ahead, behind = (family.legs[0].offset[rows] for family in families)
            return {"apart": -turned_back(images.matrix, ((ahead - behind) / (2.0 * step))[:, None])}
        if parameter.acts == "air":
            source = int(self.source[rows][0])
            ahead, behind = (family.medium(source).speed_of_sound for family in families)
            return {"speed": (ahead - behind) / (2.0 * step)}
        return {}

    def _later(self, family: PathFamily, rows: Rows, times: Floats) -> Floats:
        """Time (s) by which a receiver of a scene beside takes the samples later that it takes at `times`."""
        receiver = int(self.receiver[rows][0])
        own, other = self.scene.receivers[receiver], family.scene.receivers[receiver]
        if own is other:
            return np.zeros_like(times)
        given = (times - own.clock_error(np.zeros(1))) / own.clock_rate
        return np.asarray(other.clock_error(given) - own.clock_error(given))


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
