"""Echoes of a train of pulses: by range and pulse, and by range and speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Complexes, Floats, as_count, as_flag, as_index, as_number, read_only, short_repr
from clsim.errors import InputError, check_packages, check_pictures
from clsim.recording import Recording
from clsim.scene.signal.signal import Signal
from clsim.score.ranging import MatchedFilter, emissions_of, outputs_of, scored_paths, source_index, span_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_RANGE_DB = 60.0  # shown below the loudest
_COLUMNS = 1600  # of a picture


@dataclass(frozen=True, slots=True, eq=False)
class RangeDopplerMap:
    """Echoes of a train of pulses by range and speed.

    Attributes
    ----------
    amplitude : ndarray (speeds, ranges) complex
        The factor of the pulse as received: a path of constant speed keeps the one that it has.
    ranges : ndarray (ranges,)
        m.
    speeds : ndarray (speeds,)
        Increasing; positive where the range grows, m/s.
    unambiguous_speed : float
        Half the width of `speeds`, m/s: a path that is faster than this, either way, appears at another speed.
    """

    amplitude: Complexes
    ranges: Floats
    speeds: Floats
    unambiguous_speed: float

    __repr__ = short_repr

    def to_xarray(self) -> Any:
        """Return it with named dimensions ``speed`` and ``range``."""
        check_packages("to_xarray", "a DataArray", "tables", "xarray")
        import xarray

        coordinates = {
            "speed": ("speed", self.speeds, {"units": "m/s", "long_name": "speed at which the range grows"}),
            "range": ("range", self.ranges, {"units": "m"}),
        }
        return xarray.DataArray(self.amplitude, coordinates, ("speed", "range"), name="amplitude")

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row for each ``speed``, m/s, and ``range``, m: complex ``amplitude``."""
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        import pandas

        speeds, ranges = np.meshgrid(self.speeds, self.ranges, indexing="ij")
        return pandas.DataFrame({"speed": speeds.ravel(), "range": ranges.ravel(), "amplitude": self.amplitude.ravel()})

    def plot(self) -> Figure:
        """Draw the level over range and speed."""
        title = f"unambiguous up to ±{self.unambiguous_speed:.3g} m/s"
        return _drawn(self.ranges, self.speeds, self.amplitude, ylabel="speed at which it grows (m/s)", title=title)


@dataclass(frozen=True, slots=True, eq=False)
class EchoMap:
    """Echoes of a train of pulses by range and pulse: what a sonar's display shows.

    Attributes
    ----------
    amplitude : ndarray (pulses, ranges) complex
        Output of the matched filter: the factor of the pulse as received.
    ranges : ndarray (ranges,)
        m.
    emission_times : ndarray (pulses,)
        When each pulse begins, s.
    """

    amplitude: Complexes
    ranges: Floats
    emission_times: Floats

    __repr__ = short_repr

    def plot(self) -> Figure:
        """Draw the level over range and number of the pulse."""
        return _drawn(self.ranges, np.arange(float(len(self.amplitude))), self.amplitude, ylabel="pulse")


