"""Tracks computed on the host: sampled ones, scenes whose paths begin or end, and devices without float64."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.opencl.launch import upload
from clsim.render.opencl.block_polynomials import SMOOTH_SHARE, between, block_error, block_polynomials
from clsim.render.plan import Plan, node_times

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.opencl.activity import Activity
    from clsim.render.opencl.batches import PathBatch
    from clsim.render.opencl.fades import Boundaries
    from clsim.render.source_filters import SourceFilters
    from clsim.tracks.basis import Basis

_CELL = 4  # nodes from one at which costly gains are taken to the next
_BESIDE = 8  # paths whose terms stand side by side, as in polynomials.h


@dataclass(frozen=True, slots=True, eq=False)
class HostNodes:
    """Block polynomials of a run, uploaded, and what was found while they were made."""

    delay: Any
    polynomials: Any
    activity: None
    error: Floats
    unheld: Floats
    shortest: float
    longest: float


class HostTracks:
    """Makes block polynomials in NumPy and uploads them."""

    def __init__(self, plan: Plan, queue: Any) -> None:
        self._plan, self._queue = plan, queue

    def prepare(
        self,
        source: int,
        batch: PathBatch,
        bounds: Boundaries,
        start: int,
        length: int,
        activity: Activity | None,
        first: int,
    ) -> tuple[int, PathBatch, Boundaries]:
        """Return what `nodes` needs; nothing is left out here."""
        return source, batch, bounds

    def nodes(
        self,
        state: tuple[int, PathBatch, Boundaries],
        start: int,
        block: int,
        blocks: int,
        meanwhile: Callable[[], None] | None = None,
    ) -> HostNodes:
        """Make the polynomials of `blocks` blocks from a sample on; the host has no time for anything else."""
        source, batch, bounds = state
        plan, filters = self._plan, self._plan.source_filters[source]
        rate = plan.sampling_rate
        whole = np.empty((blocks, batch.count), dtype=np.int32)
        cubics = np.empty((blocks, plan.delay_terms + 4 * len(filters.basis), batch.count), dtype=np.float32)
        error = np.zeros(-(-blocks * block // plan.segment))
        shortest, longest = math.inf, -math.inf
        times = node_times(start, block, blocks, rate)
        first, last = bounds.samples_from(start)
        begins = block * np.arange(blocks)
        for i, index in enumerate(batch.pairs):
            here = batch.of_pair(i)
            delay, change, gain = self._evaluated(index, times, filters.basis, batch.path[here])
            whole[:, here], made = block_polynomials(
                delay, change, gain, block, rate, filters.delay_samples, filters.oversampling, plan.delay_terms
            )
            sized = gain * filters.basis.strengths[:, None, None]
            part = 0.0 if plan.is_fine(block) else plan.subblock(source, block) / block
            swiftness = 2.0 * math.pi * filters.swiftness
            wrong = block_error(delay, change, sized, swiftness, block / rate, part, plan.delay_terms)
            heard = (first[here, None] < begins + block) & (last[here, None] > begins)
            sounds = heard & _sounds(filters, times, delay, rate)
            terms = plan.delay_terms
            made[:, terms:] = np.where(heard.T[:, None], made[:, terms:], 0.0)
            cubics[:, :, here] = made
            loud = np.abs(sized).sum(axis=0)[:, 1:-2] * heard
            np.maximum(error, _by_segment(np.where(sounds, wrong, 0.0), loud, plan.segment // block), out=error)
            shortest, longest = min(shortest, float(delay.min())), max(longest, float(delay.max()))
        beside = 1 if plan.delay_terms == 8 else _BESIDE
        laid_out = cubics.reshape(*cubics.shape[:2], -1, beside).swapaxes(1, 2)
        return HostNodes(
            self._upload(whole), self._upload(laid_out), None, error, np.zeros(len(error)), shortest, longest
        )

    def _evaluated(
        self, pair: int, times: Floats, basis: Basis, rows: NDArray[np.int64]
    ) -> tuple[Floats, Floats, Floats]:
        """Return delays, their rates, and gains at evenly spaced times; costly gains only where they change fast.

        Others are taken at every fourth node, and at those between from these, as in `smooth.h`: where this is known
        to be wrong by less than the error that is allowed between nodes, by 10 dB, relative to what is heard of all.
        """
        tracks, count, cells = self._plan.tracks, len(times), -(-(len(times) - 1) // _CELL)
        if not tracks.costly(pair) or cells < 4:
            return tracks.evaluate(pair, times, basis, rows)
        longer = times[0] + (times[1] - times[0]) * np.arange(_CELL * cells + 1)
        delay, rate, few = tracks.evaluate(pair, longer, basis, rows, every=_CELL)
        gain, wrong = between(few, _CELL)
        level = math.sqrt(np.mean(np.tensordot(basis.strengths, np.abs(few), 1) ** 2))
        allowed = math.sqrt(SMOOTH_SHARE) * 10 ** (self._plan.motion_error_db / 20)
        fast = np.flatnonzero(basis.strengths @ wrong > allowed * level)
        if len(fast):
            gain[:, fast, :count] = tracks.evaluate(pair, times, basis, rows[fast])[2]
        return delay[:, :count], rate[:, :count], gain[..., :count]

    def _upload(self, array: NDArray[Any]) -> Any:
        return upload(self._queue.context, array)


def _sounds(filters: SourceFilters, times: Floats, delay: Floats, rate: float) -> NDArray[np.bool_]:
    """Return in which blocks (paths, blocks) of nodes (paths, blocks + 3) what is emitted can arrive."""
    first, last = filters.emitted_between(rate)
    return np.asarray((times[3:] - delay[:, 3:] >= first) & (times[:-3] - delay[:, :-3] <= last))


def _by_segment(wrong: Floats, gain: Floats, step: int) -> Floats:
    """Return the largest error of each segment relative to what is heard, of those of paths (paths, blocks)."""
    first = np.arange(0, wrong.shape[1], step)
    error, heard = (
        np.sqrt(np.sum(np.maximum.reduceat(values, first, axis=1) ** 2, axis=0)) for values in (wrong, np.abs(gain))
    )
    return np.asarray(error / np.maximum(heard, 1e-30))
