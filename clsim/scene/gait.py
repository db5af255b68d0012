"""How people walk: joint angles and translations over the cycle of a gait, by speed.

R. Boulic, N. Magnenat-Thalmann and D. Thalmann, A global human walking model with real-time kinematic personification,
The Visual Computer 6 (1990), 344-358: from experiments, for speeds up to 3 leg lengths a second. Angles that the paper
draws go through its control points, with the values that V. C. Chen reads from them (The Micro-Doppler Effect in
Radar, 2011, section 4.1), as monotone cubics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats

SLOWEST, FASTEST = 0.1, 3.0  # leg lengths a second
_SPEEDS = 25  # between which angles are linear, over the range of speeds of a walk


@dataclass(frozen=True, slots=True, eq=False)
class Gait:
    """A walk at n instants; angles in rad, right side in row 0, left in row 1, translations in leg lengths."""

    hip: Floats  # (2, n) flexion, that of the ankle with the toes up
    knee: Floats  # likewise
    ankle: Floats  # likewise
    shoulder: Floats  # likewise
    elbow: Floats  # likewise
    lean: Floats  # (n,) of the trunk: backwards, and its turn to the left
    thorax: Floats  # likewise
    turn: Floats  # (n,) of the pelvis: to the left, and how far its left is above its right
    tilt: Floats  # likewise
    forward: Floats  # (n,) where the pelvis is, from where one walks at an even speed and a height
    left: Floats  # likewise
    up: Floats  # likewise


def cycle_duration(relative_speed: Floats) -> Floats:
    """Return how long two steps take, leg lengths over speed ``1.346 / sqrt(v)``, for one leg length, s.

    Shapes: relative_speed (n,).

    Examples
    --------
    >>> cycle_duration(np.array([1.0, 4.0])).tolist()
    [1.346, 0.673]
    """
    return np.asarray(1.346 / np.sqrt(relative_speed))


def gait_at(phase: Floats, relative_speed: Floats) -> Gait:
    """Return the walk at phases and speeds.

    Shapes: phase (n,); relative_speed (n,).
    """
    v, both = relative_speed, np.stack([phase, phase + 0.5]) % 1.0
    slow, wave = np.minimum(v, 0.5), 2.0 * np.pi * phase
    duration = cycle_duration(v)
    support = 0.752 - 0.143 / duration
    lean = np.radians(8.0 * slow - 8.0 * slow**2) * (1.0 - np.sin(2.0 * wave - 0.2 * np.pi))
    ahead = -(0.084 * slow - 0.084 * slow**2) * np.sin(2.0 * (wave + 2.0 * np.pi * (0.625 - support)))
    return Gait(
        _joint("hip", both, v), _joint("knee", both, v), _joint("ankle", both, v),
        np.radians(3.0 - 9.88 * v * (0.5 + np.cos(2.0 * np.pi * both))), _joint("elbow", both, v), lean,
        -_joint("thorax", both[:1], v)[0], np.radians(4.0 * v * np.cos(wave)),
        np.radians(1.66 * v * _tilt(phase % 1.0)),
        ahead, -(0.128 * slow - 0.128 * slow**2) * np.sin(wave - 0.2 * np.pi),
        0.015 * v * (np.sin(2.0 * wave - 0.7 * np.pi) - 1.0),
    )  # fmt: skip


def _tilt(phase: Floats) -> Floats:
    """Return the tilt of the pelvis over its amplitude, at phases 0 to 1: down on the side that swings."""
    half = phase % 0.5
    first = np.cos(2.0 * np.pi * half * 10.0 / 3.0) - 1.0
    then = -np.cos(2.0 * np.pi * (half - 0.15) * 10.0 / 7.0) - 1.0
    return np.where(phase < 0.5, 1.0, -1.0) * np.where(half < 0.15, first, then)


def _joint(name: str, phase: Floats, speed: Floats) -> Floats:
    """Return an angle (m, n), rad, at phases (m, n) of 0 to 1 and speeds (n,)."""
    low, high = float(speed.min()), float(speed.max())
    speeds = np.linspace(low, high, _SPEEDS if high - low > 1e-6 else 1)
    at = (speed - low) / max(high - low, 1e-6) * (len(speeds) - 1)
    total = np.zeros(phase.shape)
    for i, one in enumerate(speeds.tolist()):
        share = np.maximum(1.0 - np.abs(at - i), 0.0)
        here = np.flatnonzero(share)
        total[:, here] += share[here] * _cubics(_control_points(name, one), phase[:, here])
    return np.asarray(np.radians(total))


def _cubics(points: list[tuple[float, float]], phase: Floats) -> Floats:
    """Return the values of monotone cubics of period 1 through points."""
    from scipy.interpolate import PchipInterpolator

    once = np.array(sorted(points))
    every = np.concatenate([once + np.array([shift, 0.0]) for shift in (-2.0, -1.0, 0.0, 1.0, 2.0)])
    return np.asarray(PchipInterpolator(*every.T)(phase))


def _control_points(name: str, v: float) -> list[tuple[float, float]]:
    """Return phases and angles, in degrees, between which a joint moves."""
    s, fast = 2.0 * min(v, 0.5), max(v - 1.3, 0.0) / 1.7
    quick = min(max(v - 0.5, 0.0) / 0.8, 1.0)
    support = 0.752 - 0.143 / float(cycle_duration(np.array(v)))
    if name == "hip":
        again = [(0.2 * fast - 0.1, 25.0 + 5.0 * fast)] if fast > 0.0 else []
        return [*again, (0.5, -15.0 * s), (0.9, 25.0 * s + 6.0 * fast)]
    if name == "knee":
        return [
            (0.17 - 0.05 * fast, 3.0 + 22.0 * fast), (0.4, 3.0), (0.75 - 0.05 * fast, 70.0 * s - 5.0 * fast),
            (1.0 - 0.03 * fast, 3.0 + 3.0 * fast),
        ]  # fmt: skip
    if name == "ankle":
        return [
            (0.0, -3.0 + 5.0 * fast), (0.08, -3.0 - 15.0 * s + 4.0 * fast),
            (0.5 - 0.1 * fast, -3.0 + 11.0 * s - 3.0 * fast),
            (support, -3.0 - 17.0 * s - 8.0 * fast), (0.85, -3.0 + 5.0 * fast),
        ]  # fmt: skip
    if name == "thorax":
        return [(0.1, 4.0 * v / 3.0), (0.4, -1.5 * v), (0.6, -4.0 * v / 3.0), (0.9, 1.5 * v)]
    return [
        (0.05, 3.0 + 3.0 * s + 8.0 * quick - 6.0 * fast),
        (0.5 + 0.01 * quick + 0.04 * fast, 3.0 + 17.0 * s + 24.0 * quick + 26.0 * fast),
        (0.9 - 0.1 * fast, 3.0 + 5.0 * s + 9.0 * quick - 6.0 * fast),
    ]  # fmt: skip
