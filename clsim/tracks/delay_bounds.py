"""Bounds on the delays of very many pairs of a scene, by the clocks of receivers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from clsim.arrays import Floats
    from clsim.paths.family import PairPaths, PeakSpeeds
    from clsim.paths.path_set import PathSet

_TOGETHER = 65536  # paths looked at at a time


def delay_bounds(
    paths: PathSet, speeds: PeakSpeeds, pair_paths: Sequence[PairPaths], pairs: Sequence[int], start: float, end: float
) -> Iterator[tuple[list[int], Floats, Floats]]:
    """Yield some pairs, and the lowest and highest delays of all their paths, s, one pair's after the other's."""
    clock_times = np.array([start, end])
    clock_error = np.stack([r.clock_error(clock_times) for r in paths.scene.receivers])
    first, last = (clock_times + clock_error).T
    least, most = clock_error.min(axis=1), clock_error.max(axis=1)
    for family in paths.families:
        for batch in _batches(pair_paths, [i for i in pairs if pair_paths[i].family is family]):
            rows = np.concatenate([pair_paths[i].index for i in batch])
            r = family.receiver[rows]
            low, high = family.delay_bounds(rows, first[r], last[r], speeds)
            reach = np.repeat([pair_paths[i].reach for i in batch], [len(pair_paths[i]) for i in batch])
            yield batch, low - most[r] - reach, high - least[r] + reach


def _batches(pair_paths: Sequence[PairPaths], pairs: list[int]) -> Iterator[list[int]]:
    """Yield neighbouring pairs together whose paths are a bounded number, or one pair."""
    batch: list[int] = []
    count = 0
    for pair in pairs:
        if batch and count + len(pair_paths[pair]) > _TOGETHER:
            yield batch
            batch, count = [], 0
        batch.append(pair)
        count += len(pair_paths[pair])
    if batch:
        yield batch
