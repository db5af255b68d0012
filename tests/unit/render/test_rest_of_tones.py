"""What narrow parts leave of a tone, noise or a sweep, where it is known to be nothing without filtering."""

import math
from fractions import Fraction

import numpy as np
import pytest

from clsim import Signal
from clsim.render.baseband import Baseband
from clsim.render.envelope import NarrowBand, Split
from clsim.render.mixer import Mixer
from clsim.scene.signal.occupied_bandwidth import ShortTimeSpectra

RATE = 192e3
SPLIT = Split.into((NarrowBand.designed(Baseband(40e3, 4e3, 8e3), 200.0, 1200.0, RATE, -85.0),), -85.0)
RANGES = [(-5000, 30_000), (10_011, 60_003), (30_000, 70_000), (66_000, 80_000), (0, 76_800)]


@pytest.mark.parametrize("fade", [0.0, 0.02], ids=["abrupt", "fades"])
@pytest.mark.parametrize("frequency", [40e3, 40.2e3, 41.5e3], ids=["carrier", "passed", "left"])
def test_the_rest_of_a_tone_is_that_of_its_samples(frequency: float, fade: float) -> None:
    tone = Signal.tone(frequency, 0.4, RATE, amplitude=2.0, fade=fade)
    samples = Signal.from_array(tone.read(0, tone.count), RATE)  # of which nothing is known
    sounding = 0
    for first, last in RANGES:
        rest = SPLIT.rest(tone, first, last)
        np.testing.assert_array_equal(rest, SPLIT.rest(samples, first, last))
        sounding += bool(np.any(rest))
    assert tone.steady_band(*RANGES[1]) == (frequency, frequency)
    assert sounding >= 3 if frequency < 41e3 else sounding == len(RANGES)


@pytest.mark.parametrize("fade", [0.0, 0.02])
def test_a_tone_is_steady_where_its_level_is_whole(fade: float) -> None:
    tone, steady = (Signal.tone(1e3, 0.1, 48e3, fade=f) for f in (fade, 0.0))
    inside = [n for n in range(tone.count) if tone.steady_band(n, n + 1)]
    assert len(inside) > 0.9 * (0.1 - 2.0 * fade) * 48e3
    first, last = inside[0], inside[-1] + 1
    np.testing.assert_array_equal(tone.read(first, last), steady.read(first, last))
    assert tone.steady_band(first - 1, last) is tone.steady_band(first, last + 2) is None


@pytest.mark.parametrize("method", ["linear", "exponential"])
@pytest.mark.parametrize("ends", [(39.9e3, 40.1e3), (40.3e3, 39.9e3)], ids=["passed", "from beyond"])
def test_the_rest_of_a_sweep_is_that_of_its_samples(ends: tuple[float, float], method: str) -> None:
    sweep = Signal.chirp(*ends, 0.4, RATE, method=method, window="tukey")
    samples = Signal.from_array(sweep.read(0, sweep.count), RATE)
    known = 0
    for first, last in [*RANGES, (20_000, 30_000), (40_000, 45_000)]:
        rest = SPLIT.rest(sweep, first, last)
        np.testing.assert_array_equal(rest, SPLIT.rest(samples, first, last))
        known += sweep.steady_band(first, last) is not None and not np.any(rest)
    assert known > 0
    low, high = sweep.steady_band(20_000, 50_000) or (0.0, 0.0)
    middle = np.linspace(0.0, 1.0, 76_801)[[20_000, 50_000]]
    at = ends[0] + (ends[1] - ends[0]) * middle if method == "linear" else ends[0] * (ends[1] / ends[0]) ** middle
    np.testing.assert_allclose([low, high], np.sort(at), rtol=1e-12)
    assert sweep.steady_band(7000, 30_000) is None  # it rises


@pytest.mark.parametrize("fade", [0.0, 0.02])
def test_the_rest_of_noise_is_that_of_its_samples(fade: float) -> None:
    noise = Signal.noise(0.4, RATE, 1, (39e3, 41e3), fade=fade)
    samples = Signal.from_array(noise.read(0, noise.count), RATE)
    split = Split.into((NarrowBand.designed(Baseband(40e3, 8e3, 12e3), 2000.0, 3000.0, RATE, -90.0),), -90.0)
    low, high = noise.steady_band(*RANGES[1]) or (0.0, 0.0)
    assert 38e3 < low < 39e3
    assert 41e3 < high < 42e3
    found = [split.rest(noise, *ends) for ends in RANGES]
    for ends, rest in zip(RANGES, found, strict=True):
        np.testing.assert_array_equal(rest, split.rest(samples, *ends))
    assert [bool(np.any(rest)) for rest in found] == [not fade, False, False, True, True]


def test_windows_in_which_the_rest_is_loud_are_those_of_its_spectra() -> None:
    frequencies, energy, weights, _ = Signal.tone(40e3, 0.4, RATE).short_time_spectra()
    sound = ShortTimeSpectra(frequencies, energy, weights)
    split = Split.into(SPLIT.bands, -50.0)
    rest, loud = split.rest_of(sound), split.loud_in(sound)
    assert 0 < np.count_nonzero(loud) < len(loud)  # the ends are abrupt
    np.testing.assert_array_equal(rest.weights, weights[loud])
    stopped = energy * split.left(frequencies) ** 2
    np.testing.assert_array_equal(rest.energy, stopped[loud])
    assert np.array_equal(stopped.sum(axis=1) > split.silence**2, loud)


def test_filters_that_differ_by_factors_are_mixed_alike(rng: np.random.Generator) -> None:
    """Delays of 0 to 2 samples by factors against filters that are delayed."""
    taps = np.hanning(65) * np.exp(-0.5j * math.pi * np.arange(-32, 33))
    late = [np.roll(np.pad(taps, 8), k) for k in range(3)]
    each, turn = np.stack(late), Fraction(1, 4)

    def acting(frequencies: np.ndarray) -> np.ndarray:
        return np.exp(2j * math.pi * np.outer(np.arange(3), frequencies))

    one_by_one, together = Mixer.of(each, 4, turn), Mixer.of(each, 4, turn, taps[None], acting)
    np.testing.assert_allclose(together.gains, one_by_one.gains, atol=1e-9 * np.abs(one_by_one.gains).max())
    sound = rng.standard_normal(40_000)
    made = [
        mixer(lambda a, b: np.pad(sound, 70_000)[a + 70_000 : b + 70_000], 0, 200) for mixer in (one_by_one, together)
    ]
    np.testing.assert_allclose(made[1], made[0], atol=1e-9 * np.abs(made[0]).max())