def _drawn(ranges: Floats, up: Floats, amplitude: Complexes, **labels: str) -> Figure:
    """Draw the level of amplitudes (up, ranges), the largest in each of at most 1600 steps."""
    check_pictures("plot")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(9.0, 5.0), layout="constrained")
    level = 20.0 * np.log10(np.maximum(np.abs(amplitude), 1e-30))
    first = np.arange(0, len(ranges), -(-len(ranges) // _COLUMNS))
    level = np.maximum.reduceat(level, first, axis=1)  # no echo is between two pixels
    peak = float(level.max())
    shown = axes.pcolormesh(ranges[first], up, level, vmin=peak - _RANGE_DB, vmax=peak, cmap="magma", shading="nearest")
    axes.set(xlabel="range (m)", **labels)
    figure.colorbar(shown, ax=axes, label="level (dB)")
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class _Train:
    """Matched outputs `rows` (pulses, ranges) of a train, as if each pulse began at a sample."""

    rows: Complexes
    ranges: Floats
    emitted: Floats
    centre: float
    speed_of_sound: float

    @classmethod
    def of(
        cls, recording: Recording, pulse: Signal, receiver: int | str, source: int | str,
        part: tuple[int, int | None, int], passes: float, max_range: float | None,
    ) -> _Train:  # fmt: skip
        """Filter the part (first, count, least) of a train."""
        paths = scored_paths(recording, "echoes")
        row = as_index("receiver", receiver, recording.receiver_names)
        rate, c = recording.sampling_rate, paths.scene.air.speed_of_sound
        matched = MatchedFilter.of(pulse, rate)
        emitted = emissions_of(recording, source_index(paths, source), len(matched.pulse))
        first = as_count("first", part[0], at_most=max(len(emitted) - part[2], 0))
        most = len(emitted) - first
        count = most if part[1] is None else as_count("count", part[1], at_least=part[2], at_most=most)
        emitted = emitted[first : first + count]
        reach = None if max_range is None else passes * as_number("max_range", max_range, above=0.0, unit="m")
        span = span_of(emitted, recording, reach, c)
        rows = np.zeros((len(emitted), span), dtype=np.complex128)
        for k, (begin, output) in enumerate(outputs_of(recording.samples[row], matched, emitted, span)):
            late = emitted[k] * rate - begin  # of the emission after the sample, below one
            rows[k, : len(output)] = output * np.exp(2j * np.pi * matched.centre * late / rate)
        return cls(rows, read_only(np.arange(span) / rate * c / passes), emitted, matched.centre, c)


def range_doppler(
    recording: Recording, pulse: Signal, receiver: int | str = 0, *, source: int | str = 0, first: int = 0,
    count: int | None = None, two_way: bool = True, max_range: float | None = None,
) -> RangeDopplerMap:  # fmt: skip
    """Return the range-Doppler map of a train of pulses.

    Parameters
    ----------
    recording : Recording
        Recording of sound, with its paths, of which only the scene is used.
    pulse : Signal
        The pulse that the source repeats.
    receiver : int or str
        Index or name.
    source : int or str
        Index or name.
    first : int
        Emission with which the train begins.
    count : int, optional
        Emissions that it has, at least 2; all that follow when left out.
    two_way : bool
        Whether sound travels the range forth and back, as a sonar's does, or one way.
    max_range : float, optional
        m; what fits between two emissions when left out.

    Returns
    -------
    RangeDopplerMap
        With as many speeds as emissions. They are known but for multiples of the whole span.

    Notes
    -----
    The matched filter's output of each pulse, Fourier transformed over the pulses under a Hann window. A range that
    grows at v turns the phase of the pulse's mean frequency f by ``-2 pi f v P / c`` (two ways: twice that) in a
    period P (M. A. Richards, "Fundamentals of Radar Signal Processing", 2nd edition, 2014, section 5.3).
    """
    passes = 2.0 if as_flag("two_way", two_way) else 1.0
    train = _Train.of(recording, pulse, receiver, source, (first, count, 2), passes, max_range)
    gaps = np.diff(train.emitted)
    if len(gaps) == 0 or np.ptp(gaps) > 1e-9:
        raise InputError("source", f"must emit two evenly spaced pulses at least, but emits {len(train.emitted)}")
    window = np.hanning(len(train.rows) + 2)[1:-1]
    made = np.fft.fft(train.rows * (window / window.sum())[:, None], axis=0)
    fastest = 0.5 * train.speed_of_sound / (passes * train.centre * float(gaps[0]))
    speeds = -2.0 * fastest * np.fft.fftfreq(len(train.rows))
    order = np.argsort(speeds)
    return RangeDopplerMap(read_only(made[order]), train.ranges, read_only(speeds[order]), fastest)


def echoes(
    recording: Recording, pulse: Signal, receiver: int | str = 0, *, source: int | str = 0, two_way: bool = True,
    max_range: float | None = None,
) -> EchoMap:  # fmt: skip
    """Compute the matched filter's output over range and number of the pulse, as a sonar's display shows it.

    Parameters
    ----------
    recording, pulse, receiver, source, two_way, max_range
        As of `range_doppler`.

    Examples
    --------
    >>> import clsim
    >>> ping = clsim.Signal.chirp(30e3, 50e3, duration=1e-3, sampling_rate=192e3, window="hann")
    >>> pings = clsim.Signal.pulses(ping, period=0.02, count=3)
    >>> sonar = clsim.Source("sonar", pings, clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
    >>> ear = clsim.Receiver("ear", clsim.Trajectory.fixed((1.0, 1.0, 1.02)))
    >>> room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9))
    >>> paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [sonar], [ear]), max_order=1)
    >>> found = echoes(clsim.render(paths, 192e3), ping, max_range=2.0)
    >>> loudest = abs(found.amplitude[:, 300:]).argmax(axis=1) + 300  # beyond the direct sound
    >>> found.ranges[loudest].round(2)
    array([1., 1., 1.])
    """
    passes = 2.0 if as_flag("two_way", two_way) else 1.0
    train = _Train.of(recording, pulse, receiver, source, (0, None, 1), passes, max_range)
    return EchoMap(read_only(train.rows), train.ranges, read_only(train.emitted))
