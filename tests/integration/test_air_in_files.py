"""Air in scene files: what is told of it, studies over it, its ground truth, and searches for paths in it."""

from pathlib import Path

import numpy as np
import pytest
from made_meshes import screen

import clsim
from clsim.cli import main
from clsim.scene_file.scene import build_scene
from clsim.study.file import load_study

A, B = (1.0, 1.0, 0.5), (3.0, 1.0, 2.0)
SCENE = """
format = 1
[air]
%s
[room]
kind = "shoebox"
size = [4.0, 3.0, 2.5]
walls = { reflection = 0.9 }
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 40e3, duration = 0.01, sampling_rate = 192e3, fade = 0.002 }
trajectory = { kind = "fixed", position = [1.0, 1.0, 0.5] }
[[receivers]]
name = "left"
trajectory = { kind = "fixed", position = [3.0, 1.0, 2.0] }
[paths]
max_order = 1
[render]
sampling_rate = 192e3
"""
EVERYTHING = """
temperature_celsius = [19.0, 24.0]
relative_humidity = [0.6, 0.4]
dispersion = true
wind = [0.3, -0.2, 0.0]
fluctuation = { rms = 2e-6, correlation_time = 0.2, correlation_length = 0.3, seed = 3 }
"""


def test_check_tells_what_the_air_is_like(tmp_path: Path, capsys: pytest.CaptureFixture[str], device: None) -> None:
    (tmp_path / "scene.toml").write_text(SCENE % EVERYTHING, "utf-8")
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    told = capsys.readouterr().out
    for words in (
        "air: 19 °C, 60 % at 0 m to 24 °C, 40 % at 2.5 m", "legs are straight", "air: wind of (0.3, -0.2, 0) m/s",
        "air: delays fluctuate by 2 µs, over 0.2 s and 0.3 m, seed 3", "air disperses: what 'robot' sends about 40000 Hz goes",
        "the scene file is valid",
    ):  # fmt: skip
        assert words in told


STUDY = """
format = 1
scene = "scene.toml"
[[vary]]
field = "air.wind[0]"
name = "wind"
values = [-2.0, 0.0, 2.0]
[[vary]]
field = "air.temperature_celsius"
name = "temperatures"
values = [[20.0, 20.0], [20.0, 26.0]]
[[vary]]
field = "air.relative_humidity"
name = "humidity"
values = [0.2, 0.8]
"""


def test_studies_vary_wind_temperature_and_humidity(tmp_path: Path) -> None:
    """Every member's direct sound is late by the closed form of its own air, and absorbed by it."""
    (tmp_path / "scene.toml").write_text(SCENE % "wind = [0.0, 0.0, 0.0]\n", "utf-8")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    study = load_study(tmp_path / "study.toml", 1000)
    assert len(study.members) == 12
    d = np.subtract(B, A)
    for member in study.members:
        file = build_scene(study.content_of(member), tmp_path)
        truth = clsim.find_paths(file.scene, 0).table([0.0])
        told = member.parameters
        warm = np.interp(np.linspace(A[2], B[2], 2001), [0.0, 2.5], told["temperatures"])
        layers = [clsim.Air(celsius, told["humidity"]) for celsius in warm[20::40]]
        c = 1.0 / np.mean([1.0 / layer.speed_of_sound for layer in layers])
        along = d @ [told["wind"], 0.0, 0.0]
        exact = (np.sqrt(along**2 + (c**2 - told["wind"] ** 2) * (d @ d)) - along) / (c**2 - told["wind"] ** 2)
        # The middles of 50 layers; wind goes through all of them at their mean speed.
        assert truth.delay[0, 0] == pytest.approx(exact, abs=1e-10)
        loss = np.mean([layer.absorption_at(40e3) for layer in layers]) * (np.linalg.norm(d) - 1.0)
        assert 20.0 * np.log10(np.linalg.norm(d) * abs(truth.gain[0, 0])) == pytest.approx(-loss, abs=0.1)


def test_ground_truth_is_that_of_the_paths() -> None:
    """In air of every kind at once, and with ends that move."""
    air = clsim.Air(
        (19.0, 24.0), (0.6, 0.4), dispersion=True, wind=(3.0, -2.0, 0.5),
        fluctuation=clsim.Fluctuation(2e-6, 0.2, 0.3, 3),
    )  # fmt: skip
    tone = clsim.Signal.tone(40e3, 0.3, 192e3)
    source = clsim.Source("s", tone, clsim.Trajectory.line(A, (1.5, 1.2, 0.9), 0.4))
    ears = [clsim.Receiver("r", clsim.Trajectory.line(B, (3.2, 1.4, 1.5), 0.4))]
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9))
    paths, times = clsim.find_paths(clsim.Scene(room, air, [source], ears), 1), np.linspace(0.05, 0.3, 7)
    truth, table = clsim.direct_path(paths, times), paths.table(times)
    np.testing.assert_array_equal(truth.delay[0, 0], table.delay[0])
    np.testing.assert_array_equal(truth.doppler_factor[0, 0], table.doppler_factor[0])
    plain = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], ears), 0).table(times).delay[0]
    assert np.abs(truth.delay[0, 0] - plain).min() > 10e-6


@pytest.mark.parametrize("engine", ["opencl", "reference"])
def test_paths_in_wind_are_hidden_when_the_wind_makes_them(engine: str, device: None) -> None:
    """The moment at which a wall gets between what was emitted and what hears it, within the search's resolution.

    A source at 15 m/s passes behind a screen's edge; against a wind of 40 m/s sound is 2 ms later, so it left 3 cm before.
    """
    room = clsim.MeshRoom(*screen((4.0, 0.0, 0.0), (0.0, 4.0, 0.0), 3.0), clsim.Material.from_reflection(0.9))
    ear, start, speed = np.array([7.0, -1.0, 1.5]), np.array([1.0, -3.0, 1.5]), 15.0
    source = clsim.Source(
        "s", clsim.Signal.tone(40e3, 0.3, 192e3), clsim.Trajectory.line(start, start + np.array([0.0, 7.5, 0.0]), 0.5)
    )
    ends = []
    for wind in (-40.0, 0.0):
        air = clsim.Air(speed_of_sound=343.0, wind=(wind, 0.0, 0.0))
        scene = clsim.Scene(room, air, [source], [clsim.Receiver("r", clsim.Trajectory.fixed(ear))])
        paths = clsim.find_paths(scene, 0, engine=engine)
        # It is seen past the edge at (4, 0) as long as it is at y < 1.
        left = (1.0 - start[1]) / speed
        d = ear - np.array([start[0], start[1] + left * speed, start[2]])
        along = d[0] * wind
        late = (np.sqrt(along**2 + (343.0**2 - wind**2) * (d @ d)) - along) / (343.0**2 - wind**2)
        assert np.isneginf(paths.start[0])
        assert paths.end[0] == pytest.approx(left + late, abs=1e-4)
        ends.append(paths.end[0])
    assert ends[0] - ends[1] > 1.5e-3
