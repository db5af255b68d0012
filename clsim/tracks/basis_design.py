"""Design of a few filters per source that represent the responses of all its paths, and their residual."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.errors import InputError, warn
from clsim.numerics.band_filters import LONGEST, BandFilters, band_filters
from clsim.tracks.basis import Band, Basis, Sample, flat_basis, in_parts, parts_of
from clsim.tracks.picked import Draw

MOST_FUNCTIONS = 256  # a rod of 30 cm over 20 to 60 kHz takes 60, ears of 512 samples at 44.1 kHz that turn take 240
_TURNED_DB = -80.0  # error from which on it is told that phases at one frequency are not held
_EMPHASES = 5  # times that instants which are held badly are given more weight
_HOPELESS = 4.0  # times the bound, from which on another weight does not help
_WIDE = 4.0  # times the lower end of a band, from which on its upper end asks for a grid that is looked for by few
_OF_FEW = 0.3  # times the bound, up to which few instants tell of all
_ROUNDING = 1e-9  # of the largest singular value, below which there is nothing but rounding
_LARGE, _SUMS = 256, (32, 96)  # rows and columns, beyond which their range is that of so many random sums
_SEVERAL = 4  # parts of a sample, from which on one is looked at before the others
_MARGIN_DB = 1.0  # by which the functions are better than asked, so that unseen responses are as good
_FILTER_MARGIN_DB = 6.0  # by which the filters are better than that


def turning_basis(source: int, frequency: float, band: Band, sampling_rate: float, error_db: float) -> Basis:
    """Return the basis that takes every complex response at one frequency, over a band."""
    sample = Sample(band, np.ones((1, len(band.frequencies))), np.zeros(1, dtype=np.int64), np.zeros(1))
    filters = band_filters(
        np.array([[1.0], [1.0j]]), band.low, band.high, sampling_rate, sample.importance, sample.left,
        10 ** (error_db / 20),
    )  # fmt: skip
    Held(source, band.low, band.high, sampling_rate, at_centre=True).within(max(error_db, _TURNED_DB), filters)
    flat, both, ones = flat_basis(frequency), np.eye(2), np.ones(2)
    return replace(flat, projection=both, functions=both, filters=filters.taps, sizes=ones, strengths=ones)


def scene_basis(
    drawn: Draw, band_at: Callable[[int], Band], sampling_rate: float, error_db: float, paired: bool = False,
    option: str = "response_error_db",
) -> Basis:  # fmt: skip
    """Return the fewest functions that hold the responses of a source's paths within an error.

    Phases of paths are as good as random, so that what a receiver hears, and the error of it, are the roots of sums of
    squares over its paths. Responses are sampled over paths and instants of the run, likelier the stronger they are and
    weighted by how likely that was, so that sums over samples stand for those over paths. The functions are their
    singular vectors, real and imaginary parts side by side, weighted by what sounds at any moment: the best for the
    sum. Instants held worst are given more weight. They are then checked at other responses, and those of the instants
    held worst are added until all are within the error. A delay that all responses have about in common is taken out,
    and given to the filters. `Basis.paired` functions are singular vectors of complex responses, each also times j.
    """
    allowed = 10 ** ((error_db - _MARGIN_DB) / 20)
    late = drawn.common_delay(band_at(drawn.grids[0]), sampling_rate)
    for count in drawn.grids:
        band, fine = (replace(band_at(n), late=late) for n in (count, 3 * count))
        few = drawn if drawn.whole and band.high <= _WIDE * band.low else drawn.probe()
        if few is drawn and len(drawn.rows) > _SEVERAL and count < drawn.grids[-1]:
            sampled = replace(drawn, rows=drawn.rows[:1]).responses(fine)
            if float(sampled.relative(_unresolved(sampled.responses)).max()) > allowed:
                continue  # the others need not be looked at
        sampled = few.responses(fine)
        unresolved = float(sampled.relative(_unresolved(sampled.responses)).max())
        if unresolved <= (allowed if few is drawn else _OF_FEW * allowed):
            break
    held = Held(
        drawn.source, band.low, band.high, sampling_rate, len(band.frequencies), _in_db(unresolved), option=option
    )
    if held.resolved_db > WORST_DB:
        held.within(error_db)
    thirds = replace(sampled, band=band, responses=sampled.responses[:, 1::3].copy())
    every = thirds if few is drawn else drawn.responses(band)
    if drawn.whole:
        sampled, held_out = (every.frames(np.s_[i::2] if len(every.first) > 1 else np.s_[:]) for i in (0, 1))
    else:
        sampled, held_out = every, drawn.responses(band, held_out=True)
    rows, step = _Rows.of(sampled, paired), 1 + int(paired)
    count = rows.least(_HOPELESS * allowed)
    for attempt in itertools.count(1):
        found = _Functions.of(rows, count, allowed)
        while found.worst > allowed and count < MOST_FUNCTIONS:
            count += step
            found = _Functions.of(rows, count, allowed)
        wrong = held_out.wrong(found.left(held_out.responses), found.nodes)
        if wrong.max() <= allowed or count == MOST_FUNCTIONS:
            break
        # What is held worst joins the rows; if that does not do, one more function is needed.
        rows = _Rows.of(rows.sample.with_frames(held_out, np.argsort(-wrong)[:3]), paired)
        count += step * int(attempt % 2 == 0)
    held = replace(held, functions=count, functions_db=_in_db(float(wrong.max())))
    return _designed(found, rows.sample, error_db, held, paired)


def _in_db(ratio: float) -> float:
    return 20.0 * math.log10(max(ratio, 1e-15))


def _unresolved(responses: Floats | Complexes) -> Floats | Complexes:
    """Errors of responses (n, 3 F) as made of every third, Chebyshev points as well."""
    from scipy.fft import idct

    coefficients = _chebyshev_coefficients(responses[:, 1::3])
    coefficients[:, 0] *= 2.0
    coefficients *= responses.shape[1]
    made: Any = idct(coefficients, type=2, n=responses.shape[1], axis=1)
    made -= responses
    return np.asarray(made)


def _designed(found: _Functions, sample: Sample, error_db: float, held: Held, paired: bool) -> Basis:
    """Return functions as filters, scaled so that at no instant the gains of all paths add up to more than 1."""
    band, loudness = sample.band, sample.loudness()
    flat = np.ptp(found.shapes.real) <= 10 ** (error_db / 20) * np.abs(found.shapes).max()
    if parts_of(found.shapes) == len(found.shapes) == 1 and flat:
        loudest = band.frequencies[int(np.argmax(band.energy.max(axis=0)))]
        flat_one = replace(flat_basis(loudest), loudness=loudness, tilt=band.tilt)
        return replace(flat_one, requested_db=error_db, error_db=held.functions_db)
    together = sample.by_frame(found.gains(sample.responses))
    if paired:
        together = np.maximum(together[:, ::2], together[:, 1::2]).repeat(2, axis=1)
    loudest_of = together.max(axis=0)
    scale = np.sqrt(np.where(loudest_of > 0.0, loudest_of, 1.0))[:, None]  # nothing may be loud at instants of a sample
    sizes = sample.sizes(found.shapes * scale, together / scale[:, 0] ** 2)
    order = np.argsort(-sizes, kind="stable")  # weak ones need fewer branches
    shapes, sizes, nodes, importance = (found.shapes * scale)[order], sizes[order], found.nodes, sample.importance
    filters = band_filters(
        _chebyshev_coefficients(shapes), band.low, band.high, held.sampling_rate, importance, sample.left,
        10 ** ((error_db - _FILTER_MARGIN_DB) / 20), round(band.late * held.sampling_rate),
    )  # fmt: skip
    reached = held.within(error_db, filters)
    if band.late != 0.0:  # the delay that was taken out of responses is put back
        shapes = shapes * band.turn
    projection = _projection(shapes, nodes, importance)
    weight = importance[nodes] / math.sqrt(float(np.mean(importance[nodes] ** 2)))
    functions = in_parts(shapes[:, nodes] * weight, parts_of(found.shapes))
    strengths = np.sqrt(np.sum(functions**2, axis=1) / len(nodes))
    requested_db = max(error_db, reached)  # what is told already needs no other warning
    return Basis(
        band.frequencies[nodes], projection, functions, weight, filters.taps, sizes, strengths, loudness, requested_db,
        reached, paired, band.tilt, held.option,
    )  # fmt: skip


def _projection(shapes: Floats | Complexes, nodes: NDArray[np.int64], weight: Floats) -> Floats:
    """Return the matrix from responses at nodes to gains (K, parts M), by weighted least squares."""
    parts = parts_of(shapes)
    weighted = in_parts(shapes[:, nodes] * weight[nodes], parts).T
    return np.asarray(np.linalg.pinv(weighted) * np.tile(weight[nodes], parts))


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """A sample, and its weighted responses as places (n, r) along axes that hold them all.

    Axes (r, parts F) are those of real and imaginary parts side by side, or complex ones (r, F) of `paired` functions.
    """

    sample: Sample
    weight: Floats
    places: Floats | Complexes
    axes: Floats | Complexes
    paired: bool

    @staticmethod
    def of(sample: Sample, paired: bool) -> _Rows:
        """Return rows of responses; axes along which there is nothing but rounding are left out."""
        weight = sample.importance
        weighted: Any = sample.responses * weight
        if not paired:
            weighted = in_parts(weighted, parts_of(sample.responses))
        sizes, axes = _axes(_square(weighted))
        axes = axes[: max(int(np.count_nonzero(sizes > _ROUNDING * sizes[0])), 1)]
        return _Rows(sample, weight, weighted @ axes.conj().T, axes, paired)

    def shapes(self, vectors: Floats | Complexes, count: int) -> Floats | Complexes:
        """Return functions (K, F) by the first vectors along the axes: one for each, or two that are paired."""
        frequencies = len(self.weight)
        if self.paired:
            one = vectors[: count // 2] @ self.axes / self.weight
            return np.stack([one, 1j * one], axis=1).reshape(-1, frequencies)
        found = vectors[:count] @ self.axes
        shapes: Any = found[:, :frequencies] / self.weight
        turned = found[:, frequencies:]
        return np.asarray(shapes + 1j * (turned / self.weight) if turned.size else shapes)

    def least(self, allowed: float) -> int:
        """Return a number of functions below which the mean error of all rows is above what is allowed, at least 1."""
        sizes = np.linalg.norm(self.places, axis=0)  # along singular vectors, falling
        left = np.sqrt(np.cumsum(sizes[::-1] ** 2))[::-1] / max(float(np.linalg.norm(sizes)), 1e-300)
        count = np.count_nonzero(left > allowed) * (1 + int(self.paired))
        return int(np.clip(count, 1 + int(self.paired), MOST_FUNCTIONS))


@dataclass(frozen=True, slots=True, eq=False)
class _Functions:
    """Functions (K, F) over a band, indices (M,) of nodes, and the projection (K, parts M) from there."""

    shapes: Floats | Complexes
    nodes: NDArray[np.int64]
    projection: Floats
    worst: float = math.inf  # largest error over all windows and frames of the rows

    @staticmethod
    def of(rows: _Rows, count: int, allowed: float) -> _Functions:
        frequencies, weight, first = len(rows.weight), rows.weight, rows.sample.first
        # Devices take them eight at a time. Of paired functions, complex responses at as many determine both.
        own = count // (1 + int(rows.paired))
        nodes = _spread(min(-(-2 * own // 8), frequencies // 8) * 8, frequencies)
        # A tone is next to all there is: a node must lie on it.
        loudest = int(np.median(np.flatnonzero(weight >= weight.max())))
        nodes[np.argmin(np.abs(nodes - loudest))] = loudest
        emphasis, worst = np.ones(len(first)), math.inf
        lengths = np.diff([*first.tolist(), len(rows.places)])
        for more in range(_EMPHASES, 0, -1):
            each = np.repeat(emphasis, lengths)[:, None]
            _, _, vectors = np.linalg.svd(_square(each * rows.places), full_matrices=False)
            shapes = rows.shapes(vectors, count)
            functions = _Functions(shapes, nodes, _projection(shapes, nodes, weight))
            wrong, before = functions.error(rows), worst
            worst = float(wrong.max())
            # As it falls from one weight to the next, it may not come down to what is allowed.
            hopeless = worst * (worst / before) ** (more - 1) > allowed
            if hopeless or not allowed < worst < _HOPELESS * allowed:
                break
            emphasis *= 1.0 + 3.0 * wrong / worst
        return replace(functions, worst=worst)

    def gains(self, rows: Floats | Complexes) -> Floats:
        """Return the gains (n, K) of responses (n, F)."""
        return np.asarray(in_parts(rows[:, self.nodes], parts_of(self.shapes)) @ self.projection.T)

    def left(self, responses: Floats | Complexes) -> Floats | Complexes:
        """Errors (n, F) of responses (n, F) as sums of the functions."""
        left: Any = self.gains(responses) @ self.shapes
        left -= responses
        return np.asarray(left)

    def error(self, rows: _Rows) -> Floats:
        """Largest error over all windows of each frame of the rows, (frames,)."""
        return rows.sample.wrong(self.left(rows.sample.responses), self.nodes)


def _square(rows: Any) -> Any:
    """Return a matrix with the same singular values and vectors along rows, of no more rows than columns."""
    return np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) > 2 * rows.shape[1] else rows


def _axes(rows: Any) -> tuple[Floats, Any]:
    """Return singular values and vectors (r, F) along rows, of large matrices without those that are rounding.

    A few random sums of large ones hold their range (N. Halko, P. G. Martinsson, J. A. Tropp, "Finding structure with
    randomness", SIAM Rev. 53(2), 2011, algorithm 4.1). It is seen in the last singular value if they are too few.
    """
    for count in _SUMS if min(rows.shape) > _LARGE else ():
        sums = np.random.default_rng(0).standard_normal((count, len(rows))) @ rows
        within = np.linalg.qr(sums.conj().T)[0].conj().T
        _, sizes, axes = np.linalg.svd(rows @ within.conj().T, full_matrices=False)
        if sizes[-1] < _ROUNDING * sizes[0]:
            return sizes, axes @ within
    _, sizes, axes = np.linalg.svd(rows, full_matrices=False)
    return sizes, axes


def _spread(count: int, among: int) -> NDArray[np.int64]:
    """Return indices of Chebyshev points that are nearly the Chebyshev points of a smaller number."""
    return np.round((np.arange(count) + 0.5) * among / count - 0.5).astype(np.int64)


def _chebyshev_coefficients(values: Floats | Complexes) -> Floats | Complexes:
    """Return the coefficients (K, F) of polynomials from their values at Chebyshev points, high to low."""
    from scipy.fft import dct

    coefficients: Any = dct(values, type=2, axis=1) / values.shape[1]
    coefficients[:, 0] *= 0.5
    return np.asarray(coefficients)


WORST_DB = -40.0  # error up to which a shortfall is a warning; beyond it must be asked for
_NEAR_ZERO = 8.0  # in sampling rates over taps: up to there it is 0 Hz that asks for long filters
# Added to errors about 0 Hz: they fill a part of one bin of the short-time spectra, in which a signal may have several
# times the energy of the bin's mean.
_UNSURE_DB = 4.0


@dataclass(frozen=True, slots=True)
class Held:
    """Errors of the steps from responses to filters over a source's band, dB."""

    source: int  # index
    low: float  # the band, Hz
    high: float  # likewise
    sampling_rate: float  # hz
    evaluated_at: int = 0  # frequencies of the band at which responses were looked at
    resolved_db: float = -math.inf  # error between these frequencies
    functions: int = 0  # functions of frequency
    functions_db: float = -math.inf  # error of responses as sums of them
    at_centre: bool = False  # responses are those at one frequency: no error was asked for, so that none is refused
    option: str = "response_error_db"  # option that asks for the error

    def within(self, requested_db: float, filters: BandFilters | None = None) -> float:
        """Return the error that is reached, dB, with filters if they are there already."""
        reached = max(self.resolved_db, self.functions_db, -math.inf if filters is None else filters.error_db)
        if reached <= requested_db:
            return reached
        cause, remedy = self._cause(reached, filters)
        if filters is not None and reached == filters.error_db and self._near_zero(filters):
            reached += _UNSURE_DB
        where = f"from {self.low:.0f} to {self.high:.0f} Hz"
        if reached > WORST_DB and not self.at_centre:
            raise InputError(
                self.option,
                f"must be reached {where}, but for source {self.source} {requested_db:g} dB is not: {cause}; "
                f"{reached:.0f} dB is the best; {remedy}, or ask for less",
            )
        requested = f", not the {requested_db:g} dB asked for" if not self.at_centre else ""
        less = f", or ask for {self.option}={math.ceil(reached)}" if not self.at_centre else ""
        warn(
            f"source {self.source}: air, walls and directivities are approximated to {reached:.0f} dB {where}"
            f"{requested}: {cause}; {remedy}{less}"
        )
        return reached

    def _cause(self, reached: float, filters: BandFilters | None) -> tuple[str, str]:
        """Return the limit of the error, and a remedy."""
        smooth = (
            "smooth what walls and directivities do over frequency (thin the rows of a table, shorten impulse "
            "responses), or narrow the signal's band (fade it)"
        )
        if reached == self.resolved_db:
            longest = 1e3 * 2.0 * self.evaluated_at / (math.pi * (self.high - self.low))
            return (
                f"{self.evaluated_at} frequencies do not resolve what walls and directivities do (impulse "
                f"responses longer than {longest:.3g} ms)"
            ), smooth
        if filters is None or reached == self.functions_db:
            return f"walls and directivities ask for more than {self.functions} functions of frequency", smooth
        if self._near_zero(filters):
            return (
                f"walls or directivities have a phase at {filters.worst:.0f} Hz, so near to 0 Hz that no filter of up "
                f"to {LONGEST} taps has it, and the signal sounds there, as one does that begins or ends abruptly"
            ), "fade the signal or narrow its band"
        longest = 1e3 * LONGEST / self.sampling_rate
        return (
            f"no filter of up to {LONGEST} taps ({longest:.0f} ms) does what walls and directivities do at "
            f"{filters.worst:.0f} Hz"
        ), smooth

    def _near_zero(self, filters: BandFilters) -> bool:
        """Whether filters are worst so near to 0 Hz that only longer ones would do."""
        return filters.worst <= _NEAR_ZERO * self.sampling_rate / LONGEST
