"""The raster behind a spectrogram: true levels at the true place, and bounded."""

import numpy as np
import pytest

from clsim.pictures.plots import spectrogram

RATE = 192e3


def centres(raster) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of the rows and times of the columns."""
    rows, columns = raster.level.shape
    frequencies = raster.low + (np.arange(rows) + 0.5) * (raster.high - raster.low) / rows
    return frequencies, (np.arange(columns) + 0.5) * raster.duration / columns


@pytest.mark.parametrize("band", [(39e3, 41e3), (0.0, 96e3)])
def test_a_sine_has_its_level_at_its_frequency(band: tuple[float, float]) -> None:
    tone = np.sqrt(2.0) * np.sin(2 * np.pi * 40.4e3 * np.arange(100_000) / RATE)
    raster = spectrogram(tone, RATE, band)
    # 1 Pa rms. Between two bins a Hann window loses up to 1.43 dB; it never gains but by its own other half, -90 dB.
    peaks = raster.level.max(axis=0)
    assert np.all(peaks < 20 * np.log10(1.0 / 20e-6) + 0.01)
    assert np.all(peaks > 20 * np.log10(1.0 / 20e-6) - 1.43)
    frequencies, _ = centres(raster)
    height = (raster.high - raster.low) / len(frequencies)
    np.testing.assert_allclose(frequencies[raster.level.argmax(axis=0)], 40.4e3, atol=height)


def test_white_noise_has_its_density(rng: np.random.Generator) -> None:
    noise = rng.normal(size=400_000)
    segment = 1024
    raster = spectrogram(noise, RATE, (10e3, 20e3), segment)
    power = np.mean(10 ** (raster.level / 10)) * (20e-6) ** 2
    # Variance 1 over 96 kHz, in a window's noise bandwidth of 1.5 bins of 187.5 Hz.
    # 400 000 / 1024 * 53 independent values: a deviation of 1 %.
    assert power == pytest.approx(1.5 * RATE / segment / 96e3, rel=0.05)


def test_a_click_is_in_its_column() -> None:
    sound = np.zeros(200_000)
    sound[150_000] = 1.0
    raster = spectrogram(sound, RATE, (0.0, 96e3), 512)
    _, times = centres(raster)
    # The click lies within the windows, 512 samples long, of its columns alone.
    power = 10 ** (raster.level.max(axis=0).astype(np.float64) / 10)
    assert (power @ times) / power.sum() == pytest.approx(150_000 / RATE, abs=raster.duration / len(times))
    assert np.all(raster.level[:, np.abs(times - 150_000 / RATE) > 512 / RATE] < 0.0)


class Long:
    """Silence, which counts what is read at once."""

    def __init__(self, duration: float) -> None:
        self.count = int(duration * RATE)
        self.largest = 0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, part: slice) -> np.ndarray:
        self.largest = max(self.largest, part.stop - part.start)
        return np.zeros(part.stop - part.start, dtype=np.float32)


@pytest.mark.parametrize(("duration", "band"), [(60.0, (0.0, 96e3)), (10.0, (39.9e3, 40.1e3)), (5.0, (40e3, 40e3))])
def test_long_sound_is_read_in_pieces(duration: float, band: tuple[float, float]) -> None:
    sound = Long(duration)
    raster = spectrogram(sound, RATE, band)
    assert raster.level.shape[0] <= 600
    assert raster.level.shape[1] <= 1200
    assert 0 < sound.largest <= 65536


@pytest.mark.parametrize("count", [1, 3, 130])
def test_short_sound(count: int) -> None:
    raster = spectrogram(np.ones(count), RATE, (0.0, 96e3))
    assert np.all(np.isfinite(raster.level))
