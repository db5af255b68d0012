"""Diffuse noise with the coherence of the receivers' places, at a signal-to-noise ratio."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_number
from clsim.errors import InputError
from clsim.scene_file.model import Model

_BAND = 2048  # frequencies mixed at a time
_LOADING = 1e-6  # of the coherence matrix, which is singular at 0 Hz
_LEAST_HZ = 20.0  # below which a sloped spectrum is flat


class NoiseModel(Model):
    """The table ``[noise]`` of a study."""

    snr_db: float
    slope_db: float = 0.0  # of the power spectral density, per octave: 0 white, -3 pink
    field: Literal["spherical", "cylindrical"] = "spherical"

    def checked(self) -> NoiseModel:
        """Return the table, if its numbers are within bounds."""
        as_number("snr_db", self.snr_db, at_least=-200.0, at_most=200.0, unit="dB")
        as_number("slope_db", self.slope_db, at_least=-24.0, at_most=24.0, unit="dB")
        return self

    def samples(
        self, clean: NDArray[np.floating], rate: float, positions: Floats, speed_of_sound: float, seed: Sequence[int]
    ) -> NDArray[np.float32]:
        """Return noise (rows, n) whose energy is that of `clean` (rows, n), less the ratio.

        positions: (rows, 3) of the receivers, m.
        """
        power = float(np.square(clean, dtype=np.float64).sum())
        if power == 0.0:
            raise InputError("snr_db", "must come with sound, but the recording is silent")
        made = self._mixed(clean.shape, rate, positions, speed_of_sound, np.random.default_rng(seed))
        made *= math.sqrt(power / float(np.square(made).sum())) * 10.0 ** (-self.snr_db / 20.0)
        return made.astype(np.float32)

    def _mixed(
        self, shape: tuple[int, ...], rate: float, positions: Floats, c: float, chance: np.random.Generator
    ) -> Floats:
        """Mix independent noises by a square root of the coherence matrix at each frequency (Habets et al. 2008)."""
        from scipy.fft import irfft, next_fast_len

        rows, count = shape
        size = next_fast_len(count, real=True)
        frequencies = np.arange(size // 2 + 1) * (rate / size)
        spectrum = chance.standard_normal((len(frequencies), rows)) + 1j * chance.standard_normal(
            (len(frequencies), rows)
        )
        apart = np.linalg.norm(positions[:, None] - positions, axis=2)
        for first in range(0, len(frequencies), _BAND):
            some = slice(first, first + _BAND)
            alike: Floats = self.coherence(frequencies[some, None, None], apart, c) + _LOADING * np.eye(rows)
            root = np.asarray(np.linalg.cholesky(alike / (1.0 + _LOADING)), dtype=np.float64)
            spectrum[some] = (root @ spectrum[some, :, None])[..., 0]
        level = np.maximum(frequencies, _LEAST_HZ) ** (self.slope_db / (20.0 * math.log10(2.0)))
        level[0] = 0.0
        return np.asarray(irfft(spectrum.T * level, size, axis=1)[:, :count])

    def coherence(
        self, frequency: NDArray[np.floating], distance: NDArray[np.floating], speed_of_sound: float
    ) -> Floats:
        """Return the coherence of pressure at two places of a diffuse field.

        ``sin(kd) / (kd)`` where sound comes from all directions, ``J0(kd)`` from all horizontal ones (R. K. Cook et
        al., "Measurement of correlation coefficients in reverberant sound fields", JASA 27, 1955).
        """
        from scipy.special import j0

        phase = 2.0 * math.pi * frequency * distance / speed_of_sound
        return np.asarray(np.sinc(phase / math.pi) if self.field == "spherical" else j0(phase))
