"""The transpose of the linear map: what a small change of the received signals says about parameters and signals."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.response import SceneResponse
from clsim.render.methods.per_sample import delayed_streams
from clsim.render.plan import Allocation, node_times
from clsim.sensitivity.linear_map import scene_tracks, through_ends
from clsim.sensitivity.moments import MomentEngine
from clsim.sensitivity.parameters import displacements
from clsim.tracks.basis import flat_basis
from clsim.tracks.splines import heard

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.render.plan import Plan
    from clsim.render.source_filters import SourceFilters
    from clsim.sensitivity.linear_map import LinearMap
    from clsim.tracks.basis import Basis
    from clsim.tracks.tracks import SceneTracks

_BLOCK, _SHORT_BLOCK = 96, 24  # samples between the nodes of tangents; short where responses vary
_Key = tuple[int, int, int]  # kind of path, source and receiver
_EVERY = 4  # long blocks between the nodes of tangents of images, whose directions change slowly
_RUN = 3072  # samples that are worked on at a time, whole blocks


def adjoint(linear: LinearMap, weights: Floats) -> Floats:
    """Return the transpose of the map applied to weights (rows, samples): a number for each parameter.

    On each path, what arrives of each function of frequency is multiplied by the weights and brought to the nodes of
    cubics, as interpolation would bring values at nodes to the samples. What is left for each parameter is a product
    with its tangents at the nodes.
    """
    plan = linear.plan
    weights = through_ends(plan, np.array(weights, dtype=np.float64), transposed=True)
    product = _Product(linear)
    if plan.options.engine == "opencl":
        others = Allocation(frozenset(i for i in range(len(plan.tracks.pairs)) if not product.concerned(i)))
        shared = replace(plan, source_filters=linear.shared.source_filters, allocation=others, builders=[])
        MomentEngine(shared).taken(weights, product.by_moments)
        return product.found
    for pair, member in enumerate(plan.tracks.pairs):
        block = _SHORT_BLOCK if scene_tracks(plan).pair_paths[pair].family.varies else _BLOCK
        filters, row = linear.shared.source_filters[member.source], weights[plan.rows_of_pair(pair).start]
        for start in range(0, plan.samples if product.concerned(pair) else 0, _RUN):
            blocks = -(-min(_RUN, plan.samples - start) // block)
            at_nodes = _at_nodes(linear, pair, filters, row, start, block, blocks)
            if at_nodes is not None:
                product.add(pair, np.arange(len(member)), start, block, at_nodes)
    return product.found


class _Product:
    """Products of arrivals at nodes with the tangents by all parameters, added up.

    Trajectories are moved by all of their points together: the products with the displacements and velocities of an
    end are taken first, and only then brought to its points.
    """

    def __init__(self, linear: LinearMap) -> None:
        self._linear, self.found = linear, np.zeros(len(linear.tangents))
        self._keys = list(_pairs(scene_tracks(linear.plan)))
        knots: dict[Any, list[int]] = {}
        for j, parameter in enumerate(linear.parameters):
            if parameter.knot is not None:
                knots.setdefault((parameter.source, parameter.receiver), []).append(j)
        self._ends = [_MovedEnd(linear, np.array(mine)) for mine in knots.values()]
        of_ends = {j for mine in knots.values() for j in mine}
        self._tables = {j: _pairs(t) for j, t in enumerate(linear.tangents) if j not in of_ends}

    def concerned(self, pair: int) -> bool:
        """Test if any parameter changes a pair."""
        tables = [*self._tables.values(), *(table for end in self._ends for table in end.tables)]
        return any(self._keys[pair] in table for table in tables)

    def add(self, pair: int, rows: NDArray[np.int64], start: int, block: int, at_nodes: Floats) -> None:
        """Add the products of some paths, of arrivals (K, P, nodes) at the nodes of blocks from a sample on."""
        plan, key = self._linear.plan, self._keys[pair]
        smooth = block == plan.blocks[0] and not scene_tracks(plan).pair_paths[pair].family.costly
        if smooth:
            at_nodes, block = at_nodes @ _sparser(at_nodes.shape[2]), _EVERY * block
        times = node_times(start, block, at_nodes.shape[2] - 3, plan.sampling_rate)
        basis = self._linear.shared.source_filters[key[1]].basis
        for j, table in self._tables.items():
            if key in table:
                gains = self._linear.tangents[j].evaluate(table[key], times, basis, rows)[2][0]
                self.found[j] += float(np.sum(gains * at_nodes))
        for end in self._ends:
            if key in end.tables[0]:
                self.found[end.parameters] += end.product(key, times, basis, rows, at_nodes)

    def by_moments(self, pair: int, rows: NDArray[np.int64], start: int, block: int, moments: Floats) -> None:
        """Add the products of some paths, of moments (blocks, P, K, 4) of blocks from a sample on."""
        if not np.any(moments):
            return
        blocks, paths, functions, _ = moments.shape
        at_nodes = np.zeros((functions, paths, blocks + 3))
        for i, powers in enumerate(_powers()):
            at_nodes[:, :, i : i + blocks] += (moments @ powers).transpose(2, 1, 0)
        self.add(pair, rows, start, block, at_nodes)


class _MovedEnd:
    """The points of one end's trajectory, by which parameters (n,) it is moved."""

    def __init__(self, linear: LinearMap, parameters: NDArray[np.int64]) -> None:
        from scipy.interpolate import PPoly

        self.parameters, own = parameters, [linear.parameters[j] for j in parameters]
        self._end, self._tracks = own[0], [linear.tracks_of(each) for each in displacements(own[0])]
        self.tables = [_pairs(tracks) for tracks in self._tracks]
        curves: list[Any] = [each.knot.polynomial for each in own[::3] if each.knot]  # each axis moves alike
        self._spread = PPoly(np.stack([c.c[:, :, 0] for c in curves], axis=2), curves[0].x)

    def product(self, key: _Key, times: Floats, basis: Basis, rows: NDArray[np.int64], at_nodes: Floats) -> Floats:
        """Return the products of arrivals (K, P, nodes) of some paths with the tangents by all parameters (n,)."""
        each = [t.pair_paths[table[key]].part(rows) for t, table in zip(self._tracks, self.tables, strict=True)]
        tangents: list[Any] = [paths.family for paths in each]
        scene, here, base, kinematics = self._tracks[0].scene, each[0].rows, tangents[0].base, tangents[0].kinematics
        now = times + scene.receivers[key[2]].clock_error(times)
        found, at = base.arrivals(here, now, kinematics), SceneResponse(scene, key[1], basis.nodes)
        own = base.response(here, found, now, at)
        simple = base.is_specular and scene.air.wind is None and not (scene.air.layers or scene.air.dispersion)
        forces = [_force(basis, t.beside(here, own, now, at), at_nodes) for t in tangents[: 3 if simple else None]]
        when = now if self._end.source is None else found.emission_time
        inside = np.clip(when, self._spread.x[0], self._spread.x[-1])
        moved = np.einsum("ptn,apt->na", self._spread(np.broadcast_to(inside, at_nodes.shape[1:])), forces[:3])
        if self._end.source is not None:
            if simple:  # of the source's velocity there is but its Mach factor, (1 - M) to a power
                power = kinematics.exponent * kinematics.retarded
                factor = power * found.frequency_ratio / base.medium(key[1]).speed_of_sound
                forces += list(_force(basis, own, at_nodes) * factor * np.moveaxis(found.departure, 2, 0))
            velocity = np.where((inside == when)[..., None], self._spread(inside, 1), 0.0)
            moved += np.einsum("ptn,apt->na", velocity, forces[3:])
        return np.asarray(moved.ravel())


