"""Measures of rooms by closed forms, and impulse responses as sums of images."""

import math
import warnings
from dataclasses import replace
from pathlib import Path

import frozen_sums
import numpy as np
import pytest
import soundfile
from exhaustive import few
from made_responses import OffCentre

import clsim
from clsim.acoustics.room_acoustics import (
    centre_time,
    decay_curve,
    interaural_correlation,
    lateral_fractions,
    modulation_transfer,
    reverberation_time,
    transmission_index,
)
from clsim.numerics.convolution import band_taper, delayed_sums, ringing

ROOM_MEASURES_RATE = 48e3


def decaying(seconds: float, length: float, rng: np.random.Generator) -> np.ndarray:
    times = np.arange(round(length * ROOM_MEASURES_RATE)) / ROOM_MEASURES_RATE
    return np.asarray(rng.standard_normal(len(times)) * 10.0 ** (-3.0 * times / seconds))


@pytest.mark.parametrize("seconds", [0.2, 1.0, 4.0])
def test_an_exponential_decay(seconds: float) -> None:
    """EDT is T, the centre time T / 13.8, and modulation goes as a low-pass of the decay's time."""
    times = np.arange(round(2.0 * seconds * ROOM_MEASURES_RATE)) / ROOM_MEASURES_RATE
    taps = 10.0 ** (-3.0 * times / seconds)
    per_second = 6.0 * math.log(10.0) / seconds  # of the energy
    assert reverberation_time(decay_curve(taps), ROOM_MEASURES_RATE, 0.0, -10.0) == pytest.approx(seconds, rel=1e-3)
    assert centre_time(taps, ROOM_MEASURES_RATE) == pytest.approx(1.0 / per_second, rel=1e-3)
    turning = 2.0 * np.pi * 0.63 * 2.0 ** (np.arange(14) / 3.0)
    transfer = modulation_transfer(np.square(taps), ROOM_MEASURES_RATE)
    np.testing.assert_allclose(transfer, 1.0 / np.sqrt(1.0 + (turning / per_second) ** 2), rtol=1e-3)


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
        fractions.append(lateral_fractions(waves, waves * cosine, ROOM_MEASURES_RATE))
    lf, lfc = np.mean(fractions, axis=0)
    window = (0.08 - 0.005) / 0.08
    assert lf == pytest.approx(window / 3.0, rel=0.02)
    assert lfc == pytest.approx(window / 2.0, rel=0.02)
    one, other = rng.standard_normal((2, 48_000))
    assert interaural_correlation(one, np.roll(one, 40), ROOM_MEASURES_RATE) == pytest.approx(1.0, abs=2e-3)
    assert interaural_correlation(one, np.roll(one, -40), ROOM_MEASURES_RATE) == pytest.approx(1.0, abs=2e-3)
    assert interaural_correlation(one, np.roll(one, 60), ROOM_MEASURES_RATE) < 0.05
    assert interaural_correlation(one, -(one + other), ROOM_MEASURES_RATE) == pytest.approx(math.sqrt(0.5), abs=0.02)


