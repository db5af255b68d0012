"""Tracks computed on the host: sampled ones, scenes whose paths begin or end, and devices without float64."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.render.blocks import block_cubics, block_error
from clsim.render.plan import SEGMENT, Plan, node_times

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.slots import Slots


@dataclass(frozen=True, slots=True, eq=False)
class HostNodes:
    """Block polynomials of a run, uploaded, and what was found while they were made."""

    delay: Any
    cubics: Any
    error: Floats
    shortest: float
    longest: float
    start: int
    block: int
    partly: list[tuple[int, int, int]] = field(default_factory=list)

    def edges(self, first: int, last: int) -> list[tuple[int, int, int, int]]:
        """Return group, path, first and end sample where a path begins or ends within blocks `first` to `last`."""
        return [
            (group, path, self.start + k * self.block, self.start + (k + 1) * self.block)
            for group, path, k in self.partly
            if first <= k < last
        ]


class HostTracks:
    """Makes block polynomials in NumPy and uploads them."""

    def __init__(self, plan: Plan, queue: Any) -> None:
        self._plan, self._queue = plan, queue

    def prepare(self, source: int, slots: Slots, start: int, length: int) -> tuple[int, Slots]:
        """Return what `nodes` needs."""
        return source, slots

    def nodes(self, state: tuple[int, Slots], start: int, block: int, blocks: int) -> HostNodes:
        """Make the polynomials of `blocks` blocks from a sample on."""
        _source, slots = state
        plan, emission = self._plan, self._plan.emissions[state[0]]
        rate = plan.sampling_rate
        whole = np.empty((blocks, slots.count), dtype=np.int32)
        cubics = np.empty((blocks, 8, slots.count), dtype=np.float32)
        error = np.zeros(-(-blocks * block // SEGMENT))
        shortest, longest = math.inf, -math.inf
        partly: list[tuple[int, int, int]] = []
        times = node_times(start, block, blocks, rate)
        late = emission.start * rate - emission.bank.shift
        for i, index in enumerate(slots.groups):
            here = slots.of_group(i)
            delay, change, gain = plan.tracks.evaluate(index, times, slots.path[here])
            gain[slots.filling[here]] = 0.0
            whole[:, here], made = block_cubics(delay, change, gain, block, rate, late)
            wrong = block_error(change, gain, 2.0 * math.pi * emission.band, block / rate)
            heard = self._heard(index, slots, here, start, block, blocks)
            made[:, 4:] *= heard[:, None] == 2
            cubics[:, :, here] = made
            for k, slot in np.argwhere((heard == 1) & ~slots.filling[here]):
                partly.append((index, int(slots.path[here][slot]), int(k)))
            np.maximum(error, _by_segment(wrong, gain, block), out=error)
            shortest, longest = min(shortest, float(delay.min())), max(longest, float(delay.max()))
        return HostNodes(self._upload(whole), self._upload(cubics), error, shortest, longest, start, block, partly)

    def _heard(self, index: int, slots: Slots, here: slice, start: int, block: int, blocks: int) -> NDArray[np.int8]:
        """Return how each path is heard in each block (blocks, paths): 0 not, 1 partly, 2 throughout."""
        group, rate = self._plan.tracks.groups[index], self._plan.sampling_rate
        begin, end = group.start[slots.path[here]], group.end[slots.path[here]]
        first = (start + block * np.arange(blocks)[:, None]) / rate
        last = (start + block * np.arange(1, blocks + 1)[:, None] - 1) / rate
        throughout = (first >= begin) & (last < end)
        at_all = (last >= begin) & (first < end)
        return np.where(throughout, 2, np.where(at_all, 1, 0)).astype(np.int8)

    def _upload(self, array: NDArray[Any]) -> Any:
        import pyopencl as cl

        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self._queue.context, flags, hostbuf=np.ascontiguousarray(array))


def _by_segment(wrong: Floats, gain: Floats, block: int) -> Floats:
    """Return the largest error of each segment relative to the strongest gain, from (paths, blocks)."""
    first = np.arange(0, wrong.shape[1], SEGMENT // block)
    error = np.maximum.reduceat(wrong.max(axis=0), first)
    strongest = np.maximum.reduceat(np.abs(gain[:, 1:-2]).max(axis=0), first)
    return np.asarray(error / np.maximum(strongest, 1e-30))
