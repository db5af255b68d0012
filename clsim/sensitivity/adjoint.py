"""The transpose of the linear map: what a small change of the received signals says about parameters and signals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.numerics.blas import with_blas_threads
from clsim.paths.family import PairPaths
from clsim.paths.response import NEPERS, covered
from clsim.render.methods.per_sample import delayed_streams
from clsim.render.opencl.batches import PathBatch
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.plan import BLOCKS, Allocation, Plan, node_times
from clsim.render.source_filters import SourceFilters
from clsim.scene.motion.curves import Piecewise
from clsim.sensitivity.displaced import Knot, TangentResponse
from clsim.sensitivity.images import Forces, Images, has_beams, in_closed_form, is_simple, turned_back
from clsim.sensitivity.linear_map import LinearMap, blocks_for, scene_tracks, through_ends
from clsim.sensitivity.parameters import Parameter
from clsim.sensitivity.tangents import Tangents, clock_change
from clsim.tracks.basis import Basis, flat_basis
from clsim.tracks.splines import audible

_BLOCK, _SHORT_BLOCK = 96, 24  # samples between the nodes of tangents; short where responses vary
_SHORT = 0.5e-3  # s, the same of envelopes, of which samples are few
_CUBIC = 36  # blocks in each cubic of a motion at least: with 24, which renders take, sums of them are wrong by 2e-6
RUN = 3072  # samples that are worked on at a time, whole blocks
_LEAST_FACTOR = 1e-6  # of a wall, by which responses are divided


def adjoint(linear: LinearMap, weights: Floats | Complexes) -> Floats:
    """Return the transpose of the map applied to weights (rows, samples): a number for each parameter."""
    # On each path, what arrives of each function of frequency is multiplied by the weights and brought to the nodes of
    # cubics, as interpolation would bring values at nodes to the samples. `Pulled` takes it on to the parameters.
    plan = linear.plan
    weights = through_ends(plan, np.array(weights), transposed=True)
    pulled = Pulled(linear)
    spreads = [parameter.shift.spread for parameter in linear.parameters if isinstance(parameter.shift, Knot)]
    fit = min((blocks_for(plan, spread, _CUBIC) for spread in spreads), default=plan.blocks)
    if plan.options.engine == "opencl" and plan.baseband is None:
        others = Allocation(frozenset(i for i in range(len(plan.tracks.pairs)) if not pulled.concerned(i)))
        shared = replace(
            plan, source_filters=linear.shared.source_filters, allocation=others, blocks=fit, builders=[]
        )  # fmt: skip
        MomentEngine(shared).taken(weights, partial(_by_moments, pulled))
        return pulled.found
    for pair, member in enumerate(plan.tracks.pairs):
        paths = scene_tracks(plan).pair_paths[pair]
        block = min(_SHORT_BLOCK if paths.family.varies or has_beams(paths) else _BLOCK, fit[0])
        if plan.baseband is not None:
            block = max(round(_SHORT * plan.sampling_rate), 2)
        filters, rows = linear.shared.source_filters[member.source], weights[plan.rows_of_pair(pair)]
        for start in range(0, plan.samples if pulled.concerned(pair) else 0, RUN):
            blocks = -(-min(RUN, plan.samples - start) // block)
            at_nodes = _at_nodes(linear, pair, filters, rows, start, block, blocks)
            if at_nodes is not None:
                pulled.add(pair, np.arange(len(member)), start, block, at_nodes)
    return pulled.found


def _by_moments(
    pulled: Pulled, pair: int, rows: NDArray[np.int64], start: int, block: int, moments: NDArray[np.float32]
) -> None:
    """Add the products of some paths, of moments (C, blocks, P, K, 4) of blocks from a sample on."""
    if not np.any(moments):
        return
    channels, blocks, paths, functions, _ = moments.shape
    at_nodes = np.zeros((channels, paths, blocks + 3, functions))
    made = (_powers() @ moments.reshape(-1, 4).T.astype(np.float64)).reshape(4, *moments.shape[:4])
    for i in range(4):
        at_nodes[:, :, i : i + blocks] += made[i].swapaxes(1, 2)
    with with_blas_threads(1):  # matrices are small
        pulled.add(pair, rows, start, block, at_nodes)


def arriving(
    plan: Plan, pair: int, filters: SourceFilters, start: int, stop: int
) -> tuple[Floats, NDArray[np.int64], Floats, Floats, Floats | Complexes | float]:
    """Return times (n,), and of each path the emitted sample, the rest of the delay, activity and phase, (P, n)."""
    times, member = np.arange(start, stop) / plan.sampling_rate, plan.tracks.pairs[pair]
    one = flat_basis(filters.signal.centre_frequency)
    delay = plan.tracks.evaluate(pair, times, one, every=len(times))[0]
    delay_samples = delay * (filters.oversampling * plan.sampling_rate) + filters.delay_samples
    whole = np.rint(delay_samples)
    emitted = filters.oversampling * np.arange(start, stop) - whole.astype(np.int64)
    weight = audible(times, member.start, member.end, plan.tracks.transition)
    return times, emitted, delay_samples - whole, weight, filters.carrier_phase(delay_samples)


def _at_nodes(
    linear: LinearMap, pair: int, filters: SourceFilters, rows: Floats | Complexes, start: int, block: int, blocks: int
) -> Floats | None:
    """Return weighted arrivals (C, P, nodes, K) of all functions, brought to the nodes of blocks; None for silence."""
    plan = linear.plan
    stop = min(start + block * blocks, plan.samples)
    _, emitted, mu, weight, phase = arriving(plan, pair, filters, start, stop)
    weighted = weight * np.conj(rows[:, None, start:stop]) * phase
    out, cubics = None, _lagrange(block)
    for p, delayed in delayed_streams(linear.shared, filters, emitted, mu, np.any(weighted, axis=(0, 2))):
        out = np.zeros((len(rows), len(emitted), blocks + 3, len(delayed))) if out is None else out
        full = np.zeros((len(rows), len(delayed), blocks * block))
        full[..., : stop - start] = (delayed * weighted[:, p, None]).real
        at_nodes = full.reshape(len(rows), -1, blocks, block) @ cubics
        for i in range(4):
            out[:, p, i : i + blocks] += at_nodes[..., i].swapaxes(1, 2)
    return out


def _lagrange(block: int) -> Floats:
    """Return the weights (block, 4) of nodes at -1, 0, 1 and 2 blocks in the cubic through them, at each sample."""
    u, places = np.arange(block) / block, (-1.0, 0.0, 1.0, 2.0)
    return np.stack([np.prod([(u - q) / (p - q) for q in places if q != p], axis=0) for p in places], axis=1)


def _powers() -> Floats:
    """Return the coefficients (4, 4) on [-1, 1] of the cubics that are 1 at one node and 0 at the others."""
    return np.asarray(np.linalg.inv(np.vander([-3.0, -1.0, 1.0, 3.0], 4, increasing=True)).T, dtype=np.float64)


Take = Callable[[int, NDArray[np.int64], int, int, NDArray[np.float32]], None]

_TOGETHER = 4  # long blocks between the nodes of tangents of images, whose directions change slowly
_FAR = 2.0**23  # samples, up to which float32 counts


class _MomentRun(Run):
    """Takes the moments of a batch of paths, in blocks as they would be rendered."""

    _engine: MomentEngine
    _divides = False

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        import pyopencl as cl

        engine, batch, plan = self._engine, self._batch, self._plan
        begin, subblock = segment * plan.segment, plan.subblock(self._source, block)
        together = engine.together(batch, block)
        blocks, filters, ramp = (end - begin) // block, plan.source_filters[self._source], batch.bounds.ramp
        out = np.empty((self._channels, -(-blocks // together), batch.count, self._functions, 4), dtype=np.float32)
        on_device = engine._scratch.take("moments", out[0].nbytes)
        bounds = [np.clip(x - (self._start + begin), -_FAR, _FAR) for x in (batch.bounds.start, batch.bounds.end)]
        constants = {"SUBBLOCK": subblock, "FUNCTIONS": self._functions, "OVERSAMPLING": filters.oversampling}
        layout = {"LANES": engine._layout.lanes, "TOGETHER": together, **self._polynomial_constants(nodes)}
        layout["GAINS"] = self._channels
        for channel in range(self._channels):
            engine._compiler.kernel("moments", constants | layout)(
                engine._queue, ((batch.count, out.shape[1]), (1, 1)), **self._branch_arguments(begin),
                **self._block_arguments(nodes, first_block), first_row=filters.rows,
                start=np.where(batch.padding, _FAR, bounds[0]).astype(np.float32), end=bounds[1].astype(np.float32),
                per_ramp=1.0 / ramp if ramp else 0.0, block_subblocks=block // subblock, blocks=blocks,
                row=np.repeat(batch.row, np.diff(batch.first_slot)) + np.int32(channel), weights=engine.weights,
                weight_stride=self._length, first_sample=begin, taken=on_device,
            )  # fmt: skip
            cl.enqueue_copy(engine._queue, out[channel], on_device)
        for i, pair in enumerate(batch.pairs):
            mine = np.flatnonzero(~batch.padding[batch.of_pair(i)]) + batch.of_pair(i).start
            engine.take(pair, batch.path[mine], self._start + begin, together * block, out[:, :, mine])


class MomentEngine(OpenclEngine):
    """Multiplies what arrives by weights of the received samples, instead of adding it up."""

    run = _MomentRun
    take: Take
    weights: Any  # on the device, of a chunk

    def taken(self, weights: Floats, take: Take) -> None:
        """Pass the moments of all paths on, piece by piece, of weights (rows, samples)."""
        self.take, self.skips_silence = take, False
        for start in range(0, weights.shape[1], self._plan.chunk):
            self.add(weights[:, start : start + self._plan.chunk], start)

    def maker(self, pair: int) -> Any:
        """Return the maker of the nodes of a pair, with one gain in place of those of all functions."""
        plan = self._plan
        one = (replace(f, basis=flat_basis(f.signal.centre_frequency)) for f in plan.source_filters)
        self._plan = replace(plan, source_filters=tuple(one), builders=[])
        try:
            return super().maker(pair)
        finally:
            self._plan = plan

    def together(self, batch: PathBatch, block: int) -> int:
        """Return the number of blocks of a length whose moments are added up, where responses change slowly."""
        tracks = self._plan.tracks.of_scene
        assert tracks is not None
        paths = tracks.pair_paths[batch.pairs[0]]
        slow = block == BLOCKS[0] == self._plan.blocks[0] and not paths.family.costly and not has_beams(paths)
        return _TOGETHER if slow else 1

    def put(self, rows: NDArray[np.float32], pressure: NDArray[Any]) -> None:
        """Leave the weights as they are."""

    def _add(self, pressure: NDArray[Any], start: int) -> None:
        length = self.branch_signals.whole_blocks(start, start + pressure.shape[1])
        padded = np.zeros((len(pressure), length), dtype=np.float32)
        padded[:, : pressure.shape[1]] = pressure
        self.weights = self._upload(padded)
        super()._add(pressure, start)


class Pulled:
    """Derivatives of a loss by parameters, from products of weights with what arrives at nodes of paths."""

    # Of images the products are brought to the places and velocities of both ends first. What each parameter does to
    # these takes next to nothing, so that the costs hardly depend on their number. Others are multiplied by the
    # tangents by places and velocities of both ends, the air, and the walls and things that a path meets.
    def __init__(self, linear: LinearMap) -> None:
        self._linear, self.found = linear, np.zeros(len(linear.parameters))
        self._tracks = scene_tracks(linear.plan)
        self._families: dict[int, list[tuple[int, NDArray[np.bool_]]]] = {}
        for family in self._tracks.paths.families:
            touched = ((j, parameter.touched(family)) for j, parameter in enumerate(linear.parameters))
            self._families[id(family)] = [(j, mine) for j, mine in touched if mine.any()]

    def concerned(self, pair: int) -> bool:
        """Test if any parameter changes a pair."""
        return any(True for _ in self._parameters(self._tracks.pair_paths[pair]))

    def add(self, pair: int, rows: NDArray[np.int64], start: int, block: int, at_nodes: Floats) -> None:
        """Add the products of some paths, of arrivals (C, P, nodes, K) at the nodes of blocks from a sample on."""
        paths, plan = self._tracks.pair_paths[pair].part(rows), self._linear.plan
        basis = self._linear.shared.source_filters[paths.source].basis
        times = node_times(start, block, at_nodes.shape[2] - 3, plan.sampling_rate)
        now = times + self._tracks.scene.receivers[paths.receiver].clock_error(times)
        at = TangentResponse(self._tracks.scene, paths.source, basis.nodes, plan.options.responses == "centre")
        found = paths.arrivals(now, self._tracks.kinematics)
        tangents = Tangents.of(paths, now, found, at, self._tracks.kinematics)
        weights, here = _at_frequencies(basis, at_nodes), list(self._parameters(paths))
        if in_closed_form(paths.family) and paths.reach == 0.0:
            images = Images.of(paths, now, found, self._tracks.kinematics)
            of_images = _OfImages(images, images.forces(tangents.own, weights, at), weights, at)
            for js in self._together(j for j in here if self._linear.parameters[j].acts != "scene"):
                self.found[js] += of_images.by([self._linear.parameters[j] for j in js])
            here = [j for j in here if self._linear.parameters[j].acts == "scene"]
        of_tangents = _OfTangents(tangents, weights)
        for js in self._together(here):
            self.found[js] += of_tangents.by([self._linear.parameters[j] for j in js])

    def _together(self, here: Iterable[int]) -> list[list[int]]:
        """List the numbers of parameters: those of the trajectory of an end together, others alone."""
        groups: dict[Any, list[int]] = {}
        for j in here:
            own = self._linear.parameters[j]
            groups.setdefault((own.source, own.receiver) if is_of_points(own) else j, []).append(j)
        return list(groups.values())

    def _parameters(self, paths: PairPaths) -> Iterator[int]:
        """Yield the numbers of parameters that change some paths."""
        return (j for j, mine in self._families[id(paths.family)] if mine[paths.rows].any())


def _at_frequencies(basis: Basis, at_nodes: Floats) -> Complexes:
    """Return weights (C, P, nodes, F) of responses of which arrivals (C, P, nodes, K) take the gains."""
    count, each = len(basis.nodes), at_nodes.reshape(-1, len(basis))
    weights = np.empty((*at_nodes.shape[:3], count), dtype=np.complex128)
    weights.real = (each @ basis.projection[:, :count]).reshape(weights.shape)
    weights.imag = (each @ basis.projection[:, count:]).reshape(weights.shape) if basis.parts == 2 else 0.0
    return weights


def is_of_points(parameter: Parameter) -> bool:
    """Test if a parameter is a coordinate of a point of an end's trajectory."""
    return parameter.acts == "shift" and isinstance(parameter.shift, Knot)