def test_lateral_measures_of_a_scene() -> None:
    """A figure of eight across the source hears none of it, and of a wall's echo the squared cosine; equal ears correlate."""
    room = clsim.Shoebox((60.0, 60.0, 60.0), {
        "y_min": clsim.Material.from_reflection(1.0), "default": clsim.Material.from_reflection(0.0)})  # fmt: skip
    source = clsim.Source(
        "s", clsim.Signal.tone(1e3, 0.1, ROOM_MEASURES_RATE), clsim.Trajectory.fixed((20.0, 4.0, 30.0))
    )
    here = clsim.Trajectory.fixed((30.0, 4.0, 30.0))
    across = clsim.Trajectory.fixed((30.0, 4.0, 30.0), orientation=(0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    ears = [
        clsim.Receiver("omni", here), clsim.Receiver("eight", across, clsim.FirstOrder(0.0)), clsim.Receiver("same", here)
    ]  # fmt: skip
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0, absorption=False), [source], ears)
    responses = clsim.impulse_responses(clsim.find_paths(scene, 1), ROOM_MEASURES_RATE, tail="off")
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
    source = clsim.Source(
        "s", clsim.Signal.tone(1e3, 0.1, ROOM_MEASURES_RATE), clsim.Trajectory.fixed((50.0, 40.0, 40.0))
    )
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((50.0 + distance, 40.0, 40.0)))]
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0, absorption=False), [source], ears)
    return clsim.impulse_responses(clsim.find_paths(scene, 0), ROOM_MEASURES_RATE, band=band, tail="off")


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
        tmp_path / "hall.wav", np.stack([np.zeros_like(whole), whole], axis=1), round(ROOM_MEASURES_RATE),
        subtype="FLOAT",
    )  # fmt: skip
    near = np.zeros(4800)
    near[100] = 0.05 * 0.4  # at 2.5 m
    soundfile.write(tmp_path / "free.wav", np.stack([near, near], axis=1), round(ROOM_MEASURES_RATE), subtype="FLOAT")
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
    soundfile.write(tmp_path / "loud.wav", np.clip(wave, -top, top), round(ROOM_MEASURES_RATE), subtype=subtype)
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
    noise = rng.standard_normal(round(length * ROOM_MEASURES_RATE))
    made = noise if snr_db is None else decaying(1.0, length, rng) + noise * 10.0 ** (-snr_db / 20.0)
    soundfile.write(tmp_path / "noisy.wav", 0.05 * made, round(ROOM_MEASURES_RATE), subtype="FLOAT")
    with pytest.warns(clsim.ClsimWarning, match="NaN there"):
        found = clsim.room_measures(tmp_path / "noisy.wav", "octave")
    for name in ("t20", "t30", "edt"):
        assert np.isnan(getattr(found, name)).all(), name


RATE = 192e3
SIZE = (5.0, 4.0, 3.0)
A, B = (1.1, 1.3, 1.2), (3.7, 2.9, 2.2)
AIR = clsim.Air()
TONE = clsim.Signal.tone(40e3, 0.01, RATE)


def scene_of(source, receiver, walls=None, signal=TONE, **options) -> clsim.Scene:
    walls = clsim.Material.from_reflection(0.9) if walls is None else walls
    return clsim.Scene(
        clsim.Shoebox(SIZE, walls), AIR, [clsim.Source("s", signal, source, **options)],
        [clsim.Receiver("r", receiver)],
    )  # fmt: skip


def fixed(a=A, b=B, **options) -> clsim.Scene:
    return scene_of(clsim.Trajectory.fixed(a), clsim.Trajectory.fixed(b), **options)


def spectrum(found: clsim.ImpulseResponses, f: np.ndarray) -> np.ndarray:
    """Return the spectrum of the only pair's response at frequencies (F,)."""
    return np.array([np.sum(found.samples[0, 0] * np.exp(-2j * np.pi * x * found.times)) for x in f])


def test_sums_of_delayed_impulses(rng: np.random.Generator) -> None:
    size = 1000
    delays, gains = np.concatenate([[0.0, 7.0, 999.99], rng.uniform(0, size, 50)]), rng.normal(size=(53, 9))
    exact = gains.T @ np.exp(-2j * np.pi * np.outer(delays, np.arange(501)) / size)
    np.testing.assert_allclose(delayed_sums(delays, gains, size), exact, atol=1e-9)


