"""Room-acoustic and lateral measures of impulse responses, simulated or measured, by frequency band."""

from __future__ import annotations

import math
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics import room_acoustics as acoustics
from clsim.arrays import Floats, as_choice, as_count, as_floats, as_number, read_only, short_repr, texts
from clsim.errors import InputError, warn
from clsim.files.sound import read_sound_file
from clsim.impulse_responses import ImpulseResponses, as_response_band
from clsim.numerics.convolution import band_taper
from clsim.paths.path_table import labelled_dataset
from clsim.scene.directivity.head_related import EARS
from clsim.scene.directivity.patterns import Ambisonic
from clsim.scene.scene import Scene
from clsim.tail.zones import DiffuseField

BANDS = {"octave": 1, "third-octave": 3}
_DIRECT = 2.5e-3  # s, after the first arrival, that count as direct sound
_DECAYS = {"edt": (0.0, -10.0), "t20": (-5.0, -25.0), "t30": (-5.0, -35.0)}  # dB, between which decays are looked at
_ORDER = 3  # of the band filters, of each edge
_ONSET_DB = -20.0  # re the largest sample, at which a measured response begins (ISO 3382-1:2009, annex A.2.1)
_MOST_OF_FILE = 0.475  # of its sampling rate: the band of a measured response
_SHORTEST = 0.05  # s, of a measured response
_AT = 10.0  # m from a source in the free field, of the level that G is relative to
_OF_PAIRS = {
    "edt": "s", "t20": "s", "t30": "s", "c50": "dB", "c80": "dB", "d50": "1", "ts": "s", "g": "dB", "drr": "dB",
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class RoomMeasures:
    """Decay and clarity of impulse responses, and the predictions of diffuse-field theory.

    Attributes
    ----------
    frequencies : ndarray (bands,)
        Centres of the bands, Hz.
    edt, t20, t30 : ndarray (sources, receivers, bands)
        Reverberation times from the decay between 0 and -10 dB, -5 and -25 dB, and -5 and -35 dB, s; NaN where a
        response ends before, or where noise or its end hides the decay.
    c50, c80 : ndarray (sources, receivers, bands)
        Clarity, dB.
    d50 : ndarray (sources, receivers, bands)
        Definition, a share.
    ts : ndarray (sources, receivers, bands)
        Centre time, s.
    g : ndarray (sources, receivers, bands)
        Sound strength: level re that of the same source at 10 m in the free field, dB; of a directional source re its
        axis. NaN for a measured response without one in the free field.
    drr : ndarray (sources, receivers, bands)
        Energy of the first 2.5 ms from the first arrival on over that of all after it, dB.
    sabine, eyring : ndarray (bands,)
        Reverberation times of a diffuse field, s; NaN in rooms that are not closed, and of measurements.
    source_names, receiver_names : tuple of str
        Along the first two axes; of a file "measured" and its name.
    """

    frequencies: Floats
    edt: Floats
    t20: Floats
    t30: Floats
    c50: Floats
    c80: Floats
    d50: Floats
    ts: Floats
    g: Floats
    drr: Floats
    sabine: Floats
    eyring: Floats
    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]

    __repr__ = short_repr

    def to_xarray(self) -> Any:
        """Return it with dimensions ``source``, ``receiver`` and ``frequency``, coordinates and units."""
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


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """Responses, and what is known of them."""

    samples: Floats  # (sources, receivers, n)
    begin: NDArray[np.int64]  # (sources, receivers) sample of the first arrival, -1 where nothing is heard
    rate: float  # Hz
    band: tuple[float, float]  # Hz
    free_field: Floats | None  # (m,) response at 10 m of the source
    scene: Scene | None
    names: tuple[tuple[str, ...], tuple[str, ...]]  # of sources and receivers

    @classmethod
    def simulated(cls, responses: ImpulseResponses) -> _Given:
        """Make them of a scene."""
        rate, first = responses.sampling_rate, responses.first_arrivals
        begin = np.where(np.isfinite(first), responses.lead + np.floor(np.nan_to_num(first) * rate), -1.0)
        kept, size = as_response_band(rate, responses.band), 2 * round(rate)
        frequencies: Floats = np.fft.rfftfreq(size, 1.0 / rate).astype(np.float64)
        taper = band_taper(frequencies, kept.low, kept.high, kept.below, kept.above)
        impulse = np.fft.irfft(taper * np.exp(-1j * np.pi * np.arange(len(taper))), size) / _AT
        return cls(
            responses.samples, begin.astype(np.int64), rate, responses.band, impulse, responses.scene,
            (responses.source_names, responses.receiver_names),
        )  # fmt: skip

    @classmethod
    def measured(cls, path: Any, channel: int, free_field: tuple[Any, float] | None) -> _Given:
        """Make one of a sound file."""
        taps, rate = read_sound_file(path, as_count("channel", channel))
        reference = None
        if free_field is not None:
            if not isinstance(free_field, tuple | list) or len(free_field) != 2:
                raise InputError("free_field", f"must be a sound file and a distance in m, but is {free_field!r:.80}")
            distance = as_number("free_field[1]", free_field[1], at_least=1e-3, at_most=1e3, unit="m")
            raw, other = read_sound_file(free_field[0], channel)
            if other != rate:
                raise InputError("free_field[0]", f"must have the sampling rate {rate:g} Hz, but has {other:g} Hz")
            reference = raw.astype(np.float64) * (distance / _AT)
        samples = taps.astype(np.float64)
        peak = np.abs(samples).max()
        if not peak > 0.0:
            raise InputError("responses", f"must hold a response, but {path} is silent")
        if len(samples) < _SHORTEST * rate:
            lasts = f"{1e3 * len(samples) / rate:.3g} ms"
            raise InputError("responses", f"must last {1e3 * _SHORTEST:g} ms at least, but {path} lasts {lasts}")
        if acoustics.is_clipped(samples):
            warn(f"{path} is clipped: several samples in a row are at full scale, so early energies are wrong")
        begin = int(np.argmax(np.abs(samples) >= peak * 10.0 ** (_ONSET_DB / 20.0)))
        names = ("measured",), (str(path),)
        band = (0.0, _MOST_OF_FILE * rate)
        return cls(samples[None, None], np.array([[begin]]), rate, band, reference, None, names)