class _OfTangents:
    """Products of weights with the tangents of any paths."""

    def __init__(self, tangents: Tangents, weights: Complexes) -> None:
        self._tangents, self._weights = tangents, weights

    def by(self, parameters: list[Parameter]) -> Any:
        """Return the derivatives by a parameter, or by the points of a trajectory."""
        (parameter, *_), tangents, shift = parameters, self._tangents, parameters[0].shift
        if not is_of_points(parameter) or not isinstance(shift, Knot):
            return np.sum([np.sum(weight * self._product(each)) for weight, each in tangents.terms(parameter)])
        when, moving = tangents.times, parameter.source is not None
        when = (tangents.found.emission_time if moving else np.broadcast_to(when, tangents.own.shape[1:3])).ravel()
        places, velocities = np.zeros((2, len(when), 3))
        for axis, p in {p.shift.axis: p for p in parameters if isinstance(p.shift, Knot)}.items():
            places[:, axis] = self._product(tangents.of_place(p)).ravel()
            if moving:
                velocities[:, axis] = self._product(tangents.of_velocity(p)).ravel()
        return _at_knots(shift.spread, when, places, velocities, parameters)

    def _product(self, responses: Any) -> Floats:
        """Return the real part (P, T) of weights times responses (C, P, T, F)."""
        return np.asarray(np.einsum("cptf,cptf->pt", np.conj(self._weights), responses).real)


