"""A few filters per source that carry the responses of all its paths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.filters import linear_phase_filters
from clsim.errors import InputError
from clsim.paths.arrivals import arrivals, responses

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.tracks import SceneTracks

MOST_FUNCTIONS = 40
_GRID = 129  # frequencies of a band at which responses are looked at
_TIMES = 24  # instants of a run at which paths are looked at
_ROWS = 512  # responses of which the functions are made
_HELD_OUT = 4096  # responses at which they are checked
_EMPHASES = 5  # times that responses which are held badly are given more weight
_QUIETEST = 0.01  # weight of frequencies at which a signal has next to nothing
_SEED = 20_160_914


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """K functions of frequency; a response is their sum with K gains.

    Attributes
    ----------
    nodes : ndarray (M,)
        Frequencies at which responses are taken, Hz.
    projection : ndarray (K, M)
        From responses at the nodes to gains.
    filters : ndarray (K, L)
        The functions as symmetric filters of odd length, about their middle tap.
    error_db : float
        Largest root mean square error of a response over the signal's spectrum, relative to the strongest arrival, dB.
    """

    nodes: Floats
    projection: Floats
    filters: Floats
    error_db: float

    def __len__(self) -> int:
        return len(self.projection)

    @property
    def half(self) -> int:
        """Taps on either side of the filters' middle."""
        return int(self.filters.shape[1] // 2)


def flat_basis(frequency: float) -> Basis:
    """Return the basis that takes every response at one frequency."""
    return Basis(np.array([frequency]), np.ones((1, 1)), np.ones((1, 1)), -math.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Where a signal has energy.

    Attributes
    ----------
    low, high : float
        Ends, Hz.
    frequencies : ndarray (F,)
        Chebyshev points from high to low, Hz.
    weight : ndarray (F,)
        Amplitude of the spectrum at them, relative to its largest; small ones raised.
    """

    low: float
    high: float
    frequencies: Floats
    weight: Floats


def band_of(low: float, high: float, frequencies: Floats, energy: Floats) -> Band:
    """Return a signal's band from its energy spectrum; `low` and `high` in Hz."""
    high = max(high, low * (1.0 + 1e-6))
    grid = chebyshev_points(low, high, _GRID)
    width = (high - low) / 64.0
    spectrum = np.array([energy[np.abs(frequencies - f) <= max(width, frequencies[1])].max(initial=0.0) for f in grid])
    weight = np.sqrt(spectrum / max(float(spectrum.max()), 1e-300))
    return Band(low, high, grid, np.maximum(weight, _QUIETEST))


def chebyshev_points(low: float, high: float, count: int) -> Floats:
    """Return the Chebyshev points of the first kind of an interval, from high to low."""
    angle = math.pi * (np.arange(count) + 0.5) / count
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * np.cos(angle))


def scene_basis(
    tracks: SceneTracks, source: int, band: Band, until: float, sampling_rate: float, error_db: float
) -> Basis:
    """Return the fewest functions that hold the responses of a source's paths within an error.

    Parameters
    ----------
    tracks : SceneTracks
        The paths and how they move.
    source : int
        Index of the source.
    band : Band
        Of its signal.
    until : float
        End of the run, s.
    sampling_rate : float
        Hz.
    error_db : float
        Asked bound, dB relative to the strongest arrival at the same receiver.

    Raises
    ------
    InputError
        If more than 40 functions would be needed.

    Notes
    -----
    Responses are sampled over all paths and the run, likelier the stronger they are; the functions are the singular
    vectors of these rows, weighted by the signal's spectrum, the worst held ones more. They are then checked at other
    responses, and those that they hold worst are added until all are within the error.
    """
    rng = np.random.default_rng(_SEED)
    rows = _sampled(tracks, source, band, until, _ROWS, rng)
    held_out = _sampled(tracks, source, band, until, _HELD_OUT, rng)
    allowed = 10 ** ((error_db - 1.0) / 20)
    count = 1
    while True:
        functions, nodes, projection = _functions(rows, count, allowed, band)
        while _error(rows, functions, nodes, projection, band).max() > allowed and count < MOST_FUNCTIONS:
            count += 1
            functions, nodes, projection = _functions(rows, count, allowed, band)
        wrong = _error(held_out, functions, nodes, projection, band)
        if wrong.max() <= allowed:
            break
        if count == MOST_FUNCTIONS:
            raise InputError(
                "response_error_db",
                f"must be reached by {MOST_FUNCTIONS} functions of frequency, but {error_db:g} dB needs more for "
                f"source {source}; ask for less, narrow the signal's band, or smooth the tables of walls and beams",
            )
        # What is held worst joins the rows; if that is little, one more function is needed.
        rows = np.concatenate([rows, held_out[np.argsort(-wrong)[:64]]])
        count += int(wrong.max() > 1.2 * allowed)
    reached = 20.0 * math.log10(max(float(wrong.max()), 1e-15))
    if len(functions) == 1 and np.ptp(functions) <= allowed * np.abs(functions).max():
        return Basis(*_flat(band), reached)
    # Scaled to gains of at most 1: what a function adds to any path is no more than the function itself.
    gains = np.abs(rows[:, nodes] @ projection.T).max(axis=0)[:, None]
    coefficients = _chebyshev_coefficients(functions * gains)
    filters = linear_phase_filters(coefficients, band.low, band.high, sampling_rate, error_db - 6.0, band.weight)
    return Basis(band.frequencies[nodes], projection / gains, filters, reached)


def _flat(band: Band) -> tuple[Floats, Floats, Floats]:
    """Return node, projection and filter of one function that is 1 everywhere: taken where the signal is loudest."""
    loudest = band.frequencies[int(np.argmax(band.weight))]
    return np.array([loudest]), np.ones((1, 1)), np.ones((1, 1))


def _sampled(
    tracks: SceneTracks, source: int, band: Band, until: float, count: int, rng: np.random.Generator
) -> Floats:
    """Return responses (count, F) of a source's paths relative to the strongest at the same receiver."""
    scene = tracks.scene
    groups = [i for i, g in enumerate(tracks.groups) if g.source == source]
    if len(groups) > 16:
        groups = sorted(rng.choice(groups, 16, replace=False).tolist())
    times = np.sort(rng.uniform(0.0, until, _TIMES))
    times[:2] = 0.0, until
    picked = []
    for i in groups:
        group = tracks.path_groups[i]
        member = tracks.groups[i]
        if len(member) > 4096:
            some = np.sort(rng.choice(len(member), 4096, replace=False))
            group, start, end = group.part(some), member.start[some], member.end[some]
        else:
            start, end = member.start, member.end
        found = arrivals(scene, group, times, tracks.motion, tracks.amplitude)
        heard = (times >= start[:, None]) & (times < end[:, None])
        level = np.where(heard, np.abs(found.gain), 0.0)
        strongest = np.full(len(times), max(float(level.max()), 1e-300))
        chance = (level / strongest).ravel()
        if not chance.any():
            continue
        share = -(-count // len(groups))
        chosen = rng.choice(
            len(chance), min(share, int(np.count_nonzero(chance))), replace=False, p=chance / chance.sum()
        )
        p, t = np.unravel_index(chosen, level.shape)
        for at in np.unique(t):
            mine = p[t == at]
            part, one = group.part(mine), times[at : at + 1]
            there = arrivals(scene, part, one, tracks.motion, tracks.amplitude)
            picked.append(responses(scene, part, there, one, band.frequencies)[:, 0] / strongest[at])
    return np.concatenate(picked) if picked else np.ones((1, len(band.frequencies)))


def _functions(rows: Floats, count: int, allowed: float, band: Band) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Return functions (count, F) for responses (n, F), indices of nodes, and the projection from them."""
    emphasis = np.ones(len(rows))
    for _ in range(_EMPHASES):
        _, _, shapes = np.linalg.svd(emphasis[:, None] * rows * band.weight, full_matrices=False)
        functions = shapes[:count] / band.weight
        nodes, projection = _projection(functions)
        wrong = _error(rows, functions, nodes, projection, band)
        if wrong.max() <= allowed:
            break
        emphasis *= 1.0 + 3.0 * wrong / wrong.max()
    return functions, nodes, projection


def _projection(functions: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return indices of about twice as many frequencies as functions, and the least squares from them to gains."""
    count = min(-(-2 * len(functions) // 8) * 8, functions.shape[1])
    nodes = np.round((np.arange(count) + 0.5) * functions.shape[1] / count - 0.5).astype(np.int64)
    return nodes, np.asarray(np.linalg.pinv(functions[:, nodes].T))


def _error(rows: Floats, functions: Floats, nodes: NDArray[np.int64], projection: Floats, band: Band) -> Floats:
    """Return the root mean square error of every response over the signal's spectrum, (n,)."""
    made = rows[:, nodes] @ projection.T @ functions
    return np.asarray(np.sqrt(np.mean(((made - rows) * band.weight) ** 2, axis=1) / np.mean(band.weight**2)))


def _chebyshev_coefficients(values: Floats) -> Floats:
    """Return the coefficients (K, F) of polynomials from their values at Chebyshev points, high to low."""
    from scipy.fft import dct

    coefficients = dct(values, type=2, axis=1) / values.shape[1]
    coefficients[:, 0] *= 0.5
    return np.asarray(coefficients)