def room_measures(
    responses: ImpulseResponses | str | PathLike[str],
    bands: str | None = "octave",
    *,
    channel: int = 0,
    free_field: tuple[str | PathLike[str], float] | None = None,
) -> RoomMeasures:
    """Compute decay times, clarity, definition, centre time, strength and direct-to-reverberant ratios of responses.

    Parameters
    ----------
    responses : ImpulseResponses or path-like
        From `impulse_responses`, of orders high enough that the decay is there, or a sound file that holds a measured
        impulse response. Such a one begins where it first comes within 20 dB of its largest sample.
    bands : {"octave", "third-octave"}, optional
        Into which responses are cut: those that lie within the band of the responses; None for their whole band.
    channel : int
        Index of the sound file's channel, from 0.
    free_field : (path-like, float), optional
        For the strength of a measured response: a sound file with the same source, microphone and gain in the free
        field, and their distance, m.

    Raises
    ------
    InputError
        If `responses` is not an `ImpulseResponses`, a file cannot be read, is silent or lasts less than 50 ms, the word
        is not
        known, or no such band lies
        within that of the responses.

    Warns
    -----
    ClsimWarning
        If noise or the end of a response hides the decay in a band, or a file is clipped.

    Notes
    -----
    ISO 3382-1:2009, section 5.3.3 and annex A.2; T30 is ``-60 dB`` over the slope of a line through the decay. Band
    filters have the magnitude of Butterworth filters of order 3 at either edge, without phase.
    Where a response ends in steady noise, it is cut where its late decay meets the noise (Lundeby); for decays, the
    noise's power before is taken off, and the energy of the decay beyond is added. A time is NaN, and a warning names
    the band, where noise is less than 10 dB below the part of the decay that it is taken from, or the response is too
    short for it.
    Early sound is what comes within 50 or 80 ms of the first arrival. Sabine's and Eyring's times take the walls'
    absorption averaged over angles of incidence of a diffuse field, and the air's.
    """
    given = _given(responses, channel, free_field)
    centres = band_centres(given.band, bands)
    share = None if bands is None else 2.0 ** (0.5 / BANDS[bands])
    shape = (*given.samples.shape[:2], len(centres))
    found = {name: np.full(shape, math.nan) for name in _OF_PAIRS}
    hidden = np.zeros(len(centres), np.bool_)
    for b, centre in enumerate(centres):
        free = None if given.free_field is None else cut_to_band(given.free_field, given.rate, centre, share)
        for s, r in np.argwhere(given.begin >= 0).tolist():
            taps = cut_to_band(given.samples[s, r], given.rate, centre, share)
            values, covered = _measures(taps, int(given.begin[s, r]), given.rate, free)
            hidden[b] |= covered
            for name, value in values.items():
                found[name][s, r, b] = value
    if hidden.any():
        named = ", ".join(f"{centre:.4g}" for centre in centres[hidden])
        warn(
            f"noise or the end of responses hides the decay at {named} Hz: T30, or T20 as well, is NaN there; give "
            "longer responses, or with less noise"
        )
    sabine, eyring = _diffuse(given.scene, centres)
    return RoomMeasures(
        read_only(centres), **{name: read_only(values) for name, values in found.items()}, sabine=read_only(sabine),
        eyring=read_only(eyring), source_names=given.names[0], receiver_names=given.names[1],
    )  # fmt: skip


