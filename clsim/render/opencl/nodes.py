"""Nodes of paths made on the device, in float64, whatever their leg and vertex, and block polynomials from them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.opencl.launch import Compiler, Scratch, upload, work
from clsim.paths.cubics import CUBIC_COLUMNS, knot_rate, motion_knots
from clsim.render.opencl.batches import CELL, Activity, Boundaries, PathBatch
from clsim.render.opencl.block_polynomials import GAIN_ERROR, SMOOTH_ERROR, SMOOTH_SHARE
from clsim.render.opencl.environment import OMNI, RECEIVER_NODE, SPHERICAL, TABLES, VECTOR, Environment, receiver_at
from clsim.render.opencl.node_constants import OF_DELAYS, OF_GAINS
from clsim.render.opencl.path_columns import COLUMNS, Rendered
from clsim.render.plan import Plan, node_times
from clsim.tracks.tracks import SceneTracks

_STRETCH = 24  # blocks whose gains are interpolated from nodes of them all, see smooth.h
_MOST_TURN = 0.1  # rad that ends may turn in a block: beams that turn faster are looked at in every block


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Block polynomials of a run on the device, and the errors, levels and delays of their paths."""

    delay: Any
    polynomials: Any
    activity: Any  # subblocks of each block and path in which something sounds; None if all are looked at
    squares: Floats  # (3, segments, slots): of errors, of levels, and of residuals of all functions of frequency
    shortest: float  # s
    longest: float


@dataclass(frozen=True, slots=True, eq=False)
class DeviceChunk:
    """Data of one source and a batch of receivers over a chunk, on the device."""

    source: int
    batch: PathBatch
    start: int  # sample
    paths: dict[str, Any]  # arguments of every program of nodes
    exact: dict[str, Any]  # those of programs in float64 alone
    bounds: Boundaries
    cells: dict[str, Any] | None
    first: int  # sample of the branches
    turn: float  # at which the source's beam turns at most, rad/s


