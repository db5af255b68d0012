"""Pictures of complex envelopes: level over time and frequency off the carrier."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.pictures.plots import RANGE_DB, new_figure, save_figure

if TYPE_CHECKING:
    import os

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

_COLUMNS = 1600  # of the picture at most
_REFERENCE = 20e-6  # Pa, of the envelope's rms


def envelope_spectrogram(
    envelope: NDArray[np.complex64],
    sampling_rate: float,
    carrier: float,
    path: str | os.PathLike[str],
    *,
    title: str,
    segment: int | None = None,
    shown: float | None = None,
) -> None:
    """Draw the level of a complex envelope over time and frequency off the carrier.

    Shapes: envelope (n,) Pa.
    """
    figure, axes = new_figure(5.0)
    axes.grid(visible=False)
    draw_envelope_spectrogram(figure, axes, envelope, sampling_rate, carrier, title=title, segment=segment, shown=shown)
    save_figure(figure, path)


def draw_envelope_spectrogram(
    figure: Figure,
    axes: Axes,
    envelope: NDArray[np.complex64],
    sampling_rate: float,
    carrier: float,
    *,
    title: str,
    segment: int | None = None,
    shown: float | None = None,
) -> None:
    """Draw the level of a complex envelope into axes; what is given is as in `envelope_spectrogram`."""
    from scipy.signal import ShortTimeFFT
    from scipy.signal.windows import hann

    length = min(segment or max(16, round(0.1 * sampling_rate)), max(16, len(envelope)))
    hop = max(length // 8, math.ceil(len(envelope) / _COLUMNS), 1)
    window = hann(length, sym=False)
    size = 2 ** math.ceil(math.log2(2 * length))
    transform = ShortTimeFFT(window / window.sum(), hop, sampling_rate, fft_mode="centered", mfft=size)
    padded = np.pad(envelope, (0, max(0, length - len(envelope))))
    spectrum = np.abs(transform.stft(padded)).astype(np.float32)
    # The rms of a tone is its amplitude over the root of two.
    level = 20.0 * np.log10(np.maximum(spectrum / math.sqrt(2.0), 1e-30) / _REFERENCE)
    peak = float(level.max())
    half, end = 0.5 * sampling_rate, len(envelope) / sampling_rate
    axes.title.set_parse_math(False)  # names may hold what looks like a formula
    image = axes.imshow(
        level, origin="lower", aspect="auto", cmap="magma", vmin=peak - RANGE_DB, vmax=peak,
        extent=(float(transform.t(len(padded))[0]), float(transform.t(len(padded))[-1]), -half, half),
    )  # fmt: skip
    axes.set(
        xlabel="time (s)", ylabel=f"frequency - {carrier / 1e3:g} kHz (Hz)", title=title, xlim=(0.0, end),
        ylim=(-(shown or half), shown or half),
    )  # fmt: skip
    figure.colorbar(image, ax=axes, pad=0.015, aspect=30).set_label("level (dB re 20 µPa)", fontsize=12)