def speech_transmission(
    responses: ImpulseResponses | str | PathLike[str],
    speech_db: ArrayLike | None = None,
    noise_db: ArrayLike | None = None,
    *,
    channel: int = 0,
) -> Floats:
    """Compute the speech transmission index (sources, receivers), 0 to 1; NaN where nothing is received.

    Parameters
    ----------
    responses : ImpulseResponses or path-like
        As for `room_measures`; exact or measured up to 11.4 kHz.
    speech_db : float or array_like (7,), optional
        Level of speech at the listener: A-weighted, dB SPL, or by octave from 125 Hz to 8 kHz. Without it neither
        noise, masking nor the threshold of hearing counts.
    noise_db : array_like (7,), optional
        Levels of noise by octave, dB SPL.
    channel : int
        Index of the sound file's channel, from 0.

    Raises
    ------
    InputError
        If `responses` is not an `ImpulseResponses`, or do not reach over the octaves from 125 Hz to 8 kHz, or levels
        are not such.

    Notes
    -----
    IEC 60268-16:2020, section 6.1, the indirect method: modulation transfer functions of the response by octave, of
    male speech. Noise at the end of a measured response is cut off where the decay meets it.
    """
    given, octave = _given(responses, channel, None), math.sqrt(2.0)
    low, high = acoustics.SPEECH_BANDS[0] / octave, acoustics.SPEECH_BANDS[-1] * octave
    if given.band[0] > low or given.band[1] < high:
        raise InputError(
            "responses", f"must reach from {low:.0f} to {high:.0f} Hz for the index, but reach from {given.band[0]:g} "
            f"to {given.band[1]:g} Hz"
        )  # fmt: skip
    if noise_db is not None and speech_db is None:
        raise InputError("speech_db", "must be given where there is noise, but is None")
    speech = None
    if speech_db is not None:
        one = np.isscalar(speech_db) or getattr(speech_db, "shape", None) == ()
        speech = as_floats("speech_db", speech_db, () if one else (7,), within=200.0) + acoustics.SPEECH_DB * one
    noise = None if noise_db is None else as_floats("noise_db", noise_db, (7,), within=200.0)
    index = np.full(given.samples.shape[:2], math.nan)
    for s, r in np.argwhere(given.begin >= 0).tolist():
        transfer = []
        for centre in acoustics.SPEECH_BANDS.tolist():
            taps, begin = cut_to_band(given.samples[s, r], given.rate, centre, octave), int(given.begin[s, r])
            decay = taps[: begin + acoustics.before_noise(taps[begin:], given.rate)[0]]
            transfer.append(acoustics.modulation_transfer(np.square(decay), given.rate))
        index[s, r], _ = acoustics.transmission_index(np.array(transfer), speech, noise)
    return read_only(index)


