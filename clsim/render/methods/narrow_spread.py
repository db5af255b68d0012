"""The spread of a tone by motion, estimated from a sample of paths: whether an envelope at a low rate holds it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.render.envelope import MARGIN_DB, NarrowBand
from clsim.tracks.basis import flat_basis
from clsim.tracks.tracks import SceneTracks

BETA = 12.5  # of the Kaiser window that shows -110 dB beside a line
_ROWS, _STRETCHES = 3, 8  # paths of a pair, and stretches of the run, in which their motion is looked at
_STRETCH = 0.02  # s
# Samples of a stretch from one at which paths are solved to the next: what jumps bends the curves through all.
_BETWEEN = 8


def spread(
    tracks: SceneTracks, pair: int, narrow: NarrowBand, span: tuple[float, float, float], max_rate: float
) -> float:
    """Estimate the level of a carrier tone outside the envelope's band, relative to it, from a sample of paths."""
    from scipy.interpolate import CubicHermiteSpline, CubicSpline

    carrier, member = narrow.baseband.carrier, tracks.pairs[pair]
    fades = getattr(tracks.pair_paths[pair].family, "fades", None) is not None
    # What is farther off than the skirts is folded, and stays outside.
    shift, skirt = carrier * max_rate, narrow.half - narrow.flat
    rate = min(2.0 * (narrow.baseband.sampling_rate or 0.0), 8.0 * (shift + skirt))
    count, rng = math.ceil(_STRETCH * rate), np.random.default_rng(pair)
    rows = np.unique(np.append(0, rng.integers(0, len(tracks.pairs[pair]), _ROWS - 1)))
    window, worst = np.kaiser(count, BETA), 0.0
    outside = np.abs(np.fft.fftfreq(count, 1.0 / rate)) > shift + skirt
    begins = rng.uniform(0.0, max(span[2] - _STRETCH, 0.0), _STRETCHES)
    ends: Floats = np.arange(float(-(-count // _BETWEEN) + 1)) * (_BETWEEN / rate)
    now: Floats = np.arange(float(count)) / rate
    delays, rates, (gains, *_) = tracks.evaluate(pair, (begins[:, None] + ends).ravel(), flat_basis(carrier), rows)
    each: list[Any] = [x.reshape(len(rows), len(begins), -1) for x in (delays, rates, gains[0])]
    delays, gains = CubicHermiteSpline(ends, each[0], each[1], axis=2)(now), CubicSpline(ends, each[2], axis=2)(now)
    for k, begin in enumerate(begins.tolist()):
        delay, gain = delays[:, k], gains[:, k]
        audible = (begin - delay[:, 0] >= span[0] - _STRETCH) & (begin + _STRETCH - delay[:, -1] <= span[1] + _STRETCH)
        if fades:  # briefer ones belong to paths of a few milliseconds
            audible &= (member.start[rows] <= begin) & (begin + _STRETCH <= member.end[rows])
        spectrum = np.fft.fft((gain * np.exp(-2j * math.pi * carrier * delay) * window)[audible], axis=1)
        level = np.maximum(np.linalg.norm(spectrum, axis=1), 1e-300)
        worst = max(worst, float((np.linalg.norm(spectrum[:, outside], axis=1) / level).max(initial=0.0)))
    return worst * 10 ** (-MARGIN_DB / 20)
