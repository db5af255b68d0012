"""Measures of rooms by closed forms, and of what is measured in files."""

import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from exhaustive import few

import clsim
from clsim.acoustics.room_acoustics import (
    centre_time,
    clarity,
    decay_curve,
    definition,
    eyring_time,
    interaural_correlation,
    lateral_fractions,
    modulation_transfer,
    reverberation_time,
    sabine_time,
    transmission_index,
)

RATE = 48e3


def decaying(seconds: float, length: float, rng: np.random.Generator) -> np.ndarray:
    times = np.arange(round(length * RATE)) / RATE
    return np.asarray(rng.standard_normal(len(times)) * 10.0 ** (-3.0 * times / seconds))


@pytest.mark.parametrize("seconds", [0.2, 1.0, 4.0])
def test_an_exponential_decay(seconds: float) -> None:
    """EDT and T30 are T, the centre time T / 13.8, and modulation goes as a low-pass of the decay's time."""
    times = np.arange(round(2.0 * seconds * RATE)) / RATE
    taps = 10.0 ** (-3.0 * times / seconds)
    per_second = 6.0 * math.log(10.0) / seconds  # of the energy
    assert reverberation_time(decay_curve(taps), RATE, 0.0, -10.0) == pytest.approx(seconds, rel=1e-3)
    assert centre_time(taps, RATE) == pytest.approx(1.0 / per_second, rel=1e-3)
    assert reverberation_time(decay_curve(taps), RATE, -5.0, -35.0) == pytest.approx(seconds, rel=1e-4)
    assert math.isnan(reverberation_time(decay_curve(taps)[:4800], RATE, -5.0, -35.0))
    late = 10.0 ** (-6.0 * 0.08 / seconds)  # of the energy, after 80 ms
    assert clarity(taps, 3840) == pytest.approx(10.0 * math.log10((1.0 - late) / late), abs=1e-3)
    assert definition(taps, 3840) == pytest.approx(1.0 - late, abs=1e-3)
    turning = 2.0 * np.pi * 0.63 * 2.0 ** (np.arange(14) / 3.0)
    transfer = modulation_transfer(np.square(taps), RATE)
    np.testing.assert_allclose(transfer, 1.0 / np.sqrt(1.0 + (turning / per_second) ** 2), rtol=1e-3)


def test_sabine_and_eyring() -> None:
    """With 4 m V of the air, 4 m²; where all is absorbed Eyring's time is 0."""
    area, air = np.array([10.0]), np.array([0.01])
    assert sabine_time(100.0, area, air, 340.0)[0] == pytest.approx(24 * math.log(10) * 100 / (340 * 14.0))
    assert eyring_time(100.0, 10.0, area, air, 340.0)[0] == 0.0


def test_the_index_of_equal_bands() -> None:
    """The index of one apparent ratio in all bands is its share of 30 dB; masking and the threshold only lower it."""
    assert transmission_index(np.ones((7, 14)))[0] == 1.0
    assert transmission_index(np.zeros((7, 14)))[0] == 0.0
    ratio_db = 3.0
    transfer = np.full((7, 14), 1.0 / (1.0 + 10.0 ** (-0.1 * ratio_db)))
    assert transmission_index(transfer)[0] == pytest.approx((ratio_db + 15.0) / 30.0, abs=1e-12)
    loud, faint = (transmission_index(transfer, np.full(7, level))[0] for level in (70.0, 10.0))
    assert faint < 0.7 * loud < loud < (ratio_db + 15.0) / 30.0
    # Noise as loud as the speech is a ratio of 0 dB of a transfer of 1, but for masking and threshold.
    shared = transmission_index(np.ones((7, 14)), np.full(7, 62.0), np.full(7, 62.0))[1]
    np.testing.assert_allclose(shared, 0.5, atol=0.02)


def test_lateral_sound_and_ears(rng: np.random.Generator) -> None:
    """In a diffuse field a figure of eight receives a third of the energy; ears apart by less than 1 ms are the same."""
    fractions = []
    for _ in range(200):  # independent waves from all sides, by sample
        cosine = rng.uniform(-1.0, 1.0, 4000)
        waves = rng.standard_normal(4000)
        fractions.append(lateral_fractions(waves, waves * cosine, RATE))
    lf, lfc = np.mean(fractions, axis=0)
    window = (0.08 - 0.005) / 0.08
    assert lf == pytest.approx(window / 3.0, rel=0.02)
    assert lfc == pytest.approx(window / 2.0, rel=0.02)
    one, other = rng.standard_normal((2, 48_000))
    assert interaural_correlation(one, np.roll(one, 40), RATE) == pytest.approx(1.0, abs=2e-3)
    assert interaural_correlation(one, np.roll(one, -40), RATE) == pytest.approx(1.0, abs=2e-3)
    assert interaural_correlation(one, np.roll(one, 60), RATE) < 0.05
    assert interaural_correlation(one, -(one + other), RATE) == pytest.approx(math.sqrt(0.5), abs=0.02)


