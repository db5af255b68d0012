"""Room-acoustic measures of impulse responses, by frequency band."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.decay import (
    clarity,
    decay_curve,
    definition,
    eyring_time,
    has_decay_range,
    reverberation_time,
    sabine_time,
)
from clsim.arrays import Floats, as_choice, read_only, short_repr, texts
from clsim.errors import InputError, warn
from clsim.impulse_responses import ImpulseResponses
from clsim.paths.labelled import labelled_dataset

if TYPE_CHECKING:
    from clsim.scene.scene import Scene

BANDS = {"octave": 1, "third-octave": 3}
_DIRECT = 2.5e-3  # s, after the first arrival, that count as direct sound
_FIRST_DB, _DECAYS = -5.0, {"t20": -25.0, "t30": -35.0}  # between which decays are looked at
_ORDER = 3  # of the band filters, of each edge
_ANGLES = 32  # over which absorption is averaged
_OF_PAIRS = {"t20": "s", "t30": "s", "c50": "dB", "c80": "dB", "d50": "1", "drr": "dB"}


@dataclass(frozen=True, slots=True, eq=False)
class RoomMeasures:
    """Decay and clarity of impulse responses, and the predictions of diffuse-field theory.

    Attributes
    ----------
    frequencies : ndarray (bands,)
        Centres of the bands, Hz.
    t20, t30 : ndarray (sources, receivers, bands)
        Reverberation times from the decay between -5 and -25 dB, and -5 and -35 dB, s; NaN where a response ends
        before, or where noise or its end hides the decay.
    c50, c80 : ndarray (sources, receivers, bands)
        Clarity, dB.
    d50 : ndarray (sources, receivers, bands)
        Definition, a share.
    drr : ndarray (sources, receivers, bands)
        Energy of the first 2.5 ms from the first arrival on over that of all after it, dB.
    sabine, eyring : ndarray (bands,)
        Reverberation times of a diffuse field, s; NaN in rooms that are not closed.
    source_names, receiver_names : tuple of str
        Along the first two axes.
    """

    frequencies: Floats
    t20: Floats
    t30: Floats
    c50: Floats
    c80: Floats
    d50: Floats
    drr: Floats
    sabine: Floats
    eyring: Floats
    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]

    __repr__ = short_repr

    def to_xarray(self) -> Any:
        """Return it with dimensions ``source``, ``receiver`` and ``frequency``, coordinates and units.

        Returns
        -------
        xarray.Dataset
            A variable for each measure.

        Raises
        ------
        InputError
            If xarray is missing.
        """
        over = ("source", "receiver", "frequency")
        variables: dict[str, Any] = {name: (over, getattr(self, name)) for name in _OF_PAIRS}
        variables |= {name: (("frequency",), getattr(self, name)) for name in ("sabine", "eyring")}
        coordinates = {
            "source": ("source", texts(self.source_names)),
            "receiver": ("receiver", texts(self.receiver_names)),
            "frequency": ("frequency", self.frequencies),
        }
        found = labelled_dataset(variables, coordinates)
        for name, unit in {**_OF_PAIRS, "sabine": "s", "eyring": "s", "frequency": "Hz"}.items():
            found[name].attrs["units"] = unit
        return found


def room_measures(responses: ImpulseResponses, bands: str | None = "octave") -> RoomMeasures:
    """Return reverberation times, clarity, definition and direct-to-reverberant ratios of impulse responses.

    Parameters
    ----------
    responses : ImpulseResponses
        From `impulse_responses`, of orders high enough that the decay is there.
    bands : {"octave", "third-octave"}, optional
        Into which responses are cut: those that lie within the band of the responses; None for their whole band.

    Returns
    -------
    RoomMeasures
        By source, receiver and band.

    Raises
    ------
    InputError
        If the responses are none, the word is not known, or no such band lies within that of the responses.

    Warns
    -----
    ClsimWarning
        If noise or the end of a response hides the decay in a band.

    Notes
    -----
    ISO 3382-1:2009, section 5.3.3 and annex A.2; T30 is ``-60 dB`` over the slope of a line through the decay. Band
    filters have the magnitude of Butterworth filters of order 3 at either edge, without phase.
    Noise is not cut off: where a response ends in noise that would change a reverberation time by some 5 %, or is too
    short for it, that time is NaN, and a warning names the bands.
    Early sound is what comes within 50 or 80 ms of the first arrival. Sabine's and Eyring's times take the walls'
    absorption averaged over angles of incidence of a diffuse field, and the air's.
    """
    if not isinstance(responses, ImpulseResponses):
        raise InputError("responses", f"must be ImpulseResponses, but are {responses!r:.80}")
    centres = _centres(responses.band, bands)
    share = None if bands is None else 2.0 ** (0.5 / BANDS[bands])
    shape = (*responses.samples.shape[:2], len(centres))
    found = {name: np.full(shape, math.nan) for name in _OF_PAIRS}
    rate, hidden = responses.sampling_rate, np.zeros(len(centres), np.bool_)
    for s, r in np.ndindex(*shape[:2]):
        if not math.isfinite(responses.first_arrivals[s, r]):
            continue
        begin = responses.lead + math.floor(responses.first_arrivals[s, r] * rate)
        for b, centre in enumerate(centres):
            taps = _cut(responses.samples[s, r], rate, centre, share)
            for name, value in _measures(taps, begin, rate).items():
                found[name][s, r, b] = value
            for name, last_db in _DECAYS.items():
                time = found[name][s, r, b]
                if not (math.isnan(time) or has_decay_range(taps[begin:], rate, last_db, time)):
                    found[name][s, r, b], hidden[b] = math.nan, True
    if hidden.any():
        named = ", ".join(f"{centre:.4g}" for centre in centres[hidden])
        warn(
            f"noise or the end of responses hides the decay at {named} Hz: T30, or T20 as well, is NaN there; give "
            "longer responses, or with less noise"
        )
    sabine, eyring = _diffuse(responses.scene, centres)
    return RoomMeasures(
        read_only(centres), **{name: read_only(values) for name, values in found.items()}, sabine=read_only(sabine),
        eyring=read_only(eyring), source_names=responses.source_names, receiver_names=responses.receiver_names,
    )  # fmt: skip


def _centres(band: tuple[float, float], bands: str | None) -> Floats:
    """Return the centres of the bands that lie within a band, Hz."""
    low, high = band
    if bands is None:
        return np.array([math.sqrt(max(low, 1e-3 * high) * high)])
    as_choice("bands", bands, tuple(BANDS))
    parts = BANDS[bands]
    centres = 1000.0 * 2.0 ** (np.arange(-5 * parts, 11 * parts) / parts)
    half = 2.0 ** (0.5 / parts)
    kept: Floats = centres[(centres / half >= low) & (centres * half <= high)]
    if not len(kept):
        raise InputError("bands", f"must lie within {low:g} to {high:g} Hz of the responses, but no {bands} band does")
    return kept


def _cut(taps: Floats, rate: float, centre: float, share: float | None) -> Floats:
    """Return taps (n,) cut to a band from `centre / share` to `centre * share`, Hz."""
    if share is None:
        return taps
    from scipy.fft import irfft, next_fast_len, rfft

    size = next_fast_len(2 * len(taps), real=True)
    frequencies = np.maximum(np.arange(size // 2 + 1) * (rate / size), 1e-3)
    off = (frequencies / centre - centre / frequencies) / (share - 1.0 / share)
    magnitude = 1.0 / np.sqrt(1.0 + off ** (2 * _ORDER))
    return np.asarray(irfft(rfft(taps, size) * magnitude, size)[: len(taps)])


def _measures(taps: Floats, begin: int, rate: float) -> dict[str, float]:
    """Return the measures of taps (n,) by the sample of the first arrival."""
    curve = decay_curve(taps[begin:])
    early = begin + round(0.05 * rate)
    return {
        **{name: reverberation_time(curve, rate, _FIRST_DB, last_db) for name, last_db in _DECAYS.items()},
        "c50": clarity(taps, early),
        "c80": clarity(taps, begin + round(0.08 * rate)),
        "d50": definition(taps, early),
        "drr": clarity(taps, begin + round(_DIRECT * rate)),
    }


def _diffuse(scene: Scene, frequencies: Floats) -> tuple[Floats, Floats]:
    """Return Sabine's and Eyring's times at frequencies (F,), s."""
    mesh = scene.room.as_mesh()
    if mesh.volume is None:
        return np.full(len(frequencies), math.nan), np.full(len(frequencies), math.nan)
    corners = mesh.vertices[mesh.triangles]
    triangles = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    area = np.bincount(mesh.walls.of_triangle, triangles, minlength=len(mesh.faces.materials))
    c = scene.air.speed_of_sound
    # Gauss's rule over the squared sine of the angle of incidence, as which a diffuse field is spread.
    places, weights = np.polynomial.legendre.leggauss(_ANGLES)
    cosine, weights = np.sqrt(0.5 * (1.0 - places)), 0.5 * weights
    total: Floats = np.zeros(len(frequencies))
    for material in dict.fromkeys(mesh.faces.materials):
        mine = float(area[[m is material for m in mesh.faces.materials]].sum())
        at = np.clip(frequencies, *material.band)
        returned = material.energy_at(at, cosine[:, None] if material.depends_on_angle else 1.0, c)
        absorbed = np.broadcast_to(1.0 - returned, (len(cosine), len(frequencies)))
        total += mine * (weights @ absorbed)
    air = scene.air.absorption_at(frequencies) * (math.log(10.0) / 10.0)
    surface = float(area.sum())
    return sabine_time(mesh.volume, total, air, c), eyring_time(mesh.volume, surface, total, air, c)
