"""Ambisonic recordings for headphones."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.numerics.sphere import fibonacci_sphere
from clsim.recording import Recording, as_recording
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.head_related import EARS, HeadRelated, SphericalHead
from clsim.scene.directivity.patterns import HIGHEST, NORMALIZATIONS, Ambisonic

_STEPS = 512  # between frequencies: ears' filters have twice as many taps
_SPREAD = 4  # directions to a component
_SPEED = 343.0  # m/s, where the air is not known


def decode_binaural(
    recording: Recording,
    hrtf: str | PathLike[str] | ChannelDirectivity | None = None,
    receiver: str | None = None,
    normalization: str | None = None,
) -> Recording:
    """Decode an ambisonic recording for headphones.

    Parameters
    ----------
    recording : Recording
        A recording of sound, not of envelopes.
    hrtf : path-like or HeadRelated or SphericalHead, optional
        As of `Receiver.binaural`; a rigid sphere when left out.
    receiver : str, optional
        Name of the ambisonic receiver; the first when left out.
    normalization : {"SN3D", "N3D"}, optional
        Normalization of the components: that of the receiver, or SN3D where the recording has no paths.

    Raises
    ------
    InputError
        If the recording has no ambisonic components of a whole order, `normalization` is not that of the receiver, or
        the responses cannot be read.

    Notes
    -----
    Each ear's filters are the mean of its responses over all directions, weighted by the components: the least error
    over all plane waves, and exact for those responses that the order holds (Z. Ben-Hur et al., Acta Acust. 3, 2019).
    Above some ``order * c / (2 pi 8.75 cm)`` Hz the order holds less than a head does, and levels fall.
    """
    if as_recording(recording).carrier is not None:
        raise InputError("recording", f"must be sound, but is the envelope about {recording.carrier:g} Hz")
    known = list(dict.fromkeys(name for name, channel in recording.channels if channel.startswith("ACN")))
    if not known or (receiver is not None and receiver not in known):
        raise InputError("receiver", f"must be ambisonic, one of {known}, but is {receiver!r:.80}")
    name = receiver or known[0]
    rows = recording.samples[recording.rows_of(name)].astype(np.float64)
    order = round(np.sqrt(len(rows))) - 1
    if (order + 1) ** 2 != len(rows) or order > HIGHEST:
        raise InputError("recording", f"must have all components of an order, but has {len(rows)}")
    components, speed = _as_recorded(recording, name, order, normalization)
    filters = _ear_filters(_ears(hrtf), components, recording.sampling_rate, speed)
    samples = _filtered(rows, filters)
    channels = tuple((name, ear) for ear in EARS)
    names = tuple(f"{name} {ear}" for ear in EARS)
    return Recording(samples, recording.sampling_rate, names, None, recording.notes, channels=channels)


def _as_recorded(recording: Recording, name: str, order: int, normalization: str | None) -> tuple[Ambisonic, float]:
    """Return the components of a receiver, and the speed of sound, m/s."""
    if recording.paths is None:
        return Ambisonic(order, normalization or NORMALIZATIONS[0]), _SPEED
    scene = recording.paths.scene
    recorded: Any = next(end.directivity for end in scene.receivers if end.name == name)
    if normalization not in (None, recorded.normalization):
        raise InputError("normalization", f"must be {recorded.normalization} of {name!r}, but is {normalization!r:.80}")
    return recorded, scene.air.speed_of_sound


def _ears(hrtf: str | PathLike[str] | ChannelDirectivity | None) -> ChannelDirectivity:
    if hrtf is None:
        return SphericalHead()
    ears: Any = HeadRelated.from_sofa(hrtf, outside="hold") if isinstance(hrtf, str | PathLike) else hrtf
    if not isinstance(ears, ChannelDirectivity) or ears.channels != EARS:
        raise InputError("hrtf", f"must be a SOFA file or a directivity of two ears, but is {hrtf!r:.80}")
    return ears


def _ear_filters(ears: ChannelDirectivity, components: Ambisonic, rate: float, speed: float) -> Floats:
    """Return the filters (2, C, 2 steps) of the components for both ears; the second half is before time 0."""
    from scipy.fft import irfft

    directions = fibonacci_sphere(max(_SPREAD * (components.order + 1) ** 2, 256))
    frequencies = np.clip(np.linspace(0.0, 0.5 * rate, _STEPS + 1), *ears.band)
    harmonics = components.gain_towards(directions, 0.0, speed)
    shares = np.linalg.pinv(harmonics)  # (C, n)
    gains = ears.gain_towards(directions[:, None], frequencies, speed)
    return np.asarray(irfft(np.einsum("cn,nfe->ecf", shares, gains), axis=-1))


def _filtered(rows: Floats, filters: Floats) -> Floats:
    """Return the sum (2, n) of rows (C, n) through filters (2, C, m) whose second half is before time 0."""
    from scipy.signal import oaconvolve

    half = filters.shape[2] // 2
    taps = np.roll(filters, half, axis=2)
    whole = oaconvolve(rows[None], taps, axes=2).sum(axis=1)
    return np.asarray(whole[:, half : half + rows.shape[1]], dtype=np.float32)
