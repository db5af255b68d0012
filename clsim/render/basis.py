"""A few filters per source that carry the responses of all its paths."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.filters import band_filters
from clsim.paths.arrivals import arrivals
from clsim.paths.responses import Responses, is_complex
from clsim.render.shortfall import WORST_DB, Held

if TYPE_CHECKING:
    from collections.abc import Callable

    from clsim.arrays import Complexes, Floats
    from clsim.render.tracks import SceneTracks

MOST_FUNCTIONS = 40
_GRIDS = (129, 387, 1161)  # frequencies of a band at which responses are looked at: the first number that resolves them
_TIMES = 24  # instants of a run at which paths are looked at
_ROWS = 512  # responses of which the functions are made
_HELD_OUT = 4096  # responses at which they are checked
_MOST_GROUPS = 16  # pairs of source and receiver looked at
_MOST_PATHS = 4096  # of each
_EMPHASES = 5  # times that responses which are held badly are given more weight
_QUIETEST = 0.01  # weight of frequencies at which a signal has next to nothing
_MARGIN_DB = 1.0  # by which the functions are better than asked, so that unseen responses are as good
_FILTER_MARGIN_DB = 6.0  # by which the filters are better than that
_SEED = 20_160_914
_LATEST = 0.012  # s between the earliest and the latest of responses that can be told
_MOST_DELAYS = 512  # samples of them
_LATE_ROWS = 64  # responses that tell it
_LATE_SHARE = 1e-4  # of their energy may lie earlier than the time of which the middle is taken, and later
_TURNED_DB = -80.0  # error from which on it is told that phases at one frequency are not held
_LEAST_LATE = 32  # samples; less is not worth being taken out


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """K functions of frequency; a response is their sum with K real gains.

    Attributes
    ----------
    nodes : ndarray (M,)
        Frequencies at which responses are taken, Hz.
    projection : ndarray (K, parts M)
        From responses at the nodes to gains; two parts, real and imaginary ones, for complex responses.
    functions : ndarray (K, parts M)
        The functions at the nodes, weighted like `weight`: what is left of a response without them was lost.
    weight : ndarray (M,)
        Of the nodes' frequencies, so that the mean square over nodes is that over the signal's spectrum.
    filters : ndarray (K, L)
        The functions as filters of odd length, about their middle tap.
    sizes : ndarray (K,)
        Most that each function adds to any path, relative to the strongest arrival.
    asked_db, error_db : float
        Asked (or, if that was told to be out of reach, reached) and reached bound of the root mean square error of a
        response over the signal's spectrum, relative to the strongest arrival at the same receiver, dB.
    """

    nodes: Floats
    projection: Floats
    functions: Floats
    weight: Floats
    filters: Floats
    sizes: Floats
    asked_db: float
    error_db: float

    def __len__(self) -> int:
        return len(self.projection)

    @property
    def parts(self) -> int:
        """1 for real responses, 2 for complex ones."""
        return int(self.projection.shape[1] // len(self.nodes))

    @property
    def half(self) -> int:
        """Taps on either side of the filters' middle."""
        return int(self.filters.shape[1] // 2)

    @property
    def at_one_frequency(self) -> bool:
        """Whether responses are taken at one frequency for all."""
        return len(self.nodes) == 1

    def gains(self, responses: Floats | Complexes) -> Floats:
        """Return the gains (..., K) of responses (..., M) at the nodes."""
        return np.asarray(_in_parts(responses, self.parts) @ self.projection.T)


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
    late : float
        Delay that is taken out of responses, s.
    """

    low: float
    high: float
    frequencies: Floats
    weight: Floats
    late: float = 0.0

    @property
    def turn(self) -> Complexes:
        """What the delay does at the frequencies, (F,)."""
        return np.asarray(np.exp(-2j * math.pi * self.late * self.frequencies))


def band_of(low: float, high: float, frequencies: Floats, energy: Floats, count: int = _GRIDS[0]) -> Band:
    """Return a signal's band from its energy spectrum; `low` and `high` in Hz."""
    high = max(high, low * (1.0 + 1e-6))
    grid = chebyshev_points(low, high, count)
    width = (high - low) / 64.0
    spectrum = np.array([energy[np.abs(frequencies - f) <= max(width, frequencies[1])].max(initial=0.0) for f in grid])
    weight = np.sqrt(spectrum / max(float(spectrum.max()), 1e-300))
    return Band(low, high, grid, np.maximum(weight, _QUIETEST))


def chebyshev_points(low: float, high: float, count: int) -> Floats:
    """Return the Chebyshev points of the first kind of an interval, from high to low."""
    angle = math.pi * (np.arange(count) + 0.5) / count
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * np.cos(angle))


