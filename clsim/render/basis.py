"""A few filters per source that carry the responses of all its paths."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.filters import NoFilterError, band_filters
from clsim.errors import InputError
from clsim.paths.arrivals import arrivals
from clsim.paths.responses import Responses

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.render.occupied import ShortTimeSpectra
    from clsim.render.tracks import SceneTracks

MOST_FUNCTIONS = 40
_GRIDS = (129, 387)  # frequencies of a band at which responses are looked at: the first number that resolves them
_TIMES = 24  # instants of a run at which the paths of a pair are looked at, fewer where there are many pairs
_FRAMES = 48  # of all pairs, about
_ROWS = 1024  # responses of which the functions are made
_HELD_OUT = 4096  # responses at which they are checked
_MOST_GROUPS = 16  # pairs of source and receiver looked at
_MOST_PATHS = 4096  # of each
_EMPHASES = 5  # times that instants which are held badly are given more weight
_HOPELESS = 4.0  # times the bound, from which on another weight does not help
_QUIETEST = 1e-3  # weight of frequencies at which a signal has next to nothing
_FAINTEST = 1e-4  # energy of what is heard of a window, relative to its centre frequency, that is asked for
_MARGIN_DB = 1.0  # by which the functions are better than asked, so that unseen responses are as good
_FILTER_MARGIN_DB = 6.0  # by which the filters are better than that
_SEED = 20_160_914


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
        Most that each function adds to what is heard at any instant, relative to that.
    strengths : ndarray (K,)
        Root mean square of each weighted function over the nodes.
    loudness : ndarray (W,)
        Inverse of the energy that is heard of each short window of the signal, as a mean over the run.
    asked_db, error_db : float
        Asked and reached bound of the error of the sum of all paths at a receiver, in the root mean square over the
        spectrum of what sounds within some 40 ms, relative to that sum, dB.
    """

    nodes: Floats
    projection: Floats
    functions: Floats
    weight: Floats
    filters: Floats
    sizes: Floats
    strengths: Floats
    loudness: Floats
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
    energy : ndarray (W, F)
        Of short windows of the signal near them, relative to what sounds about the window.
    """

    low: float
    high: float
    frequencies: Floats
    energy: Floats

    @property
    def rest(self) -> Floats:
        """Energy (W,) of what sounds about each window, but not in it."""
        return np.asarray(np.maximum(1.0 - self.energy.sum(axis=1), 0.0))


def band_of(low: float, high: float, sound: ShortTimeSpectra, count: int = _GRIDS[0]) -> Band:
    """Return a signal's band from its short-time spectra; `low` and `high` in Hz."""
    high = max(high, low * (1.0 + 1e-6))
    grid = chebyshev_points(low, high, count)
    return Band(low, high, grid, sound.near(grid[::-1], low, high)[:, ::-1])


def chebyshev_points(low: float, high: float, count: int) -> Floats:
    """Return the Chebyshev points of the first kind of an interval, from high to low."""
    angle = math.pi * (np.arange(count) + 0.5) / count
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * np.cos(angle))


def flat_basis(frequency: float) -> Basis:
    """Return the basis that takes every response at one frequency; for real responses."""
    one = np.ones((1, 1))
    return Basis(
        np.array([frequency]), one, one, np.ones(1), one, np.ones(1), np.ones(1), np.ones(1), -math.inf, -math.inf
    )


