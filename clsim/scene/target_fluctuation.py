"""Scatterers whose strength is never quite the same: seeded noise of amplitude and phase over time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import as_count, as_number, read_only

if TYPE_CHECKING:
    from clsim.arrays import Complexes, Floats

_WAVES = 64
_AT_A_TIME = 16384  # instants


@dataclass(frozen=True, slots=True)
class TargetFluctuation:
    """Slow noise of what a scatterer sends back, as of many parts that move a little against each other.

    Parameters
    ----------
    correlation_time : float
        After which what fluctuates has the correlation 1/e, from 1 ms, s.
    steady : float
        Share of the mean power that does not fluctuate, 0 to 1: at 0 the power is distributed exponentially, as in
        Swerling's cases 1 and 2; at 0.71 it varies as much as in his cases 3 and 4.
    seed : int
        Of the noise: the same one gives the same noise, whenever and in whatever pieces it is asked for.

    Raises
    ------
    InputError
        If a value is out of bounds.

    Notes
    -----
    The pressure is multiplied by ``sqrt(steady) + sqrt(1 - steady) z(t)`` at the time t of scattering, alike in all
    directions and at all frequencies, with ``z = K^(-1/2) sum_k exp(j (w_k t + phi_k))`` of 64 waves. With normal w_k
    the correlation over seeds is exactly ``exp(-(t/T)²)``, and z is nearly Gaussian (P. Swerling, Probability of
    detection for fluctuating targets, IRE Trans. Inf. Theory 6 (1960), 269-308; A. Rahimi and B. Recht, Random features
    for large-scale kernel machines, NIPS 2007). The mean power is that without fluctuation.

    Examples
    --------
    >>> noise = TargetFluctuation(correlation_time=0.2, seed=3)
    >>> bool(abs(np.mean(np.abs(noise.at(np.linspace(0.0, 1e4, 100_000))) ** 2) - 1.0) < 0.01)
    True
    """

    correlation_time: float
    steady: float = 0.0
    seed: int = 0
    _waves: Floats = field(init=False, repr=False, compare=False)  # (2, K): rad/s, and phases

    def __post_init__(self) -> None:
        time = as_number("correlation_time", self.correlation_time, at_least=1e-3, unit="s")
        steady = as_number("steady", self.steady, at_least=0.0, at_most=1.0)
        seed = as_count("seed", self.seed)
        for name, value in (("correlation_time", time), ("steady", steady), ("seed", seed)):
            object.__setattr__(self, name, value)
        rng = np.random.default_rng(seed)
        waves = [math.sqrt(2.0) / time * rng.normal(size=_WAVES), rng.uniform(0.0, 2.0 * math.pi, _WAVES)]
        object.__setattr__(self, "_waves", read_only(np.array(waves)))

    @property
    def most(self) -> float:
        """Bound on its magnitude."""
        return math.sqrt(self.steady) + math.sqrt((1.0 - self.steady) * _WAVES)

    def at(self, times: Floats) -> Complexes:
        """Return the factor of the pressure.

        Parameters
        ----------
        times : ndarray (...)
            Of scattering, s.

        Returns
        -------
        ndarray (...)
            Complex; its mean square over time is 1.
        """
        flat, found = times.ravel(), np.empty(times.size, dtype=np.complex128)
        for first in range(0, len(flat), _AT_A_TIME):
            some = slice(first, first + _AT_A_TIME)
            angle = flat[some, None] * self._waves[0] + self._waves[1]
            found[some] = np.cos(angle).sum(axis=1) + 1j * np.sin(angle).sum(axis=1)
        scale = math.sqrt((1.0 - self.steady) / _WAVES)
        return math.sqrt(self.steady) + scale * found.reshape(times.shape)