def test_lateral_measures_of_a_scene() -> None:
    """A figure of eight across the source hears none of it, and of a wall's echo the squared cosine; equal ears correlate."""
    room = clsim.Shoebox((60.0, 60.0, 60.0), {
        "y_min": clsim.Material.from_reflection(1.0), "default": clsim.Material.from_reflection(0.0)})  # fmt: skip
    source = clsim.Source("s", clsim.Signal.tone(1e3, 0.1, RATE), clsim.Trajectory.fixed((20.0, 4.0, 30.0)))
    here = clsim.Trajectory.fixed((30.0, 4.0, 30.0))
    across = clsim.Trajectory.fixed((30.0, 4.0, 30.0), orientation=(0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    ears = [
        clsim.Receiver("omni", here), clsim.Receiver("eight", across, clsim.FirstOrder(0.0)), clsim.Receiver("same", here)
    ]  # fmt: skip
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0, absorption=False), [source], ears)
    responses = clsim.impulse_responses(clsim.find_paths(scene, 1), RATE, tail="off")
    found = clsim.lateral_measures(responses, ("omni", "eight"), ("omni", "same"))
    far = math.hypot(10.0, 8.0)
    direct, echo = 10.0**-2, far**-2
    high = found.frequencies >= 2000.0
    np.testing.assert_allclose(found.lf[0, high], (8.0 / far) ** 2 * echo / (direct + echo), rtol=0.01)
    np.testing.assert_allclose(found.lfc[0, high], (8.0 / far) * echo / (direct + echo), rtol=0.01)
    np.testing.assert_allclose([found.iacc, found.iacc_early], 1.0, atol=1e-9)
    assert np.isnan(clsim.lateral_measures(responses, ears=("omni", "eight")).lf).all()
    with pytest.raises(
        clsim.InputError, match=r"ears\[1\]: must be a receiver's name, one of omni, eight, same, but is 'x'"
    ):
        clsim.lateral_measures(responses, ears=("omni", "x"))


def free_field(distance: float, band: tuple[float, float] | None = None) -> clsim.ImpulseResponses:
    room = clsim.Shoebox((100.0, 90.0, 80.0), clsim.Material.from_reflection(0.5))
    source = clsim.Source("s", clsim.Signal.tone(1e3, 0.1, RATE), clsim.Trajectory.fixed((50.0, 40.0, 40.0)))
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((50.0 + distance, 40.0, 40.0)))]
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0, absorption=False), [source], ears)
    return clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, band=band, tail="off")


@pytest.mark.filterwarnings("ignore:noise or the end of responses")  # of which there is no decay
@pytest.mark.parametrize("band", [None, (400.0, 9e3)])
@pytest.mark.parametrize("bands", ["octave", "third-octave", None])
def test_strength_of_the_direct_sound(bands: str | None, band: tuple[float, float] | None) -> None:
    found = clsim.room_measures(free_field(2.5, band), bands)
    low = found.frequencies >= 1000.0  # below, a filter rings for longer than the response lasts
    np.testing.assert_allclose(found.g[0, 0, low], 20.0 * math.log10(10.0 / 2.5), atol=0.02)


def test_a_measured_response(tmp_path: Path, rng: np.random.Generator) -> None:
    """A file with silence before, noise after and another gain has the measures of what it holds."""
    taps = decaying(0.9, 2.5, rng)
    whole = 0.05 * np.concatenate([np.zeros(1234), taps]) + 0.05 * 10.0**-3 * rng.standard_normal(1234 + len(taps))
    soundfile.write(
        tmp_path / "hall.wav", np.stack([np.zeros_like(whole), whole], axis=1), round(RATE),
        subtype="FLOAT",
    )  # fmt: skip
    near = np.zeros(4800)
    near[100] = 0.05 * 0.4  # at 2.5 m
    soundfile.write(tmp_path / "free.wav", np.stack([near, near], axis=1), round(RATE), subtype="FLOAT")
    found = clsim.room_measures(tmp_path / "hall.wav", channel=1, free_field=(tmp_path / "free.wav", 2.5))
    exact = free_field(2.5)
    held = replace(exact, samples=taps[None, None], first_arrivals=np.zeros((1, 1)), lead=0)
    wanted = clsim.room_measures(held)
    high = found.frequencies >= 500.0
    assert found.source_names == ("measured",)
    assert np.isnan(found.sabine).all()
    for name in ("edt", "t20", "t30"):
        np.testing.assert_allclose(getattr(found, name)[0, 0, high], getattr(wanted, name)[0, 0, high], rtol=0.03)
    for name in ("c50", "c80", "g"):
        np.testing.assert_allclose(getattr(found, name)[0, 0, high], getattr(wanted, name)[0, 0, high], atol=0.15)
    np.testing.assert_allclose(found.ts[0, 0, high], 0.9 / 6.0 / math.log(10.0), rtol=0.1)
    assert np.isnan(clsim.room_measures(tmp_path / "hall.wav", channel=1).g).all()


