"""Air that absorbs evenly more over a band, as an imaginary delay in the sum of envelopes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clsim.arrays import Complexes, Floats
from clsim.numerics.blas import with_blas_threads
from clsim.numerics.fractional_delay import design_bandlimited, design_tilted
from clsim.paths.response import SceneResponse
from clsim.render.baseband import SUBBLOCK
from clsim.render.interpolator import Bandlimited, Bank
from clsim.render.source_filters import Emission
from clsim.tracks.basis import NO_TILT, Basis, Tilt

Design = tuple[Basis, tuple[Bank, ...], "Stretches"]

_MOST_TILT = 0.5  # exponent of a tilt at the band's end, between a delay and the middle of its stretch
_STEPS = 16  # of that exponent, to which it is rounded up, so that designs are found again
_LEAST_TILT = 0.25  # the same over all delays, below which functions of frequency cost as little
_ROUNDING_DB = 2.0, -1.0  # steps of what functions add, so that designs are found again, and the error of a weak one
_NEAR = 1e-6  # m, by which the air that is passed may differ from delays at the speed of sound
_FITTED = 33  # frequencies, through whose absorption the tilt goes
_FLAT = 1e-3  # change of a wall's factor over the band, beyond which paths of equal length differ: without a tilt
_LEAST_WORK = 1.5e7  # paths times samples of the envelope, below which designing costs more than is gained
_FEW = 3  # functions, up to which no others are looked at
_LEAST_PATHS = 100  # for each stretch beyond the first one, from which on their branch signals pay
_COMPLEX = 1.15  # cost of a branch where delays are complex, relative to that of real ones
_FILTERED = 66.0  # cost of making a branch signal, relative to that of a path


@dataclass(frozen=True, slots=True)
class Stretches:
    """Equal stretches of delay, in each of which a tilt acts about the stretch's middle.

    Over the delay D, samples of an envelope, a tilt is ``exp(-w per_sample (D - still))`` at w rad a sample. What a
    path has in common with the middle of its stretch is in the filters of the branch signals. The rest is small, and
    joins the path's delay: the branches take powers of ``mu - j nu``.
    """

    tilt: Tilt = NO_TILT
    per_sample: float = 0.0  # imaginary delay over delay
    still: float = 0.0  # delay over which the tilt is 1, samples
    length: float = 1.0  # samples
    count: int = 1
    most: float = 0.0  # imaginary delay between a delay and the middle of its stretch, samples

    @property
    def origin(self) -> int:
        return math.floor(self.still)

    def filters(self, taps: Complexes, rate: float, carrier: float, half: float, every: int) -> Complexes:
        """Return filters (count K, M) of all stretches from those (K, L) about the carrier, within a `half`, Hz."""
        from scipy.fft import fft, ifft, next_fast_len

        if self.per_sample == 0.0:
            return taps
        size, middle = next_fast_len(4 * taps.shape[1]), taps.shape[1] // 2
        frequencies: Floats = np.asarray(np.fft.fftfreq(size) * rate, dtype=np.float64)
        acts = self.acting(frequencies, rate, carrier, half, every)[:, None]
        spectra, reach = ifft(taps, size, axis=1) * acts, middle * 3 // 2
        return np.roll(fft(spectra), reach - middle, axis=2)[:, :, : 2 * reach + 1].reshape(-1, 2 * reach + 1)

    def acting(self, frequencies: Floats, rate: float, carrier: float, half: float, every: int) -> Floats:
        """Return the factors (count, F) of frequencies, Hz, at a rate, Hz, by how far they are off the carrier."""
        away = np.clip((frequencies - carrier + 0.5 * rate) % rate - 0.5 * rate, -half, half)
        late = self.per_sample * ((np.arange(self.count) + 0.5) * self.length + self.origin - self.still)
        return np.asarray(np.exp(-2.0 * math.pi * every / rate * np.outer(late, away)))


WHOLE = Stretches()  # without a tilt


def _tilt_of(emission: Emission, low: float, high: float) -> Tilt:
    """Return the even part of the air's absorption over a band, Hz: none where delays are not those of air at rest."""
    of_scene = emission.tracks.of_scene
    if of_scene is None or emission.static or emission.options.responses == "centre" or not len(emission.sound.energy):
        return NO_TILT
    drawn, scene, carrier = emission.drawn(), of_scene.paths.scene, 0.5 * (low + high)
    air, c, paths = scene.air, scene.air.speed_of_sound, drawn.tracks.paths
    alike = not (air.dispersion or air.layers or air.fluctuation is not None or paths.is_complex or paths.turns_phases)
    if not alike or any(receiver.electronics is not None for receiver in scene.receivers):
        return NO_TILT
    away = np.linspace(low, high, _FITTED) - carrier
    at = SceneResponse(scene, emission.source, carrier + away)
    if np.ptp(at.largest_reflection(np.arange(at.surfaces)[:, None]), axis=1).max() > _FLAT:
        return NO_TILT
    if any(np.abs(some.found.through - c * some.found.delay).max(initial=0.0) > _NEAR for some in drawn.rows):
        return NO_TILT
    return Tilt(float(np.polyfit(away, at.nepers, 1)[0]), carrier)