@pytest.mark.parametrize("edges", [(0.0, 0.45, 0.0, 0.05), (0.1, 0.2, 0.05, 0.05), (0.2, 0.25, 0.1, 0.25)])
def test_ringing_is_what_it_is_said_to_be(edges: tuple[float, float, float, float]) -> None:
    """An impulse between samples, cut where it is said to have rung out, keeps its spectrum."""
    size = 2**14
    f = np.arange(size // 2 + 1) / size
    weight = band_taper(f, *edges)
    low, high, below, above = edges
    assert np.all(weight[(f >= low) & (f <= high)] == 1.0)
    assert np.all(weight[(f >= high + above) | (f <= low - below if below else f < 0)] == 0.0)
    impulse = np.fft.irfft(weight * np.exp(-2j * np.pi * f * (size / 2 + 0.37)))
    away = np.abs(np.arange(size) - size / 2 - 0.37)
    reach = ringing(below, above)
    cut = np.where(away <= reach, impulse, 0.0)
    assert np.abs(np.fft.rfft(cut) - np.fft.rfft(impulse)).max() < 10 ** (-115 / 20)
    assert np.abs(impulse[away > reach * 5 / 7]).max() < 10 ** (-100 / 20) * np.abs(impulse).max()


@pytest.mark.parametrize("band", [None, (20e3, 60e3), (38e3, 42e3)])
def test_one_path_is_its_closed_form(band: tuple[float, float] | None) -> None:
    scene = fixed()
    found = clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, band=band, tail="off")
    distance = float(np.linalg.norm(np.subtract(A, B)))
    low, high = band or (200.0, 0.475 * RATE)
    f = np.linspace(low, high, 200)
    exact = 10 ** (-AIR.absorption_at(f) * (distance - 1) / 20) / distance
    exact = exact * np.exp(-2j * np.pi * f * distance / AIR.speed_of_sound)
    assert np.abs(spectrum(found, f) - exact).max() < 10 ** (-115 / 20) / distance


def test_one_path_in_air_that_disperses_has_its_wavenumber() -> None:
    """Over the whole band; the first metre is passed at the speed of the signal's centre."""
    air = clsim.Air(dispersion=True)
    found = clsim.impulse_responses(clsim.find_paths(replace(fixed(), air=air), 0), RATE, tail="off")
    distance = float(np.linalg.norm(np.subtract(A, B)))
    f = np.linspace(200.0, 0.475 * RATE, 200)
    k = air.wavenumber_at(f)
    exact = np.exp((k.imag - 1j * k.real) * (distance - 1) - 2j * np.pi * f / air.speed_at(40e3)) / distance
    assert np.abs(spectrum(found, f) - exact).max() < 10 ** (-115 / 20) / distance
    still = np.exp(k.imag * (distance - 1) - 2j * np.pi * f * distance / air.speed_of_sound) / distance
    assert np.abs(still - exact).max() > 10 ** (-10 / 20) / distance


@pytest.mark.parametrize("place", [(3.7, 2.9, 2.2), (3.7, 2.9, 2.2003), (3.7, 2.901, 2.2)])
def test_the_peak_lies_at_the_delay(place: tuple[float, float, float]) -> None:
    """Within 0.01 sample, by a parabola through the largest of 64 times as many samples."""
    scene = fixed(b=place)
    found = clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, tail="off")
    late = np.linalg.norm(np.subtract(A, place)) / AIR.speed_of_sound * RATE
    taps = found.samples[0, 0]
    even = len(taps) + len(taps) % 2
    fine = np.fft.irfft(np.fft.rfft(taps, even), 64 * even)
    k = int(fine.argmax())
    a, b, c = fine[k - 1 : k + 2]
    at = (k + 0.5 * (a - c) / (a - 2 * b + c)) / 64 - found.lead
    assert at == pytest.approx(late, abs=0.01)


def test_a_beam_with_a_phase_turns_all_frequencies() -> None:
    """A source that radiates from 2 mm ahead of where it is said to be is heard from there."""
    scene = fixed(directivity=OffCentre(2e-3), aim=np.subtract(B, A))
    found = clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, band=(20e3, 60e3), tail="off")
    f = np.linspace(20e3, 60e3, 100)
    distance = float(np.linalg.norm(np.subtract(A, B)))
    exact = 10 ** (-AIR.absorption_at(f) * (distance - 1) / 20) / distance
    exact = exact * np.exp(-2j * np.pi * f * (distance - 2e-3) / AIR.speed_of_sound)
    assert np.abs(spectrum(found, f) - exact).max() < 10 ** (-115 / 20) / distance