def flat_basis(frequency: float) -> Basis:
    """Return the basis that takes every response at one frequency; for real responses."""
    one = np.ones((1, 1))
    return Basis(np.array([frequency]), one, one, np.ones(1), one, np.ones(1), -math.inf, -math.inf)


def turning_basis(source: int, frequency: float, band: Band, sampling_rate: float, error_db: float) -> Basis:
    """Return the basis that takes every complex response at one frequency, over a band."""
    filters = band_filters(np.array([[1.0], [1.0j]]), band.low, band.high, sampling_rate, error_db, band.weight)
    Held(source, band.low, band.high, sampling_rate, at_centre=True).within(max(error_db, _TURNED_DB), filters)
    return Basis(
        np.array([frequency]), np.eye(2), np.eye(2), np.ones(1), filters.taps, np.ones(2), -math.inf, -math.inf
    )  # fmt: skip


def scene_basis(
    tracks: SceneTracks,
    source: int,
    band_at: Callable[[int], Band],
    until: float,
    sampling_rate: float,
    error_db: float,
) -> Basis:
    """Return the fewest functions that hold the responses of a source's paths within an error.

    Parameters
    ----------
    tracks : SceneTracks
        The paths and how they move.
    source : int
        Index of the source.
    band_at : callable
        Returns the band of its signal at a number of frequencies.
    until : float
        End of the run, s.
    sampling_rate : float
        Hz.
    error_db : float
        Asked bound, dB relative to the strongest arrival at the same receiver.

    Raises
    ------
    InputError
        If responses change too fast over frequency for 1161 points, 40 functions, or filters of 2049 taps, and are not
        even held within -40 dB.

    Warns
    -----
    ClsimWarning
        If they are, but not within the asked error.

    Notes
    -----
    Responses are sampled over all paths and the run, likelier the stronger they are; the functions are the singular
    vectors of these rows, real and imaginary parts side by side, weighted by the signal's spectrum, the worst held ones
    more. They are then checked at other responses, and those that they hold worst are added until all are within the
    error. A delay that all responses have about in common is taken out, and given to the filters.
    """
    allowed = 10 ** ((error_db - _MARGIN_DB) / 20)
    late = _common_delay(tracks, source, band_at(_GRIDS[0]), until, sampling_rate)
    for count in _GRIDS:
        rng, band, fine = np.random.default_rng(_SEED), *(replace(band_at(n), late=late) for n in (count, 3 * count))
        sampled = _sampled(tracks, source, fine, until, _ROWS, rng)
        unresolved = _unresolved(sampled, fine.weight)
        if unresolved <= allowed:
            break
    held = Held(source, band.low, band.high, sampling_rate, len(band.frequencies), _in_db(unresolved))
    if held.resolved_db > WORST_DB:
        held.within(error_db)
    held_out, rows = _sampled(tracks, source, band, until, _HELD_OUT, rng), _Rows.of(sampled[:, 1::3], band)
    count = 1
    for attempt in itertools.count(1):
        found = _Functions.of(rows, count, allowed)
        while found.wrong(rows.responses).max() > allowed and count < MOST_FUNCTIONS:
            count += 1
            found = _Functions.of(rows, count, allowed)
        wrong = found.wrong(held_out)
        if wrong.max() <= allowed or count == MOST_FUNCTIONS:
            break
        # What is held worst joins the rows; if that is little, one more function is needed.
        rows = _Rows.of(np.concatenate([rows.responses, held_out[np.argsort(-wrong)[:64]]]), band)
        count += int(wrong.max() > 1.2 * allowed or attempt % 3 == 0)
    held = replace(held, functions=count, functions_db=_in_db(float(wrong.max())))
    return _designed(found, rows.responses, band, error_db, held)


def _in_db(ratio: float) -> float:
    return 20.0 * math.log10(max(ratio, 1e-15))


