"""The transpose of the linear map: what a small change of the received signals says about parameters and signals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.numerics.blas import with_blas_threads
from clsim.render.methods.per_sample import delayed_streams
from clsim.render.opencl.batches import PathBatch
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.plan import BLOCKS, Allocation, Plan
from clsim.render.source_filters import SourceFilters
from clsim.sensitivity.displaced import Knot
from clsim.sensitivity.images import has_beams
from clsim.sensitivity.linear_map import FilteredTracks, LinearMap, blocks_for, scene_tracks, through_ends
from clsim.sensitivity.pulled import Pulled
from clsim.tracks.basis import flat_basis
from clsim.tracks.splines import audible

_BLOCK, _SHORT_BLOCK = 96, 24  # samples between the nodes of tangents; short where responses vary
_SHORT = 0.5e-3  # s, the same of envelopes, of which samples are few
_CUBIC = 36  # blocks in each cubic of a motion at least: with 24, which renders take, sums of them are wrong by 2e-6
_RUN = 3072  # samples that are worked on at a time, whole blocks


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
        for start in range(0, plan.samples if pulled.concerned(pair) else 0, _RUN):
            blocks = -(-min(_RUN, plan.samples - start) // block)
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


def adjoint_signal(plan: Plan, source: int, weights: Floats) -> Floats:
    """Return the transpose of a render as a function of what a source emits, at the sampling rate of the recording."""
    weights = through_ends(plan, np.array(weights, dtype=np.float64), transposed=True)
    filters, tracks = plan.source_filters[source], FilteredTracks.of(scene_tracks(plan))
    samples, half = filters.oversampling * filters.signal.count, filters.filter_half
    streams = np.zeros((len(filters.basis), samples + 2 * half))  # from sample -half on
    for i, pair in enumerate(plan.tracks.pairs):
        for start in range(0, plan.samples if pair.source == source else 0, _RUN):
            times, emitted, mu, weight, _ = _arriving(plan, i, filters, start, min(start + _RUN, plan.samples))
            rows = weights[plan.rows_of_pair(i), None, None, start : start + len(times)]
            taken = np.sum(tracks.evaluate(i, times, filters.basis)[2] * weight * rows, axis=0)
            for p in np.flatnonzero(weight.any(axis=1)).tolist():
                _scatter(plan, filters, emitted[p], mu[p], taken[:, p], streams)
    each = [np.convolve(stream, taps[::-1], "valid") for stream, taps in zip(streams, filters.filters, strict=True)]
    return np.asarray(np.sum(each, axis=0)[:: filters.oversampling])


def _scatter(
    plan: Plan, filters: SourceFilters, emitted: NDArray[np.int64], mu: Floats, taken: Floats, streams: Floats
) -> None:
    """Add values (K, n) to streams (K, m) where taps would read them."""
    taps = plan.options.interpolator.taps(filters.bank, mu)
    places = emitted[:, None] + filters.bank.centre - np.arange(taps.shape[1]) + filters.filter_half
    inside = (places >= 0) & (places < streams.shape[1])
    for stream, values in zip(streams, taken, strict=True):
        spread = (taps * values[:, None])[inside]
        stream += np.bincount(places[inside], weights=spread, minlength=len(stream))


def _arriving(
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
    _, emitted, mu, weight, phase = _arriving(plan, pair, filters, start, stop)
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


class MomentEngine(OpenclEngine):
    """Multiplies what arrives by weights of the received samples, instead of adding it up."""

    take: Take
    weights: Any  # on the device, of a chunk

    @property
    def run(self) -> type[Run]:
        """Class that takes a batch of paths."""
        return _MomentRun

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
