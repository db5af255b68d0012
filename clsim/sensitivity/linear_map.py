"""The linear map from small changes of parameters to received signals, and its transpose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.paths.family import PairPaths, PathFamily
from clsim.paths.path_set import PathSet
from clsim.paths.response import Arrivals
from clsim.render.methods.per_sample import PathSum
from clsim.render.options import RenderOptions
from clsim.render.plan import BLOCKS, Allocation, Plan, chunk_of
from clsim.render.planning import plan_paths
from clsim.render.render import PressureSum, ReceiverEnd
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.ends import Receiver
from clsim.scene.motion.curves import Piecewise
from clsim.sensitivity.displaced import ByFunctions, Knot, TangentResponse, locally, moving, varied
from clsim.sensitivity.parameters import Parameter, along, trajectories, with_spread
from clsim.sensitivity.tangents import TangentPaths, Tangents
from clsim.tracks.basis import Basis
from clsim.tracks.picked import SEED
from clsim.tracks.tracks import SceneTracks

_MOST_PAIRS = 16  # of a source, that the design of functions of frequency looks at
_TOGETHER = 24  # parameters that are rendered at a time
_LEAST = 0.03  # of the loudest tangent: errors of fainter ones are relative to it
_BLOCKS = (768, 576, 384, 288, 256, *BLOCKS[2:])  # samples in a block by points of a trajectory, as in `Plan`
_CUBIC = 24  # blocks in each cubic of a motion at least
_SAMPLED = 5  # instants and pairs at which levels of tangents are taken
_LESS_DB, _MOST_DB = 10.0, -20.0  # by which tangents may be held less well than responses, and at most
_PER_SAMPLE: dict[str, Any] = {
    "convolve_static": False, "narrowband": False, "channels": False, "prune_below_db": None,
    "scattering_error_db": None,
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LinearMap:
    """Parameters of a scene, and the functions of frequency that the tangents of its paths by all of them share."""

    plan: Plan  # of the sum over the paths themselves, sample by sample
    parameters: tuple[Parameter, ...]
    shared: Plan  # with the filters for the responses of all tangents

    @classmethod
    def of(cls, paths: PathSet, parameters: Sequence[Parameter], options: RenderOptions) -> LinearMap:
        """Design the filters."""
        plan = plan_of(paths, options)
        few = representatives(scene_tracks(plan), parameters, plan.options.responses == "centre")
        allowed = min(plan.options.response_error_db + _LESS_DB, _MOST_DB)
        own = replace(plan.options, duration=plan.duration, response_error_db=allowed, tail="off", responses="band")
        shared = plan_paths(few, own) if few is not None else plan
        return cls(plan, tuple(parameters), shared)

    def forward(self, out: Floats | Complexes) -> None:
        """Write the derivatives of all rows by all parameters into an array (parameters, rows, samples)."""
        out[:] = 0.0
        others = [j for j, parameter in enumerate(self.parameters) if not isinstance(parameter.shift, Knot)]
        for first in range(0, len(others), _TOGETHER):
            here = others[first : first + _TOGETHER]
            self._write(here, [self.parameters[j] for j in here], out, 0, self.plan.samples)
        for js in trajectories(self.parameters):
            self._write_points(js, out)
        for j in range(len(out)):
            out[j] = through_ends(self.plan, out[j])

    def _write_points(self, js: NDArray[np.int64], out: Floats | Complexes) -> None:
        """Write those by the points of a trajectory (points, 3), of which few move it at the same time."""
        # They are sums of derivatives by B-splines, of which each moves it for four of its cubics.
        plan, knot = self.plan, self.parameters[js[0, 0]].shift
        assert isinstance(knot, Knot)
        spread, mixed = locally(knot.spread)
        windows = [(at, min(at + plan.segment, plan.samples)) for at in range(0, plan.samples, plan.segment)]
        spans = [moving(spread, *self._times(*window)) for window in windows]
        count = max(last - first for first, last in spans)  # the same in all, for few kernels
        blocks = blocks_for(plan, spread)
        for window, (first, _) in zip(windows, spans, strict=True):
            here = min(first, len(js) - count) + np.arange(count)
            for some in np.array_split(here, -(-3 * count // _TOGETHER)):
                mine = js[some].ravel().tolist()
                self._write(mine, [with_spread(self.parameters[j], spread) for j in mine], out, *window, blocks)
        for axis in range(3):
            out[js[:, axis]] = np.tensordot(mixed, out[js[:, axis]], 1)

    def _times(self, start: int, stop: int) -> tuple[float, float]:
        """First and last time, s, of emission or reception that samples, and the nodes beside them, depend on."""
        plan, beside = self.plan, 3 * self.plan.blocks[0]
        tracks, times = scene_tracks(plan), np.array([start - beside, stop + beside]) / plan.sampling_rate
        late = np.stack([receiver.clock_error(times) for receiver in tracks.scene.receivers])
        first = min(times[0] - tracks.longest_delay(*times), float((times + late).min()))
        return first, float((times + late).max())

    def _write(
        self, js: Sequence[int], parameters: Sequence[Parameter], out: Floats | Complexes, start: int, stop: int,
        blocks: tuple[int, ...] | None = None,
    ) -> None:  # fmt: skip
        """Write those by some parameters, which are rendered together, from a sample to another."""
        plan = self.plan
        tracks = TangentTracks.among_all(
            scene_tracks(plan), parameters, plan.duration, plan.options.responses == "centre"
        )
        if not tracks.pairs:
            return
        rows = sum(map(len, tracks.channels))
        chunk = chunk_of(plan.options, stop - start, plan.sampling_rate, plan.segment, rows, tracks.longest_delay)
        shared = replace(
            self.shared, tracks=tracks, allocation=Allocation(), samples=stop, chunk=chunk,
            blocks=blocks or plan.blocks, builders=[PathSum],
        )  # fmt: skip
        pressure = PressureSum(shared)
        for at in range(start, stop, chunk):
            piece = pressure(at)
            for mine, j, row in tracks.rows(plan.first_rows):
                out[js[j], row, at : at + piece.shape[1]] = tracks.scales[j] * piece[mine]
        pressure.warn()


@dataclass(frozen=True, slots=True, eq=False)
class TangentTracks(SceneTracks):
    """Tracks of the tangents of paths by several parameters: these are channels of the receivers, with one delay."""

    parameters: tuple[Parameter, ...]
    here: tuple[tuple[int, ...], ...]  # parameters on which the paths to each receiver depend
    at_centre: bool  # whether responses are those at the centre frequency
    scales: Floats  # (parameters,) by which gains are divided, so that none is held less well than others
    least_level = _LEAST  # part of the loudest tangent: B-splines begin and end with next to nothing
    eased_db = _LESS_DB
    on_device = False  # nodes are not of paths alone

    @classmethod
    def among_all(
        cls, own: SceneTracks, parameters: Sequence[Parameter], until: float, at_centre: bool
    ) -> TangentTracks:
        """Return the tangents of the paths that depend on any of some parameters, in a run that ends at a time, s."""
        touched = {
            (id(family), j): parameter.touched(family)
            for family in own.paths.families for j, parameter in enumerate(parameters)
        }  # fmt: skip

        def changes(pair: PairPaths, j: int) -> bool:
            return bool(touched[id(pair.family), j][pair.rows].any())

        here = tuple(
            tuple(j for j in range(len(parameters)) if any(changes(p, j) for p in own.pair_paths if p.receiver == r))
            for r in range(len(own.scene.receivers))
        )
        mine = [i for i, pair in enumerate(own.pair_paths) if any(changes(pair, j) for j in here[pair.receiver])]
        pairs, columns = [], {f.name: getattr(own, f.name) for f in fields(SceneTracks) if f.init}
        for i in mine:
            member, count = own.pairs[i], len(here[own.pairs[i].receiver])
            pairs.append(replace(member, channels=range(count * member.channels.start, count * member.channels.stop)))
        columns |= {"pairs": tuple(pairs), "pair_paths": tuple(own.pair_paths[i] for i in mine)}
        made = cls(
            **columns, parameters=tuple(parameters), here=here, at_centre=at_centre, scales=np.ones(len(parameters))
        )
        return replace(made, scales=made.levels(until))

    @property
    def channels(self) -> tuple[tuple[str, ...], ...]:
        """Names of the receivers' channels for each parameter."""
        each = zip((r.directivity.channels for r in self.scene.receivers), self.here, strict=True)
        return tuple(tuple(f"{name} {j}" for name in names for j in here) for names, here in each)

    def rows(self, first_rows: NDArray[np.int32]) -> Iterator[tuple[int, int, int]]:
        """Yield rows of the pressure, and of each the parameter and the row of the recording."""
        numbers = ((r, c) for r in range(len(self.here)) for c in range(first_rows[r + 1] - first_rows[r]))
        each = [(j, int(first_rows[r]) + c) for r, c in numbers for j in self.here[r]]
        return ((i, j, row) for i, (j, row) in enumerate(each))

    def levels(self, until: float) -> Floats:
        """Levels (parameters,) of the tangents at the centre frequency, each of the loudest of its first pairs."""
        times, found = np.linspace(0.0, until, _SAMPLED), np.zeros(len(self.parameters))
        counted = np.zeros(len(self.parameters), dtype=int)
        for pair in self.pair_paths:
            js = [j for j in self.here[pair.receiver] if counted[j] < _SAMPLED]
            counted[js] += 1
            if js:
                emitted = self.scene.sources[pair.source].emitted.centre_frequency
                at = TangentResponse(self.scene, pair.source, np.array([emitted]))
                here = Tangents.of(pair, times, pair.arrivals(times, self.kinematics), at, self.kinematics)
                loud = [np.linalg.norm(here.by(along(self.parameters[j])), axis=1).max() for j in js]
                found[js] = np.maximum(found[js], loud)
        return np.where(found > 0.0, found, 1.0)

    def gains(
        self, pairs: Sequence[int], paths: Sequence[PairPaths], found: Arrivals, times: Floats, basis: Basis
    ) -> list[Floats]:
        """Return the gains (C, K, P, T) of tangents of paths of some pairs."""
        at = TangentResponse(self.scene, paths[0].source, basis.nodes, self.at_centre)
        return [self._gains(Tangents.of(pair, times, found, at, self.kinematics), basis) for pair in paths]

    def _gains(self, tangents: Tangents, basis: Basis) -> Floats:
        """Return the gains (C, K, P, T) by all parameters, each a channel; what they share is projected once."""
        here, own = self.here[tangents.paths.receiver], tangents.own
        out = np.zeros((len(own), len(here), len(basis), *own.shape[1:3]))
        known: dict[int, tuple[Any, Floats]] = {}  # with the responses themselves, for their identity
        for i, j in enumerate(here):
            for weight, response in tangents.terms(self.parameters[j]):
                if id(response) not in known:
                    known[id(response)] = response, np.moveaxis(basis.gains(response), -1, 1)
                out[:, i] += weight / self.scales[j] * known[id(response)][1]
        return out.reshape(-1, *out.shape[2:])


