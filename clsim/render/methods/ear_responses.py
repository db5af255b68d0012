"""Responses of receivers whose channels differ over frequency: spectra by direction, and how fast these turn."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from clsim.arrays import Complexes, Floats
from clsim.scene.directivity.directivity import ChannelDirectivity

LAGRANGE, BEFORE = 6, 2  # from which responses between two of them are made, and how many lie before both
_TURNS = (0.025, 0.0175, 0.0125, 0.00875, 0.006, 0.004)  # rad between nodes, tried in this order
_TURN_ERROR_DB = -92.0  # of responses between nodes, relative to them, over random great circles
_CIRCLES = 24
_SIZES = (2048, 8192, 32768, 131072)  # samples in which impulse responses are looked for
_MOST_PIECES = 9  # of a segment, between sudden changes of directions
_FADE = 1.0 / 12.0  # of the sampling rate, over which responses fade out above the band
_POWERS = 16  # of a bin's phase factor that are worked out at a time
_QUIET = 1e-10  # of their energy, that is cut off at either end


@dataclass(frozen=True, slots=True, eq=False)
class EarResponses:
    """Responses of a receiver's channels within a band at a sampling rate."""

    directivity: ChannelDirectivity
    speed_of_sound: float  # m/s
    rate: float  # Hz
    band: float  # Hz, from which on to half the sampling rate responses are faded out
    before: int  # samples that a response lasts before the centre's time
    after: int
    turn: float  # rad from node to node

    def spectra(self, directions: Floats, size: int, kind: Any) -> Complexes:
        """Return the responses (..., C, F) of a kind of number at a transform's first bins, by direction (..., 3)."""
        step, fade = self.fade(size)
        return self.at_multiples(directions, step, fade.astype(np.empty(0, kind).real.dtype))

    def fade(self, size: int) -> tuple[float, Floats]:
        """Return the first frequency of a transform, Hz, and the factors (F,) by which responses fade out beyond."""
        step, end = self.rate / size, min(self.band + _FADE * self.rate, 0.5 * self.rate)
        share = (step * np.arange(math.ceil(end / step)) - self.band) / (end - self.band)
        return step, np.cos(0.5 * math.pi * np.clip(share, 0.0, 1.0)) ** 2

    def at_multiples(self, directions: Floats, step: float, weights: Floats) -> Complexes:
        """Return weighted responses (..., C, F) at multiples of a frequency from 0 Hz on, by direction (..., 3)."""
        count, directivity, c = len(weights), self.directivity, self.speed_of_sound
        frequencies = np.clip(step * np.arange(count), *directivity.band)
        gain = directivity.aligned(directions, frequencies, c, range(len(directivity.channels)))
        angle = -2.0j * math.pi * step * directivity.lateness(directions, c)[..., None]
        # Products of few powers: exponential functions would take most of the time.
        coarse, fine = (np.exp(angle * k) for k in (_POWERS * np.arange(-(-count // _POWERS)), np.arange(_POWERS)))
        kind = np.result_type(weights, np.complex64)
        turned = coarse.astype(kind)[..., None] * fine.astype(kind)[..., None, :]
        out = turned.reshape(*angle.shape[:-1], -1)[..., :count] * weights
        out *= np.moveaxis(gain, 0, -2)
        return np.asarray(out)


@lru_cache(maxsize=32)
def ear_responses(directivity: ChannelDirectivity, speed_of_sound: float, rate: float, band: float) -> EarResponses:
    """Return a receiver's responses, with their length and the angle between nodes as measured at some directions."""
    from scipy.fft import irfft

    drawn = np.random.default_rng(0).standard_normal((2, _CIRCLES, 3))
    axis = drawn[0] / np.linalg.norm(drawn[0], axis=1, keepdims=True)
    across = np.cross(axis, drawn[1])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    made = EarResponses(directivity, speed_of_sound, rate, min(band, 0.49 * rate), 0, 0, 0.0)
    for size in _SIZES:
        impulses = irfft(made.spectra(axis, size, np.complex128), size, axis=-1)
        energy = np.cumsum(np.roll(np.sum(impulses**2, axis=(0, 1)), size // 2))
        edges = np.searchsorted(energy, energy[-1] * np.array([_QUIET, 1.0 - _QUIET])) - size // 2
        if np.abs(edges).max() < 0.4 * size:
            break
    for turn in _TURNS:
        angle = turn * np.append(np.arange(LAGRANGE) - 1.0 * BEFORE, 0.5)[:, None]
        towards = axis[:, None] * np.cos(angle) + across[:, None] * np.sin(angle)
        found = made.at_multiples(towards, made.band / 64, np.ones(65))  # (circles, nodes, C, F)
        wrong = np.tensordot(found[:, :-1], lagrange_weights(np.array([BEFORE + 0.5]))[:, 0], ([1], [0])) - found[:, -1]
        if np.linalg.norm(wrong) <= 10 ** (_TURN_ERROR_DB / 20.0) * np.linalg.norm(found[:, -1]):
            break
    return replace(made, before=max(int(-edges[0]), 0), after=max(int(edges[1]), 0), turn=turn)


def lagrange_weights(places: Floats) -> Floats:
    """Return Lagrange's weights (LAGRANGE, n) of nodes 0, 1 and so on at places (n,)."""
    nodes, same = np.arange(LAGRANGE), np.eye(LAGRANGE)[..., None]
    factors = (places - nodes[:, None]) / np.where(same, 1.0, (nodes[:, None] - nodes)[..., None])
    return np.asarray(np.where(same, 1.0, factors).prod(axis=1))


def between_jumps(jumps: Floats, first: int, count: int) -> list[Floats | None]:
    """Return samples (P, 2) between which paths do not jump (P, Q), for as many pieces as lie in some samples.

    Where there are very many jumps they are small, and not looked at.
    """
    edges = np.pad(jumps, ((0, 0), (1, 1)), constant_values=((0, 0), (-np.inf, np.inf)))
    low = np.count_nonzero(jumps <= first, axis=1)
    most = int((np.count_nonzero(jumps < first + count, axis=1) - low).max(initial=0)) + 1
    if jumps.shape[1] == 0 or most > _MOST_PIECES:
        return [None]
    starts = np.minimum(low[:, None] + np.arange(most), jumps.shape[1])
    pieces = np.stack([np.take_along_axis(edges, starts + i, axis=1) for i in range(2)], axis=-1)
    pieces[starts - low[:, None] > np.count_nonzero(jumps < first + count, axis=1)[:, None] - low[:, None]] = np.inf
    return list(pieces.swapaxes(0, 1))
