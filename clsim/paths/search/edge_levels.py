"""The least level of paths over ends of edges, and which paths are above it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, Rows, unique_rows
from clsim.paths.vertices.edge_events import TWO_ENDS, end_numbers
from clsim.scene.scene import Scene

QUIET = 1e-3  # pressure over the direct sound: paths that stay below it are left out
QUIET_ECHO = 2e-4  # without direct sound: over that in free air as far away
_SAMPLED = 9  # instants of an interval, at which it is looked how loud a path is
_STEP, _MOST = 0.03, 129  # m that the ends go from instant to instant where the least level is near, and most of these
_NEVER = 1e-2  # of the least level, below which paths are not looked at more closely


def lowest_wave(scene: Scene) -> float:
    """Least wave number of a centre frequency of the sources, 1/m."""
    lowest = min((source.emitted.centre_frequency for source in scene.sources), default=0.0)
    return float(2.0 * np.pi * lowest / scene.air.speed_of_sound)


def least_level(direct: bool) -> float:
    """Pressure over that in free air, see `end_levels`: paths that stay below it are left out."""
    return QUIET if direct else QUIET_ECHO


def loud(
    levels: Callable[[Rows, Floats], Floats], span: tuple[Floats, Floats], speed: Floats, least: float,
    paths: tuple[Rows, NDArray[Any]],
) -> Rows:  # fmt: skip
    """Find which stretches (n,) of time, s, are of paths that are above a least level in some of their stretches.

    levels: estimates (k, T) of some stretches (k,) at times (k, T), s.
    speed: of both ends together (n,), m/s.
    paths: number of the end (n,) and what else (n, k) a path meets. Paths over both of two ends are two halves, of
    which both are there or neither.
    """
    (begin, end), (number, met) = span, paths
    every, count, most = np.arange(len(begin)), np.full(len(begin), _SAMPLED), np.zeros(len(begin))
    for step in (0.0, _STEP):
        if step:
            every = every[(most > _NEVER * least) & (most <= least)]
            count = np.clip((speed * (end - begin))[every] / step, 2 * _SAMPLED, _MOST)
            count = 2 ** np.ceil(np.log2(count)).astype(np.int64) + 1
        for instants in np.unique(count).tolist():
            some = every[count == instants]
            times = begin[some, None] + np.linspace(0.0, 1.0, instants) * (end - begin)[some, None]
            most[some] = np.maximum(most[some], levels(some, times).max(axis=1))
    first, last = end_numbers(number)
    half = np.where(number >= TWO_ENDS, -1 - 2 * first - last, number)
    path = unique_rows(np.column_stack([half, met]))[2]
    louder = np.zeros(len(path))
    np.maximum.at(louder, path, most)
    return np.flatnonzero(louder[path] > least)