def _given(responses: Any, channel: int, free_field: Any) -> _Given:
    """Responses of a scene or of a sound file."""
    if isinstance(responses, ImpulseResponses):
        return _Given.simulated(responses)
    if isinstance(responses, str | PathLike):
        return _Given.measured(responses, channel, free_field)
    raise InputError("responses", f"must be ImpulseResponses or a sound file, but are {responses!r:.80}")


def band_centres(band: tuple[float, float], bands: str | None) -> Floats:
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


def cut_to_band(taps: Floats, rate: float, centre: float, share: float | None) -> Floats:
    """Return taps (n,) cut to a band from `centre / share` to `centre * share`, Hz."""
    if share is None:
        return taps
    from scipy.fft import irfft, next_fast_len, rfft

    size = next_fast_len(2 * len(taps), real=True)
    frequencies = np.maximum(np.arange(size // 2 + 1) * (rate / size), 1e-3)
    off = (frequencies / centre - centre / frequencies) / (share - 1.0 / share)
    magnitude = 1.0 / np.sqrt(1.0 + off ** (2 * _ORDER))
    return np.asarray(irfft(rfft(taps, size) * magnitude, size)[: len(taps)])


def _measures(taps: Floats, begin: int, rate: float, free_field: Floats | None) -> tuple[dict[str, float], bool]:
    """Measures of taps (n,) in a band by the sample of the first arrival, and whether noise hides one: NaN."""
    whole, noise, beyond = acoustics.before_noise(taps[begin:], rate)
    decay = taps[: begin + whole]
    curve, early = acoustics.decay_curve(decay[begin:], noise, beyond), begin + round(0.05 * rate)
    found = {name: acoustics.reverberation_time(curve, rate, *levels) for name, levels in _DECAYS.items()}
    reached = [name for name in _DECAYS if math.isfinite(found[name])]
    noisy, fall = beyond > 0.0, acoustics.level_fall(taps[begin:], rate)
    hidden = [
        name
        for name in reached
        if not acoustics.has_decay_range(curve, rate, _DECAYS[name][1], found[name], noisy=noisy, fall_db=fall)
    ]
    found |= dict.fromkeys(hidden, math.nan)
    energy, free = (math.nan if x is None else float(np.sum(np.square(x))) for x in (decay, free_field))
    found |= {
        "c50": acoustics.clarity(decay, early),
        "c80": acoustics.clarity(decay, begin + round(0.08 * rate)),
        "d50": acoustics.definition(decay, early),
        "ts": acoustics.centre_time(decay, rate, begin),
        "g": 10.0 * math.log10(energy / free) if energy > 0.0 and free > 0.0 else math.nan,
        "drr": acoustics.clarity(decay, begin + round(_DIRECT * rate)),
    }
    return found, bool(hidden) or (noisy and len(reached) < len(_DECAYS))


def _diffuse(scene: Scene | None, frequencies: Floats) -> tuple[Floats, Floats]:
    """Sabine's and Eyring's times at frequencies (F,), s."""
    field = None if scene is None else DiffuseField.of(scene, frequencies)
    if scene is None or field is None:
        return np.full(len(frequencies), math.nan), np.full(len(frequencies), math.nan)
    c = scene.air.speed_of_sound
    return (
        acoustics.sabine_time(field.volume, field.absorption_area, field.air, c),
        acoustics.eyring_time(field.volume, field.surface, field.absorption_area, field.air, c),
    )


_EARLY = 0.08  # s


@dataclass(frozen=True, slots=True, eq=False)
class LateralMeasures:
    """How much sound arrives from the side.

    Attributes
    ----------
    frequencies : ndarray (bands,)
        Centres of the bands, Hz.
    lf, lfc : ndarray (sources, bands)
        Early lateral energy fractions; NaN without microphones.
    iacc, iacc_early, iacc_late : ndarray (sources, bands)
        Interaural cross-correlation coefficients of all sound, of the first 80 ms, and of what follows, 0 to 1; NaN
        without ears.
    source_names : tuple of str
        Along the first axis.
    """

    frequencies: Floats
    lf: Floats
    lfc: Floats
    iacc: Floats
    iacc_early: Floats
    iacc_late: Floats
    source_names: tuple[str, ...]

    __repr__ = short_repr


def lateral_measures(
    responses: ImpulseResponses,
    microphones: tuple[str, str] | str | None = None,
    ears: tuple[str, str] | str | None = None,
    bands: str = "octave",
) -> LateralMeasures:
    """Compute lateral energy fractions of two microphones at a place, and the correlation of two ears.

    Parameters
    ----------
    responses : ImpulseResponses
        From `impulse_responses`.
    microphones : (str, str) or str, optional
        Names of an omnidirectional receiver and of a figure of eight, ``FirstOrder(0.0)``, whose null points at the
        source; or of an ambisonic receiver that faces the source: its channels ACN0 and ACN1 are both.
    ears : (str, str) or str, optional
        Names of the receivers of the left and the right ear, or of a head with two channels.
    bands : {"octave", "third-octave"}
        Into which responses are cut.

    Raises
    ------
    InputError
        If `responses` is not an `ImpulseResponses`, a receiver is not known, or no such band lies within that of the
        responses.

    Notes
    -----
    ISO 3382-1:2009, annexes A and B. Sound begins with the earliest path to either receiver of a pair.
    """
    if not isinstance(responses, ImpulseResponses):
        raise InputError("responses", f"must be ImpulseResponses, but are {responses!r:.80}")
    centres = band_centres(responses.band, bands)
    share, rate = 2.0 ** (0.5 / BANDS[bands]), responses.sampling_rate
    # Over microphones of gain 1 along their axes: ambisonic ones can be of N3D.
    kinds = (end.directivity for end in responses.scene.receivers)
    factors = np.concatenate([d.scale if isinstance(d, Ambisonic) else np.ones(len(d.channels)) for d in kinds])
    samples = responses.samples / factors[:, None]
    shape, names = (len(samples), len(centres)), ("lf", "lfc", "iacc", "iacc_early", "iacc_late")
    found = {name: np.full(shape, math.nan) for name in names}
    for field, pair in (("microphones", microphones), ("ears", ears)):
        if pair is None:
            continue
        rows = _rows(field, pair, responses.receiver_names)
        first = np.fmin.reduce(responses.first_arrivals[:, rows], axis=1)  # NaN where neither has a path
        for s in np.flatnonzero(np.isfinite(first)).tolist():
            begin = responses.lead + math.floor(first[s] * rate)
            for b, centre in enumerate(centres.tolist()):
                one, other = (cut_to_band(samples[s, r], rate, centre, share) for r in rows)
                if field == "microphones":
                    found["lf"][s, b], found["lfc"][s, b] = acoustics.lateral_fractions(one, other, rate, begin)
                else:
                    early = begin + round(_EARLY * rate)
                    found["iacc"][s, b] = acoustics.interaural_correlation(one, other, rate)
                    found["iacc_early"][s, b] = acoustics.interaural_correlation(one[:early], other[:early], rate)
                    found["iacc_late"][s, b] = acoustics.interaural_correlation(one[early:], other[early:], rate)
    values = {name: read_only(one) for name, one in found.items()}
    return LateralMeasures(read_only(centres), **values, source_names=responses.source_names)


def _rows(field: str, pair: Any, names: tuple[str, ...]) -> list[int]:
    """Find two rows by their names, or the two of a receiver of several channels."""
    if isinstance(pair, str):
        pair = tuple(f"{pair} {channel}" for channel in (EARS if field == "ears" else ("ACN0", "ACN1")))
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise InputError(field, f"must be the names of two receivers, but is {pair!r:.80}")
    for i, name in enumerate(pair):
        if name not in names:
            raise InputError(f"{field}[{i}]", f"must be a receiver's name, one of {', '.join(names)}, but is {name!r}")
    return [names.index(name) for name in pair]
