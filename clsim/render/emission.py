"""What is emitted, and the filters for it: delays, and what air, walls and beams do over a signal's band."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_number
from clsim.errors import ClsimWarning, InputError
from clsim.paths.known import check_known
from clsim.paths.responses import is_complex
from clsim.render.basis import Basis, band_of, flat_basis, scene_basis, turning_basis
from clsim.render.interpolator import Bandlimited, Bank, Interpolator
from clsim.render.occupied import occupied_band, shares
from clsim.render.tracks import SceneTracks, Tracks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.impulse_response import ImpulseResponse
    from clsim.scene.signal import Signal

DEFAULT_RESPONSE_ERROR_DB = -80.0  # of air, walls and beams over a signal's band
AT_CENTRE = "centre"  # instead of that error: all of them as at the centre of the signal's band
EXACT_DB = -100.0  # the same for the reference engine
_MAIN_SHARE = 1e-4  # of a signal's energy at either end of its band, for which walls and beams need not be known
_WIDEST = 0.95  # of Nyquist, the widest band that a bank holds
_LOUD_SHARE_DB = -60.0  # of the signal's energy outside the band, from which on it is a warning
_WEAK_ERROR_DB = -60.0  # of the filter, from which on it is a warning


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
    def rows(self) -> NDArray[Any]:
        """Where the branches of every function begin among all, and their number at the end, (K + 1,) int."""
        return np.cumsum([0, *(len(bank.taps) for bank in self.banks)])

    def streams(self, first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of the signal through each function of the basis, (K, n)."""
        places, values = self.sounding(first, last)
        out = np.zeros((len(self.basis), last - first))
        out[:, places] = values
        return out

    def sounding(self, first: int, last: int) -> tuple[NDArray[np.int64], Floats]:
        """Return where samples `first` to `last` of those streams sound, from `first` on, (n,), and these (K, n).

        What no sound reaches is silent, without the rounding of transforms; pauses cost nothing.
        """
        reach = 2 * self.basis.half  # of a sample, into those of the streams before it
        signal = self.signal.read(first - self.basis.half, last + self.basis.half)
        heard = np.flatnonzero(signal)
        if not len(heard):
            return heard, np.zeros((len(self.basis), 0))
        pause = np.flatnonzero(np.diff(heard) > reach + 1)
        begins = np.maximum(heard[np.concatenate([[0], pause + 1])] - reach, 0)
        lengths = np.minimum(heard[np.concatenate([pause, [-1]])] + 1, last - first) - begins
        places = _ranges(begins, lengths)
        if reach == 0:
            return places, signal[places] * self.basis.filters
        from scipy.signal import oaconvolve

        together = signal[_ranges(begins, lengths + reach)]  # without the pauses
        made = oaconvolve(together[None], self.basis.filters, mode="valid", axes=1)
        within = _ranges(np.cumsum(lengths + reach) - lengths - reach, lengths)
        return places, np.asarray(made[:, within])

    def turned(self, late: Floats) -> Floats | Complexes | float:
        """Return the factor by which delays (P, n), samples, turn the phase of what is carried: 1 of sound as it is."""
        return 1.0

    @property
    def held(self) -> tuple[float, float]:
        """Frequencies between which sound is not removed on purpose, Hz."""
        return 0.0, 0.5 * self.signal.sampling_rate

    def emitted(self, first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of what impulse responses are convolved with."""
        return self.signal.read(first, last)

    def acting(self, response: ImpulseResponse) -> ImpulseResponse:
        """Return an impulse response at the signal's sampling rate as it acts on what is emitted."""
        return response

    def describe_filters(self) -> str:
        """Return how delays are carried."""
        removed = "none" if np.isneginf(self.removed_db) else f"{self.removed_db:.0f} dB"
        return (
            f"filters of {len(self.bank.taps)} branches hold up to {self.band:.0f} Hz within "
            f"{self.bank.error_db:.1f} dB; share of the signal above: {removed}"
        )

    def describe(self) -> str:
        """Return how air, walls and beams are carried, and what it costs."""
        basis = self.basis
        if not math.isfinite(basis.asked_db):
            return f"air, walls and beams are those at {basis.nodes[0]:.6g} Hz"
        if len(basis) == 1 and basis.at_one_frequency:
            return f"air, walls and beams hardly change over the signal's band ({basis.error_db:.1f} dB)"
        rows, most = int(self.rows[-1]), len(self.bank.taps)
        return (
            f"{len(basis)} functions of frequency, taken at {len(basis.nodes)} frequencies, carry air, walls and beams "
            f"within {basis.error_db:.1f} dB ({rows} branch signals, {rows / most:.1f} times the work of one function)"
        )


def design_emission(
    index: int,
    signal: Signal,
    start: float,
    tracks: Tracks,
    *,
    interpolator: Interpolator,
    until: float,
    sampling_rate: float,
    response_error_db: float | str,
    exact: bool,
    at_rest: bool = False,
) -> Emission:
    """Return a source's signal at the sampling rate, Hz, with filters for its band and for how its paths move.

    Parameters
    ----------
    index : int
        Of the source.
    signal : Signal
        What it emits.
    start : float
        Time at which that begins, s.
    tracks : Tracks
        Its paths.
    interpolator : Interpolator
        Delays.
    until : float
        End of the run, s.
    sampling_rate : float
        Hz.
    response_error_db : float or "centre"
        As in `render`.
    exact : bool
        For the reference engine: -100 dB at least.
    at_rest : bool
        All its paths are convolved, so that nothing needs functions of frequency.

    Raises
    ------
    InputError
        If a wall or a beam is not known over the signal's band, or asks for too many functions.
    """
    check_response_error(response_error_db)
    signal = signal.at_rate(sampling_rate)
    spectrum = signal.energy_spectrum()
    high, removed_db, bank = _delay_filters(index, spectrum, interpolator, tracks, sampling_rate)
    basis = basis_of(index, signal, spectrum, high, tracks, until, sampling_rate, response_error_db, exact, at_rest)
    banks = tuple(interpolator.weaker(bank, size) for size in basis.sizes)
    return Emission(signal, start, banks, basis, high, removed_db)


def check_response_error(response_error_db: float | str) -> None:
    """Raise an InputError if the asked error of responses is neither in dB nor that of the centre frequency."""
    if response_error_db == AT_CENTRE:
        return
    if isinstance(response_error_db, str):
        raise InputError("response_error_db", f"must be dB or {AT_CENTRE!r}, but is {response_error_db!r:.80}")
    as_number("response_error_db", response_error_db, at_least=-120.0, at_most=-20.0, unit="dB")


def _delay_filters(
    index: int, spectrum: tuple[Floats, Floats], interpolator: Interpolator, tracks: Tracks, rate: float
) -> tuple[float, float, Bank]:
    """Return the end of the band that matters, the share above it in dB, and the filters for band and speed."""
    field, max_rate = f"signals[{index}]", tracks.max_rate(index)
    widest = _WIDEST * 0.5 * rate / (1.0 + max_rate)
    floor_db = interpolator.error_db if isinstance(interpolator, Bandlimited) else -90.0
    band, removed_db = occupied_band(spectrum, widest, floor_db - 6.0)
    bank = interpolator.bank(2.0 * math.pi * band / rate, max_rate)
    if removed_db > _LOUD_SHARE_DB:
        _warn(
            f"{field}: {removed_db:.0f} dB of its energy lies above {band:.0f} Hz, the band of the delay filters "
            "at this sampling rate and speed, and is removed or distorted; fade or window the signal, or sample faster"
        )
    if bank.error_db > _WEAK_ERROR_DB:
        _warn(
            f"{field}: the delay filters are wrong by up to {bank.error_db:.0f} dB for content at {band:.0f} Hz; "
            'sample faster or use the "bandlimited" interpolator'
        )
    return band, removed_db, bank


def basis_of(
    index: int,
    signal: Signal,
    spectrum: tuple[Floats, Floats],
    high: float,
    tracks: Tracks,
    until: float,
    rate: float,
    error_db: float | str,
    exact: bool,
    at_rest: bool,
    least: float = 0.0,
) -> Basis:
    """Return the functions of frequency that a source's paths need, from `least` to `high` Hz at most."""
    if not isinstance(tracks, SceneTracks):
        return flat_basis(signal.centre_frequency)
    frequencies, energy = spectrum
    below = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
    if not energy.any():  # silence needs nothing
        return flat_basis(signal.centre_frequency)
    check_known(tracks.scene, [index], *shares(spectrum, _MAIN_SHARE), f"the signal of source {index}")
    if at_rest:
        return flat_basis(signal.centre_frequency)
    floor_db = EXACT_DB if isinstance(error_db, str) or exact else error_db
    low = float(frequencies[np.searchsorted(below, 10 ** ((floor_db - 6.0) / 10))])
    low = min(max(low, least, frequencies[1]), 0.999 * high)
    band = partial(band_of, low, high, frequencies, energy)
    if not isinstance(error_db, str):
        return scene_basis(tracks, index, band, until, rate, min(floor_db, error_db))
    if is_complex(tracks.scene):
        return turning_basis(index, signal.centre_frequency, band(), rate, floor_db)
    return flat_basis(signal.centre_frequency)


def _ranges(begins: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return whole numbers from each beginning on, range after range."""
    ends = np.cumsum(lengths)
    return np.repeat(begins - ends + lengths, lengths) + np.arange(int(ends[-1]) if len(ends) else 0)


def _warn(message: str) -> None:
    warnings.warn(message, ClsimWarning, stacklevel=6)