def _common_delay(tracks: SceneTracks, source: int, band: Band, until: float, sampling_rate: float) -> float:
    """Return the middle of the time in which complex responses have nearly all their energy, s, in whole samples.

    It is 0 where that is little, and for real responses, which have no delay.
    """
    if not is_complex(tracks.scene):
        return 0.0
    width = band.high - band.low
    count = int(np.clip(math.ceil(_LATEST * width), 64, _MOST_DELAYS))
    even = np.linspace(band.low, band.high, count)
    weight = np.interp(even, band.frequencies[::-1], band.weight[::-1]) * np.hanning(count)
    spread = Band(band.low, band.high, even, weight)
    rows = _sampled(tracks, source, spread, until, _LATE_ROWS, np.random.default_rng(_SEED))
    energy = np.sum(np.abs(np.fft.ifft(rows * weight, axis=1)) ** 2, axis=0)
    # The transform goes round: time begins opposite to where most of the energy is, which is late rather than early.
    turns = np.angle(energy @ np.exp(2j * math.pi * np.arange(count) / count)) / (2.0 * math.pi)
    begin = round((turns + (turns < -0.25) - 0.5) * count)
    below = np.cumsum(np.roll(energy, -begin)) / max(float(energy.sum()), 1e-300)
    middle = begin + 0.5 * float(np.searchsorted(below, [_LATE_SHARE, 1.0 - _LATE_SHARE]).sum())
    samples = round(middle * sampling_rate * (count - 1) / count / width)
    return samples / sampling_rate if abs(samples) >= _LEAST_LATE else 0.0


def _unresolved(responses: Floats | Complexes, weight: Floats) -> float:
    """Return the largest error of responses (n, 3 F) as made of every third, which are Chebyshev points too."""
    from scipy.fft import idct

    coefficients = _chebyshev_coefficients(responses[:, 1::3])
    coefficients[:, 0] *= 2.0
    made = idct(coefficients * responses.shape[1], type=2, n=responses.shape[1], axis=1)
    wrong = np.sqrt(np.mean(np.abs((made - responses) * weight) ** 2, axis=1) / np.mean(weight**2))
    return float(wrong.max())


def _designed(found: _Functions, rows: Floats | Complexes, band: Band, error_db: float, held: Held) -> Basis:
    """Return functions as filters, scaled to gains of at most 1: what each adds to a path is at most its own size."""
    reached = held.functions_db
    flat = np.ptp(found.shapes.real) <= 10 ** (error_db / 20) * np.abs(found.shapes).max()
    if found.parts == len(found.shapes) == 1 and flat:
        loudest = band.frequencies[int(np.argmax(band.weight))]
        one = np.ones((1, 1))
        return Basis(np.array([loudest]), one, one, np.ones(1), one, np.ones(1), error_db, reached)
    scale = np.abs(found.gains(rows)).max(axis=0)[:, None]
    shapes = found.shapes * scale
    sizes = (np.abs(shapes) * band.weight).max(axis=1)
    order = np.argsort(-sizes, kind="stable")  # weak ones need fewer branches
    shapes, sizes, projection = shapes[order], sizes[order], (found.projection / scale)[order]
    filters = band_filters(
        _chebyshev_coefficients(shapes), band.low, band.high, held.sampling_rate, error_db - _FILTER_MARGIN_DB,
        band.weight, round(band.late * held.sampling_rate),
    )  # fmt: skip
    reached = held.within(error_db, filters)
    nodes = found.nodes
    if band.late != 0.0:  # the delay that was taken out of responses is put back
        shapes = shapes * band.turn
        projection = np.asarray(np.linalg.pinv(_in_parts(shapes[:, nodes], found.parts).T))
    weight = band.weight[nodes] / math.sqrt(float(np.mean(band.weight[nodes] ** 2)))
    functions = _in_parts(shapes[:, nodes] * weight, found.parts)
    asked_db = max(error_db, reached)  # what is told already needs no other warning
    return Basis(band.frequencies[nodes], projection, functions, weight, filters.taps, sizes, asked_db, reached)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Sampled responses (n, F), and the same weighted as places (n, r) along axes (r, parts F) that hold them all."""

    band: Band
    responses: Floats | Complexes
    places: Floats
    axes: Floats

    @staticmethod
    def of(responses: Floats | Complexes, band: Band) -> _Rows:
        """Return rows of responses; axes along which there is nothing but rounding are left out."""
        weighted = _in_parts(responses * band.weight, 1 + int(np.iscomplexobj(responses)))
        _, sizes, axes = np.linalg.svd(weighted, full_matrices=False)
        axes = axes[: max(int(np.count_nonzero(sizes > 1e-9 * sizes[0])), 1)]
        return _Rows(band, responses, weighted @ axes.T, axes)

    @property
    def parts(self) -> int:
        return 1 + int(np.iscomplexobj(self.responses))


@dataclass(frozen=True, slots=True, eq=False)
class _Functions:
    """Functions (K, F) over a band, indices (M,) of nodes, and the projection (K, parts M) from there."""

    band: Band
    shapes: Floats | Complexes
    nodes: np.ndarray[tuple[int], np.dtype[np.int64]]
    projection: Floats

    @staticmethod
    def of(rows: _Rows, count: int, allowed: float) -> _Functions:
        """Return the functions that hold responses best."""
        frequencies, weight = len(rows.band.weight), rows.band.weight
        nodes = _spread(min(-(-2 * count // 8) * 8, frequencies), frequencies)
        # A tone is next to all there is: a node must lie on it.
        loudest = int(np.median(np.flatnonzero(weight >= weight.max())))
        nodes[np.argmin(np.abs(nodes - loudest))] = loudest
        emphasis = np.ones(len(rows.places))
        for _ in range(_EMPHASES):
            _, _, vectors = np.linalg.svd(emphasis[:, None] * rows.places, full_matrices=False)
            found = vectors[:count] @ rows.axes
            shapes: Floats | Complexes = found[:, :frequencies] / weight
            if rows.parts == 2:
                shapes = shapes + 1j * (found[:, frequencies:] / weight)
            projection = np.asarray(np.linalg.pinv(_in_parts(shapes[:, nodes], rows.parts).T))
            functions = _Functions(rows.band, shapes, nodes, projection)
            wrong = functions.wrong(rows.responses)
            if wrong.max() <= allowed:
                break
            emphasis *= 1.0 + 3.0 * wrong / wrong.max()
        return functions

    @property
    def parts(self) -> int:
        return 1 + int(np.iscomplexobj(self.shapes))

    def gains(self, rows: Floats | Complexes) -> Floats:
        """Return the gains (n, K) of responses (n, F)."""
        return np.asarray(_in_parts(rows[:, self.nodes], self.parts) @ self.projection.T)

    def wrong(self, rows: Floats | Complexes) -> Floats:
        """Return the root mean square error of every response over the signal's spectrum, (n,)."""
        left = np.abs(self.gains(rows) @ self.shapes - rows) * self.band.weight
        return np.asarray(np.sqrt(np.mean(left**2, axis=1) / np.mean(self.band.weight**2)))


