"""What a source emits and the filters that delay it and carry its paths' responses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.render.basis import Basis
    from clsim.render.interpolator import Bank
    from clsim.scene.signal import Signal


@dataclass(frozen=True, slots=True, eq=False)
class Emission:
    """One source's signal and the filters for it.

    Attributes
    ----------
    signal : Signal
        At the sampling rate of the recording.
    start : float
        Time at which it begins, s.
    banks : tuple of Bank
        Branch filters, for each function of the basis; fewer for those that add little.
    basis : Basis
        Functions of frequency that carry the responses of its paths.
    band : float
        Highest frequency that the bank holds, Hz.
    removed_db : float
        Share of the signal's energy above the band, dB; -inf for none.
    """

    signal: Signal
    start: float
    banks: tuple[Bank, ...]
    basis: Basis
    band: float
    removed_db: float

    @property
    def bank(self) -> Bank:
        """The branch filters of the strongest function."""
        return self.banks[0]

    @property
    def rows(self) -> Floats:
        """Where the branches of every function begin among all, and their number at the end, (K + 1,) int."""
        return np.cumsum([0, *(len(bank.taps) for bank in self.banks)])

    def streams(self, first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of the signal through each function of the basis, (K, n)."""
        half = self.basis.half
        signal = self.signal.read(first - half, last + half)
        if half == 0:
            return signal * self.basis.filters
        if not np.any(signal):
            return np.zeros((len(self.basis), last - first))
        from scipy.signal import oaconvolve

        out = np.asarray(oaconvolve(signal[None], self.basis.filters, mode="valid", axes=1))
        # What no sound reaches is silent, without the rounding of the transforms.
        sounding = np.concatenate([[0], np.cumsum(signal != 0.0)])
        out[:, sounding[2 * half + 1 :] == sounding[: last - first]] = 0.0
        return out

    def turned(self, late: Floats) -> Floats | Complexes | float:
        """Return the factor by which delays (P, n), samples, turn the phase of what is carried: 1 of sound as it is."""
        return 1.0

    def describe(self) -> list[str]:
        """Return how delays, air, walls and beams are carried, and what it costs, a line each."""
        removed = "none" if np.isneginf(self.removed_db) else f"{self.removed_db:.0f} dB"
        return [
            f"filters of {len(self.bank.taps)} branches hold up to {self.band:.0f} Hz within "
            f"{self.bank.error_db:.1f} dB; share of the signal above: {removed}",
            self.describe_responses(),
        ]

    def describe_responses(self) -> str:
        """Return how air, walls and beams are carried, and what it costs."""
        basis = self.basis
        if not math.isfinite(basis.asked_db):
            return f"air, walls and beams are those at {basis.nodes[0]:.6g} Hz"
        if len(basis) == 1 and basis.at_one_frequency:
            return f"air, walls and beams hardly change over the signal's band ({basis.error_db:.1f} dB)"
        rows, most = int(self.rows[-1]), len(self.bank.taps)
        return (
            f"{len(basis)} functions of frequency carry air, walls and beams within {basis.error_db:.1f} dB "
            f"({rows} branch signals, {rows / most:.1f} times the work of one function)"
        )
