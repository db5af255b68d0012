"""Signals of samples: from sound files, and at other sampling rates."""

import numpy as np
import pytest
import soundfile

from clsim import InputError, Signal


@pytest.mark.parametrize(("old", "frequency"), [(250e3, 85e3), (48e3, 21e3), (44_100, 19e3)])
def test_resampling_keeps_the_band(old: float, frequency: float) -> None:
    tone = Signal.tone(frequency, 0.2, old, fade=0.02)
    moved = Signal.from_array(tone.read(0, tone.count), old).at_rate(192e3)
    expected = Signal.tone(frequency, 0.2, 192e3, fade=0.02).read(0, moved.count)
    # Between the fades, whose kinks no band holds. Designed for 110 dB in pass and stop band, met within a decibel.
    steady = slice(6000, -6000)
    assert np.abs(moved.read(0, moved.count)[steady] - expected[steady]).max() < 10 ** (-109 / 20)


def test_resampling_removes_what_the_new_rate_cannot_hold() -> None:
    tone = Signal.tone(110e3, 0.2, 250e3, fade=0.02)
    moved = Signal.from_array(tone.read(0, tone.count), 250e3).at_rate(192e3)
    assert np.abs(moved.read(0, moved.count)[6000:-6000]).max() < 10 ** (-109 / 20)


def test_wav(tmp_path, rng: np.random.Generator) -> None:
    path = tmp_path / "two.wav"
    samples = rng.uniform(-1, 1, (1000, 2))
    soundfile.write(path, samples, 250_000, subtype="FLOAT")
    signal = Signal.from_wav(path, channel=1, scale=3.0)
    assert signal.sampling_rate == 250e3
    np.testing.assert_allclose(signal.read(0, 1000), 3.0 * samples[:, 1], rtol=1e-6)
    with pytest.raises(InputError, match="channel: must be below 2"):
        Signal.from_wav(path, channel=2)
    (tmp_path / "no.wav").write_text("nothing")
    for name in ("no.wav", "missing.wav", "."):
        with pytest.raises(InputError, match="path: must be a sound file"):
            Signal.from_wav(tmp_path / name)
    with pytest.raises(InputError, match="path: must be a path"):
        Signal.from_wav(3)  # not an open file's number


def test_wav_with_nan_or_nothing_is_refused(tmp_path) -> None:
    soundfile.write(tmp_path / "nan.wav", np.array([0.0, 0.0, np.nan]), 48_000, subtype="FLOAT")
    with pytest.raises(InputError, match=r"path: must hold finite samples, but \[2\]"):
        Signal.from_wav(tmp_path / "nan.wav")
    soundfile.write(tmp_path / "empty.wav", np.empty(0), 48_000, subtype="FLOAT")
    with pytest.raises(InputError, match="path: must hold sound"):
        Signal.from_wav(tmp_path / "empty.wav")
