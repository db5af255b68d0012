"""Sums of all paths at one frequency and instant, and their jumps where paths begin and end."""

import inspect
import textwrap
from collections.abc import Callable
from typing import Any

import numpy as np

from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse


def field(paths: PathSet, times: np.ndarray, frequency: float, receiver: int = 0) -> np.ndarray:
    """Return the sum of all paths that are heard at times (T,), as a phasor."""
    return terms(paths, times, frequency, receiver).sum(axis=0)


def terms(paths: PathSet, times: np.ndarray, frequency: float, receiver: int = 0) -> np.ndarray:
    """Return the phasor of every path of a receiver (P, T), 0 where it is not heard."""
    at = SceneResponse(paths.scene, 0, np.array([frequency]))
    parts = []
    for _, pair in paths.at_receiver(receiver).pairs():
        found = pair.arrivals(times)
        sent = pair.response(found, times, at)[..., 0] * np.exp(-2j * np.pi * frequency * found.delay)
        family = pair.family
        heard = (times >= family.start[pair.rows][:, None]) & (times < family.end[pair.rows][:, None])
        parts.append(np.where(heard, sent, 0.0))
    return np.concatenate(parts)


def jumps(paths: PathSet, events: np.ndarray, frequency: float, receiver: int = 0, step: float = 1e-7) -> np.ndarray:
    """Return the jump of the sum at each event (E,), relative to the strongest path there.

    What the sum changes by in as short a time beside the event is no jump.
    """
    times = (events[:, None] + step * np.array([-3.0, -1.0, 1.0, 3.0])).ravel()
    one = terms(paths, times, frequency, receiver)
    sums = one.sum(axis=0).reshape(-1, 4)
    jump = np.abs((sums[:, 2] - sums[:, 1]) - 0.5 * ((sums[:, 1] - sums[:, 0]) + (sums[:, 3] - sums[:, 2])))
    return jump / np.abs(one).max(axis=0).reshape(-1, 4).max(axis=1)


def mistaken(function: Callable[..., Any], right: str, wrong: str) -> Callable[..., Any]:
    """Return a function with one place of its text changed."""
    text = textwrap.dedent(inspect.getsource(function))
    assert text.count(right) == 1, right
    room = dict(vars(inspect.getmodule(function)))
    exec(f"from __future__ import annotations\n{text.replace(right, wrong)}", room)
    return room[function.__name__]
