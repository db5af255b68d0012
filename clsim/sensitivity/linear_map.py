"""The linear map from small changes of parameters to received signals, and its transpose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.path_set import PathSet
from clsim.render.methods.per_sample import PathSum
from clsim.render.plan import Allocation, Plan
from clsim.render.planning import plan_paths
from clsim.render.render import PressureSum, ReceiverEnd
from clsim.sensitivity.displaced import varied
from clsim.sensitivity.parameters import check_differentiable, whole_shift
from clsim.sensitivity.tangents import TangentPaths
from clsim.tracks.tracks import SceneTracks, track

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from clsim.arrays import Floats
    from clsim.paths.arrivals import Kinematics
    from clsim.paths.family import PathFamily
    from clsim.render.options import RenderOptions
    from clsim.sensitivity.parameters import Parameter

_MOST_PAIRS = 16  # of a source, that the design of functions of frequency looks at
_LESS_DB, _MOST_DB = 10.0, -20.0  # by which tangents may be held less well than responses, and at most
_PER_SAMPLE: dict[str, Any] = {
    "convolve_static": False, "narrowband": False, "channels": False, "prune_below_db": None, "shadow_error_db": None,
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LinearMap:
    """Parameters of a scene, and the functions of frequency that the tangents of its paths by all of them share.

    Attributes
    ----------
    plan : Plan
        Plan of the sum over the paths themselves, sample by sample.
    shared : Plan
        With the filters for the responses of all tangents.
    """

    plan: Plan
    parameters: tuple[Parameter, ...]
    shared: Plan

    def tracks_of(self, parameter: Parameter) -> SceneTracks | None:
        """Return the tracks of the tangents by a parameter; None of none."""
        options, own = self.plan.options, scene_tracks(self.plan)
        tangents = tangents_of(own.paths, parameter, own.kinematics)
        if tangents is None:
            return None
        return track(tangents, motion=options.motion, amplitude=options.amplitude, transition=options.transition)

    @classmethod
    def of(cls, paths: PathSet, parameters: Sequence[Parameter], options: RenderOptions) -> LinearMap:
        """Design the filters."""
        plan = plan_of(paths, options)
        few = _representatives(scene_tracks(plan), parameters)
        allowed = min(plan.options.response_error_db + _LESS_DB, _MOST_DB)
        own = replace(plan.options, duration=plan.duration, response_error_db=allowed)
        shared = plan_paths(few, own) if few is not None else plan
        return cls(plan, tuple(parameters), shared)

    def plan_of(self, tracks: SceneTracks) -> Plan:
        """Return the plan of the sum over tangents, by the filters that all share."""
        return replace(
            self.shared, tracks=tracks, allocation=Allocation(), samples=self.plan.samples, chunk=self.plan.chunk,
            builders=[PathSum],
        )  # fmt: skip

    def forward(self) -> Iterator[Floats]:
        """Yield the derivative of all rows (rows, samples) by each parameter."""
        for parameter in self.parameters:
            tracks = self.tracks_of(parameter)
            silent = np.zeros((self.plan.row_count, self.plan.samples))
            yield silent if tracks is None else received(self.plan_of(tracks))


def plan_of(paths: PathSet, options: RenderOptions) -> Plan:
    """Return the plan of a sum over paths, sample by sample and without noise at the receivers."""
    check_differentiable(paths, options)
    return plan_paths(_without_noise(paths), replace(options, **_PER_SAMPLE))


def scene_tracks(plan: Plan) -> SceneTracks:
    """Return the tracks of a plan, which are those of a scene."""
    assert plan.tracks.of_scene is not None
    return plan.tracks.of_scene


def received(plan: Plan) -> Floats:
    """Render a plan in the precision of its engine, (rows, samples), with the linear part of the receivers' ends."""
    out, pressure = np.zeros((plan.row_count, plan.samples)), PressureSum(plan)
    for start in range(0, plan.samples, plan.chunk):
        piece = pressure(start)
        out[:, start : start + piece.shape[1]] = piece
    pressure.warn()
    return through_ends(plan, out)


def through_ends(plan: Plan, rows: Floats, transposed: bool = False) -> Floats:
    """Pass rows (rows, samples) of pressure through transducers and filters of the receivers, or by the transpose.

    The ends are causal and do not change over time: their transpose is the same on reversed time.
    """
    step = -1 if transposed else 1
    for i, receiver in enumerate(plan.receivers):
        if receiver.transducer is not None or receiver.electronics is not None:
            for row in range(plan.row_count)[plan.rows_of(i)]:
                end = ReceiverEnd(receiver, plan.row_names[row], plan.sampling_rate)
                rows[row] = end(0, rows[row, ::step])[::step]
    return rows


def _without_noise(paths: PathSet) -> PathSet:
    """Return the paths in a scene whose receivers neither add noise nor round."""
    quiet: dict[str, Any] = dict.fromkeys(("ambient_noise_db", "snr_db", "self_noise_db", "adc_bits", "adc_full_scale"))
    receivers = tuple(
        r if r.electronics is None else varied(r, electronics=varied(r.electronics, **quiet))
        for r in paths.scene.receivers
    )
    scene = varied(paths.scene, receivers=receivers)
    return PathSet(scene, tuple(family.in_scene(scene) for family in paths.families))


def tangents_of(paths: PathSet, parameter: Parameter, kinematics: Kinematics) -> PathSet | None:
    """Return the tangents of all paths that depend on a parameter, a kind for each kind of path; None of none."""
    found = []
    for family in paths.families:
        mine = np.flatnonzero(parameter.touched(family))
        if len(mine):
            found.append(TangentPaths.of(family.part(mine), parameter, kinematics))
    return PathSet(paths.scene, tuple(found)) if found else None


def _representatives(tracks: SceneTracks, parameters: Sequence[Parameter]) -> PathSet | None:
    """Return tangents of a few pairs by parameters of all kinds, of which functions of frequency are designed."""
    kinds: dict[str, list[Parameter]] = {}
    for parameter in parameters:
        kinds.setdefault(parameter.kind, []).append(parameter)
    found: list[PathFamily] = []
    for source in range(len(tracks.paths.scene.sources)):
        each = max(_MOST_PAIRS // len(kinds), 2)
        for mine in kinds.values():
            found += _of_kind(tracks, mine, source, each)
    return PathSet(tracks.paths.scene, tuple(found)) if found else None


def _of_kind(tracks: SceneTracks, parameters: list[Parameter], source: int, count: int) -> Iterator[PathFamily]:
    """Yield tangents by some parameters of a kind, those of each of another pair of a source."""
    own = [p for p in parameters if p.source in (None, source)]
    pairs = [pair for pair in tracks.pair_paths if pair.source == source]
    for i in range(min(count, len(own) * len(pairs))):
        parameter = own[i * len(own) // count if len(own) > count else i % len(own)]
        first = i % len(pairs)
        for pair in (pair for pair in pairs[first:] + pairs[:first] if parameter.receiver in (None, pair.receiver)):
            paths = pair.family.part(pair.index)
            mine = np.flatnonzero(parameter.touched(paths))
            if len(mine):
                yield TangentPaths.of(paths.part(mine), whole_shift(parameter), tracks.kinematics)
                break