class _OfImages:
    """Products of the forces on some images with what parameters do."""

    def __init__(self, images: Images, forces: Forces, weights: Complexes, at: TangentResponse) -> None:
        self._images, self._forces, self._weights, self._at = images, forces, weights, at
        self._apart, self._product = forces.apart.sum(axis=1), forces.product.sum(axis=(0, 2))  # (P, 3) and (P, F)

    def by(self, parameters: list[Parameter]) -> Any:
        """Return the derivatives by a parameter, or by the points of a trajectory."""
        (parameter, *_), forces = parameters, self._forces
        acts = parameter.acts
        if acts in ("gain", "start"):
            return NEPERS * parameter.gain_db * forces.level.sum() if acts == "gain" else forces.delay.sum()
        if acts == "shift":
            return self._by_places(parameters)
        if acts == "clock":
            return np.sum(forces.later * clock_change(parameter, self._images.family.scene, self._images.times))
        if acts == "wall":
            return self._by_wall(parameter)
        return self._by_reflection(parameter) if acts == "reflection" else self._by_scene(parameter)

    def _by_places(self, parameters: list[Parameter]) -> Any:
        """Return the derivatives by displacements of an end."""
        images, forces, shift = self._images, self._forces, parameters[0].shift
        assert shift is not None
        if parameters[0].receiver is not None:
            own = np.einsum("pij,ptj->ti", images.matrix, forces.apart)
            if isinstance(shift, Knot):
                return _at_knots(shift.spread, images.times, own, np.zeros_like(own), parameters)
            return np.sum(own * shift.position(images.times))
        if not isinstance(shift, Knot):
            return -self._apart.sum(axis=0) @ shift.position(np.zeros(()))
        when = images.found.emission_time.ravel()
        return _at_knots(shift.spread, when, -forces.apart.reshape(-1, 3), forces.velocity.reshape(-1, 3), parameters)

    def _by_wall(self, parameter: Parameter) -> float:
        """Return the derivative by the displacement of a wall, by which the offsets of images change."""
        images = self._images
        part: Any = images.family.part(images.rows)
        moved = part.in_scene(parameter.moved(part.scene, 1.0))  # offsets are linear in walls
        offset = moved.legs[0].offset - part.legs[0].offset
        return -float(np.sum(self._apart * turned_back(images.matrix, offset[:, None])[:, 0]))

    def _by_reflection(self, parameter: Parameter) -> float:
        """Return the derivative by the factor of a wall, which responses have once for each reflection."""
        images, family = self._images, self._images.family
        material = family.scene.room.faces.materials[parameter.wall or 0]
        covering = covered(self._at.frequencies, material)
        factor = material.reflection_at(covering, 1.0, family.scene.air.speed_of_sound)
        if material.depends_on_angle or np.min(np.abs(factor)) < _LEAST_FACTOR or family.scene.panels:
            return self._by_scene(parameter)
        met = np.sum(family.walls[images.rows] == parameter.wall, axis=1)
        return float(np.sum((met.astype(np.complex128) @ self._product / factor).real))

    def _by_scene(self, parameter: Parameter) -> float:
        """Return the derivative by what changes responses and the speed of sound."""
        images, family = self._images, self._images.family
        source = int(family.source[images.rows][0])
        scenes = [parameter.moved(family.scene, sign * parameter.step) for sign in (1.0, -1.0)]
        ats = [self._at.in_scene(scene) for scene in scenes]
        walls = np.arange(len(self._at.angular) - 1)[:, None]
        if is_simple(family, images.rows, self._at) and np.array_equal(
            ats[0].reflection(walls), ats[1].reflection(walls)
        ):
            beyond = np.einsum("pt,cptf->f", images.found.through - 1.0, self._forces.product.real)
            changed = float(beyond @ (ats[1].nepers - ats[0].nepers))
        else:
            moved = zip((replace(images.paths, family=family.in_scene(scene)) for scene in scenes), ats, strict=True)
            each = [paths.responses(images.found, images.times, at) for paths, at in moved]
            changed = float(np.sum((np.conj(self._weights) * (each[0] - each[1])).real))
        frequency = family.scene.sources[source].emitted.centre_frequency
        speeds = [scene.air.speed_at(frequency) for scene in scenes]
        return (changed + float(self._forces.speed.sum()) * (speeds[0] - speeds[1])) / (2.0 * parameter.step)


def _at_knots(
    spread: Piecewise, times: Floats, places: Floats, velocities: Floats, parameters: list[Parameter]
) -> Floats:
    """Return products with the points of a motion, of products with places and velocities (n, 3) at times (n,)."""
    # Each cubic of the motion takes sums with the powers of the time on it, whatever the number of points.
    knots, powers = spread.polynomial.x, spread.polynomial.c[::-1]  # (4, pieces, points)
    inside = (times >= knots[0]) & (times <= knots[-1])
    when = np.clip(times, knots[0], knots[-1])
    piece = np.clip(np.searchsorted(knots, when, "right") - 1, 0, len(knots) - 2)
    late, found = when - knots[piece], np.zeros((powers.shape[2], 3))
    for axis in {p.shift.axis for p in parameters if isinstance(p.shift, Knot)}:
        for m in range(len(powers)):
            values = places[:, axis] * late**m
            if m:
                values = values + m * inside * velocities[:, axis] * late ** (m - 1)
            found[:, axis] += np.bincount(piece, values, len(knots) - 1) @ powers[m]
    return np.array([found[p.shift.number, p.shift.axis] for p in parameters if isinstance(p.shift, Knot)])
