"""Fractional-delay filters that a user can choose, and the banks made from them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from clsim.arrays import Floats, as_count, as_number
from clsim.errors import InputError
from clsim.numerics.fractional_delay import bank_error, design_bandlimited, lagrange_bank, lagrange_taps

SUBBLOCK = 32  # neighbouring samples that share the whole part of a path's delay
SMALL_SUBBLOCK = 8  # for fast motion, and for filters that are only good near the middle of their range
_LARGEST_MU = 1.6  # beyond which smaller subblocks are cheaper than more branches
_LARGEST_ORDER = 40


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """Branch filters whose sum weighted by powers of ``mu`` is a delay of ``shift + mu`` samples."""

    taps: Floats  # (branches, length) coefficient of ``mu**q`` of each tap
    centre: int  # index of the tap without delay
    shift: float  # delay at ``mu = 0``: 0 or 0.5 samples
    edge: float  # end of the signal's band, rad per sample
    mu_max: float  # largest ``|mu|`` that occurs
    subblock: int  # neighbouring samples that share a whole delay
    # Largest deviation from a pure delay over all delays and the signal's band, times its importance, dB.
    error_db: float

    @property
    def half_length(self) -> int:
        """Samples by which the filter looks to either side at most, for any ``mu``."""
        return int(max(self.centre, self.taps.shape[1] - 1 - self.centre)) + math.ceil(self.mu_max) + 1

    @property
    def before(self) -> int:
        """Samples that the filter reads before the first one."""
        return int(self.taps.shape[1]) - 1 - self.centre


class Interpolator(ABC):
    """A fractional-delay filter: subclasses give `_bank`, polynomials of ``mu``, and `_taps`, their own formula."""

    __slots__ = ()
    error_db: float = -90.0  # Bound on the error that is asked of all that is rendered with it, dB

    def bank(self, edge: float, max_rate: float, importance: tuple[float, ...] = (1.0,), oversampling: int = 1) -> Bank:
        """Return the bank up to an `edge`, rad per sample, for delays that change by up to `max_rate`, s/s.

        Errors may be larger where the `importance` of equal bands from 0 to the edge is less. The signal has so many
        samples in one of the recording (`oversampling`).
        """
        return self._bank(edge, oversampling * max_rate, importance)

    def taps(self, bank: Bank, mu: Floats) -> Floats:
        """Return the taps (n, length) of a `bank` for delays `mu` (n,) beyond its shift, samples: the reference's."""
        return self._taps(bank, mu)

    @abstractmethod
    def _bank(self, edge: float, max_rate: float, importance: tuple[float, ...]) -> Bank:
        """Return the bank for delays that change by at most `max_rate` samples a sample."""

    @abstractmethod
    def _taps(self, bank: Bank, mu: Floats) -> Floats:
        """Return taps (n, length) for each ``mu`` (n,)."""


@dataclass(frozen=True, slots=True)
class Lagrange(Interpolator):
    """Lagrange interpolation: exact at 0 Hz, and worse the higher the frequency.

    Parameters
    ----------
    order : int
        From 1 to 40; it has one tap more.

    Notes
    -----
    Even orders jump where the whole part of the delay changes (-63 dB at 0.42 of Nyquist for order 12).
    """

    order: int = 12

    def __post_init__(self) -> None:
        as_count("order", self.order, at_least=1, at_most=_LARGEST_ORDER)

    def _bank(self, edge: float, max_rate: float, importance: tuple[float, ...]) -> Bank:
        """Return the bank: the closed form as polynomials of ``mu``."""
        return _lagrange(lagrange_bank(self.order), self.order // 2, self.order, edge, max_rate)

    def _taps(self, bank: Bank, mu: Floats) -> Floats:
        """Return the closed-form taps."""
        return lagrange_taps(self.order, mu + self.order / 2)


@dataclass(frozen=True, slots=True)
class TruncatedLagrange(Interpolator):
    """A Lagrange interpolator without its outer taps, which has a wider band (Välimäki and Haghparast 2007).

    Parameters
    ----------
    order : int
        Order of the prototype, up to 40.
    length : int
        Taps that are kept; ``order + 1 - length`` must be even.
    """

    order: int
    length: int

    def __post_init__(self) -> None:
        as_count("order", self.order, at_least=1, at_most=_LARGEST_ORDER)
        as_count("length", self.length, at_least=2, at_most=self.order + 1)
        if (self.order + 1 - self.length) % 2:
            raise InputError(
                "length", f"must differ from order + 1 = {self.order + 1} by an even number, but is {self.length}"
            )

    def _bank(self, edge: float, max_rate: float, importance: tuple[float, ...]) -> Bank:
        """Return the bank: the middle taps as polynomials of ``mu``."""
        centre = self.order // 2 - self._dropped
        return _lagrange(lagrange_bank(self.order, self.length), centre, self.order, edge, max_rate)

    def _taps(self, bank: Bank, mu: Floats) -> Floats:
        """Return the closed-form taps."""
        whole = lagrange_taps(self.order, mu + self.order / 2)
        return whole[:, self._dropped : self._dropped + self.length]

    @property
    def _dropped(self) -> int:
        return (self.order + 1 - self.length) // 2


@dataclass(frozen=True, slots=True)
class Bandlimited(Interpolator):
    """The shortest filters that keep a stated error over the signal's band.

    Parameters
    ----------
    error_db : float
        Bound on the deviation from a pure delay, from -120 to -40 dB, relative to what sounds within some 40 ms.
    """

    error_db: float = -90.0

    def __post_init__(self) -> None:
        as_number("error_db", self.error_db, at_least=-120.0, at_most=-40.0, unit="dB")

    def _bank(self, edge: float, max_rate: float, importance: tuple[float, ...]) -> Bank:
        """Return the bank: least-squares filters for a Chebyshev series in ``mu``."""
        subblock, mu_max = _subblock(SUBBLOCK, max_rate)
        if mu_max > _LARGEST_MU:
            subblock, mu_max = _subblock(SMALL_SUBBLOCK, max_rate)
        # Rounded up, so that designs are found again.
        mu_max = math.ceil(mu_max * 32) / 32
        taps, reached = design_bandlimited(self.error_db, edge, mu_max, self.rounded(importance))
        return Bank(taps, taps.shape[1] // 2, 0.0, edge, mu_max, subblock, reached)

    def rounded(self, importance: tuple[float, ...]) -> tuple[float, ...]:
        """Return each `importance`, a factor, rounded up, so that designs are found again; no error is above -12 dB."""
        least = 10.0 ** ((self.error_db + 12.0) / 20.0)
        steps = np.ceil(20.0 * np.log10(np.maximum(importance, least)) / 6.0)
        return tuple((10.0 ** (0.3 * steps)).tolist())

    def _taps(self, bank: Bank, mu: Floats) -> Floats:
        """Return the bank evaluated in float64."""
        return np.asarray(np.vander(mu, len(bank.taps), increasing=True) @ bank.taps)


def _subblock(samples: int, max_rate: float) -> tuple[int, float]:
    """Return a subblock's length, and the largest ``|mu|`` in it: rounding, and motion within half of it."""
    return samples, 0.52 + 0.5 * (samples - 1) * max_rate


def _lagrange(taps: Floats, centre: int, order: int, edge: float, max_rate: float) -> Bank:
    subblock, mu_max = _subblock(SMALL_SUBBLOCK, max_rate)
    shift = 0.5 if order % 2 else 0.0
    error = bank_error(taps, centre, shift, edge, mu_max)
    return Bank(taps, centre, shift, edge, mu_max, subblock, 20 * math.log10(max(error, 1e-15)))
