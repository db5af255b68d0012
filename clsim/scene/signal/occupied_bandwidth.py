"""Where and when a signal has energy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from weakref import WeakKeyDictionary

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.scene.signal.signal import SEGMENT_LENGTH, Signal

CELLS = 64  # of a band, by which a signal's importance is given


@dataclass(frozen=True, eq=False)
class ShortTimeSpectra:
    """A signal's energy by window of some 40 ms and frequency, relative to the total energy around the window."""

    frequencies: Floats  # (F,) evenly spaced from 0 to half the sampling rate, Hz
    energy: Floats  # (W, F) see `Signal.short_time_spectra`
    weights: Floats  # (W,) windows for which each stands

    def near(self, points: Floats, low: float, high: float) -> Floats:
        """Return the energy (W, n) near rising frequencies (n,), Hz, those of bins that reach between `low` and `high`.

        A bin stands for all frequencies that are nearest to it: it is spread evenly over the points among these, lest
        errors at points between bins count for nothing.
        """
        last, half = len(points) - 1, 0.5 * float(self.frequencies[1])
        bins = np.flatnonzero((self.frequencies + half > low) & (self.frequencies - half < high))
        place = partial(np.interp, xp=points, fp=np.arange(last + 1, dtype=np.float64))
        begin, end = (np.clip(self.frequencies[bins] + side, low, high) for side in (-half, half))
        parts = np.ceil(place(end) - place(begin)).astype(np.int64) + 1
        which = np.repeat(np.arange(len(bins)), parts)
        step = np.arange(len(which)) - np.repeat(np.cumsum(parts) - parts, parts)
        at = place(begin[which] + (end - begin)[which] * (step + 0.5) / parts[which])
        before = np.minimum(at.astype(np.int64), max(last - 1, 0))
        shares = np.concatenate([1.0 - (at - before), at - before]) / np.tile(parts[which], 2)
        return self._gathered(
            np.tile(bins[which], 2), np.concatenate([before, np.minimum(before + 1, last)]), shares, last + 1
        )

    def _gathered(self, bins: NDArray[np.int64], places: NDArray[np.int64], shares: Floats, count: int) -> Floats:
        """Return sums (W, count) of shares of the energy of bins (n,), each added at its place."""
        onto = scipy.sparse.csr_array((shares, (bins, places)), shape=(len(self.frequencies), count))
        return np.asarray(self.energy @ onto)

    @cached_property
    def _cumulative(self) -> tuple[Floats, Floats]:
        """Largest energy of any window up to each frequency (F,), and from each one on (F,)."""
        below = np.cumsum(self.energy, axis=1).max(axis=0, initial=0.0)
        return below, np.cumsum(self.energy[:, ::-1], axis=1).max(axis=0, initial=0.0)[::-1]

    def bounds(self, share: float) -> tuple[float, float]:
        """Return the frequencies below and above which no window has more than a share of its energy, Hz."""
        below, above = self._cumulative
        low = int(np.searchsorted(below, share))
        high = len(above) - 1 - int(np.searchsorted(above[::-1], share))
        last = len(self.frequencies) - 1
        return float(self.frequencies[min(low, last)]), float(self.frequencies[max(high, 0)])

    def importance(self, high: float, loudness: Floats, about: float = 0.0) -> Floats:
        """Return the weights (CELLS,) of errors in equal cells from 0 Hz to `high` Hz, away from a frequency, Hz."""
        # Where errors times weights stay below a bound, their root mean square over the spectrum of any window,
        # relative to its audible energy, is at most 3 dB above it: 1 for the strongest components, small for skirts of
        # onsets. `loudness` (W,) is the inverse of the audible energy of each window.
        cell = (np.abs(self.frequencies - about) * (CELLS / high)).astype(np.int64)
        bins = np.flatnonzero(cell < CELLS)
        energy = self._gathered(bins, cell[bins], np.ones(len(bins)), CELLS)
        weight = np.sqrt((np.minimum(CELLS * energy, 1.0) * loudness[:, None]).max(axis=0, initial=0.0))
        # Filters bend between cells, and a bin stands for all frequencies that are nearest to it.
        reach = max(1, math.ceil(float(self.frequencies[1]) * CELLS / high))
        padded = np.pad(weight, reach)
        return np.asarray(np.max([np.roll(padded, k)[reach:-reach] for k in range(-reach, reach + 1)], axis=0))

    def swiftness(self) -> float:
        """Return the largest root mean square frequency of any window, Hz: errors of delays weigh by it."""
        return math.sqrt(float((self.energy @ self.frequencies**2).max(initial=0.0)))


# Of signals that are still used: paths by scatterers and all others have filters of their own.
_known: WeakKeyDictionary[Signal, tuple[Floats, Floats, Floats, Floats]] = WeakKeyDictionary()


def spectra(signal: Signal) -> tuple[ShortTimeSpectra, Callable[[], tuple[Floats, Floats]]]:
    """Return a signal's short-time spectra (without a window for silence) and a function for its energy spectrum."""
    # The function gives frequencies (n,), Hz, and energy (n,) as `Signal.energy_spectrum`. Both are computed together
    # where their windows have the same length; otherwise the function computes it when first called.
    if signal not in _known:
        _known[signal] = signal.short_time_spectra()
    frequencies, energy, weights, whole = _known[signal]
    found = ShortTimeSpectra(frequencies, energy, weights)
    if len(whole) == SEGMENT_LENGTH // 2 + 1:
        return found, lambda: (frequencies, whole)
    return found, cache(signal.energy_spectrum)


def shares(spectrum: tuple[Floats, Floats], share: float) -> tuple[float, float]:
    """Return the frequencies below and above which a share of the energy of a spectrum lies, Hz."""
    frequencies, energy = spectrum
    below = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
    low, high = np.minimum(np.searchsorted(below, [share, 1.0 - share]), len(below) - 1)
    return float(frequencies[low]), float(frequencies[high])


def share_removed(spectrum: tuple[Floats, Floats], low_pass: Floats, rate: float) -> float:
    """Share of a spectrum's energy that a low-pass (taps at a rate, Hz) takes away, dB; -inf for none."""
    frequencies, energy = spectrum
    total, size = float(energy.sum()), 1 << max(12, 3 + len(low_pass).bit_length())
    passed = np.abs(np.fft.rfft(low_pass, size)) / abs(float(low_pass.sum()))
    lost = 1.0 - np.interp(frequencies, np.fft.rfftfreq(size, 1.0 / rate), passed)
    share = float(energy @ lost**2) / total if total > 0.0 else 0.0
    return 10.0 * math.log10(share) if share > 0.0 else -math.inf