def blocks_for(plan: Plan, spread: Piecewise, in_each: int = _CUBIC) -> tuple[int, ...]:
    """Return the samples in a block of derivatives by the points of a trajectory, which bend in each of its cubics."""
    step = max(np.diff(spread.polynomial.x[1:-1]).min() * plan.sampling_rate / in_each, _BLOCKS[-1])
    return plan.blocks if plan.baseband is not None else tuple(b for b in _BLOCKS if b <= step)


@dataclass(frozen=True, slots=True, eq=False)
class FilteredTracks(SceneTracks):
    """Tracks of paths whose gains of heads are those that a render filters."""

    @classmethod
    def of(cls, own: SceneTracks) -> FilteredTracks:
        """Return the same tracks with these gains."""
        return cls(**{f.name: getattr(own, f.name) for f in fields(SceneTracks) if f.init})

    def gains(
        self, pairs: Sequence[int], paths: Sequence[PairPaths], found: Arrivals, times: Floats, basis: Basis
    ) -> list[Floats]:
        """Return the gains (C, K, P, T) of paths of some pairs."""
        at = TangentResponse(self.scene, paths[0].source, basis.nodes)
        each = (Tangents.of(pair, times, found, at, self.kinematics).own for pair in paths)
        return [np.moveaxis(basis.gains(own), -1, 1) for own in each]