class NodeMaker:
    """Makes block polynomials of the paths of one family with ``tracks.cl``."""

    most_counted: ClassVar[float] = math.inf  # samples of a chunk; of more, silence is not left out

    def __init__(
        self, plan: Plan, tracks: SceneTracks, family: Any, queue: Any, compiler: Compiler, together: int
    ) -> None:
        self._plan, self._tracks, self._queue, self._compiler = plan, tracks, queue, compiler
        self._family = family
        self._together = together  # nodes of a path that are solved side by side
        self._scratch, self._upload = Scratch(queue.context), partial(upload, queue.context)
        scene = tracks.paths.scene
        wind = np.zeros(3) if scene.air.wind is None else np.array(scene.air.wind)
        media = (family.medium(source) for source in range(len(scene.sources)))
        self._media = [{"speed_of_sound": medium.speed_of_sound, "wind": wind} for medium in media]
        self._knot_rates = []
        for source, filters in zip(scene.sources, plan.source_filters, strict=True):
            # A position wrong by this much is wrong in phase by half the asked error at the band's end.
            allowed, turns = 10 ** (plan.motion_error_db / 20), 2.0 * math.pi * filters.swiftness
            end = min(filters.signal.duration + source.start, plan.duration)
            self._knot_rates.append(knot_rate(source, end, allowed * scene.air.speed_of_sound / turns))
        self._environments = [
            Environment(scene, i, self._mach(i), filters.basis, self._upload)
            for i, filters in enumerate(plan.source_filters)
        ]
        self._static = {
            i: receiver_at(r, np.zeros(1))
            for i, r in enumerate(scene.receivers)
            if math.isinf(r.trajectory.end) and r.electronics is None
        }
        rendered = Rendered(plan, tracks, family, self._environments, together, self._upload)
        self._columns = COLUMNS[family.device](rendered)
        self._max_rates = [tracks.max_rate(i) for i in range(tracks.source_count)]
        self._all_static = len(self._static) == len(scene.receivers)
        for i, env in enumerate(self._environments):
            mine = [pair for pair in tracks.pair_paths if pair.family is family and pair.source == i]
            env.most_bounces(self._columns.met(pair.rows) for pair in mine)

    def prepare(
        self, source: int, batch: PathBatch, bounds: Boundaries, start: int, length: int, activity: Activity | None,
        first: int,
    ) -> DeviceChunk:  # fmt: skip
        """Upload paths for a stretch of samples; `first` is that of branch signals, whose `activity` skips silence."""
        plan, scene = self._plan, self._tracks.paths.scene
        env, pairs = self._environments[source], self._tracks.pair_paths
        rows = np.concatenate([pairs[g].index[batch.path[batch.of_pair(i)]] for i, g in enumerate(batch.pairs)])
        reflection = self._columns.reflection(source, rows)
        reflection = np.where(batch.padding[:, None, None], 0.0, reflection).astype(np.float32)
        receiver_of = np.repeat(np.arange(len(batch.pairs), dtype=np.int32), np.diff(batch.first_slot))
        rate = plan.sampling_rate
        longest, shortest = batch.longest, min(0.0, batch.shortest)  # below 0 s by a receiver's own clock
        spare = 0.05 + plan.segment / rate  # for nodes and coarse delays beside the run
        knots, knot_first = motion_knots(
            scene.sources[source], start / rate - longest - 0.01 * abs(longest) - spare,
            (start + length) / rate - shortest + spare,
            self._knot_rates[source], sideways=env.source_kind == SPHERICAL,
        )  # fmt: skip
        paths = self._views(source, rows) | self._uploaded(receiver_of=receiver_of) | self._trajectory(knots)
        paths |= {"knot_count": len(knots), "first_knot": knot_first, "knot_rate": self._knot_rates[source]}
        exact = self._columns.poses(start / rate - longest - spare, (start + length) / rate - shortest + spare)
        exact |= self._coarse_delays(source, batch, paths | exact, start, -(-length // plan.segment) + 3)
        wall_of, normal = self._columns.bounces(source, rows)
        paths |= self._uploaded(reflection=reflection, wall_of=wall_of, normal=normal)
        cells = None
        if activity is not None and start + length - first < self.most_counted:
            cells = self._uploaded(active_cells=np.stack([activity.following, activity.preceding]))
            cells["cells"] = len(activity.cells)
        turn = 0.0
        if env.source_kind != OMNI:
            turn = self._knot_rates[source] * _largest_turn(knots[:, CUBIC_COLUMNS : CUBIC_COLUMNS + 3])
        exact |= self._columns.field(source, rows)
        return DeviceChunk(source, batch, start, paths, exact, bounds, cells, first, turn)

    def _views(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        """Images of paths (slots,) and what their leg and vertex add, as the program takes them."""
        return self._columns.views(source, rows)

    def _trajectory(self, knots: Floats) -> dict[str, Any]:
        return self._uploaded(knots=knots)

    def _coarse_delays(
        self, source: int, batch: PathBatch, paths: dict[str, Any], start: int, ends: int
    ) -> dict[str, Any]:
        """Solve the delays at the ends of segments, from which those between are predicted, and what goes with them."""
        import pyopencl as cl

        rate, segment = self._plan.sampling_rate, self._plan.segment
        groups = -(-ends // self._together)
        ends = groups * self._together
        numbers = {"coarse_delays": 2, "coarse_states": self._columns.state_numbers}
        out = {
            name: cl.Buffer(self._queue.context, cl.mem_flags.READ_WRITE, 8 * count * ends * batch.count)
            if count else None
            for name, count in numbers.items()
        }  # fmt: skip
        times = (start + segment * np.arange(-1.0, ends - 1)) / rate
        constants = {"RECEIVER_DIRECTIVITY": OMNI, "OMNI": OMNI, "SPHERICAL": SPHERICAL}  # no beams: delays only
        constants["CUBIC_COLUMNS"] = CUBIC_COLUMNS
        constants |= self._motion_constants(source) | self._exact_constants(source)
        del constants["SMOOTH_ERROR"]
        kernel = self._compiler.kernel("coarse_delays", constants)
        kernel(
            self._queue, work(batch.count, groups), **paths, receivers=self._receivers_at(batch, times), ends=ends,
            start=start / rate, segment_time=segment / rate, **self._media[source],
            delays=out["coarse_delays"], states=out["coarse_states"],
        )  # fmt: skip
        return out

    def nodes(
        self, chunk: DeviceChunk, start: int, block: int, blocks: int, meanwhile: Callable[[], None] | None = None
    ) -> Nodes:
        """Make the polynomials of `blocks` blocks from a sample on; something else can be done meanwhile."""
        import pyopencl as cl

        plan, batch, rate = self._plan, chunk.batch, self._plan.sampling_rate
        filters = plan.source_filters[chunk.source]
        segments, channels = -(-blocks * block // plan.segment), self._channels(batch)
        terms = plan.delay_terms + 4 * len(filters.basis) * channels
        # Sums of envelopes round the delays of all paths of a batch, also of those that only fill it up.
        zeros, size = plan.delay_terms == 8, 4 * (terms * blocks * batch.count + VECTOR)
        delay = self._scratch.take(("delay", block), 4 * blocks * batch.count, zeros=zeros)
        polynomials = self._scratch.take(("polynomials", block), size, zeros=zeros)
        found = np.empty((segments, batch.count, 4), dtype=np.float32)
        residual = np.empty((segments, batch.count), dtype=np.float32)
        there = [self._scratch.take(name, to.nbytes) for name, to in (("found", found), ("residual", residual))]
        count = segments * (plan.segment // block) + -(plan.segment // block) % _STRETCH + 4
        receivers = self._receivers_at(batch, node_times(start, block, count, rate))
        active_from, active_until = chunk.bounds.samples_from(start)
        env = self._environments[chunk.source]
        reception = env.reception(channels)
        activity: Any = None
        cells: dict[str, Any] = {"active_cells": None, "cells": 0}
        if chunk.cells is not None:
            activity, cells = self._scratch.take(("activity", block), 4 * blocks * batch.count), chunk.cells
            cl.enqueue_fill_buffer(self._queue, activity, np.zeros(1, np.int32), 0, 4 * blocks * batch.count)
        made = {
            "delay": delay, "polynomials": polynomials, "found": there[0], "residual": there[1], "blocks": blocks,
            "directivity_of": reception.table_of[batch.receiver], "nodes": receivers.shape[1],
            "receiver_directivities": reception.tables, "projection": reception.projection,
            "active_from": active_from, "active_until": active_until, "activity": activity,
            "angular_frequency": 2.0 * math.pi * filters.swiftness, "max_rate": self._max_rates[chunk.source],
            "origin": start - chunk.first, "air_and_functions": env.air,
        }  # fmt: skip
        made |= env.tables | cells | self._shape(chunk.source, block, batch)
        self._launch(chunk, start, segments, receivers, made)
        if meanwhile is not None:
            meanwhile()
        cl.enqueue_copy(self._queue, found, there[0])
        cl.enqueue_copy(self._queue, residual, there[1])
        span = float(found[..., 2].min()), float(found[..., 3].max())
        self._columns.check(span[0], start / rate, (start + block * blocks) / rate)
        return Nodes(delay, polynomials, activity, np.stack([found[..., 0], found[..., 1], residual]), *span)

    def _launch(
        self, chunk: DeviceChunk, start: int, segments: int, receivers: NDArray[Any], more: dict[str, Any]
    ) -> None:
        rate, source, segment = self._plan.sampling_rate, chunk.source, self._plan.segment
        filters = self._plan.source_filters[source]
        first, last = filters.emitted_between(rate)
        constants = self._constants(source, chunk.batch) | {"SPARSE": int(more["activity"] is not None)}
        constants |= OF_GAINS | {"KNOWN_AT": self._columns.known_at}
        kernel = self._compiler.kernel("tracks", constants | self._exact_constants(source))
        kernel(
            self._queue, work(chunk.batch.count, segments), **chunk.paths, **chunk.exact, **more, **self._media[source],
            receivers=receivers, start=start / rate,
            first_segment=(start - chunk.start) // segment, sampling_rate=rate, emitted_first=first, emitted_last=last,
            delay_samples=filters.delay_samples, oversampling=filters.oversampling,
            smooth=self._smooth(chunk, receivers, more["block_samples"]),
        )  # fmt: skip

    def _exact_constants(self, source: int) -> dict[str, Any]:
        wind = int(self._tracks.paths.scene.air.wind is not None)
        smooth = np.float32(SMOOTH_ERROR)
        return OF_DELAYS | self._columns.constants | {
            "SMOOTH_ERROR": smooth, "NODES_AT_ONCE": self._together, "WIND": wind,
        }  # fmt: skip

    def _smooth(self, chunk: DeviceChunk, receivers: NDArray[Any], block: int) -> float:
        """Return the allowed error of gains between nodes, squared and relative; 0 where beams turn fast or bend."""
        env, turn = self._environments[chunk.source], chunk.turn * block / self._plan.sampling_rate
        kind = env.reception(self._channels(chunk.batch)).kind
        if SPHERICAL in (env.source_kind, kind):
            return 0.0
        if kind != OMNI:
            turn = max(turn, _largest_turn(receivers["axes"][..., 0, :]), _largest_turn(receivers["axes"][..., 1, :]))
        return SMOOTH_SHARE * 10 ** (self._plan.motion_error_db / 10) if turn <= _MOST_TURN else 0.0

    def _mach(self, source: int) -> float:
        """Return a bound of a source's speed over that of sound, by as much as frequencies on the way follow it."""
        speed = float(self._tracks.speeds.source[source]) if self._tracks.kinematics.retarded else 0.0
        return speed / float(self._family.medium(source).slowest)

    def _motion_constants(self, source: int) -> dict[str, int]:
        sideways = self._environments[source].source_kind == SPHERICAL
        return {
            "KNOT_COLUMNS": CUBIC_COLUMNS * (3 if sideways else 2),
            "RETARDED": int(self._tracks.kinematics.retarded),
            "STATIC_RECEIVERS": int(self._all_static),
        }

    def _channels(self, batch: PathBatch) -> int:
        """Return the number of channels that the receivers of a batch have, all as many."""
        return len(self._tracks.pairs[batch.pairs[0]].channels)

    def _shape(self, source: int, block: int, batch: PathBatch) -> dict[str, float]:
        """Return values that differ between blocks and scenes: as arguments they need no new build."""
        subblock = self._plan.subblock(source, block)
        return {
            "block_samples": block, "segment_blocks": self._plan.segment // block, "subblock_samples": subblock,
            "subblock_share": self._plan.left_out_over(source, block, few=batch.few),
            "function_count": len(self._plan.source_filters[source].basis) * self._channels(batch),
            "angular": self._environments[source].angular,
        }  # fmt: skip

    def _constants(self, source: int, batch: PathBatch) -> dict[str, Any]:
        retarded, env = self._tracks.kinematics.retarded, self._environments[source]
        reception = env.reception(self._channels(batch))
        functions = len(self._plan.source_filters[source].basis) * reception.channels
        room = 1 if functions == 1 else -(-functions // VECTOR) * VECTOR  # for so many functions
        return self._motion_constants(source) | TABLES | {
            "CELL": CELL, "DELAY_TERMS": self._plan.delay_terms, "FUNCTIONS": room, "FREQUENCIES": env.count,
            "PARTS": env.parts, "AIR_TERMS": env.air_terms, "CUBIC_COLUMNS": CUBIC_COLUMNS,
            "MACH_EXPONENT": self._tracks.kinematics.exponent if retarded else 0,
            "SOURCE_DIRECTIVITY": env.source_kind, "RECEIVER_DIRECTIVITY": reception.kind,
            "CHANNELS": reception.channels, "GAIN_ERROR": np.float32(GAIN_ERROR[self._plan.delay_terms]),
        }  # fmt: skip

    def _receivers_at(self, batch: PathBatch, times: Floats) -> NDArray[Any]:
        """Return motion and clock of a batch's receivers, (receivers, nodes), with one node if all are at rest."""
        times = times[:1] if self._all_static else times
        out = np.empty((len(batch.pairs), len(times)), dtype=RECEIVER_NODE)
        for i, r in enumerate(batch.receiver):
            out[i] = self._static[r] if r in self._static else receiver_at(self._tracks.paths.scene.receivers[r], times)
        return out

    def _uploaded(self, **columns: NDArray[Any]) -> dict[str, Any]:
        return {name: self._upload(column) for name, column in columns.items()}


def _largest_turn(axes: Floats) -> float:
    """Return the largest angle between neighbouring axes (..., n, 3), rad."""
    chord = np.linalg.norm(np.diff(axes, axis=-2), axis=-1).max(initial=0.0)
    return 2.0 * math.asin(min(0.5 * float(chord), 1.0))