def _force(basis: Basis, response: Floats | Complexes, at_nodes: Floats) -> Floats:
    """Return products (P, nodes) of responses (P, nodes, F) with arrivals (K, P, nodes)."""
    return np.asarray(np.einsum("ptk,kpt->pt", basis.gains(response), at_nodes))


def adjoint_signal(plan: Plan, source: int, weights: Floats) -> Floats:
    """Return the transpose of a render as a function of what a source emits, at the sampling rate of the recording."""
    weights = through_ends(plan, np.array(weights, dtype=np.float64), transposed=True)
    filters = plan.source_filters[source]
    samples, half = filters.oversampling * filters.signal.count, filters.filter_half
    streams = np.zeros((len(filters.basis), samples + 2 * half))  # from sample -half on
    for i, pair in enumerate(plan.tracks.pairs):
        for start in range(0, plan.samples if pair.source == source else 0, _RUN):
            times, emitted, mu, weight = _arriving(plan, i, filters, start, min(start + _RUN, plan.samples))
            gains = plan.tracks.evaluate(i, times, filters.basis)[2][0]
            taken = gains * weight * weights[plan.rows_of_pair(i).start, start : start + len(times)]
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


def _pairs(tracks: SceneTracks) -> dict[_Key, int]:
    """Index pairs by kind of path, source and receiver."""
    kinds = {id(family): i for i, family in enumerate(tracks.paths.families)}
    return {(kinds[id(p.family)], p.source, p.receiver): i for i, p in enumerate(tracks.pair_paths)}