def stretches_of(
    emission: Emission, band: tuple[float, float], rate: float, edge: float, tilted: bool
) -> Stretches | None:
    """Return the stretches for an envelope of a band, Hz, at a rate, Hz, that ends at an edge, rad; None for none."""
    samples, paths = min(emission.signal.duration, emission.until) * rate, _paths(emission)
    if not tilted or paths * samples < _LEAST_WORK:
        return None
    of_scene, tilt = emission.tracks.of_scene, _tilt_of(emission, *band)
    if tilt.slope == 0.0 or of_scene is None:
        return None
    c = of_scene.paths.scene.air.speed_of_sound
    per_sample = tilt.slope * c / (2.0 * math.pi)
    longest = emission.tracks.longest_delay(0.0, emission.until, emission.source) * rate
    exponent = abs(per_sample) * edge * longest
    count = math.ceil(0.5 * exponent / _MOST_TILT)
    if exponent < _LEAST_TILT or paths < _LEAST_PATHS * (count - 1):
        return None
    most = math.ceil(0.5 * exponent / count * _STEPS) / _STEPS / edge
    return Stretches(tilt, per_sample, (emission.start + 1.0 / c) * rate, longest / count, count, most)


def bank_of(
    size: float, importance: Floats, interpolator: Bandlimited, edge: float, mu_max: float, stretches: Stretches
) -> Bank:
    """Return the delay filters of a function by the most that it adds, up to an edge, rad, for delays in samples.

    Errors may be larger where the `importance` (cells,) of equal bands from 0 to the edge is less.
    """
    (step_db, most_db), error_db = _ROUNDING_DB, interpolator.error_db
    least = 10.0 ** ((error_db - most_db) / 20.0)
    most = 10.0 ** (step_db / 20.0 * math.ceil(20.0 * math.log10(min(max(size, least), 1.0)) / step_db))
    weights = tuple(most * weight for weight in interpolator.rounded(tuple(np.minimum(importance, 1.0).tolist())))
    if stretches.per_sample:
        with with_blas_threads(1):  # of small matrices
            taps, reached = design_tilted(error_db, edge, mu_max, stretches.most, weights)
    else:
        taps, reached = design_bandlimited(error_db, edge, mu_max, weights)
    return Bank(taps, taps.shape[1] // 2, 0.0, edge, mu_max, SUBBLOCK, reached)


def _paths(emission: Emission) -> int:
    return sum(len(pair) for pair in emission.tracks.pairs if pair.source == emission.source)


def cheapest(emission: Emission, stretches: Stretches | None, designed: Callable[[Stretches], Design]) -> Design:
    """Return the design that costs least: with a tilt in some stretches, or with functions of frequency alone."""
    if stretches is None:
        return designed(WHOLE)
    tilted = designed(stretches)
    if len(tilted[0]) <= _FEW:
        return tilted
    paths = _paths(emission)

    def cost(design: Design) -> float:
        """Return the cost of the branches of a design, in those of a path."""
        branches, parts = sum(len(bank.taps) for bank in design[1]), design[2]
        return branches * (paths * (_COMPLEX if parts.per_sample else 1.0) + _FILTERED * parts.count)

    return min(tilted, designed(WHOLE), key=cost)
