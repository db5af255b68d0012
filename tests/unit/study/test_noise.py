"""Diffuse noise: its ratio to the sound, its coherence between places and its spectrum against theory."""

import math

import numpy as np
import pytest
from exhaustive import few
from scipy.signal import csd, welch
from scipy.special import j0

import clsim
from clsim.study.draws import NoiseModel

RATE, SPEED = 16e3, 343.0
PLACES = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.2, 0.1]])
WINDOW = 256


def made(seconds: float = 60.0, **table: object) -> tuple[np.ndarray, np.ndarray]:
    clean = np.random.default_rng(1).standard_normal((4, int(seconds * RATE))).astype(np.float32)
    noise = NoiseModel.model_validate({"snr_db": 12.0} | table).checked()
    return clean, noise.samples(clean, RATE, PLACES, SPEED, [1, 2]).astype(np.float64)


def test_the_ratio_of_energies_is_met() -> None:
    clean, noise = made(1.0, snr_db=7.5)
    ratio = np.square(clean.astype(np.float64)).sum() / np.square(noise).sum()
    assert 10.0 * math.log10(ratio) == pytest.approx(7.5, abs=1e-5)


@pytest.mark.parametrize(("field", "law"), few([("spherical", np.sinc), ("cylindrical", lambda x: j0(np.pi * x))]))
def test_the_coherence_is_that_of_a_diffuse_field(field: str, law: object) -> None:
    _, noise = made(30.0, field=field)
    # The window's main lobe, four lines wide, smears the law less than this; the mean over lines is much finer.
    count = 2 * noise.shape[1] / WINDOW
    powers = [welch(each, RATE, nperseg=WINDOW)[1] for each in noise]
    for one, other in ((0, 1), (0, 2), (0, 3), (2, 3), (1, 3)):
        distance = np.linalg.norm(PLACES[one] - PLACES[other])
        frequencies, cross = csd(noise[one], noise[other], RATE, nperseg=WINDOW)
        off = (cross / np.sqrt(powers[one] * powers[other]) - law(2.0 * frequencies * distance / SPEED))[3:-3]  # type: ignore[operator]
        assert np.abs(off).max() < 5.0 / math.sqrt(count) + 0.01
        assert abs(off.mean()) < 5.0 / math.sqrt(count * len(off)) + 0.003


def test_each_receiver_has_the_same_level_and_a_sloped_spectrum_falls() -> None:
    _, noise = made(slope_db=-3.0103)
    levels = 10.0 * np.log10(np.square(noise).mean(axis=1))
    assert np.ptp(levels) < 0.3  # pink: few cycles of the lowest frequencies carry much of it
    frequencies, power = welch(noise[0], RATE, nperseg=WINDOW)
    octaves = [power[(frequencies >= f) & (frequencies < 2.0 * f)].mean() * f for f in (1e3, 2e3, 3.5e3)]
    assert np.ptp(10.0 * np.log10(octaves)) < 0.2  # equal energy in equal ratios


def test_silence_has_no_ratio() -> None:
    with pytest.raises(clsim.InputError, match="snr_db: must come with sound, but the recording is silent"):
        NoiseModel(snr_db=3.0).samples(np.zeros((4, 100), np.float32), RATE, PLACES, SPEED, [1])