def _arriving(
    plan: Plan, pair: int, filters: SourceFilters, start: int, stop: int
) -> tuple[Floats, NDArray[np.int64], Floats, Floats]:
    """Return times (n,), and of each path the emitted sample, the rest of the delay, and the activity, (P, n)."""
    times, member = np.arange(start, stop) / plan.sampling_rate, plan.tracks.pairs[pair]
    one = flat_basis(filters.signal.centre_frequency)
    delay = plan.tracks.evaluate(pair, times, one, every=len(times))[0]
    delay_samples = delay * (filters.oversampling * plan.sampling_rate) + filters.delay_samples
    whole = np.rint(delay_samples)
    emitted = filters.oversampling * np.arange(start, stop) - whole.astype(np.int64)
    return times, emitted, delay_samples - whole, heard(times, member.start, member.end, plan.tracks.transition)


def _at_nodes(
    linear: LinearMap, pair: int, filters: SourceFilters, row: Floats, start: int, block: int, blocks: int
) -> Floats | None:
    """Return weighted arrivals (K, P, nodes) of all functions, brought to the nodes of blocks; None for silence."""
    plan = linear.plan
    stop = min(start + block * blocks, plan.samples)
    _, emitted, mu, weight = _arriving(plan, pair, filters, start, stop)
    weight = weight * row[start:stop]
    out, cubics = None, _lagrange(block)
    for p, delayed in delayed_streams(linear.shared, filters, emitted, mu, np.any(weight, axis=1)):
        out = np.zeros((len(delayed), len(emitted), blocks + 3)) if out is None else out
        full = np.zeros((len(delayed), blocks * block))
        full[:, : stop - start] = delayed * weight[p]
        for i, moved in enumerate(np.moveaxis(full.reshape(-1, blocks, block) @ cubics, 2, 0)):
            out[:, p, i : i + blocks] += moved
    return out


def _lagrange(block: int) -> Floats:
    """Return the weights (block, 4) of nodes at -1, 0, 1 and 2 blocks in the cubic through them, at each sample."""
    u, places = np.arange(block) / block, (-1.0, 0.0, 1.0, 2.0)
    return np.stack([np.prod([(u - q) / (p - q) for q in places if q != p], axis=0) for p in places], axis=1)


def _powers() -> Floats:
    """Return the coefficients (4, 4) on [-1, 1] of the cubics that are 1 at one node and 0 at the others."""
    return np.asarray(np.linalg.inv(np.vander([-3.0, -1.0, 1.0, 3.0], 4, increasing=True)).T, dtype=np.float64)


def _sparser(count: int) -> Floats:
    """Return the matrix (count, fewer) that brings nodes of blocks to nodes of blocks `_EVERY` times as long."""
    place = (np.arange(count) - 1.0) / _EVERY
    block = np.clip(np.floor(place), 0.0, None)
    made = np.zeros((count, int(block[-1]) + 4))
    powers = (2.0 * (place - block) - 1.0)[:, None] ** np.arange(4)
    made[np.arange(count)[:, None], block.astype(np.int64)[:, None] + np.arange(4)] = powers @ _powers().T
    return made
