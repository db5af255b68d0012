"""Tracks computed on the host: sampled ones, scenes whose paths begin or end, and devices without float64."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.numerics.blas import with_blas_threads
from clsim.opencl.launch import upload, work
from clsim.paths.cubics import CUBIC_COLUMNS
from clsim.render.opencl.batches import Activity, Boundaries, PathBatch
from clsim.render.opencl.block_polynomials import SMOOTH_SHARE, between, block_error, block_polynomials
from clsim.render.opencl.nodes import DeviceChunk, NodeMaker, Nodes
from clsim.render.plan import Plan, node_times
from clsim.render.source_filters import SourceFilters
from clsim.tracks.basis import Basis

Item = TypeVar("Item")
Result = TypeVar("Result")

_CELL = 4  # nodes from one at which costly gains are taken to the next
_PATHS_EACH = 128  # paths of a pair that one thread makes at a time
_BESIDE = {4: 8, 8: 16}  # paths whose terms stand side by side, by the terms of delays, as in polynomials.h


# Paths of some pairs that have the same ones: slots of each pair, and rows of the pairs' paths.
_Part = tuple[list[tuple[int, NDArray[np.int64]]], NDArray[np.int64]]


class HostNodeMaker:
    """Makes block polynomials in NumPy, in threads, and uploads them."""

    def __init__(self, plan: Plan, queue: Any) -> None:
        self._plan, self._upload = plan, partial(upload, queue.context)

    def prepare(
        self, source: int, batch: PathBatch, bounds: Boundaries, start: int, length: int, activity: Activity | None,
        first: int,
    ) -> tuple[int, PathBatch, Boundaries]:  # fmt: skip
        """Return the arguments of `nodes`; the host skips no silent parts."""
        return source, batch, bounds

    def nodes(
        self, state: tuple[int, PathBatch, Boundaries], start: int, block: int, blocks: int,
        meanwhile: Callable[[], None] | None = None,
    ) -> Nodes:  # fmt: skip
        source, batch, bounds = state
        plan, filters = self._plan, self._plan.source_filters[source]
        audible, times = bounds.samples_from(start), node_times(start, block, blocks, plan.sampling_rate)
        whole = np.empty((blocks, batch.count), dtype=np.int32)
        channels = len(plan.tracks.pairs[batch.pairs[0]].channels)  # the same of all of a batch
        terms = plan.delay_terms + 4 * len(filters.basis) * channels
        cubics = np.empty((blocks, terms, batch.count), dtype=np.float32)
        squares = np.zeros((3, -(-blocks * block // plan.segment), batch.count))

        def make(part: _Part) -> list[tuple[float, float]]:
            here = []
            for (_, slots), tracks in zip(part[0], self._evaluated(part, times, filters.basis), strict=True):
                here.append((float(tracks[0].min()), float(tracks[0].max())))
                active = audible[0][slots, None], audible[1][slots, None]
                whole[:, slots], cubics[:, :, slots], squares[:2, :, slots] = self._part(
                    source, times, block, tracks, active
                )
            return here

        parts, padding = _parts(plan, batch)
        with with_blas_threads(1):  # each part has a thread of its own, and its matrices are small
            lows, highs = zip(
                *(found for several in side_by_side(make, parts, meanwhile) for found in several), strict=True
            )
        for first, silent in padding:
            whole[:, silent], cubics[:, :, silent] = whole[:, [first]], 0.0
        laid_out = cubics.reshape(*cubics.shape[:2], -1, _BESIDE[plan.delay_terms]).swapaxes(1, 2)
        return Nodes(self._upload(whole), self._upload(laid_out), None, squares, min(lows), max(highs))

    def _part(
        self, source: int, times: Floats, block: int, tracks: tuple[Floats, Floats, Floats],
        active: tuple[NDArray[np.int32], NDArray[np.int32]],
    ) -> tuple[NDArray[np.int32], NDArray[np.float32], Floats]:  # fmt: skip
        """Return whole delays, polynomials and squares (2, segments, P) of errors and levels of paths."""
        plan, filters, (delay, change, gain) = self._plan, self._plan.source_filters[source], tracks
        rate, terms = plan.sampling_rate, plan.delay_terms
        whole, made = block_polynomials(
            delay, change, gain, block, rate, filters.delay_samples, filters.oversampling, terms
        )
        sized = gain * _strengths(filters.basis, len(gain))[:, None, None]
        part, each = plan.left_out_over(source, block), np.abs(sized).sum(axis=0)
        level = each[:, 1:-2]
        if plan.tracks.least_level > 0.0:  # tangents, which may begin with nothing
            level = np.maximum(level, each[:, 2:-1])
        wrong = block_error(delay, change, sized, level, 2.0 * math.pi * filters.swiftness, block / rate, part, terms)
        begins = block * np.arange(whole.shape[0])
        audible = (active[0] < begins + block) & (active[1] > begins)
        made[:, terms:] = np.where(audible.T[:, None], made[:, terms:], 0.0)
        loud = level * audible
        sounds = audible & _sounds(filters, times, delay, rate)
        return whole, made, _by_segment(np.where(sounds, wrong, 0.0), loud, plan.segment // block)

    def _evaluated(self, part: _Part, times: Floats, basis: Basis) -> list[tuple[Floats, Floats, Floats]]:
        """Return delays, their rates, and gains of each pair at evenly spaced times.

        Gains (K C, P, T) are those of each function, by channel; costly ones are exact where they change fast.

        Others are taken at every fourth node, and at those between from these, as in `smooth.h`: where this is known
        to be wrong by less than the error that is allowed between nodes, by 10 dB, relative to what is heard of all.
        """
        tracks, count, cells = self._plan.tracks, len(times), -(-(len(times) - 1) // _CELL)
        pairs, rows = [pair for pair, _ in part[0]], part[1]
        if not tracks.costly(pairs[0]) or cells < 4:
            found = tracks.evaluate_together(pairs, times, basis, rows)
            return [(delay, rate, _side_by_side(gain)) for delay, rate, gain in found]
        longer = times[0] + (times[1] - times[0]) * np.arange(_CELL * cells + 1)
        found = tracks.evaluate_together(pairs, longer, basis, rows, every=_CELL)
        strengths = _strengths(basis, len(basis) * len(found[0][2]))
        allowed = math.sqrt(SMOOTH_SHARE) * 10 ** (self._plan.motion_error_db / 20)
        gains, fast = [], np.zeros(len(rows), dtype=np.bool_)
        for _, _, few in found:
            gain, wrong = between(_side_by_side(few), _CELL)
            level = math.sqrt(np.mean(np.tensordot(strengths, np.abs(_side_by_side(few)), 1) ** 2))
            fast |= strengths @ wrong > allowed * level
            gains.append(gain)
        if fast.any():
            anew = tracks.evaluate_together(pairs, times, basis, rows[fast])
            for gain, (_, _, exact) in zip(gains, anew, strict=True):
                gain[:, fast, :count] = _side_by_side(exact)
        return [
            (delay[:, :count], rate[:, :count], gain[..., :count])
            for (delay, rate, _), gain in zip(found, gains, strict=True)
        ]


def _side_by_side(gain: Floats) -> Floats:
    """Return gains (K C, P, T), channels of a function side by side, of gains (C, K, P, T)."""
    return np.swapaxes(gain, 0, 1).reshape(-1, *gain.shape[2:])


def _strengths(basis: Basis, count: int) -> Floats:
    """Return the strengths of a basis for each of so many gains, channels side by side."""
    return np.repeat(basis.strengths, count // len(basis))


def _sounds(filters: SourceFilters, times: Floats, delay: Floats, rate: float) -> NDArray[np.bool_]:
    """Return a mask (paths, blocks) of the blocks of nodes (paths, blocks + 3) in which the signal can arrive.

    By the nodes beside a block: of paths over two edges its own would leave too few blocks to judge by.
    """
    first, last = filters.emitted_between(rate)
    return np.asarray((times[3:] - delay[:, 3:] >= first) & (times[:-3] - delay[:, :-3] <= last))


def _by_segment(wrong: Floats, gain: Floats, step: int) -> Floats:
    """Return the squared largest error and level of each segment, (2, segments, paths), of paths (paths, blocks)."""
    first = np.arange(0, wrong.shape[1], step)
    largest = [np.maximum.reduceat(values, first, axis=1) for values in (wrong, np.abs(gain))]
    return np.stack([values.T**2 for values in largest])


def _parts(plan: Plan, batch: PathBatch) -> tuple[list[_Part], list[tuple[int, NDArray[np.int64]]]]:
    """Return the paths of a batch in parts, the same on every machine: rows beside each other together.

    Pairs with the same paths, as both ears of a head, stand in the same parts. Slots that only fill up are left out of
    ears, whose nodes cost most, and returned apart, with a slot that has a delay.
    """
    of_scene = plan.tracks.of_scene
    groups: dict[Any, list[tuple[int, NDArray[np.int64]]]] = {}
    for i, pair in enumerate(batch.pairs):
        here = batch.of_pair(i)
        order = here.start + np.argsort(batch.path[here], kind="stable")
        groups.setdefault((plan.tracks.paths_of(pair), batch.path[order].tobytes()), []).append((pair, order))
    parts, padding = [], []
    for members in groups.values():
        if of_scene is not None and of_scene.pair_paths[members[0][0]].reach > 0.0:
            padding += [(order[~batch.padding[order]][0], order[batch.padding[order]]) for _, order in members]
            members = [(pair, order[~batch.padding[order]]) for pair, order in members]
        for first in range(0, len(members[0][1]), _PATHS_EACH):
            some = [(pair, order[first : first + _PATHS_EACH]) for pair, order in members]
            parts.append((some, batch.path[some[0][1]]))
    return parts, padding


def thread_count() -> int:
    """Return the number of threads of this process that the operating system runs at the same time."""
    affinity = getattr(os, "sched_getaffinity", None)  # not told by every operating system
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def side_by_side(
    function: Callable[[Item], Result], items: Sequence[Item], meanwhile: Callable[[], None] | None = None,
    threads: int | None = None,
) -> list[Result]:  # fmt: skip
    """Apply a function to each item in threads; results keep the order of the items."""
    count = min(thread_count() if threads is None else threads, len(items))
    if count <= 1:
        if meanwhile is not None:
            meanwhile()
        return [function(item) for item in items]
    with ThreadPoolExecutor(count) as pool:
        made = pool.map(function, items)
        if meanwhile is not None:
            meanwhile()
        return list(made)


# A receiver at a node, as in nodes/pair_delay.h.
PAIR_RECEIVER = np.dtype(
    [("position", "f4", (3, 2)), ("clock_error", "f4", 2), ("velocity", "f4", 3), ("axes", "f4", (2, 3)),
     ("clock_drift", "f4")]
)  # fmt: skip


def pairs(values: Floats) -> NDArray[np.float32]:
    """Return numbers (...) as pairs of floats (..., 2), of which the second is what the first leaves."""
    large = np.asarray(values).astype(np.float32)
    return np.stack([large, (values - large).astype(np.float32)], axis=-1)


class PairNodeMaker(NodeMaker):
    """Makes block polynomials with ``pair_tracks.cl``: every node has its gains."""

    most_counted = 2**23  # samples that floats count to the half

    def _views(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        image = self._family.legs[0].part(rows)
        return self._uploaded(image_matrix=pairs(image.matrix.reshape(-1, 9).T), image_offset=pairs(image.offset.T))

    def _trajectory(self, knots: Floats) -> dict[str, Any]:
        both = pairs(knots)
        return self._uploaded(knots=both[..., 0], rests=both[:, :CUBIC_COLUMNS, 1])

    def _coarse_delays(
        self, source: int, batch: PathBatch, paths: dict[str, Any], start: int, ends: int
    ) -> dict[str, Any]:
        return {}

    def _launch(
        self, chunk: DeviceChunk, start: int, segments: int, receivers: NDArray[Any], more: dict[str, Any]
    ) -> None:
        rate, filters, block = self._plan.sampling_rate, self._plan.source_filters[chunk.source], more["block_samples"]
        paths = chunk.paths.copy()
        origin = paths.pop("first_knot")
        first, last = filters.emitted_between(rate)
        c, times = self._media[chunk.source]["speed_of_sound"], filters.oversampling
        numbers = [
            start / rate - origin, block / rate, 1.0 / c, times * rate, filters.delay_samples, 0.5 * times * block,
        ]  # fmt: skip
        given = np.zeros(receivers.shape, PAIR_RECEIVER)
        for name in ("velocity", "axes"):
            given[name] = receivers[name]
        for name in ("position", "clock_error"):
            given[name] = pairs(receivers[name])
        given["clock_drift"] = receivers["clock_rate"] - 1.0
        constants = self._constants(chunk.source, chunk.batch) | {"SPARSE": int(more["activity"] is not None)}
        kernel = self._compiler.kernel("pair_tracks", constants)
        kernel(
            self._queue, work(chunk.batch.count, segments), **paths, **more,
            receivers=given, numbers=pairs(np.array(numbers)), speed_of_sound=c, emitted_first=first - origin,
            emitted_last=last - origin,
        )  # fmt: skip
