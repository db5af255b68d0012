"""A few filters per source that carry the responses of all its paths."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clsim.arrays import Complexes, Floats


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
        """Taps on either side of the filters' middle."""
        return int(self.filters.shape[1] // 2)

    @property
    def at_one_frequency(self) -> bool:
        """Whether responses are taken at one frequency for all."""
        return len(self.nodes) == 1

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