def plan_of(paths: PathSet, options: RenderOptions, by_functions: bool = True) -> Plan:
    """Return the plan of a sum over paths, sample by sample and without noise at the receivers; tails stay."""
    # Heads have gains by functions of frequency, or filter the sound of each path as they do in a render.
    arriving = options.baseband is None and options.responses == "band"
    return plan_paths(_plain(paths, by_functions, arriving), replace(options, **_PER_SAMPLE))


def scene_tracks(plan: Plan) -> SceneTracks:
    """Return the tracks of a plan, which are those of a scene."""
    assert plan.tracks.of_scene is not None
    return plan.tracks.of_scene


def received(plan: Plan) -> Floats | Complexes:
    """Render a plan in the precision of its engine, (rows, samples), with the linear part of the receivers' ends."""
    pressure = PressureSum(plan)
    out = np.zeros((plan.row_count, plan.samples), dtype=float if plan.baseband is None else complex)
    for start in range(0, plan.samples, plan.chunk):
        piece = pressure(start)
        out[:, start : start + piece.shape[1]] = piece
    pressure.warn()
    return through_ends(plan, out)


def through_ends(plan: Plan, rows: Floats, transposed: bool = False) -> Floats:
    """Pass rows (rows, samples) of pressure through transducers and filters of the receivers, or by the transpose."""
    # The ends are causal and do not change over time: their transpose is the same on reversed time.
    step = -1 if transposed else 1
    for i, receiver in enumerate(plan.receivers):
        if receiver.transducer is not None or receiver.electronics is not None:
            for row in filter(lambda row: rows[row].any(), range(plan.row_count)[plan.rows_of(i)]):
                end = ReceiverEnd(receiver, plan.row_names[row], plan.sampling_rate)
                rows[row] = end(0, rows[row, ::step])[::step]
    return rows


