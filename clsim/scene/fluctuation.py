"""Slow seeded noise: of delays, as in moving air, and of the amplitude and phase of scatterers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from clsim.arrays import Complexes, Floats, as_count, as_number, read_only
from clsim.errors import settle

_WAVES = 64
_AT_A_TIME = 16384  # instants


@dataclass(frozen=True, slots=True)
class Fluctuation:
    """Slow noise of the delays of paths, as over a heater: Gaussian, smooth, and the same for the same seed.

    Parameters
    ----------
    rms : float
        Root of the mean square of every path's delay noise, at most 1 ms, s.
    correlation_time : float
        Time after which the correlation is 1/e, from 1 ms, s.
    correlation_length : float
        Distance between two positions of the source or receiver at which the correlation is 1/e, m.
    seed : int
        Seed of the noise.

    Notes
    -----
    A sum of 64 waves over time, the receiver as the source sees it, and the source,

        rms sqrt(2/K) sum_k cos(w_k t + a_k x + b_k y + phi_k),

    with normal w_k, a_k, b_k, so that over seeds the correlation is exactly ``exp(-(t/T)² - (x/L)² - (y/L)²)`` (A.
    Rahimi and B. Recht, "Random features for large-scale kernel machines", NIPS 2007). Images see the receiver
    elsewhere, so they fluctuate by themselves where walls are farther than the length. All derivatives exist, at any
    instant.

    The 64 waves are those of all paths. Within one run, however long, the correlation of two paths therefore deviates
    from that law by 1/sqrt(2K) = 0.09 (root mean square over pairs of paths). A run of D s adds what a Gaussian process
    has, sqrt(1.25 T / D): together 0.11 at D = 256 T, not 0.07. Statistics over many seeds are free of the former.

    Examples
    --------
    >>> over_heater = Fluctuation(rms=2e-6, correlation_time=0.5, correlation_length=0.3)
    >>> late, rate = over_heater.at(np.zeros(7), np.zeros((7, 3)), np.zeros((7, 3)))
    >>> late.shape, rate.shape
    ((7,), (7,))
    """

    rms: float
    correlation_time: float
    correlation_length: float
    seed: int = 0
    _waves: Floats = field(init=False, repr=False, compare=False)  # (8, K): 1/s, 1/m, 1/m, and phases

    def __post_init__(self) -> None:
        rms = as_number("rms", self.rms, at_least=0.0, at_most=1e-3, unit="s")
        time = as_number("correlation_time", self.correlation_time, at_least=1e-3, unit="s")
        length = as_number("correlation_length", self.correlation_length, at_least=1e-3, unit="m")
        seed = as_count("seed", self.seed)
        rng = np.random.default_rng(seed)
        scale = math.sqrt(2.0) / np.array([time, *[length] * 6])
        waves = np.vstack([scale[:, None] * rng.normal(size=(7, _WAVES)), rng.uniform(0.0, 2.0 * math.pi, (1, _WAVES))])
        settle(self, rms=rms, correlation_time=time, correlation_length=length, seed=seed, _waves=read_only(waves))

    def at(
        self, times: Floats, receiver: Floats, source: Floats, velocities: tuple[Floats, Floats] | None = None
    ) -> tuple[Floats, Floats]:
        """Return the noise (...), s, and its rate of change (...), s/s.

        Parameters
        ----------
        times : ndarray (...)
            s.
        receiver, source : ndarray (..., 3)
            The receiver as the source sees it, and the source, m.
        velocities : tuple of ndarray (..., 3), optional
            Velocities of both, m/s; zero when left out.
        """
        waves, size = self._waves, self.rms * math.sqrt(2.0 / _WAVES)
        angle = times[..., None] * waves[0] + receiver @ waves[1:4] + source @ waves[4:7] + waves[7]
        turn = waves[0] if velocities is None else waves[0] + velocities[0] @ waves[1:4] + velocities[1] @ waves[4:7]
        return size * np.cos(angle).sum(axis=-1), -size * (turn * np.sin(angle)).sum(axis=-1)

    @property
    def most(self) -> float:
        """Bound on the noise, s."""
        return self.rms * math.sqrt(2.0 * _WAVES)

    def most_rate(self, source_speed: float, receiver_speed: float) -> float:
        """Return a bound on the rate of change of the noise, s/s, by `source_speed` and `receiver_speed`, m/s."""
        by_place = [np.linalg.norm(self._waves[rows], axis=0) for rows in (slice(1, 4), slice(4, 7))]
        turns = np.abs(self._waves[0]) + receiver_speed * by_place[0] + source_speed * by_place[1]
        return self.rms * math.sqrt(2.0 / _WAVES) * float(turns.sum())


@dataclass(frozen=True, slots=True)
class TargetFluctuation:
    """Slow noise of the scattered pressure, as of many parts that move slightly against each other.

    Parameters
    ----------
    correlation_time : float
        After which what fluctuates has the correlation 1/e, from 1 ms, s.
    steady : float
        Share of the mean power that does not fluctuate, 0 to 1. At 0 the power is distributed exponentially, as in
        Swerling's cases 1 and 2. At 0.71 it varies as much as in his cases 3 and 4.
    seed : int
        Seed of the noise: the same seed gives the same noise, in any chunks.

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
        rng = np.random.default_rng(seed)
        waves = [math.sqrt(2.0) / time * rng.normal(size=_WAVES), rng.uniform(0.0, 2.0 * math.pi, _WAVES)]
        settle(self, correlation_time=time, steady=steady, seed=seed, _waves=read_only(np.array(waves)))

    @property
    def most(self) -> float:
        """Bound on its magnitude."""
        return math.sqrt(self.steady) + math.sqrt((1.0 - self.steady) * _WAVES)

    def at(self, times: Floats) -> Complexes:
        """Return the complex factor (...) of the pressure at `times` (...) of scattering, s; its mean square is 1."""
        flat, found = times.ravel(), np.empty(times.size, dtype=np.complex128)
        for first in range(0, len(flat), _AT_A_TIME):
            some = slice(first, first + _AT_A_TIME)
            angle = flat[some, None] * self._waves[0] + self._waves[1]
            found[some] = np.cos(angle).sum(axis=1) + 1j * np.sin(angle).sum(axis=1)
        scale = math.sqrt((1.0 - self.steady) / _WAVES)
        return math.sqrt(self.steady) + scale * found.reshape(times.shape)
