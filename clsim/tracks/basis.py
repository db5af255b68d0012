"""A few filters per source that carry the responses of all its paths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, firsts, ranges
from clsim.numerics.band_filters import chebyshev_points
from clsim.scene.signal.occupied_bandwidth import ShortTimeSpectra

GRIDS = (65, 129, 387, 1161)  # frequencies at which responses are looked at: the first number that resolves them
IN_CACHE = 8192  # arrivals that are worked on together: larger arrays are fresh memory at every step
_QUIETEST = 1e-3  # weight of frequencies at which a signal has next to nothing
_FAINTEST = 1e-4  # energy received of a window, relative to its centre frequency, that is requested


@dataclass(frozen=True, slots=True)
class Tilt:
    """A part of the air's absorption that falls or rises evenly over a band, which a sum of envelopes renders itself.

    Over a length x it is ``exp(-slope (f - carrier) (x - 1 m))``: a delay that is imaginary.
    """

    slope: float = 0.0  # 1 / (m Hz)
    carrier: float = 0.0  # Hz

    def at(self, frequencies: Floats) -> Floats:
        """Return the absorption at frequencies (F,), Hz, in 1/m."""
        return self.slope * (frequencies - self.carrier)


NO_TILT = Tilt()


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """K functions of frequency; a response is their sum with K real gains."""

    nodes: Floats  # (M,) frequencies at which responses are taken, Hz
    # (K, parts M) matrix from responses at the nodes to gains; complex responses have a real and an imaginary part.
    projection: Floats
    # (K, parts M) functions at the nodes, weighted like `weight`; the rest of a response is the residual.
    functions: Floats
    # (M,) weight of the nodes' frequencies, so that the mean square over nodes is that over the signal's spectrum.
    weight: Floats
    filters: Floats  # (K, L) the functions as filters of odd length, about their middle tap
    sizes: Floats  # (K,) most that each function adds to what is heard at any instant, relative to that
    strengths: Floats  # (K,) root mean square of each weighted function over the nodes
    # (W,) inverse of the received energy of each short window of the signal, as a mean over the run.
    loudness: Floats
    # Requested and reached bound of the error of the sum of all paths at a receiver: root mean square over the spectrum
    # within 40 ms, relative to that sum, dB. Where the request was not given, both are the reached one.
    requested_db: float
    error_db: float
    # Whether the second of every two functions is the first one times j, so that envelopes have complex gains.
    paired: bool = False
    tilt: Tilt = NO_TILT  # what is left out of responses
    option: str = "response_error_db"  # option that asks for the bound

    def __len__(self) -> int:
        return len(self.projection)

    @property
    def parts(self) -> int:
        """1 for real responses, 2 for complex ones."""
        return int(self.projection.shape[1] // len(self.nodes))

    @property
    def half(self) -> int:
        return int(self.filters.shape[1] // 2)

    def gains(self, responses: Floats | Complexes) -> Floats:
        """Return the gains (..., K) of responses (..., M) at the nodes."""
        return np.asarray(in_parts(responses, self.parts) @ self.projection.T)


def flat_basis(frequency: float) -> Basis:
    """Return the basis that takes every response at one frequency; for real responses."""
    one = np.ones((1, 1))
    return Basis(
        np.array([frequency]), one, one, np.ones(1), one, np.ones(1), np.ones(1), np.ones(1), -math.inf, -math.inf
    )


def in_parts(values: Floats | Complexes, parts: int) -> Floats:
    """Return real parts (..., M), followed by the imaginary ones for two parts."""
    return np.asarray(values.real if parts == 1 else np.concatenate([values.real, values.imag], axis=-1))


def parts_of(values: Floats | Complexes) -> int:
    """Return 2 for complex values (...), 1 for real ones."""
    return 1 + int(np.iscomplexobj(values))


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Band of a signal."""

    low: float  # ends, Hz
    high: float  # likewise
    frequencies: Floats  # (F,) Chebyshev points from high to low, Hz
    energy: Floats  # (W, F) of short windows of the signal near them, relative to what sounds about the window
    late: float = 0.0  # delay that is taken out of responses, s
    tilt: Tilt = NO_TILT  # absorption of the air that is taken out of them

    @property
    def turn(self) -> Complexes:
        """Phase factor of the delay at the frequencies, (F,)."""
        return np.asarray(np.exp(-2j * math.pi * self.late * self.frequencies))

    @property
    def rest(self) -> Floats:
        """Energy (W,) about each window, outside it."""
        return np.asarray(np.maximum(1.0 - self.energy.sum(axis=1), 0.0))


def band_of(low: float, high: float, sound: ShortTimeSpectra, tilt: Tilt = NO_TILT, count: int = GRIDS[0]) -> Band:
    """Return a signal's band from its short-time spectra; `low` and `high` in Hz."""
    high = max(high, low * (1.0 + 1e-6))
    grid = chebyshev_points(low, high, count)
    return Band(low, high, grid, sound.near(grid[::-1], low, high)[:, ::-1], tilt=tilt)