def _plain(paths: PathSet, by_functions: bool, arriving: bool) -> PathSet:
    """Return the paths in a scene whose receivers neither add noise nor round."""
    # Heads have gains by functions of frequency instead of filters, at the frequencies that arrive or are emitted.
    quiet: dict[str, Any] = dict.fromkeys(("ambient_noise_db", "snr_db", "self_noise_db", "adc_bits", "adc_full_scale"))

    def plain(r: Receiver) -> Receiver:
        own, electronics = r.directivity, r.electronics
        channels = by_functions and isinstance(own, ChannelDirectivity) and not own.by_functions
        return varied(
            r, electronics=electronics and varied(electronics, **quiet),
            directivity=ByFunctions(own, arriving) if channels and isinstance(own, ChannelDirectivity) else own,
        )  # fmt: skip

    scene = varied(paths.scene, receivers=tuple(map(plain, paths.scene.receivers)))
    return PathSet(scene, tuple(family.in_scene(scene) for family in paths.families))


def representatives(tracks: SceneTracks, parameters: Sequence[Parameter], at_centre: bool) -> PathSet | None:
    """Return tangents of some pairs by parameters of all kinds, of which functions of frequency are designed."""
    # Of every kind of parameter and every kind of path some are drawn: what none stands for would not be held.
    kinds: dict[Any, list[tuple[PairPaths, Parameter]]] = {}
    for one in parameters:
        for family in tracks.paths.families:
            touched = one.touched(family)
            for pair in tracks.pair_paths:
                if pair.family is family and (pair.channels or range(1)).start == 0 and touched[pair.rows].any():
                    mine = pair.part(np.flatnonzero(touched[pair.rows]))
                    kinds.setdefault((pair.source, one.kind, id(family)), []).append((mine, one))
    found: list[PathFamily] = []
    chance = np.random.default_rng(SEED)
    for (source, *_), each in kinds.items():
        count = max(_MOST_PAIRS // sum(key[0] == source for key in kinds), 2)
        for i in chance.permutation(len(each))[:count].tolist():
            pair, one = each[i]
            found.append(TangentPaths.of(pair.family.part(pair.index), one, tracks.kinematics, at_centre))
    return PathSet(tracks.paths.scene, tuple(found)) if found else None