@pytest.mark.parametrize("order", [2, 5])
def test_a_room_is_the_sum_of_its_images(order: int, measured) -> None:
    factors = (0.9, -0.8, 0.7, 0.95, 0.5, 0.85)
    names = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")
    walls = {name: clsim.Material.from_reflection(factor) for name, factor in zip(names, factors, strict=True)}
    scene = fixed(walls=walls)
    found = clsim.impulse_responses(clsim.find_paths(scene, order), RATE, tail="off")
    f = np.linspace(500.0, 0.475 * RATE, 400)
    exact = frozen_sums.response(
        f, SIZE, (A, B), order, [lambda f, x=x: np.full(len(f), x) for x in factors], AIR
    )  # fmt: skip
    error = np.abs(spectrum(found, f) - exact)
    found = 20 * np.log10(error.max() / np.abs(exact).max())
    measured("impulse responses of rooms", "sum over images", found, -110.0)


def test_a_moving_scene_is_frozen_and_convolved(engine: str) -> None:
    """The response at an instant is what is rendered where everything stands as it does then."""
    chirp = clsim.Signal.chirp(30e3, 50e3, 0.02, RATE, window="hann")
    moving = scene_of(
        clsim.Trajectory.line(A, (2.1, 1.3, 1.2), 1.0), clsim.Trajectory.line(B, (3.7, 1.9, 2.2), 1.0), signal=chirp
    )
    found = clsim.impulse_responses(clsim.find_paths(moving, 3), RATE, at=0.25, tail="off")
    frozen = fixed((1.35, 1.3, 1.2), (3.7, 2.65, 2.2), signal=chirp)
    made = clsim.render(clsim.find_paths(frozen, 3), RATE, engine=engine, duration=0.1).pressure[0]
    convolved = np.convolve(found.samples[0, 0], chirp.read(0, chirp.count))[found.lead :][: len(made)]
    made = made[: len(convolved)].astype(float)
    # The reference engine holds responses within -100 dB of the strongest and delays within its filters' -98 dB.
    assert frozen_sums.error_db(made, convolved) < (-115.0 if engine == "opencl" else -90.0)


def test_sample_0_is_time_0() -> None:
    """What rings earlier at a close receiver is cut, and told; nothing else changes."""
    near = (1.1, 1.3, 1.21)
    paths = clsim.find_paths(fixed(b=near), 1)
    kept = clsim.impulse_responses(paths, RATE, lead="keep", tail="off")
    assert 200 < kept.lead < 2000
    assert kept.times[kept.lead] == 0.0
    f = np.linspace(1e3, 91e3, 200)
    exact = frozen_sums.response(f, SIZE, (A, near), 1, [lambda f: np.full(len(f), 0.9)] * 6, AIR)
    assert np.abs(spectrum(kept, f) - exact).max() < 10 ** (-110 / 20) * np.abs(exact).max()
    with pytest.warns(clsim.ClsimWarning, match=r"rings before time 0 is cut.*-\d+ dB.*lead=\"keep\" keeps it"):
        found = clsim.impulse_responses(paths, RATE, tail="off")
    assert found.lead == 0
    assert found.times[0] == 0.0
    np.testing.assert_array_equal(found.samples, kept.samples[:, :, kept.lead :])
    late = np.linalg.norm(np.subtract(A, near)) / AIR.speed_of_sound
    assert found.first_arrivals[0, 0] == pytest.approx(late, rel=1e-12)
    assert abs(int(found.samples[0, 0].argmax()) - late * RATE) <= 0.5
    early, whole = (np.sum(np.square(kept.samples[0, 0, :n])) for n in (kept.lead, None))
    assert found.cut_db[0, 0] == pytest.approx(10 * np.log10(early / whole), abs=1e-6)
    assert kept.cut_db[0, 0] == -np.inf
    assert f"at sample {late * RATE:.1f}" in found.describe()[0]