def _spread(count: int, among: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return indices of Chebyshev points that are nearly the Chebyshev points of a smaller number."""
    return np.round((np.arange(count) + 0.5) * among / count - 0.5).astype(np.int64)


def _in_parts(values: Floats | Complexes, parts: int) -> Floats:
    """Return real parts (..., M), followed by the imaginary ones for two parts."""
    return np.asarray(values.real if parts == 1 else np.concatenate([values.real, values.imag], axis=-1))


def _sampled(
    tracks: SceneTracks, source: int, band: Band, until: float, count: int, rng: np.random.Generator
) -> Floats | Complexes:
    """Return responses (count, F) of a source's paths relative to the strongest at the same receiver."""
    responses = Responses(tracks.scene, band.frequencies)
    groups = [i for i, g in enumerate(tracks.groups) if g.source == source]
    if len(groups) > _MOST_GROUPS:
        groups = sorted(rng.choice(groups, _MOST_GROUPS, replace=False).tolist())
    times = np.sort(rng.uniform(0.0, until, _TIMES))
    times[[0, -1]] = 0.0, until
    picked: list[Any] = []
    for i in groups:
        group, start, end = tracks.path_groups[i], tracks.groups[i].start, tracks.groups[i].end
        if len(start) > _MOST_PATHS:
            some = np.sort(rng.choice(len(start), _MOST_PATHS, replace=False))
            group, start, end = group.part(some), start[some], end[some]
        found = arrivals(tracks.scene, group, times, tracks.motion, tracks.amplitude)
        heard = (times >= start[:, None]) & (times < end[:, None])
        level = np.where(heard, np.abs(found.gain), 0.0)
        loudest = float(level.max())
        if loudest == 0.0:
            continue
        most = min(-(-count // len(groups)), int(np.count_nonzero(level)))
        chosen = rng.choice(level.size, most, replace=False, p=level.ravel() / level.sum())
        p, t = np.unravel_index(chosen, level.shape)
        for at in np.unique(t):
            one, rows = slice(at, at + 1), p[t == at]
            along = responses.along(group.part(rows), found.part(rows, one), times[one])[:, 0] / loudest
            picked.append(along * np.conj(band.turn) if band.late != 0.0 else along)
    return np.concatenate(picked) if picked else np.ones((1, len(band.frequencies)))


def _chebyshev_coefficients(values: Floats | Complexes) -> Floats | Complexes:
    """Return the coefficients (K, F) of polynomials from their values at Chebyshev points, high to low."""
    from scipy.fft import dct

    coefficients: Any = dct(values, type=2, axis=1) / values.shape[1]
    coefficients[:, 0] *= 0.5
    return np.asarray(coefficients)
