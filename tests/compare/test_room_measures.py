"""Measures of a room: T30 against pyroomacoustics' from the same response; formulae against their own cases."""

import dataclasses
import math
import warnings

import numpy as np
import pytest

import clsim

RATE = 16e3


@pytest.fixture(scope="module")
def responses() -> clsim.ImpulseResponses:
    """Return a shoebox that decays by 50 dB within order 30."""
    room = clsim.Shoebox((5.0, 4.1, 3.2), clsim.Material.from_reflection(0.8))
    tone = clsim.Signal.tone(1e3, 0.1, RATE)
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.1, 1.3, 1.2)))
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((3.7, 2.9, 2.1)))]
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0, absorption=False), [source], ears)
    return clsim.impulse_responses(clsim.find_paths(scene, 30), RATE, tail="off")


def test_t30_is_pyroomacoustics(responses: clsim.ImpulseResponses) -> None:
    pra = pytest.importorskip("pyroomacoustics", reason="pyroomacoustics is not installed")
    from pyroomacoustics.experimental import measure_rt60

    assert pra
    whole = clsim.room_measures(responses, None)
    assert whole.t30.shape == (1, 1, 1)
    for name, decay in (("t20", 20), ("t30", 30)):
        theirs = measure_rt60(responses.samples[0, 0], fs=int(RATE), decay_db=decay)
        assert getattr(whole, name)[0, 0, 0] == pytest.approx(theirs, rel=0.01)


def test_bands_of_a_room_whose_walls_are_the_same_at_every_frequency(responses: clsim.ImpulseResponses) -> None:
    """A shoebox is no diffuse field: its decay is within a third of Eyring's, and alike in bands of many modes."""
    found = clsim.room_measures(responses, "octave")
    np.testing.assert_allclose(found.frequencies[[0, -1]], [31.25, 4000.0])
    high = found.frequencies >= 500.0
    assert np.ptp(found.t30[0, 0, high]) < 0.2 * found.t30[0, 0, high].mean()
    np.testing.assert_allclose(found.t30[0, 0, high], found.eyring[high], rtol=0.35)
    absorbed, surface, volume = 0.36, 2 * (5 * 4.1 + 5 * 3.2 + 4.1 * 3.2), 5 * 4.1 * 3.2
    np.testing.assert_allclose(found.sabine, 24 * math.log(10) * volume / (343.0 * absorbed * surface), rtol=1e-9)
    np.testing.assert_allclose(found.eyring, found.sabine * absorbed / -math.log(1 - absorbed), rtol=1e-9)
    np.testing.assert_allclose(found.c50, 10 * np.log10(found.d50 / (1 - found.d50)), atol=1e-9)
    third = clsim.room_measures(responses, "third-octave")
    assert len(third.frequencies) > 2.5 * len(found.frequencies)


def test_the_direct_sound_over_all_else(responses: clsim.ImpulseResponses) -> None:
    """Whole responses: the direct path's energy over that of the others, as far as these do not interfere."""
    whole = clsim.room_measures(responses, None)
    distance = math.dist((1.1, 1.3, 1.2), (3.7, 2.9, 2.1))
    energy = float(np.square(responses.samples).sum())
    direct = 0.95 * distance**-2  # of 0.95 of half the sampling rate, the part of the band
    expected = 10.0 * math.log10(direct / (energy - direct))
    assert whole.drr[0, 0, 0] == pytest.approx(expected, abs=1.0)


def test_what_has_no_measures_is_refused(responses: clsim.ImpulseResponses) -> None:
    with pytest.raises(clsim.InputError, match="bands: must be one of"):
        clsim.room_measures(responses, "decade")
    with pytest.raises(clsim.InputError, match="responses: must be ImpulseResponses"):
        clsim.room_measures(responses.samples)  # type: ignore[arg-type]


@pytest.mark.filterwarnings("ignore:noise or the end of responses hides the decay")
@pytest.mark.parametrize(("bands", "lowest"), [("octave", 2000.0), ("third-octave", 4000.0)])
def test_measures_by_band_of_three_impulses(responses: clsim.ImpulseResponses, bands: str, lowest: float) -> None:
    """A response of 1, 1/2 after 60 ms and 1/4 after 200 ms. All bands that ring out in 2.5 ms have the same measures.

    A filter of third order falls by ``exp(-pi B t / 2)``: what is left after 2.5 ms is below 0.1 % of an impulse's energy.
    """
    made = np.zeros_like(responses.samples)
    begin = responses.lead + math.floor(responses.first_arrivals[0, 0] * RATE)
    for late, height in ((0.0, 1.0), (0.06, 0.5), (0.2, 0.25)):
        made[0, 0, begin + round(late * RATE)] = height
    found = clsim.room_measures(dataclasses.replace(responses, samples=made), bands)
    wide = found.frequencies >= lowest
    assert wide.any()
    for measure, exact in (
        (found.c50, 10.0 * math.log10(1.0 / 0.3125)), (found.c80, 10.0 * math.log10(1.25 / 0.0625)),
        (found.drr, 10.0 * math.log10(1.0 / 0.3125)), (found.d50, 1.0 / 1.3125),
    ):  # fmt: skip
        np.testing.assert_allclose(measure[0, 0, wide], exact, rtol=0.0, atol=0.02)


@pytest.mark.parametrize("noise_db", [-20.0, -30.0, -40.0, -50.0, -60.0, -75.0])
def test_noise_that_hides_a_decay_gives_no_time(responses: clsim.ImpulseResponses, noise_db: float, rng) -> None:
    """White noise that decays by 60 dB in a second, and steady noise: what is reported is right within 5 %, by bands.

    Twice the time's own deviation is added, ``0.9 sqrt(1 / (B T))`` (ISO 3382-2:2008, equation A.1, without its filter).
    """
    times = np.arange(round(2.0 * RATE)) / RATE
    decay = rng.standard_normal(len(times)) * 10.0 ** (-3.0 * times)
    made = decay + 10.0 ** (noise_db / 20.0) * rng.standard_normal(len(times))
    noisy = dataclasses.replace(responses, samples=made[None, None], first_arrivals=np.zeros((1, 1)), lead=0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", clsim.ClsimWarning)
        found = clsim.room_measures(noisy)
    high = found.frequencies > 100.0
    allowed = 0.05 + 2.0 * 0.9 / np.sqrt(found.frequencies / np.sqrt(2.0))
    for name, needed_db in (("t20", 35.0), ("t30", 45.0)):
        given = getattr(found, name)[0, 0]
        right = np.isnan(given) | (np.abs(given - 1.0) <= allowed)
        assert right[high].all(), (name, given)
        if -noise_db > needed_db + 12.0:
            assert np.isfinite(given[high]).all()
        if -noise_db < needed_db - 10.0:
            assert np.isnan(given[high]).all()
            assert any("noise or the end of responses hides the decay at" in str(w.message) for w in caught)
    if noise_db < -70.0:
        assert not caught


@pytest.mark.parametrize("seconds", [0.7, 0.8, 1.0])
def test_a_decay_that_is_cut_off_is_not_taken_for_noise(responses: clsim.ImpulseResponses, seconds: float) -> None:
    taps = 10.0 ** (-3.0 * np.arange(round(seconds * RATE)) / RATE) * np.random.default_rng(1).standard_normal(round(seconds * RATE))  # fmt: skip
    cut = dataclasses.replace(responses, samples=taps[None, None], first_arrivals=np.zeros((1, 1)), lead=0)
    assert clsim.room_measures(cut, None).t30[0, 0, 0] == pytest.approx(1.0, rel=0.08)
