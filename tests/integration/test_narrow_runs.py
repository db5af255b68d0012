"""Runs of scenes with a narrow part: gone on with bit for bit, and alike in every store."""

from pathlib import Path

import numpy as np
import pytest
import soundfile
from failing import stopped_and_resumed
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

from clsim.cli import main

SCENE = scene_text(
    source_at("beacon", tone_of(40e3, 0.25), along((1, 1, 1), (2, 1, 1), 0.5)),
    receiver_at("ear", (3.0, 1.5, 2.0), electronics={"clock_ppm": 50.0, "high_cut": 80e3, "gain_db": 20.0}),
    render={"chunk": 18432, "narrowband": True},
)
pytestmark = [
    pytest.mark.usefixtures("device"),
    pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning"),  # the tone begins at once
]


def run(folder: Path, out: str, *more: str) -> int:
    return main(["run", str(folder / "scene.toml"), "-o", str(folder / out), "--no-plots", "--table", "none", *more])


def test_a_run_goes_on_bit_for_bit(tmp_path, monkeypatch, capsys) -> None:
    """Where it was stopped lies within a chunk of the envelopes, which are of another length."""
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    out = stopped_and_resumed(monkeypatch, tmp_path / "scene.toml", tmp_path, at=2 * 18432)
    assert "the device is lost" in capsys.readouterr().err
    assert np.any(soundfile.read(out / "ear.wav")[0])


def test_check_tells_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    assert "source 0, narrow part: rendered as complex envelope of " in capsys.readouterr().out
