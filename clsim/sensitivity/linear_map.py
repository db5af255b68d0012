"""The linear map from small changes of parameters to received signals, and its transpose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.arrivals import Kinematics
from clsim.paths.path_set import PathSet
from clsim.render.methods.per_sample import PathSum
from clsim.render.plan import Allocation, Plan
from clsim.render.planning import plan_paths
from clsim.render.render import PressureSum, ReceiverEnd
from clsim.sensitivity.displaced import varied
from clsim.sensitivity.parameters import check_differentiable
from clsim.sensitivity.tangents import TangentPaths
from clsim.tracks.tracks import SceneTracks, track

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from clsim.arrays import Floats
    from clsim.paths.family import PairPaths
    from clsim.render.options import RenderOptions
    from clsim.sensitivity.parameters import Parameter

_MOST_PAIRS = 16  # of a source, that the design of functions of frequency looks at
_PER_SAMPLE: dict[str, Any] = {"convolve_static": False, "narrowband": False, "channels": False, "prune_below_db": None}


@dataclass(frozen=True, slots=True, eq=False)
class LinearMap:
    """Tangents of a scene's paths by some parameters, and the functions of frequency that all of them share.

    Attributes
    ----------
    plan : Plan
        Plan of the sum over the paths themselves, sample by sample.
    tangents : tuple of SceneTracks
        Tracks of the tangents by each parameter.
    shared : Plan
        With the filters for the responses of all tangents.
    """

    plan: Plan
    parameters: tuple[Parameter, ...]
    tangents: tuple[SceneTracks, ...]
    shared: Plan

    def tracks_of(self, parameter: Parameter) -> SceneTracks:
        """Return the tracks of the tangents by one more parameter."""
        options, kinematics = self.plan.options, scene_tracks(self.plan).kinematics
        tangents = tangents_of(scene_tracks(self.plan).paths, parameter, kinematics)
        return track(tangents, motion=options.motion, amplitude=options.amplitude, transition=options.transition)

    @classmethod
    def of(cls, paths: PathSet, parameters: Sequence[Parameter], options: RenderOptions) -> LinearMap:
        """Make the tangents and design the filters."""
        plan = plan_of(paths, options)
        paths, options = scene_tracks(plan).paths, plan.options
        kinematics = Kinematics(options.motion, options.amplitude)
        sets = [tangents_of(paths, parameter, kinematics) for parameter in parameters]
        shared = plan_paths(_representatives(paths, parameters, sets), replace(options, duration=plan.duration))
        own: dict[str, Any] = {
            "motion": options.motion,
            "amplitude": options.amplitude,
            "transition": options.transition,
        }
        tracks = tuple(track(tangents, **own) for tangents in sets)
        return cls(plan, tuple(parameters), tracks, shared)

    def plan_of(self, tracks: SceneTracks) -> Plan:
        """Return the plan of the sum over tangents, by the filters that all share."""
        return replace(
            self.shared, tracks=tracks, allocation=Allocation(), samples=self.plan.samples, chunk=self.plan.chunk,
            builders=[PathSum],
        )  # fmt: skip

    def forward(self) -> Iterator[Floats]:
        """Yield the derivative of all rows (rows, samples) by each parameter."""
        for tracks in self.tangents:
            yield received(self.plan_of(tracks))


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


def tangents_of(paths: PathSet, parameter: Parameter, kinematics: Kinematics) -> PathSet:
    """Return the tangents of all paths that depend on a parameter, a kind for each kind of path."""
    found = []
    for family in paths.families:
        mine = np.ones(len(family), dtype=bool)
        for own, index in ((family.source, parameter.source), (family.receiver, parameter.receiver)):
            mine &= True if index is None else own == index
        found.append(TangentPaths.of(family.part(np.flatnonzero(mine)), parameter, kinematics))
    return PathSet(paths.scene, tuple(found))


def _representatives(paths: PathSet, parameters: Sequence[Parameter], sets: Sequence[PathSet]) -> PathSet:
    """Return tangents of a few pairs by parameters of all kinds, of which functions of frequency are designed."""
    kinds: dict[str, list[PathSet]] = {}
    for parameter, tangents in zip(parameters, sets, strict=True):
        kinds.setdefault(parameter.kind, []).append(tangents)
    found = []
    for source in range(len(paths.scene.sources)):
        of_kinds = (_pairs_of(mine, source) for mine in kinds.values())
        in_turn = (pair for turn in zip_longest(*of_kinds) for pair in turn if pair is not None)
        found += [pair for pair, _ in zip(in_turn, range(_MOST_PAIRS), strict=False)]
    families = tuple(pair.family.part(pair.index) for pair in found)
    return PathSet(paths.scene, families)


def _pairs_of(sets: Sequence[PathSet], source: int) -> Iterator[PairPaths]:
    """Yield pairs of a source: the first of each parameter, then the second of each, and so on."""
    each = [[pair for _, pair in tangents.pairs() if pair.source == source] for tangents in sets]
    yield from (pair for turn in zip_longest(*each) for pair in turn if pair is not None)
