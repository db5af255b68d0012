"""Materials from impulse responses, given or in files."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
import soundfile

from clsim.errors import ClsimWarning, InputError
from clsim.scene.material.material import Material

EXACT = 1e-13  # a few roundings of float64


def test_the_impulse_response_of_a_delay():
    rate, at = 192e3, np.array([1e3, 40e3, 91e3])
    late = Material.from_impulse_response([0.0, 0.0, 0.0, 0.8], rate)
    expected = 0.8 * np.exp(-2j * np.pi * at * 3 / rate)
    np.testing.assert_allclose(late.reflection_at(at), expected, rtol=1e-12)
    for reference, shift in ((3, 0.0), (2.5, 0.5), (-1, 4.0)):
        material = Material.from_impulse_response([0.0, 0.0, 0.0, 0.8], rate, reference=reference)
        expected = 0.8 * np.exp(-2j * np.pi * at * shift / rate)
        np.testing.assert_allclose(material.reflection_at(at), expected, rtol=1e-12)
    assert late.is_complex
    assert not late.depends_on_angle


@pytest.mark.parametrize("count", [5, 512, 1300])  # less than, exactly and more than what is summed at once
def test_the_impulse_response_of_a_known_filter(rng, count):
    taps = rng.standard_normal(count) * np.exp(-10.0 * np.arange(count) / count)
    taps /= np.abs(taps).sum()
    at = rng.uniform(1.0, 96e3, (7, 100))
    expected = [np.sum(taps * np.exp(-2j * np.pi * f * np.arange(count) / 192e3)) for f in at.ravel()]
    got = Material.from_impulse_response(taps, 192e3).reflection_at(at)
    np.testing.assert_allclose(got, np.reshape(expected, at.shape), rtol=0, atol=1e-12)


def test_an_impulse_response_that_sends_back_too_much_is_refused_or_clipped_within_the_tolerance():
    with pytest.raises(InputError, match=r"samples: must send back no more .* tolerance of 0.05, but one is 1.1 at "):
        Material.from_impulse_response([0.6, -0.5], 192e3)  # 1.1 at half the sampling rate, 0.1 at 0 Hz
    material = Material.from_impulse_response([0.6, -0.5], 192e3, tolerance=0.11)
    assert abs(material.reflection_at(96e3)) == pytest.approx(1.0, rel=1e-12)
    quiet = Material.from_impulse_response([0.6, -0.5], 192e3, band=(1e3, 10e3))
    expected = 0.6 - 0.5 * np.exp(-2j * np.pi * 5e3 / 192e3)
    assert quiet.reflection_at(5e3) == pytest.approx(expected, rel=1e-12)
    for outside in (500.0, 20e3):
        with pytest.raises(InputError, match="must be from 1000 to 10000 Hz, which"):
            quiet.reflection_at(outside)
    held = Material.from_impulse_response([0.6, -0.5], 192e3, band=(1e3, 10e3), outside="hold")
    assert held.reflection_at(20e3) == held.reflection_at(10e3)
    with pytest.raises(InputError, match="must be from 0 to 96000 Hz, which the material 'ir' covers, but is 96100 Hz"):
        Material.from_impulse_response([0.5], 192e3, name="ir").reflection_at(96.1e3)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"samples": []}, "samples"),
        ({"samples": [0.0, 0.0]}, "samples"),
        ({"samples": [0.5, np.nan]}, "samples[1]"),
        ({"samples": [[0.5]]}, "samples"),
        ({"samples": np.full(2**17 + 1, 1e-9)}, "samples"),
        ({"sampling_rate": 0.0}, "sampling_rate"),
        ({"sampling_rate": None}, "sampling_rate"),
        ({"reference": np.inf}, "reference"),
        ({"band": (2e3, 1e3)}, "band"),
        ({"band": (0.0, 97e3)}, "band"),
        ({"band": (-1.0, 9e3)}, "band"),
        ({"band": (1e3,)}, "band"),
        ({"tolerance": -0.1}, "tolerance"),
        ({"tolerance": 1.1}, "tolerance"),
        ({"outside": "zero"}, "outside"),
        ({"name": 1}, "name"),
    ],
)
def test_bad_impulse_responses_are_refused_by_name(arguments, field):
    with pytest.raises(InputError) as error:
        Material.from_impulse_response(**{"samples": [0.5], "sampling_rate": 192e3} | arguments)
    assert error.value.field == field


def test_noise_behind_an_impulse_response_is_a_warning(rng):
    taps = np.zeros(2000)
    taps[0] = 0.8
    noise = 1e-3 * rng.standard_normal(2000)
    # 1e-3 times the root of 2000 samples: 0.045.
    with pytest.warns(
        ClsimWarning, match=r"last tenth .* of 'ir' still holds 0.00.* rms, which over 2000 samples .* by some 0.04"
    ):
        noisy = Material.from_impulse_response(taps + noise, 192e3, tolerance=0.5, name="ir")
    f = np.linspace(10e3, 80e3, 200)
    spread = np.sqrt(np.mean(np.abs(noisy.reflection_at(f) - 0.8) ** 2))
    assert spread == pytest.approx(0.045, rel=0.15), "200 draws: 5 % in rms, times three"
    Material.from_impulse_response((taps + noise)[:200], 192e3)  # 0.014: said nothing of


def test_a_long_response_at_many_frequencies_takes_no_more_than_seconds():
    taps = np.zeros(2**17)
    taps[[0, -1]] = 0.3
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClsimWarning)
        material = Material.from_impulse_response(taps, 192e3)
    f = np.linspace(20e3, 60e3, 4096)
    expected = 0.3 + 0.3 * np.exp(-2j * np.pi * f * (2**17 - 1) / 192e3)
    np.testing.assert_allclose(material.reflection_at(f), expected, atol=1e-9)  # phases of 2.6e5 rad, to 1e-10


def test_sound_files(tmp_path: Path, rng):
    taps = 0.02 * rng.standard_normal((64, 2))
    soundfile.write(tmp_path / "wall.wav", taps, 192000, subtype="FLOAT")
    f = np.array([20e3, 40e3])
    for channel in (0, 1):
        read = Material.from_wav(tmp_path / "wall.wav", channel, 0.5, 3, (10e3, 90e3), "hold", 0.01, "w")
        told = Material.from_impulse_response(
            0.5 * taps[:, channel].astype(np.float32).astype(float), 192e3, 3, (10e3, 90e3), "hold", 0.01, "w"
        )
        np.testing.assert_array_equal(read.reflection_at(f), told.reflection_at(f))
        assert (read.name, read.band) == ("w", (0.0, math.inf))
    (tmp_path / "text.wav").write_text("no sound")
    for arguments, field in (
        ((tmp_path / "none.wav",), "path"),
        ((tmp_path / "text.wav",), "path"),
        ((tmp_path,), "path"),
        ((3,), "path"),
        ((tmp_path / "wall.wav", 2), "channel"),
        ((tmp_path / "wall.wav", -1), "channel"),
        ((tmp_path / "wall.wav", 0, np.nan), "scale"),
        ((tmp_path / "wall.wav", 0, 0.0), "scale"),
        ((tmp_path / "wall.wav", 0, 1000.0), "samples"),
    ):
        with pytest.raises(InputError) as error:
            Material.from_wav(*arguments)
        assert error.value.field == field