@dataclass(frozen=True, eq=False)
class Sample:
    """Responses (n, F) of paths at instants, relative to the level then, weighted by the number each represents.

    A frame is an instant at one channel of a receiver; `first` is where the responses of each begin. The sum of
    squares over the rows of a frame is that over all of its paths.
    """

    band: Band
    responses: Floats | Complexes
    first: NDArray[np.int64]
    beyond: Floats  # (n,) length of each path less 1 m, by which the band's tilt acts on it
    beside: Floats | None = None  # (frames,) energy of what else is received, which errors are relative to

    def received_of(self, values: Floats | Complexes, at: slice | NDArray[np.int64] = slice(None)) -> Any:
        """Return values (n, m) at some of the frequencies with the tilt that was taken out of responses."""
        of_air = self.band.tilt.at(self.band.frequencies[at])
        return values * np.exp(-np.outer(self.beyond, of_air)) if self.band.tilt.slope else values

    def by_frame(self, values: Floats | Complexes) -> Floats:
        """Return the sums of the squares of values (n, m) over each frame's rows, some at a time."""
        ends, made = np.append(self.first, len(values)), []
        step = max(1, IN_CACHE * 8 * len(self.first) // max(values.size, 1))
        for i in range(0, len(self.first), step):
            first = ends[i : i + step + 1]
            some = values[first[0] : first[-1]]
            squares = some.real**2 + some.imag**2 if np.iscomplexobj(some) else some**2
            made.append(np.add.reduceat(squares, first[:-1] - first[0], axis=0))
        return np.concatenate(made)

    @cached_property
    def received(self) -> Floats:
        """Return the received energy (frames, W) of each window and of its neighbourhood."""
        energy = self.by_frame(self.received_of(self.responses)) @ self.band.energy.T + self.band.rest
        return np.asarray(energy if self.beside is None else energy + self.beside[:, None])

    def loudness(self) -> Floats:
        """Return the inverse (W,) of the received energy of each window, as a mean over the frames."""
        return np.asarray(np.mean(1.0 / np.maximum(self.received, _FAINTEST), axis=0))

    def relative(self, left: Floats | Complexes) -> Floats:
        """Return the largest error over all windows of each frame, of errors (n, F) of its rows."""
        left = self.received_of(left)
        return np.asarray(np.sqrt((self.by_frame(left) @ self.band.energy.T / self.received).max(axis=1)))

    def sizes(self, shapes: Floats | Complexes, together: Floats) -> Floats:
        """Return the largest share of each function (K, F) in the received energy, of squared gains (frames, K)."""
        shares = np.abs(shapes) ** 2 @ self.band.energy.T  # (K, W)
        received = self.received
        return np.sqrt([(np.outer(g, share) / received).max() for g, share in zip(together.T, shares, strict=True)])

    def left(self, shapes: Floats | Complexes) -> float:
        """Return the error of functions that are wrong by so much (K, F), each with a gain of 1 at every instant."""
        shares = np.abs(shapes) ** 2 @ self.band.energy.T / self.received.min(axis=0)  # (K, W)
        return math.sqrt(float(shares.max(axis=1).sum()))

    def wrong(self, left: Floats | Complexes, nodes: NDArray[np.int64]) -> Floats:
        """Largest error over all windows of each frame, (frames,), of errors (n, F) of its rows.

        The error over nodes, by their indices, counts as well: the OpenCL engine measures it as it renders.
        """
        weight = self.importance[nodes]
        at_nodes, received = (
            self.by_frame(self.received_of(r[:, nodes] * weight, nodes)).sum(axis=1) for r in (left, self.responses)
        )
        if self.beside is not None:
            received = received + self.beside * np.sum(weight**2)
        return np.asarray(np.maximum(self.relative(left), np.sqrt(at_nodes / np.maximum(received, 1e-300))))

    @cached_property
    def importance(self) -> Floats:
        """Weight (F,) of errors at each frequency: largest energy in any window, relative to its received energy."""
        energy, count = self.band.energy, len(self.band.frequencies)
        weight = np.sqrt(np.minimum(count * energy, 1.0) * self.loudness()[:, None]).max(axis=0)
        return np.asarray(np.maximum(weight, _QUIETEST))

    def frames(self, which: slice | NDArray[np.int64]) -> Sample:
        begin, end = self.first[which], np.append(self.first[1:], len(self.responses))[which]
        rows = ranges(begin, end)[1]
        beside = None if self.beside is None else self.beside[which]
        return Sample(self.band, self.responses[rows], firsts(end - begin)[:-1], self.beyond[rows], beside)

    def with_frames(self, other: Sample, which: NDArray[np.int64]) -> Sample:
        more = other.frames(which)
        together: Any = np.concatenate([self.responses, more.responses])
        first = np.append(self.first, len(self.responses) + more.first)
        beside = None
        if self.beside is not None and more.beside is not None:
            beside = np.append(self.beside, more.beside)
        return Sample(self.band, together, first, np.append(self.beyond, more.beyond), beside)
