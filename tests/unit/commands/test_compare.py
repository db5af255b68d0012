"""`clsim compare`: a measured response made of a known scene, with another tail, noise, and an unknown delay and gain."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import soundfile
from scene_texts import receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main

RATE = 16e3
SCENE = scene_text(
    source_at("S", tone_of(1e3, 0.1, 16e3, fade=0.01), (1, 1, 1.2)),
    receiver_at("near", (2.2, 1.9, 1.5)),
    receiver_at("far", (4.4, 3.3, 1.9)),
    room={"kind": "shoebox", "size": (6.0, 4.5, 3.0), "walls": {"reflection": 0.85, "scattering": 0.05}},
    max_order=2,
    rate=16e3,
    render={"engine": "reference"},
)
LATE, GAIN = 0.02127, -0.037  # s, no whole number of samples; and reversed


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the scene and a measured response of its far receiver."""
    path = tmp_path_factory.mktemp("compare")
    (path / "scene.toml").write_text(SCENE)
    file = clsim.load_scene(path / "scene.toml")
    paths = clsim.find_paths(file.scene, **file.paths)
    found = clsim.impulse_responses(paths, RATE, lead="keep", tail_seed=7)
    taps = found.samples[0, 1, found.lead :]
    size = 2 * len(taps) + 4000
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(size, 1.0 / RATE) * LATE)
    made = np.fft.irfft(np.fft.rfft(taps, size) * turn, size)
    made += 1e-4 * np.abs(made).max() * np.random.default_rng(0).standard_normal(size)
    soundfile.write(path / "far.wav", GAIN * made, round(RATE), subtype="FLOAT")
    return path


def test_a_response_of_the_scene_itself(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Delay within half a sample, gain within 1.2 dB, and its polarity; strong reflections within 3 dB; parameters alike."""
    arguments = ["compare", str(folder / "far.wav"), str(folder / "scene.toml"), "--receiver", "far"]
    assert main([*arguments, "-o", str(folder / "far.png"), "--force"]) == 0
    out = capsys.readouterr().out
    told = re.search(r"is ([\d.]+) ms late and at ([+-][\d.]+) dB, polarity reversed \(by their correlation", out)
    assert told is not None, out
    assert float(told[1]) == pytest.approx(1e3 * LATE, abs=0.5e3 / RATE)
    # The other tail, of some twice the images' energy in 30 ms, correlates with them by sqrt(2 / (2 B T)) = 7 %, 0.6 dB.
    assert float(told[2]) == pytest.approx(20.0 * np.log10(abs(GAIN)), abs=1.2)
    assert (folder / "far.png").stat().st_size > 20_000
    with (folder / "far.csv").open() as file:
        rows = list(csv.DictReader(file))
    strong = [row for row in rows if row["order"] in ("0", "1")]
    assert len(strong) == 7
    assert float(strong[0]["measured_db"]) == pytest.approx(float(strong[0]["simulated_db"]), abs=0.1)
    for row in strong:  # of ten seeds the other noise of the tail changes the weakest of them by 1 dB rms
        assert float(row["measured_db"]) == pytest.approx(float(row["simulated_db"]), abs=3.0), row
    assert float(rows[0]["delay"]) == pytest.approx(np.linalg.norm([3.4, 2.3, 0.7]) / clsim.Air().speed_of_sound)
    apart = [float(x) for x in re.findall(r"(?:1000|2000|4000) +[\d.-]+ +[\d.-]+ +([+-][\d.]+)$", out, re.MULTILINE)]
    assert len(apart) >= 18
    # The same energies, other noise: within the deviation of times, 0.9 sqrt(1 / (B T)) of 700 Hz and 0.3 s is 6 %.
    assert np.mean(np.abs(apart)) < 1.5


def test_a_response_of_something_else_is_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    noise = np.random.default_rng(1).standard_normal(16_000) * 10.0 ** (-3.0 * np.arange(16_000) / 8000.0)
    soundfile.write(folder / "other.wav", np.concatenate([np.zeros(500), 0.1 * noise]), round(RATE), subtype="FLOAT")
    assert main(["compare", str(folder / "other.wav"), str(folder / "scene.toml"), "-o", str(folder / "o.png")]) == 0
    assert "the responses are not alike" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "more", "problem"),
    [
        ("far.wav", ["--receiver", "fat"], '--receiver: must be one of "near", "far"'), ("far.wav", ["--channel", "1"], "--channel: must be below 1"),
        ("none.wav", [], "measured: must be a sound file"), ("silent.wav", [], "must hold a response, but is silent"),
        ("nan.wav", [], "measured: must hold finite samples, but [7]"), ("short.wav", [], "must hold 50 ms at least, but holds 12.5 ms"),
        ("far.wav", ["-o", "x.txt"], "--output: must end in .png"), ("slow.wav", [], "measured: must be sampled at 1 kHz at least"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared(name: str, more: list[str], problem: str, folder: Path, error_of) -> None:
    bad = np.ones(16_000)
    bad[7] = np.nan
    for file, samples, rate in (
        ("silent.wav", np.zeros(16_000), 16_000), ("nan.wav", bad, 16_000), ("short.wav", np.eye(1, 200)[0], 16_000),
        ("slow.wav", np.ones(1000), 500),
    ):  # fmt: skip
        soundfile.write(folder / file, samples, rate, subtype="FLOAT")
    assert problem in error_of("compare", folder / name, folder / "scene.toml", *more)
