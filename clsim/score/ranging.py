"""Ranges by the time of flight of pulses, against the truth; matched filters, and their peaks between samples."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, as_choice, as_index, as_number, read_only, short_repr, texts
from clsim.errors import InputError, check_packages, check_pictures, counted
from clsim.paths.ground_truth import in_sight, reception_times
from clsim.paths.legs.legs import direct_paths
from clsim.paths.path_set import PathSet
from clsim.paths.response import Kinematics
from clsim.pictures.view_page import html_table
from clsim.recording import Recording, as_recording
from clsim.scene.ends import Receiver
from clsim.scene.scene import Scene
from clsim.scene.signal.signal import Signal

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from functools import lru_cache

Method = Literal["matched-filter", "first-peak", "phase"]
METHODS: tuple[str, ...] = get_args(Method)
_AT_A_TIME = 64  # emissions whose outputs are kept in memory
_LATE = 1e-10  # s, of rounding, by which a receiver's trajectory may be exceeded


@dataclass(frozen=True, slots=True, eq=False)
class RangingScore:
    """Estimated ranges and their ground truth.

    Attributes
    ----------
    delay : ndarray (receivers, emissions)
        Measured times of flight by the receivers' clocks, s; NaN where nothing was detected.
    exact : ndarray (receivers, emissions)
        True ones of the direct sound, s, also where a wall is in the way.
    line_of_sight : ndarray (receivers, emissions) of bool
        Whether the direct sound is heard.
    crlb : ndarray (receivers, emissions)
        Least standard deviation that noise allows, m (Cramér and Rao); 0 without noise, NaN where nothing was detected.
    emission_times : ndarray (emissions,)
        When the pulses began, s.
    source : int
        Index of the source.
    receiver_names : tuple of str
        Along the first axis.
    scene : Scene
        Scene of the recording.
    outlier : float
        Error from which on a range counts as an outlier, m.
    """

    delay: Floats
    exact: Floats
    line_of_sight: NDArray[np.bool_]
    crlb: Floats
    emission_times: Floats
    source: int
    receiver_names: tuple[str, ...]
    scene: Scene
    outlier: float

    __repr__ = short_repr

    @property
    def error(self) -> Floats:
        """Measured less true ranges (receivers, emissions), m; NaN where nothing was detected."""
        return self.scene.air.speed_of_sound * (self.delay - self.exact)

    @property
    def detected(self) -> NDArray[np.bool_]:
        """Where a pulse was found (receivers, emissions)."""
        return np.isfinite(self.delay)

    @property
    def detection_rate(self) -> float:
        """Share of the emissions at receivers of which a pulse was found."""
        return float(np.mean(self.detected))

    @property
    def outlier_rate(self) -> float:
        """Share of the ranges that were found whose error is at least `outlier`; NaN if none was found."""
        found = np.abs(self.error[self.detected])
        return float(np.mean(found >= self.outlier)) if len(found) else math.nan

    @property
    def bias(self) -> float:
        """Mean error without outliers, m; NaN if there is none."""
        return float(np.mean(self._inliers())) if len(self._inliers()) else math.nan

    @property
    def deviation(self) -> float:
        """Standard deviation of the error without outliers, m; NaN if there is none."""
        return float(np.std(self._inliers())) if len(self._inliers()) else math.nan

    def percentile(self, percent: float) -> float:
        """Return the magnitude of error that `percent` of all ranges do not exceed, 0 to 100 %, m; NaN without any."""
        percent = as_number("percent", percent, at_least=0.0, at_most=100.0, unit="%")
        found = np.abs(self.error[self.detected])
        return float(np.percentile(found, percent)) if len(found) else math.nan

    def to_dataframe(self) -> Any:
        """Return a row for each receiver and emission as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            Columns ``receiver``, ``emission``, ``emission_time``, ``delay``, ``exact``, ``error``, ``crlb`` and
            ``line_of_sight``, in s and m.
        """
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        import pandas

        receivers, emissions = self.delay.shape
        columns = {
            "receiver": np.repeat(texts(self.receiver_names), emissions),
            "emission": np.tile(np.arange(emissions), receivers),
            "emission_time": np.tile(self.emission_times, receivers),
        }
        over = ("delay", "exact", "error", "crlb", "line_of_sight")
        return pandas.DataFrame(columns | {name: getattr(self, name).ravel() for name in over})

    def plot(self) -> Figure:
        """Draw errors over time, by line of sight, and the distribution of their magnitudes."""
        check_pictures("plot")
        from matplotlib import pyplot

        figure, (over_time, spread) = pyplot.subplots(1, 2, figsize=(11.0, 4.3), layout="constrained")
        times = np.broadcast_to(self.emission_times, self.error.shape)
        for seen, colour, label in ((True, "#1f77b4", "in sight"), (False, "#c1272d", "not in sight")):
            shown = self.detected & (self.line_of_sight == seen)
            if shown.any():
                error = 1e3 * self.error[shown]
                over_time.plot(times[shown], error, ".", markersize=3.0, color=colour, label=label)
                size = np.sort(np.abs(error))
                spread.semilogx(size, 100.0 * (np.arange(len(size)) + 1.0) / len(size), color=colour, label=label)
        over_time.set(xlabel="time of emission (s)", ylabel="error of the range (mm)")
        spread.set(xlabel="|error| (mm)", ylabel="share of the ranges (%)", ylim=(0.0, 100.0))
        for axes in (over_time, spread):
            axes.grid(alpha=0.25, linewidth=0.6)
            if axes.get_legend_handles_labels()[0]:
                axes.legend()
        return figure

    def _inliers(self) -> Floats:
        found = self.error[self.detected]
        return found[np.abs(found) < self.outlier]

    def _repr_html_(self) -> str:
        rows = [
            ("bias", f"{1e3 * self.bias:.3f} mm"), ("deviation", f"{1e3 * self.deviation:.3f} mm"),
            ("75 % within", f"{1e3 * self.percentile(75):.3f} mm"), ("detected", f"{100 * self.detection_rate:.1f} %"),
            (f"outliers, {self.outlier:g} m and more", f"{100 * self.outlier_rate:.1f} %"),
        ]  # fmt: skip
        receivers, emissions = map(counted, self.delay.shape, ("receiver", "emission"))
        return html_table(f"RangingScore: {receivers}, {emissions}", ("", ""), rows)


def ranging(
    recording: Recording, pulse: Signal, method: str = "matched-filter", *, source: int | str = 0,
    max_range: float | None = None, detection_db: float = 14.0, first_peak_db: float = -10.0, outlier: float = 0.5,
    motion: str = "retarded",
) -> RangingScore:  # fmt: skip
    """Return the ranges that a receiver would measure by pulses of a source, and their errors.

    Parameters
    ----------
    recording : Recording
        Recording of sound, with its paths.
    pulse : Signal
        The pulse that the source repeats (see `Signal.pulses`), for which receivers look.
    method : {"matched-filter", "first-peak", "phase"}
        Arrival time of a pulse: at the peak of the matched filter's envelope; at the first of its peaks that is
        at most `first_peak_db` below that; or at the crest of the correlation itself next to the envelope's peak.
    source : int or str
        Index or name.
    max_range : float, optional
        Up to which a pulse is looked for after each emission, m; until the next emission when left out.
    detection_db : float
        Level by which a detected peak must exceed the median of the envelope in that time, 0 to 100 dB. Of ten
        thousand samples of noise alone, the largest stands above 14 dB once in some thousand tries.
    first_peak_db : float
        See `method`; from -60 to 0 dB.
    outlier : float
        Error from which on a range counts as an outlier, m.
    motion : {"retarded", "quasi-static"}
        As the recording was rendered.

    Notes
    -----
    The true time of flight is that of the sound that left when the pulse began. Of a chirp from ``f_c - B / 2`` up to
    ``f_c + B / 2`` within T, whose source recedes at v, the matched filter's peak is late by ``f_c v T / B + v T / 2``.
    The bound is ``c / (2 pi beta sqrt(2 E / N_0))`` (S. M. Kay, "Fundamentals of Statistical Signal Processing:
    Estimation Theory", 1993, section 3.11), beta the root mean square of the pulse's frequency about its mean, or about
    0 Hz for "phase", which knows the carrier; E is the energy of what was found, N_0 the density of the noise of the
    receiver's electronics at the pulse's mean frequency.
    """
    paths = scored_paths(recording, "ranging")
    as_choice("method", method, METHODS)
    detection = 10.0 ** (as_number("detection_db", detection_db, at_least=0.0, at_most=100.0, unit="dB") / 20.0)
    first = 10.0 ** (as_number("first_peak_db", first_peak_db, at_least=-60.0, at_most=0.0, unit="dB") / 20.0)
    outlier = as_number("outlier", outlier, above=0.0, unit="m")
    index = source_index(paths, source)
    rate, c = recording.sampling_rate, paths.scene.air.speed_of_sound
    matched = MatchedFilter.of(pulse, rate)
    emitted = emissions_of(recording, index, len(matched.pulse))
    span = span_of(emitted, recording, max_range, c)
    shape = (len(recording.samples), len(emitted))
    delay, level = np.full(shape, math.nan), np.zeros(shape)
    for r, samples in enumerate(recording.samples):
        for k, (begin, output) in enumerate(outputs_of(samples, matched, emitted, span)):
            place = _found(output, method, detection, first)
            if place is not None:
                delay[r, k] = (begin + place) / rate - emitted[k]
                level[r, k] = abs(output[round(min(max(place, 0), len(output) - 1))])
    exact, seen = direct_delays(paths, index, emitted, Kinematics(motion))
    spread = math.hypot(matched.bandwidth, matched.centre) if method == "phase" else matched.bandwidth
    density = np.array([_noise_density(end, rate, matched.centre) for end in paths.scene.receivers])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = c * np.sqrt(0.5 * density / (np.square(level) * matched.energy)) / (2.0 * math.pi * spread)
    crlb = np.where(np.isfinite(delay), bound, math.nan)
    return RangingScore(
        read_only(delay), read_only(exact), seen, read_only(crlb), read_only(emitted), index,
        recording.receiver_names, paths.scene, outlier,
    )  # fmt: skip


def emissions_of(recording: Recording, source: int, length: int) -> Floats:
    """Return when the pulses of a source begin that end within the recording (K,), s."""
    assert recording.paths is not None
    end = recording.paths.scene.sources[source]
    begins = end.start + end.signal.pulse_times
    rate, count = recording.sampling_rate, recording.samples.shape[1]
    kept: Floats = begins[np.floor(begins * rate) + length <= count]
    if not len(kept):
        raise InputError("recording", f"must hold a whole pulse of {length / rate:g} s, but is {count / rate:g} s long")
    return kept


def span_of(emitted: Floats, recording: Recording, max_range: float | None, speed_of_sound: float) -> int:
    """Return the search window after an emission, in samples."""
    rate = recording.sampling_rate
    gap = float(np.diff(emitted).min(initial=recording.samples.shape[1] / rate))
    if max_range is not None:
        gap = min(gap, as_number("max_range", max_range, above=0.0, unit="m") / speed_of_sound)
    return max(1, math.floor(gap * rate))


def outputs_of(
    samples: NDArray[Any], matched: MatchedFilter, emitted: Floats, span: int
) -> Iterator[tuple[int, Complexes]]:
    """Yield, for each emission, the first sample of its search window and the filter's output (n,)."""
    begins = np.floor(emitted * matched.sampling_rate).astype(np.int64)
    length = span + len(matched.pulse) - 1
    for i in range(0, len(begins), _AT_A_TIME):
        rows = np.zeros((len(begins[i : i + _AT_A_TIME]), length), dtype=np.float32)
        for row, begin in zip(rows, begins[i:], strict=False):
            part = samples[begin : begin + length]
            row[: len(part)] = part
        for begin, output in zip(begins[i:].tolist(), matched.outputs(rows), strict=False):
            yield begin, output[: len(samples) - begin]


def _found(output: Complexes, method: str, detection: float, first: float) -> float | None:
    """Return the arrival of a pulse in a filter's output (n,), in samples, or None."""
    level = np.abs(output)
    top, least = int(np.argmax(level)), detection * float(np.median(level))
    if not level[top] > least:
        return None
    if method == "first-peak":
        least = max(first * level[top], least)
        rising = (level[1:-1] > level[:-2]) & (level[1:-1] >= level[2:]) & (level[1:-1] >= least)
        top = int(np.flatnonzero(rising)[0]) + 1 if rising[:top].any() else top
    return phase_peak(output, top) if method == "phase" else envelope_peak(output, top)


def _noise_density(end: Receiver, sampling_rate: float, frequency: float) -> float:
    """Return the one-sided density of a receiver's noise at a frequency, Pa²/Hz or V²/Hz."""
    electronics, half = end.electronics, 0.5 * sampling_rate
    if electronics is None:
        return 0.0
    gain = sensitivity = 1.0
    if end.transducer is not None:
        gain = float(np.abs(end.transducer.response(np.array([frequency]), sampling_rate)[0]))
        sensitivity = end.transducer.sensitivity
    noise = (electronics.ambient_rms(sampling_rate) * gain) ** 2
    noise += (electronics.self_rms(sampling_rate) * sensitivity) ** 2
    for cut, sign in ((electronics.low_cut, -1), (electronics.high_cut, 1)):
        if cut is not None:
            noise /= 1.0 + (frequency / cut) ** (2 * sign * electronics.order)
    return float(noise * 10.0 ** (electronics.gain_db / 10.0) + electronics.step**2 / 12.0) / half


def scored_paths(recording: Recording, what: str) -> PathSet:
    """Return the paths of a recording, or raise if a score of this kind cannot be made from it."""
    recording = as_recording(recording)
    if recording.carrier is not None:
        raise InputError("recording", f"must be sound for {what}, but is the envelope about {recording.carrier:g} Hz")
    if recording.paths is None:
        raise InputError("recording", f"must have its paths for {what}, but has none: load_recording(…, paths=True)")
    if len(recording.channels) != len(recording.paths.scene.receivers):
        raise InputError("recording", f"must be of receivers of one channel for {what}, but one has several")
    return recording.paths


def source_index(paths: PathSet, source: int | str) -> int:
    """Return the index of a source, by index or name."""
    return as_index("source", source, [one.name for one in paths.scene.sources])


def direct_delays(
    paths: PathSet, source: int, emitted: Floats, kinematics: Kinematics
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return delays (receivers, K) of the direct sound emitted at times (K,), s, and a mask of those in sight."""
    # Delays are known where a wall is in the way, too; they are NaN beyond the end of a receiver's trajectory.
    receivers = paths.scene.receivers
    received = np.empty((len(receivers), len(emitted)))
    for pair in direct_paths(paths.scene).pairs():
        if pair.source == source:
            received[pair.receiver] = reception_times(pair, emitted, kinematics)
    last = np.array([receiver.trajectory.end for receiver in receivers])[:, None]
    return np.where(received <= last + _LATE, received - emitted, np.nan), in_sight(paths, source, received)


_REACH = 16  # samples to either side from which a value between samples is made
_STEPS = 64  # per sample, between which a parabola is laid
_SHAPE = 12.0  # of the Kaiser window: -115 dB
_BATCH = 2**22  # samples that are filtered at a time


@dataclass(frozen=True, slots=True, eq=False)
class MatchedFilter:
    """The filter of a pulse at a sampling rate."""

    pulse: Floats  # (n,) its samples
    sampling_rate: float  # hz
    energy: float  # sum of their squares over the sampling rate, Pa² s
    centre: float  # mean frequency of its energy, Hz
    bandwidth: float  # root mean square of the frequency about it, Hz

    __repr__ = short_repr

    @classmethod
    def of(cls, pulse: Signal, sampling_rate: float) -> MatchedFilter:
        """Return the filter of a pulse."""
        if not isinstance(pulse, Signal):
            raise InputError("pulse", f"must be a Signal, but is {pulse!r:.80}")
        at_rate = pulse.at_rate(sampling_rate)
        samples = at_rate.read(0, at_rate.count)
        total = float(np.sum(np.square(samples)))
        if total == 0.0:
            raise InputError("pulse", "must not be silent, but is")
        spectrum = np.square(np.abs(np.fft.rfft(samples, 2 * len(samples))))
        frequencies = np.fft.rfftfreq(2 * len(samples), 1.0 / sampling_rate)
        centre = float(np.sum(frequencies * spectrum) / np.sum(spectrum))
        spread = float(np.sum(np.square(frequencies - centre) * spectrum) / np.sum(spectrum))
        return cls(samples, sampling_rate, total / sampling_rate, centre, math.sqrt(spread))

    def outputs(self, rows: NDArray[Any]) -> Complexes:
        """Return the complex output (n, T - L + 1) for rows of samples (n, T): amplitude of the pulse beginning there.

        Its magnitude is the envelope, its real part the correlation itself, over the pulse's energy.
        """
        length = rows.shape[1]
        size = scipy.fft.next_fast_len(length + len(self.pulse) - 1)
        filtered = np.conj(scipy.fft.fft(self.pulse, size))
        filtered[size // 2 + 1 :] = 0.0  # what is left is the analytic signal
        filtered[1 : (size + 1) // 2] *= 2.0
        out = np.empty((len(rows), max(length - len(self.pulse) + 1, 0)), dtype=np.complex128)
        scale = 1.0 / (self.energy * self.sampling_rate)
        step = max(1, _BATCH // size)
        for i in range(0, len(rows), step):
            made = scipy.fft.ifft(scipy.fft.fft(rows[i : i + step].astype(np.float64), size) * filtered)
            out[i : i + step] = made[:, : out.shape[1]] * scale
        return out


def envelope_peak(output: Complexes, index: int) -> float:
    """Return the position of the magnitude's peak in an output (n,), near a sample, in samples."""
    places, values = _between(output, index)
    level = np.square(np.abs(values))
    top = int(np.clip(np.argmax(level), 1, len(level) - 2))
    before, at, after = level[top - 1 : top + 2]
    curve = before - 2.0 * at + after
    return float(places[top] + (0.5 * (before - after) / curve / _STEPS if curve < 0.0 else 0.0))


def phase_peak(output: Complexes, index: int) -> float:
    """Return the position nearest to the envelope's peak at which the output (n,) is real and positive, in samples."""
    # That is the crest of the correlation itself: exact to a fraction of a wave, if the envelope finds the right one.
    place = envelope_peak(output, index)
    values = _at(output, place + np.array([-0.25, 0.0, 0.25]))
    turn = np.unwrap(np.angle(values))
    rate = max(2.0 * (turn[2] - turn[0]), 1e-3)  # rad per sample
    place -= float(np.angle(values[1])) / rate
    for _ in range(3):
        place -= float(np.angle(_at(output, np.array([place]))[0])) / rate
    return float(place)


def _between(output: Complexes, index: int) -> tuple[Floats, Complexes]:
    """Return places within a sample of an index, in samples, and the output there."""
    fractions = np.arange(-_STEPS, _STEPS + 1) / _STEPS
    return index + fractions, _weights()[0] @ _around(output, index) * _weights()[1]


def _at(output: Complexes, places: Floats) -> Complexes:
    """Return an output (n,) at places, in samples, near each other."""
    index = round(float(np.mean(places)))
    near = np.arange(-_REACH, _REACH + 1)
    weights = _kernel(places[:, None] - index - near)
    return np.asarray(weights @ _around(output, index) * np.exp(0.5j * np.pi * (places - index)))


def _around(output: Complexes, index: int) -> Complexes:
    """Return samples around an index, moved down by a quarter of the sampling rate, zero beyond the ends."""
    # An analytic signal lies between 0 and half the sampling rate: moved down, it is centred and oversampled twice.
    near = np.arange(-_REACH, _REACH + 1)
    inside = (index + near >= 0) & (index + near < len(output))
    values = np.where(inside, output[np.clip(index + near, 0, len(output) - 1)], 0.0)
    return np.asarray(values * np.exp(-0.5j * np.pi * near))


@lru_cache(maxsize=1)
def _weights() -> tuple[Floats, Complexes]:
    fractions = np.arange(-_STEPS, _STEPS + 1) / _STEPS
    near = np.arange(-_REACH, _REACH + 1)
    return _kernel(fractions[:, None] - near), np.exp(0.5j * np.pi * fractions)


def _kernel(x: Floats) -> Floats:
    """Return the weight of a sample at a distance of x samples: a Kaiser-windowed sinc."""
    across = np.sqrt(np.maximum(1.0 - np.square(x / (_REACH + 1)), 0.0))
    return np.asarray(np.sinc(x) * np.i0(_SHAPE * across) / np.i0(_SHAPE))
