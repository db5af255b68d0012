"""Recordings: the samples of all receivers, and ambisonic ones for headphones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_floats, as_index, as_number, short_repr, texts
from clsim.errors import InputError, check_packages, check_pictures, counted
from clsim.files.atomic import atomic_path
from clsim.paths.path_set import PathSet
from clsim.pictures.view_page import html_table, inline_sound
from clsim.scene.ends import Receiver
from clsim.scene.signal.signal import Signal
from clsim.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure


from clsim.numerics.sphere import fibonacci_sphere
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.head_related import EARS, HeadRelated, SphericalHead
from clsim.scene.directivity.patterns import HIGHEST, NORMALIZATIONS, Ambisonic

_MOST_DRAWN = 8  # receivers in one picture
_MOST_LISTED = 64  # in a table
_SHORT, _SWEEPS = 0.05, 8.0  # s, and duration times bandwidth, of pulses that are short sweeps
_LEAST_WINDOW = 32  # samples
_PLAYED = (3000.0, 384_000.0)  # Hz: rates at which browsers play


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Samples of every receiver, with the scene and paths that they were rendered from.

    Attributes
    ----------
    samples : ndarray (rows, samples) float32, or complex64 in baseband
        A row per receiver, or for each channel of one that has several.
        Sound pressure in Pa, or the voltage of a receiver with a transducer: see `units`. In baseband the complex
        envelope about `carrier`: 1 + 0j for a cosine of 1 Pa.
    sampling_rate : float
        Hz.
    receiver_names : tuple of str
        One per row; of channels with the channel's name behind the receiver's.
    paths : PathSet or None
        The paths that were rendered, with their scene; None for tracks computed elsewhere.
    notes : tuple of str
        What was computed, one line each.
    units : tuple of str
        ``"Pa"`` or ``"V"``, one per row; all Pa when left out.
    clipped : tuple of int
        Number of samples of each row that a converter clipped; none when left out.
    carrier : float or None
        That of complex envelopes, Hz; None for sound as it is.
    channels : tuple of (str, str)
        Names of the receiver and of its channel, one per row: ``"ACN0"`` and so on for ambisonics, ``"left"`` and
        ``"right"`` for heads, ``"0"`` and so on for the elements of arrays, and "" for receivers of one channel.
    """

    samples: NDArray[Any]
    sampling_rate: float
    receiver_names: tuple[str, ...]
    paths: PathSet | None
    notes: tuple[str, ...]
    units: tuple[str, ...] = ()
    clipped: tuple[int, ...] = ()
    carrier: float | None = None
    channels: tuple[tuple[str, str], ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        count = len(self.receiver_names)
        object.__setattr__(self, "units", tuple(self.units) or ("Pa",) * count)
        object.__setattr__(self, "clipped", tuple(self.clipped) or (0,) * count)
        object.__setattr__(self, "channels", tuple(self.channels) or tuple((n, "") for n in self.receiver_names))

    def rows_of(self, receiver: str) -> list[int]:
        """Return the rows of the channels of a `receiver` by its name, in their order.

        Raises
        ------
        InputError
            If there is no such receiver.
        """
        names = [name for name, _ in self.channels]
        as_index("receiver", receiver, tuple(dict.fromkeys(names)))
        return [row for row, name in enumerate(names) if name == receiver]

    @property
    def pressure(self) -> NDArray[Any]:
        """Sound pressure (receivers, samples), Pa; in baseband its complex envelope.

        Raises
        ------
        InputError
            If a receiver has a transducer: its samples are no pressure.
        """
        return self._all_in("Pa", "pressure")

    @property
    def voltage(self) -> NDArray[Any]:
        """Voltage of the receivers' transducers (receivers, samples), V.

        Raises
        ------
        InputError
            If a receiver has none: its samples are sound pressure.
        """
        return self._all_in("V", "voltage")

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the samples, s, by the receivers' clocks."""
        return np.arange(self.samples.shape[1]) / self.sampling_rate

    def reception_times(self, receiver: int) -> NDArray[np.float64]:
        """Return the true times (samples,) at which row `receiver` was sampled, s; see `Electronics`."""
        times = self.times
        return times if self.paths is None else times + self._ends[receiver].clock_error(times)

    @property
    def _ends(self) -> list[Receiver]:
        """The receiver of each row."""
        assert self.paths is not None
        by_row = {row: end for end in self.paths.scene.receivers for row in end.rows}
        return [by_row[row] for row in self.channels]

    def save(self, path: str | PathLike[str]) -> None:
        """Write a WAV file of 32-bit floats in Pa or V, one channel per receiver, whole or not at all.

        In baseband there are two channels per receiver, real part (I) before imaginary part (Q).

        Parameters
        ----------
        path : path-like
            Path of the file; it ends in ``.wav``. Other formats: `write_flac`, `write_mat`.

        Raises
        ------
        InputError
            If it ends otherwise.
        OSError
            If the file cannot be written.
        """
        if not str(path).lower().endswith(".wav"):
            raise InputError("path", f"must end in .wav, but is {str(path)!r:.80}")
        from clsim.files.sound import as_frames, write_wav

        with atomic_path(path) as temporary:
            write_wav(temporary, self.sampling_rate, as_frames(self.samples))

    def to_xarray(self) -> Any:
        """Return the recording as an xarray Dataset, like `open_store`.

        Returns
        -------
        xarray.Dataset
            ``sound`` (receiver, time), in Pa or V; coordinates ``receiver``, ``unit`` (receiver), ``channel``
            (receiver) where there are any, ``time``, s, by the receivers' clocks, and, where the scene is known,
            ``position`` (receiver, axis) at 0 s, m; attributes
            ``sampling_rate`` and, in baseband, ``carrier``, Hz.
        """
        check_packages("to_xarray", "a Dataset", "tables", "xarray")
        positions = None
        if self.paths is not None:
            positions = np.concatenate([end.trajectory.position(np.zeros(1)) for end in self._ends])
        found = sound_coordinates(self.receiver_names, self.units, positions, self.channels)
        found["sound"] = (("receiver", "time"), self.samples, sound_attributes(self.units, self.carrier))
        found.attrs = {"clsim_version": __version__, "sampling_rate": self.sampling_rate}
        if self.carrier is not None:
            found.attrs["carrier"] = self.carrier
        return with_times(found, self.sampling_rate)

    def plot(self, receivers: int | str | Sequence[int | str] | None = None) -> Figure:
        """Draw samples of `receivers` (indices or names; by default eight) over time; in baseband their magnitude.

        Raises
        ------
        InputError
            If there is no such receiver.
        """
        check_pictures("plot")
        from matplotlib import pyplot

        from clsim.pictures.plots import draw_waveform

        wanted = range(len(self.samples))[:_MOST_DRAWN] if receivers is None else receivers
        rows = [self._row(r) for r in ([wanted] if isinstance(wanted, int | str) else wanted)]
        size = (10.0, 1.2 + 1.6 * len(rows))
        figure, axes = pyplot.subplots(len(rows), sharex=True, squeeze=False, figsize=size, layout="constrained")
        for row, place in zip(rows, axes[:, 0], strict=True):
            shown = self.samples[row] if self.carrier is None else np.abs(self.samples[row])
            name, unit = self.receiver_names[row], self.units[row]
            draw_waveform(place, shown, self.sampling_rate, title=name, unit=unit)
            place.label_outer()
        return figure

    def spectrogram(self, receiver: int | str = 0, band: tuple[float, float] | None = None) -> Figure:
        """Draw the level over time and frequency; in baseband over the offset from the carrier.

        Where all sources send short sweeps, the window is the one that resolves a sweep best.

        Parameters
        ----------
        receiver : int or str
            Index or name.
        band : (low, high), optional
            Frequencies shown, Hz; all when left out, and always in baseband.

        Raises
        ------
        InputError
            If there is no such receiver, or no such band up to half the sampling rate.
        """
        check_pictures("plot")
        from matplotlib import pyplot

        from clsim.pictures.plots import draw_spectrogram

        row = self._row(receiver)
        if band is not None:
            low, high = as_floats("band", band, (2,)).tolist()
            as_number("band[0]", low, at_least=0.0, unit="Hz")
            as_number("band[1]", high, above=low, at_most=0.5 * self.sampling_rate, unit="Hz")
        figure, axes = pyplot.subplots(figsize=(10.0, 5.0), layout="constrained")
        signals = [] if self.paths is None or self.carrier else [s.signal for s in self.paths.scene.sources]
        draw_spectrogram(
            figure, axes, self.samples[row], self.sampling_rate, title=self.receiver_names[row],
            band=None if self.carrier else band, segment=sweep_window(signals, self.sampling_rate),
            unit=self.units[row], carrier=self.carrier,
        )  # fmt: skip
        return figure

    def play(self, receiver: int | str = 0, slower: float = 10.0) -> Any:
        """Return a notebook player of a receiver's sound, normalised, and slowed down to make ultrasound audible.

        Parameters
        ----------
        receiver : int or str
            Index or name.
        slower : float
            Ratio by which time is stretched and frequencies fall, from 1 to 1000.

        Raises
        ------
        InputError
            If there is no such receiver, the slowed sound is beyond the rates that browsers play, the recording is
            a complex envelope, or IPython is missing.
        """
        row = self._row(receiver)
        slower = as_number("slower", slower, at_least=1.0, at_most=1000.0)
        if self.carrier is not None:
            raise InputError("recording", f"must be sound to be played, but is the envelope about {self.carrier:g} Hz")
        rate = self.sampling_rate / slower
        if not _PLAYED[0] <= rate <= _PLAYED[1]:
            raise InputError(
                "slower",
                f"must leave a rate of {_PLAYED[0]:g} to {_PLAYED[1]:g} Hz, which browsers play, but {slower:g} makes "
                f"it {rate:g} Hz",
            )
        return inline_sound(self.samples[row], round(rate))

    def _repr_html_(self) -> str:
        rows = [
            (
                name,
                unit,
                f"{np.sqrt(np.mean(np.square(np.abs(row), dtype=np.float64))):.3g}",
                f"{np.abs(row).max():.3g}",
            )
            for name, unit, row, _ in zip(
                self.receiver_names, self.units, self.samples, range(_MOST_LISTED), strict=False
            )
        ]
        about = "" if self.carrier is None else f", envelopes about {self.carrier:g} Hz"
        duration = self.samples.shape[1] / self.sampling_rate
        title = (
            f"Recording: {counted(len(self.samples), 'receiver')}, {duration:.6g} s at {self.sampling_rate:g} Hz{about}"
        )
        more = [f"and {len(self.samples) - len(rows)} more"] if len(rows) < len(self.samples) else []
        return html_table(title, ("receiver", "unit", "rms", "peak"), rows, [*more, *self.notes])

    def _row(self, receiver: int | str) -> int:
        """Return the row of a receiver, by index or name."""
        return as_index("receiver", receiver, self.receiver_names)

    def _all_in(self, unit: str, name: str) -> NDArray[Any]:
        for receiver, found in zip(self.receiver_names, self.units, strict=True):
            if found != unit:
                raise InputError(name, f"must be in {unit}, but {receiver!r} recorded {found}; take recording.samples")
        return self.samples


def sweep_window(signals: Iterable[Signal], sampling_rate: float) -> int | None:
    """Window of a spectrogram that resolves the shortest sweeps of signals best, samples; None for other signals."""
    windows = []
    for signal in signals:
        pulse = signal.pulse
        low, high = pulse.band()
        if pulse.duration > _SHORT or (high - low) * pulse.duration < _SWEEPS:
            return None
        windows.append(2.0 * np.sqrt(pulse.duration / (high - low)) * sampling_rate)
    return max(_LEAST_WINDOW, 2 ** round(np.log2(max(windows)))) if windows else None


def sound_coordinates(
    names: Sequence[str], units: Sequence[str], positions: Floats | None, channels: Sequence[tuple[str, str]]
) -> Any:
    """Return an xarray Dataset of receivers without sound: names, units and, if known, positions (receivers, 3), m."""
    # Where a receiver has several channels, their names come as well.
    import xarray

    coordinates: dict[str, Any] = {"receiver": texts(names), "unit": ("receiver", texts(units))}
    if positions is not None:
        attributes = {"units": "m", "long_name": "position at 0 s"}
        coordinates |= {"axis": texts("xyz"), "position": (("receiver", "axis"), positions, attributes)}
    if any(channel for _, channel in channels):
        coordinates["channel"] = "receiver", texts([channel for _, channel in channels])
    return xarray.Dataset(coords=coordinates)


def as_recording(value: object) -> Recording:
    """Return a recording."""
    if not isinstance(value, Recording):
        raise InputError("recording", f"must be a Recording, but is {value!r:.80}")
    return value


def sound_attributes(units: Sequence[str], carrier: float | None) -> dict[str, Any]:
    """Return the attributes of samples: their common unit, if they have one, and their kind."""
    kinds = sorted(set(units))
    named = {"units": kinds[0]} if len(kinds) == 1 else {}
    what = "sound pressure or voltage, unit by receiver"
    if carrier is not None:
        what = "complex envelope of sound pressure about the carrier"
    return named | {"long_name": what}


def with_times(found: Any, sampling_rate: float) -> Any:
    """Return an xarray Dataset of sound with lazy time coordinates, s."""
    import xarray

    count = found.sizes["time"]
    index = xarray.indexes.RangeIndex.linspace(0.0, count / sampling_rate, count, endpoint=False, dim="time")
    return found.assign_coords(xarray.Coordinates.from_xindex(index))


_EAR_STEPS = 512  # between frequencies: ears' filters have twice as many taps
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
    from scipy.signal import oaconvolve

    components, speed = _as_recorded(recording, name, order, normalization)
    filters = _ear_filters(_ears(hrtf), components, recording.sampling_rate, speed)
    half = filters.shape[2] // 2  # the second half is before time 0
    whole = oaconvolve(rows[None], np.roll(filters, half, axis=2), axes=2).sum(axis=1)
    samples = np.asarray(whole[:, half : half + rows.shape[1]], dtype=np.float32)
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
    frequencies = np.clip(np.linspace(0.0, 0.5 * rate, _EAR_STEPS + 1), *ears.band)
    harmonics = components.gain_towards(directions, 0.0, speed)
    shares = np.linalg.pinv(harmonics)  # (C, n)
    gains = ears.gain_towards(directions[:, None], frequencies, speed)
    return np.asarray(irfft(np.einsum("cn,nfe->ecf", shares, gains), axis=-1))
