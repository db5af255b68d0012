"""Range-Doppler maps: echoes of a train of pulses by range and speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_count, as_flag, as_index, as_number, read_only, short_repr
from clsim.errors import InputError
from clsim.packages import check_packages, check_pictures
from clsim.score.matched_filter import MatchedFilter
from clsim.score.ranging import emissions_of, outputs_of, scored_paths, source_index, span_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from clsim.arrays import Complexes
    from clsim.recording import Recording
    from clsim.scene.signal.signal import Signal

_RANGE_DB = 60.0  # shown below the loudest


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
    """

    amplitude: Complexes
    ranges: Floats
    speeds: Floats

    __repr__ = short_repr

    def to_xarray(self) -> Any:
        """Return it with named dimensions ``speed`` and ``range``.

        Returns
        -------
        xarray.DataArray
            The complex amplitude.

        Raises
        ------
        InputError
            If xarray is missing.
        """
        check_packages("to_xarray", "a DataArray", "tables", "xarray")
        import xarray

        coordinates = {
            "speed": ("speed", self.speeds, {"units": "m/s", "long_name": "speed at which the range grows"}),
            "range": ("range", self.ranges, {"units": "m"}),
        }
        return xarray.DataArray(self.amplitude, coordinates, ("speed", "range"), name="amplitude")

    def to_dataframe(self) -> Any:
        """Return a row for each speed and range as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            Columns ``speed`` in m/s, ``range`` in m, and the complex ``amplitude``.

        Raises
        ------
        InputError
            If pandas is missing.
        """
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        import pandas

        speeds, ranges = np.meshgrid(self.speeds, self.ranges, indexing="ij")
        return pandas.DataFrame({"speed": speeds.ravel(), "range": ranges.ravel(), "amplitude": self.amplitude.ravel()})

    def plot(self) -> Axes:
        """Draw its level.

        Returns
        -------
        matplotlib.axes.Axes
            Of a new figure of pyplot.
        """
        check_pictures("plot")
        from matplotlib import pyplot

        figure, axes = pyplot.subplots(figsize=(9.0, 5.0), layout="constrained")
        level = 20.0 * np.log10(np.maximum(np.abs(self.amplitude), 1e-30))
        peak = float(level.max())
        shown = axes.pcolormesh(self.ranges, self.speeds, level, vmin=peak - _RANGE_DB, vmax=peak, cmap="magma")
        axes.set(xlabel="range (m)", ylabel="speed at which it grows (m/s)")
        figure.colorbar(shown, ax=axes, label="level (dB)")
        return axes


def range_doppler(
    recording: Recording,
    pulse: Signal,
    receiver: int | str = 0,
    *,
    source: int | str = 0,
    first: int = 0,
    count: int | None = None,
    two_way: bool = True,
    max_range: float | None = None,
) -> RangeDopplerMap:
    """Return the range-Doppler map of a train of pulses.

    Parameters
    ----------
    recording : Recording
        Of sound, with its paths, of which nothing but the scene is used.
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

    Raises
    ------
    InputError
        If a value is out of bounds, the emissions are not evenly spaced, or the recording is a complex envelope.

    Notes
    -----
    The matched filter's output of each pulse, Fourier transformed over the pulses under a Hann window. A range that
    grows at v turns the phase of the pulse's mean frequency f by ``-2 pi f v P / c`` (two ways: twice that) in a
    period P (M. A. Richards, "Fundamentals of Radar Signal Processing", 2nd edition, 2014, section 5.3).
    """
    paths = scored_paths(recording, "a range-Doppler map")
    row = as_index("receiver", receiver, recording.receiver_names)
    ways = 2.0 if as_flag("two_way", two_way) else 1.0
    rate, c = recording.sampling_rate, paths.scene.air.speed_of_sound
    matched = MatchedFilter.of(pulse, rate)
    emitted = emissions_of(recording, source_index(paths, source), len(matched.pulse))
    first = as_count("first", first, at_most=max(len(emitted) - 2, 0))
    most = len(emitted) - first
    emitted = emitted[first : first + (most if count is None else as_count("count", count, at_least=2, at_most=most))]
    gaps = np.diff(emitted)
    if len(gaps) == 0 or np.ptp(gaps) > 1e-9:
        raise InputError("source", f"must emit two evenly spaced pulses at least, but emits {len(emitted)}")
    reach = None if max_range is None else ways * as_number("max_range", max_range, above=0.0, unit="m")
    span = span_of(emitted, recording, reach, c)
    rows = np.zeros((len(emitted), span), dtype=np.complex128)
    for k, (begin, output) in enumerate(outputs_of(recording.samples[row], matched, emitted, span)):
        late = emitted[k] * rate - begin  # of the emission after the sample, below one
        rows[k, : len(output)] = output * np.exp(2j * np.pi * matched.centre * late / rate)
    window = np.hanning(len(rows) + 2)[1:-1]
    made = np.fft.fft(rows * (window / window.sum())[:, None], axis=0)
    turns = np.fft.fftfreq(len(rows))  # per period
    speeds = -turns * c / (ways * matched.centre * gaps[0])
    order = np.argsort(speeds)
    ranges = np.arange(span) / rate * c / ways
    return RangeDopplerMap(read_only(made[order]), read_only(ranges), read_only(speeds[order]))