def test_several_pairs_share_one_axis_of_time() -> None:
    still = clsim.Trajectory.fixed
    sources = [clsim.Source("a", TONE, still(A)), clsim.Source("b", TONE, still((2.0, 2.0, 2.0)))]
    receivers = [clsim.Receiver(name, still(place)) for name, place in (("c", B), ("d", (4.4, 0.7, 0.9)))]
    scene = clsim.Scene(clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.9)), AIR, sources, receivers)
    found = clsim.impulse_responses(clsim.find_paths(scene, 0), RATE, tail="off")
    assert found.samples.shape[:2] == (2, 2)
    assert (found.source_names, found.receiver_names) == (("a", "b"), ("c", "d"))
    for s, source in enumerate(sources):
        for r, receiver in enumerate(receivers):
            distance = np.linalg.norm(source.trajectory.position(0.0) - receiver.trajectory.position(0.0))
            peak = int(np.abs(found.samples[s, r]).argmax())
            assert found.times[peak] * AIR.speed_of_sound == pytest.approx(distance, abs=0.51 / RATE * 344)
    shares = []
    clsim.impulse_responses(clsim.find_paths(scene, 1), RATE, progress=shares.append, tail="off")
    assert shares == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": 1.5}, r"^at: must lie within sources\[0\]\.trajectory, up to 1 s, but is 1\.5 s"),
        ({"at": -0.1}, r"^at: must be at least 0 s, but is -0\.1 s"),
        ({"at": float("nan")}, r"^at: must be finite"),
        ({"at": "now"}, r"^at: must be a number, but is 'now'"),
        ({"band": (0.0, 96e3)}, r"^band\[1\]: must be at most 91200 Hz, but is 96000 Hz"),
        ({"band": (50e3, 40e3)}, r"^band\[1\]: must be at least 50192 Hz, but is 40000 Hz"),
        ({"band": (-1.0, 40e3)}, r"^band\[0\]: must be at least 0 Hz"),
        ({"band": (1.0, 40e3)}, r"^band\[0\]: must be 0 or at least 38\.4 Hz"),
        ({"band": (1e3,)}, r"^band: must have the shape 2"),
        ({"band": (0.0, float("inf"))}, r"^band\[1\]: must be finite"),
        ({"sampling_rate": 10.0}, r"^sampling_rate: must be at least 1000 Hz"),
        ({"paths": None}, r"^paths: must be a PathSet, but is None"),
    ],
)
def test_bad_input(options: dict, message: str) -> None:
    scene = scene_of(clsim.Trajectory.line(A, (2.1, 1.3, 1.2), 1.0), clsim.Trajectory.fixed(B))
    arguments = {"paths": clsim.find_paths(scene, 1), "sampling_rate": RATE} | options
    with pytest.raises(clsim.InputError, match=message):
        clsim.impulse_responses(**arguments)


def test_what_is_not_known_and_not_heard_is_refused() -> None:
    table = clsim.AxialDirectivity([0, 90, 180], [40e3], [[1.0], [0.5], [0.1]])
    scene = fixed(directivity=table, aim=(1, 0, 0))
    with pytest.raises(clsim.InputError, match=r"^sources\[0\]\.directivity: must cover the band of the responses"):
        clsim.impulse_responses(clsim.find_paths(scene, 1), RATE, tail="off")
    scene = fixed()
    paths = clsim.find_paths(scene, 1)
    images = replace(paths.families[0], start=np.full(len(paths), 0.5), end=np.full(len(paths), np.inf))
    later = replace(paths, families=(images,))
    with pytest.raises(clsim.InputError, match=r"^paths: must hold paths that are active at 0\.2 s, but hold none"):
        clsim.impulse_responses(later, RATE, at=0.2, tail="off")
    assert np.any(clsim.impulse_responses(later, RATE, at=0.5, tail="off").samples)