def turning_basis(frequency: float, low: float, high: float, sampling_rate: float, error_db: float) -> Basis:
    """Return the basis that takes every complex response at one frequency, from `low` to `high` Hz."""
    allowed = 10 ** (error_db / 20)
    filters = band_filters(np.array([[1.0], [1.0j]]), low, high, sampling_rate, np.ones(2), np.max, allowed)
    return Basis(
        np.array([frequency]), np.eye(2), np.eye(2), np.ones(1), filters, np.ones(2), np.ones(2), np.ones(1),
        -math.inf, -math.inf,
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
        Asked bound of the sum of all paths, dB relative to what is heard.

    Raises
    ------
    InputError
        If responses change too fast over frequency for 387 points, 40 functions, or filters of 2049 taps.

    Notes
    -----
    Phases of paths are as good as random, so that what a receiver hears, and the error of it, are the roots of sums of
    squares over its paths. Responses are sampled over paths and instants of the run, likelier the stronger they are and
    weighted by how likely that was, so that sums over samples stand for those over paths. The functions are their
    singular vectors, real and imaginary parts side by side, weighted by what sounds at any moment: the best for the
    sum. Instants held worst are given more weight. They are then checked at other responses, and those of the instants
    held worst are added until all are within the error.
    """
    allowed = 10 ** ((error_db - _MARGIN_DB) / 20)
    for count in _GRIDS:
        rng, band, fine = np.random.default_rng(_SEED), band_at(count), band_at(3 * count)
        sampled = _sampled(tracks, source, fine, until, _ROWS, rng)
        if _unresolved(sampled) <= allowed:
            break
    else:
        raise _refused(source, error_db, band, f"{count} frequencies do not resolve what walls and beams do")
    held_out = _sampled(tracks, source, band, until, _HELD_OUT, rng)
    sampled = _Sample(band, sampled.responses[:, 1::3], sampled.first)
    count, rows = 1, _Rows.of(sampled)
    for attempt in itertools.count(1):
        found = _Functions.of(rows, count, allowed)
        while found.wrong(rows.sample).max() > allowed and count < MOST_FUNCTIONS:
            count += 1
            found = _Functions.of(rows, count, allowed)
        wrong = found.wrong(held_out)
        if wrong.max() <= allowed:
            break
        if count == MOST_FUNCTIONS:
            reached = 20.0 * math.log10(float(wrong.max()))
            why = f"{count} functions of frequency hold responses within {reached:.0f} dB"
            raise _refused(source, error_db, band, why)
        # What is held worst joins the rows; if that does not do, one more function is needed.
        rows = _Rows.of(rows.sample.with_frames(held_out, np.argsort(-wrong)[:3]))
        count += int(attempt % 2 == 0)
    try:
        return _designed(found, rows.sample, sampling_rate, error_db, float(wrong.max()))
    except NoFilterError as error:
        raise _refused(source, error_db, band, str(error)) from error


def _refused(source: int, error_db: float, band: Band, why: str) -> InputError:
    return InputError(
        "response_error_db",
        f"must be reached from {band.low:.0f} to {band.high:.0f} Hz, but for source {source} {error_db:g} dB is not: "
        f"{why}; ask for less, narrow the signal's band, or smooth what walls and beams do over frequency (shorter "
        "impulse responses)",
    )


def _unresolved(sample: _Sample) -> float:
    """Return the largest error of responses at 3 F frequencies as made of every third, Chebyshev points as well."""
    from scipy.fft import idct

    responses = sample.responses
    coefficients = _chebyshev_coefficients(responses[:, 1::3])
    coefficients[:, 0] *= 2.0
    made = idct(coefficients * responses.shape[1], type=2, n=responses.shape[1], axis=1)
    return float(sample.relative(made - responses).max())


def _designed(found: _Functions, sample: _Sample, sampling_rate: float, error_db: float, wrong: float) -> Basis:
    """Return functions as filters, scaled so that at no instant the gains of all paths add up to more than 1."""
    band, reached = sample.band, 20.0 * math.log10(max(wrong, 1e-15))
    flat = np.ptp(found.shapes.real) <= 10 ** (error_db / 20) * np.abs(found.shapes).max()
    if found.parts == len(found.shapes) == 1 and flat:
        loudest = band.frequencies[int(np.argmax(band.energy.max(axis=0)))]
        one = np.ones((1, 1))
        return Basis(
            np.array([loudest]), one, one, np.ones(1), one, np.ones(1), np.ones(1), sample.loudness(), error_db, reached
        )
    together = sample.by_frame(found.gains(sample.responses))
    scale = np.sqrt(together.max(axis=0))[:, None]
    shapes = found.shapes * scale
    sizes = sample.sizes(shapes, together / scale[:, 0] ** 2)
    order = np.argsort(-sizes, kind="stable")  # weak ones need fewer branches
    shapes, sizes, projection = shapes[order], sizes[order], (found.projection / scale)[order]
    importance = sample.importance
    filters = band_filters(
        _chebyshev_coefficients(shapes), band.low, band.high, sampling_rate, importance,
        lambda left: float(np.linalg.norm(sample.sizes(left, np.ones((len(sample.first), len(left)))))),
        10 ** ((error_db - _FILTER_MARGIN_DB) / 20),
    )  # fmt: skip
    nodes = found.nodes
    weight = importance[nodes] / math.sqrt(float(np.mean(importance[nodes] ** 2)))
    functions = _in_parts(shapes[:, nodes] * weight, found.parts)
    strengths = np.sqrt(np.sum(functions**2, axis=1) / len(nodes))
    return Basis(
        band.frequencies[nodes],
        projection,
        functions,
        weight,
        filters,
        sizes,
        strengths,
        sample.loudness(),
        error_db,
        reached,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Sample:
    """Responses (n, F) of paths at instants, relative to what is heard then, weighted by how many each stands for.

    A frame is an instant at one receiver; `first` is where the responses of each begin. The sum of squares over the
    rows of a frame is that over all of its paths.
    """

    band: Band
    responses: Floats | Complexes
    first: NDArray[np.int64]

    def by_frame(self, values: Floats | Complexes) -> Floats:
        """Return the sums of the squares of values (n, m) over each frame's rows."""
        return np.asarray(np.add.reduceat(values.real**2 + values.imag**2, self.first, axis=0))

    def heard(self) -> Floats:
        """Return the energy (frames, W) of what is heard of each window, and of what sounds about it."""
        return np.asarray(self.by_frame(self.responses) @ self.band.energy.T + self.band.rest)

    def loudness(self) -> Floats:
        """Return the inverse (W,) of the energy that is heard of each window, as a mean over the frames."""
        return np.asarray(np.mean(1.0 / np.maximum(self.heard(), _FAINTEST), axis=0))

    def relative(self, left: Floats | Complexes) -> Floats:
        """Return the largest error over all windows of each frame, of errors (n, F) of its rows."""
        return np.asarray(np.sqrt((self.by_frame(left) @ self.band.energy.T / self.heard()).max(axis=1)))

    def sizes(self, shapes: Floats | Complexes, together: Floats) -> Floats:
        """Return the most of what is heard that is carried by each function (K, F), of squared gains (frames, K)."""
        shares = np.abs(shapes) ** 2 @ self.band.energy.T  # (K, W)
        heard = self.heard()
        return np.sqrt([(np.outer(g, share) / heard).max() for g, share in zip(together.T, shares, strict=True)])

    @property
    def importance(self) -> Floats:
        """Weight (F,) of errors at each frequency: what sounds there in any window, relative to what is heard of it."""
        energy, count = self.band.energy, len(self.band.frequencies)
        weight = np.sqrt(np.minimum(count * energy, 1.0) * self.loudness()[:, None]).max(axis=0)
        return np.asarray(np.maximum(weight, _QUIETEST))

    def with_frames(self, other: _Sample, which: NDArray[np.int64]) -> _Sample:
        """Return the sample with some frames of another one."""
        rows, first, ends = [self.responses], [self.first], [*other.first[1:].tolist(), len(other.responses)]
        count = len(self.responses)
        for frame in which.tolist():
            part = other.responses[other.first[frame] : ends[frame]]
            rows.append(part)
            first.append(np.array([count]))
            count += len(part)
        together: Any = np.concatenate(rows)
        return _Sample(self.band, together, np.concatenate(first))


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """A sample, and its weighted responses as places (n, r) along axes (r, parts F) that hold them all."""

    sample: _Sample
    weight: Floats
    places: Floats
    axes: Floats

    @staticmethod
    def of(sample: _Sample) -> _Rows:
        """Return rows of responses; axes along which there is nothing but rounding are left out."""
        weight = sample.importance
        weighted = _in_parts(sample.responses * weight, 1 + int(np.iscomplexobj(sample.responses)))
        _, sizes, axes = np.linalg.svd(weighted, full_matrices=False)
        axes = axes[: max(int(np.count_nonzero(sizes > 1e-9 * sizes[0])), 1)]
        return _Rows(sample, weight, weighted @ axes.T, axes)

    @property
    def parts(self) -> int:
        return 1 + int(np.iscomplexobj(self.sample.responses))


@dataclass(frozen=True, slots=True, eq=False)
class _Functions:
    """Functions (K, F) over a band, indices (M,) of nodes, and the projection (K, parts M) from there."""

    shapes: Floats | Complexes
    nodes: NDArray[np.int64]
    projection: Floats

    @staticmethod
    def of(rows: _Rows, count: int, allowed: float) -> _Functions:
        """Return the functions that hold responses best."""
        frequencies, weight, first = len(rows.weight), rows.weight, rows.sample.first
        nodes = _spread(min(-(-2 * count // 8) * 8, frequencies), frequencies)
        # A tone is next to all there is: a node must lie on it.
        loudest = int(np.median(np.flatnonzero(weight >= weight.max())))
        nodes[np.argmin(np.abs(nodes - loudest))] = loudest
        emphasis = np.ones(len(first))
        lengths = np.diff([*first.tolist(), len(rows.places)])
        for _ in range(_EMPHASES):
            each = np.repeat(emphasis, lengths)[:, None]
            _, _, vectors = np.linalg.svd(each * rows.places, full_matrices=False)
            found = vectors[:count] @ rows.axes
            shapes: Floats | Complexes = found[:, :frequencies] / weight
            if rows.parts == 2:
                shapes = shapes + 1j * (found[:, frequencies:] / weight)
            weighted = _in_parts(shapes[:, nodes] * weight[nodes], rows.parts).T
            projection: Floats = np.asarray(np.linalg.pinv(weighted) * np.tile(weight[nodes], rows.parts))
            functions = _Functions(shapes, nodes, projection)
            wrong = functions.wrong(rows.sample)
            if not allowed < wrong.max() < _HOPELESS * allowed:
                break
            emphasis *= 1.0 + 3.0 * wrong / wrong.max()
        return functions

    @property
    def parts(self) -> int:
        return 1 + int(np.iscomplexobj(self.shapes))

    def gains(self, rows: Floats | Complexes) -> Floats:
        """Return the gains (n, K) of responses (n, F)."""
        return np.asarray(_in_parts(rows[:, self.nodes], self.parts) @ self.projection.T)

    def wrong(self, sample: _Sample) -> Floats:
        """Return the largest error over all windows of each frame of a sample, (frames,)."""
        return sample.relative(self.gains(sample.responses) @ self.shapes - sample.responses)


def _spread(count: int, among: int) -> NDArray[np.int64]:
    """Return indices of Chebyshev points that are nearly the Chebyshev points of a smaller number."""
    return np.round((np.arange(count) + 0.5) * among / count - 0.5).astype(np.int64)


def _in_parts(values: Floats | Complexes, parts: int) -> Floats:
    """Return real parts (..., M), followed by the imaginary ones for two parts."""
    return np.asarray(values.real if parts == 1 else np.concatenate([values.real, values.imag], axis=-1))


def _sampled(
    tracks: SceneTracks, source: int, band: Band, until: float, count: int, rng: np.random.Generator
) -> _Sample:
    """Return about `count` responses of a source's paths, at instants of the run."""
    responses = Responses(tracks.scene, band.frequencies)
    groups = [i for i, g in enumerate(tracks.groups) if g.source == source]
    if len(groups) > _MOST_GROUPS:
        groups = sorted(rng.choice(groups, _MOST_GROUPS, replace=False).tolist())
    instants = max(3, min(_TIMES, _FRAMES // max(len(groups), 1)))
    picked: list[Any] = []
    for i in groups:
        group, start, end = tracks.path_groups[i], tracks.groups[i].start, tracks.groups[i].end
        if len(start) > _MOST_PATHS:
            some = np.sort(rng.choice(len(start), _MOST_PATHS, replace=False))
            group, start, end = group.part(some), start[some], end[some]
        times = np.sort(rng.uniform(0.0, until, instants))
        times[[0, -1]] = 0.0, until
        found = arrivals(tracks.scene, group, times, tracks.motion, tracks.amplitude)
        heard = (times >= start[:, None]) & (times < end[:, None])
        level = np.where(heard, np.abs(found.gain), 0.0)
        for t in np.flatnonzero(level.any(axis=0)).tolist():
            rows, standing_for = _picked(level[:, t], -(-count // (len(groups) * instants)), rng)
            one = slice(t, t + 1)
            along = responses.along(group.part(rows), found.part(rows, one), times[one])[:, 0]
            picked.append(along * (np.sqrt(standing_for) / np.linalg.norm(level[:, t]))[:, None])
    if not picked:
        picked = [np.ones((1, len(band.frequencies)))]
    return _Sample(band, np.concatenate(picked), np.cumsum([0, *(len(rows) for rows in picked[:-1])]))


def _picked(level: Floats, count: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], Floats]:
    """Return about `count` paths, likelier the louder (P,) they are, and how many paths each stands for."""
    sounding = np.flatnonzero(level)
    if len(sounding) <= count:
        return sounding, np.ones(len(sounding))
    loud = level[sounding]
    chance = np.minimum(count * loud / loud.sum(), 1.0)
    for _ in range(8):
        sure = chance >= 1.0
        left = max(count - int(sure.sum()), 1)
        chance = np.where(sure, 1.0, np.minimum(left * loud / max(float(loud[~sure].sum()), 1e-300), 1.0))
    at = np.searchsorted(np.cumsum(chance), rng.random() + np.arange(math.floor(chance.sum())))
    at = np.unique(at[at < len(sounding)])
    return sounding[at], 1.0 / chance[at]


def _chebyshev_coefficients(values: Floats | Complexes) -> Floats | Complexes:
    """Return the coefficients (K, F) of polynomials from their values at Chebyshev points, high to low."""
    from scipy.fft import dct

    coefficients: Any = dct(values, type=2, axis=1) / values.shape[1]
    coefficients[:, 0] *= 0.5
    return np.asarray(coefficients)
