"""Transitions of paths that begin and end: at once, or by a raised cosine centred on the boundary."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import as_number

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

DEFAULT_TRANSITION = 1e-3  # s
_LONGEST = 1.0  # s


def as_transition(value: object) -> float:
    """Return the length of the transition, s; 0 for none."""
    return as_number("transition", value, at_least=0.0, at_most=_LONGEST, unit="s")


def heard(times: Floats, start: Floats, end: Floats, transition: float) -> Floats:
    """Return the weight (paths, times) of paths that are active from `start` to `end` (paths,).

    Shapes: times (T,) s; start, end (P,) s.

    transition: length of the raised cosine, s; 0 for none: 1 from `start` on and 0 from `end` on.

    A gate splatters: a 40 kHz tone that is switched leaves -49 dB at 5 kHz off, over 1 ms -90 dB. Weights of paths that
    follow each other add up to 1, however short each is.
    """
    if transition == 0.0:
        return ((times >= start[:, None]) & (times < end[:, None])).astype(np.float64)
    rise = np.clip((times - start[:, None]) / transition + 0.5, 0.0, 1.0)
    fall = np.clip((times - end[:, None]) / transition + 0.5, 0.0, 1.0)
    return np.asarray(0.5 * (np.cos(np.pi * fall) - np.cos(np.pi * rise)))


def heard_samples(
    start: Floats, end: Floats, transition: float, sampling_rate: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first sample of each path and the one after its last, counted from time 0, bounded to 62 bits."""
    first = _first_at(start - 0.5 * transition, sampling_rate)
    last = _first_at(end + 0.5 * transition, sampling_rate)
    return first, last


def _first_at(times: Floats, sampling_rate: float) -> NDArray[np.int64]:
    """Return the first sample n with ``n / sampling_rate >= time``, exactly as floats compare."""
    place = np.clip(np.ceil(times * sampling_rate), -(2.0**62), 2.0**62)
    place = np.where((place - 1.0) / sampling_rate >= times, place - 1.0, place)
    place = np.where(place / sampling_rate < times, place + 1.0, place)
    return np.asarray(np.clip(place, -(2.0**62), 2.0**62), dtype=np.int64)
