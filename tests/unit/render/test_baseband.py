"""What is asked for in baseband: bounds, sampling rates, files, scene files, the command line."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scene_texts import receiver_at, scene_text, shoebox_of, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.render.baseband import Baseband, as_baseband, blocks_of
from clsim.scene_file import load_scene
from clsim.scene_file.scene import completed_scene

RATE = 192e3
TONE = clsim.Signal.tone(40e3, 0.05, RATE, fade=0.02)


def scene(signal: clsim.Signal = TONE, speed: float = 0.0, **receiver) -> clsim.Scene:
    way = clsim.Trajectory.fixed((2.0, 2.0, 1.0))
    if speed:
        way = clsim.Trajectory.line((2.0, 2.0, 1.0), (2.0 + 0.1 * speed, 2.0, 1.0), 0.1)
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((4.0, 3.0, 2.0)), **receiver)]
    room = clsim.Shoebox((6, 5, 3), clsim.Material.from_reflection(0.8))
    return clsim.Scene(room, clsim.Air(), [clsim.Source("s", signal, way)], ears)


def planned(one: clsim.Scene, baseband: object = (40e3, 4e3), **options):
    return clsim.plan_render(clsim.find_paths(one, 1), RATE, baseband=baseband, **options)


@pytest.mark.parametrize(
    ("baseband", "message"),
    [
        (40e3, "baseband: must be a carrier and a bandwidth"),
        ((40e3,), "baseband: must be a carrier and a bandwidth"),
        ("ab", "baseband: must be a carrier and a bandwidth"),
        ((float("nan"), 4e3), "baseband.carrier: must be"),
        ((96e3, 4e3), "baseband.carrier: must be below 96000"),
        ((-40e3, 4e3), "baseband.carrier: must be"),
        ((40e3, 0.0), "baseband.bandwidth: must be above 0"),
        ((40e3, float("inf")), "baseband.bandwidth: must be"),
        ((40e3, 41e3), "baseband.bandwidth: must be at most 40000"),
        ((95e3, 4e3), "baseband.bandwidth: must be at most 2000 Hz"),
        ((40e3, 4e3, 4e3), "baseband.sampling_rate: must be at least 4255.32 Hz"),
        ((40e3, 4e3, 7e3), "baseband.sampling_rate: must be 192000 Hz over a whole number, such as .*7111.11111"),
        ((20e3, 4e3), "baseband: must hold the signals but for -40 dB .* lies outside 18000 to 22000 Hz"),
    ],
)
def test_bad_bands_are_refused(baseband: object, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        planned(scene(), baseband)


def test_doppler_must_fit() -> None:
    with pytest.raises(clsim.InputError, match=r"baseband.bandwidth: must be above 24.. Hz, twice the Doppler shift"):
        planned(scene(speed=10.0), (40e3, 2e3))
    assert planned(scene(speed=10.0), (40e3, 4e3)).sampling_rate == 6e3


def test_energy_outside_is_told() -> None:
    short = clsim.Signal.tone(40e3, 0.004, RATE)
    with pytest.raises(clsim.InputError, match="baseband: must hold the signals but for -40 dB"):
        planned(scene(short))
    faded = clsim.Signal.tone(40e3, 0.004, RATE, fade=0.0012)
    with pytest.warns(clsim.ClsimWarning, match="lies outside 38000 to 42000 Hz"):
        planned(scene(faded))


def test_receivers_that_work_on_the_sound_are_refused() -> None:
    with pytest.raises(clsim.InputError, match=r"receivers\[0\].electronics: must be no more than a clock"):
        planned(scene(electronics=clsim.Electronics(gain_db=3.0)))
    with pytest.raises(clsim.InputError, match=r"receivers\[0\].transducer: must be left out in baseband"):
        planned(scene(transducer=clsim.Transducer.named("MA40S4R")))
    assert planned(scene(electronics=clsim.Electronics(clock_ppm=20.0))).samples > 0


def test_other_interpolators_are_refused() -> None:
    with pytest.raises(clsim.InputError, match="interpolator: must be Bandlimited in baseband"):
        planned(scene(), interpolator=clsim.Lagrange(12))


def test_transitions_shorter_than_samples_are_told() -> None:
    one = scene()
    import dataclasses

    paths = clsim.find_paths(one, 1)
    images = dataclasses.replace(paths.families[0], end=np.full(len(paths), 0.03))
    paths = dataclasses.replace(paths, families=(images,))
    with pytest.warns(clsim.ClsimWarning, match="transition: paths begin and end within 2.6 samples"):
        clsim.plan_render(paths, RATE, baseband=(40e3, 1e3))


@pytest.mark.parametrize(
    ("band", "rate", "sampling_rate"),
    [
        ((40e3, 4e3), 192e3, 6e3),  # 32, not 38 times lower: whole Hz
        ((40e3, 500.0), 192e3, 2560.0),  # a 16th of the carrier or more
        ((40e3, 20e3), 500e3, 25e3),
        ((40e3, 40e3), 192e3, 64e3),
        ((1e3, 500.0), 8e3, 800.0),
        ((40e3, 4e3), 192001.0, 192001.0 / 38),  # a prime: no whole Hz
        ((40e3, 4e3, 12e3), 192e3, 12e3),
    ],
)
def test_sampling_rates(band: tuple[float, ...], rate: float, sampling_rate: float) -> None:
    assert as_baseband(band, rate).sampling_rate == pytest.approx(sampling_rate, rel=1e-12)


def test_blocks_follow_motion() -> None:
    assert blocks_of(6e3, 40e3, 0.0) == (256, 192, 128, 96, 64, 48, 32, 16, 8)
    assert blocks_of(6e3, 40e3, 0.02)[0] == 128  # 180 samples would be 24 cycles of the carrier
    assert blocks_of(6e3, 40e3, 0.5) == (8,)
    assert blocks_of(96e3, 40e3, 1e-4)[-1] >= 48
    for rate, speed in [(6e3, 0.0), (6e3, 0.02), (2560.0, 1e-3), (1e5, 0.1)]:
        blocks = blocks_of(rate, 40e3, speed)
        assert all(12 * blocks[0] % b == 0 for b in blocks)


def test_save_writes_two_channels(tmp_path: Path) -> None:
    import soundfile

    one = scene()
    made = clsim.render(clsim.find_paths(one, 0), RATE, baseband=Baseband(40e3, 4e3), engine="reference")
    made.save(tmp_path / "iq.wav")
    frames, rate = soundfile.read(tmp_path / "iq.wav", dtype="float32")
    assert rate == 6000
    assert np.array_equal(frames, np.stack([made.samples[0].real, made.samples[0].imag], 1))
    assert any("complex envelopes of 4000 Hz about 40000 Hz" in line for line in made.notes)


SCENE = scene_text(
    source_at("s", tone_of(40e3, 0.05, fade=0.02), (2.0, 2.0, 1.0)),
    receiver_at("r", (4.0, 3.0, 2.0)),
    room=shoebox_of(6.0, 5.0, 3.0, reflection=0.8),
    render={"engine": "reference", "baseband": {"carrier": 40e3, "bandwidth": 4e3}},
)


def test_scene_file_and_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import soundfile

    (tmp_path / "a.toml").write_text(SCENE)
    file = load_scene(tmp_path / "a.toml")
    assert file.render["baseband"] == Baseband(40e3, 4e3)
    assert tomllib.loads(completed_scene(file, tmp_path))["render"]["baseband"]["bandwidth"] == 4e3
    assert main(["run", str(tmp_path / "a.toml"), "-o", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    assert (tmp_path / "out" / "r_spectrogram.png").stat().st_size > 10_000
    made = clsim.render(clsim.find_paths(file.scene, 1), **file.render)
    frames = soundfile.read(tmp_path / "out" / "r.wav", dtype="float32")[0]
    assert np.array_equal(frames[:, 0] + 1j * frames[:, 1], made.samples[0])
    assert (
        main(["run", str(tmp_path / "out" / "scene.completed.toml"), "-o", str(tmp_path / "again"), "--no-plots"]) == 0
    )


def test_bad_scene_file_is_one_line(tmp_path: Path, error_of) -> None:
    (tmp_path / "a.toml").write_text(SCENE.replace("bandwidth = 4e3", "bandwidth = 4e5"))
    assert "render.baseband.bandwidth: must be at most 40000 Hz" in error_of("check", tmp_path / "a.toml")
    (tmp_path / "a.toml").write_text(SCENE.replace("bandwidth = 4e3", "width = 4e3"))
    assert "render.baseband.width: is no known key" in error_of("check", tmp_path / "a.toml")