@pytest.mark.filterwarnings("ignore:noise or the end of responses")
@pytest.mark.parametrize(
    ("subtype", "most", "clipped"),
    [("PCM_16", 0.9, False), ("PCM_16", 4.0, True), ("FLOAT", math.inf, False), ("FLOAT", 1.0, True)],
)
def test_a_clipped_response_is_told(subtype: str, most: float, clipped: bool, tmp_path, rng) -> None:
    """A file that is cut off has several samples in a row at full scale, one of floats at any value.

    A single sample may be the peak, and floats may be beyond 1.
    """
    wave = decaying(0.5, 1.0, rng)
    wave *= (most if subtype == "PCM_16" else 4.0) / np.abs(wave).max()
    if subtype == "FLOAT":
        wave[100:200] = np.sign(wave[100:200]) * np.maximum(np.abs(wave[100:200]), 2.0)  # a row of samples beyond 1
    top = 1.0 if subtype == "PCM_16" else most
    soundfile.write(tmp_path / "loud.wav", np.clip(wave, -top, top), round(RATE), subtype=subtype)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", clsim.ClsimWarning)
        clsim.room_measures(tmp_path / "loud.wav")
    assert any("loud.wav is clipped" in str(w.message) for w in caught) == clipped


def test_files_that_hold_no_response(tmp_path: Path) -> None:
    soundfile.write(tmp_path / "silence.wav", np.zeros(4800), 48_000)
    soundfile.write(tmp_path / "short.wav", np.eye(1, 4800)[0], 48_000)
    soundfile.write(tmp_path / "slow.wav", np.eye(1, 1600)[0], 16_000)
    soundfile.write(tmp_path / "empty.wav", np.zeros(0), 48_000)
    soundfile.write(tmp_path / "brief.wav", np.eye(1, 480)[0], 48_000)
    soundfile.write(tmp_path / "broken.wav", np.array([0.0, np.nan] * 4800), 48_000, subtype="FLOAT")
    for path, more, problem in (
        ("brief.wav", {}, "responses: must last 50 ms at least, but .*brief.wav lasts 10 ms"), ("broken.wav", {}, "must hold finite samples"),
        ("silence.wav", {}, "responses: must hold a response, but .*silence.wav is silent"),
        ("empty.wav", {}, "path: must hold sound, but .*empty.wav is empty$"), ("none.wav", {}, "there is no file"), ("short.wav", {"channel": 1}, "channel: must be below 1"),
        ("short.wav", {"free_field": 3.0}, "free_field: must be a sound file and a distance"),
        ("short.wav", {"free_field": ("short.wav", 0.0)}, r"free_field\[1\]: must be at least"),
        ("short.wav", {"free_field": (tmp_path / "slow.wav", 1.0)}, r"free_field\[0\]: must have the sampling rate 48000"),
    ):  # fmt: skip
        with pytest.raises(clsim.InputError, match=problem):
            clsim.room_measures(tmp_path / path, **more)
    with pytest.raises(clsim.InputError, match="responses: must reach from 88 to 11314 Hz"):
        clsim.speech_transmission(tmp_path / "slow.wav")
    with pytest.raises(clsim.InputError, match="speech_db: must be given where there is noise"):
        clsim.speech_transmission(tmp_path / "short.wav", noise_db=[40.0] * 7)
    for level, problem in (("a", "must be numbers, but is 'a'"), ([60.0] * 6, "must have the shape 7, but has 6")):
        with pytest.raises(clsim.InputError, match=f"speech_db: {problem}"):
            clsim.speech_transmission(tmp_path / "short.wav", level)  # type: ignore[arg-type]


@pytest.mark.parametrize("length", few([1.0, 2.5]))
@pytest.mark.parametrize("snr_db", [None, 0.0, 5.0, 10.0, 12.0])
def test_noise_has_no_reverberation_time(snr_db: float | None, length: float, tmp_path, rng) -> None:
    """A decay of 1 s that little noise hides, and noise alone: times of 1.3 to 6 s were given as those of the room."""
    noise = rng.standard_normal(round(length * RATE))
    made = noise if snr_db is None else decaying(1.0, length, rng) + noise * 10.0 ** (-snr_db / 20.0)
    soundfile.write(tmp_path / "noisy.wav", 0.05 * made, round(RATE), subtype="FLOAT")
    with pytest.warns(clsim.ClsimWarning, match="NaN there"):
        found = clsim.room_measures(tmp_path / "noisy.wav", "octave")
    for name in ("t20", "t30", "edt"):
        assert np.isnan(getattr(found, name)).all(), name
