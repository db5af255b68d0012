"""Scene files: the same words as the constructors, and an error that names the field for everything else."""

import copy
import math
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest
from exhaustive import few
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scene_fields import leaves, refusal, written
from scipy.spatial.transform import Rotation

import clsim
from clsim.scene_file import load_scene
from clsim.scene_file.scene import build_scene, completed_scene, scene_schema

EXAMPLE = """
format = 1
[room]
kind = "shoebox"
size = [8.0, 6.0, 3.0]
walls = { default = { reflection = 0.9 }, z_min = { absorption = { frequencies = [1e3, 50e3], coefficients = [0.1, 0.2] } } }
[air]
temperature_celsius = 21.0
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 40e3, duration = 0.05, sampling_rate = 192e3 }
trajectory = { kind = "circle", center = [4, 3, 1.5], radius = 1.0, period = 1.0, duration = 2.0 }
directivity = { kind = "piston", radius = 0.0047 }
aim = [1.0, 0.0, 0.0]
transducer = { kind = "resonance", frequency = 40e3, width = 2.4e3, sensitivity = 0.5 }
[[sources]]
name = "beacon"
start = 0.01
signal = { kind = "pulses", pulse = { kind = "chirp", start = 39e3, stop = 41e3, duration = 1e-3, sampling_rate = 192e3, fade = 1e-4 }, period = 0.01, count = 3 }
trajectory = { kind = "waypoints", times = [0.0, 1.0, 2.0], positions = [[1, 1, 1], [2, 1, 1], [2, 2, 1]] }
directivity = { kind = "named", name = "MA40S4S" }
aim = "forward"
[[receivers]]
name = "ceiling"
trajectory = { kind = "fixed", position = [1.0, 1.0, 2.9] }
directivity = { kind = "first-order", weight = 0.5 }
aim_at = [4.0, 3.0, 1.5]
transducer = { kind = "table", frequencies = [10e3, 40e3, 90e3], magnitudes = [0.001, 0.002, 0.001], outside = "zero" }
electronics = { ambient_noise_db = 10.0, self_noise_db = 5.0, seed = 3, low_cut = 20e3, high_cut = 80e3, order = 4, gain_db = 40.0, adc_bits = 12, adc_full_scale = 1.0, clock_ppm = 50.0, clock_offset = 0.001 }
[paths]
max_order = 2
[render]
sampling_rate = 192e3
interpolator = { kind = "bandlimited", error_db = -90 }
"""
CONTENT = tomllib.loads(EXAMPLE)


def changed(path: tuple, value: object) -> dict:
    content = copy.deepcopy(CONTENT)
    at = content
    for step in path[:-1]:
        at = at[step]
    at[path[-1]] = value
    return content


LEAVES = leaves(CONTENT)


def test_the_file_says_what_the_constructors_say(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(EXAMPLE)
    file = load_scene(tmp_path / "scene.toml")
    robot, beacon = file.scene.sources
    assert file.paths["max_order"] == 2
    assert file.render["interpolator"] == clsim.Bandlimited(-90)
    assert robot.directivity == clsim.Piston(0.0047)
    assert beacon.start == 0.01
    np.testing.assert_allclose(robot.trajectory.position(0.25), [4, 4, 1.5], atol=1e-12)
    np.testing.assert_allclose(file.scene.room.reflections(50e3)[[0, 4]], [0.9, math.sqrt(0.8)])
    # The parabola through the beacon's points leaves the first one at (1.5, -0.5) m/s; the ceiling looks down at (4, 3, 1.5).
    faces = [
        Rotation.from_quat(end.orientation(np.zeros(1))[0]).apply([1.0, 0.0, 0.0])
        for end in (beacon, file.scene.receivers[0])
    ]
    for axis, towards in zip(faces, [(1.5, -0.5, 0.0), (3.0, 2.0, -1.4)], strict=True):
        np.testing.assert_allclose(axis, np.array(towards) / np.linalg.norm(towards), rtol=0, atol=1e-4)


def test_a_misspelt_word_is_asked_for_where_a_list_may_stand_too() -> None:
    told = refusal(changed(("sources", 0, "aim"), "foreward"), Path())
    assert told == 'sources[0].aim: must be one of "forward", but is \'foreward\'; did you mean "forward"?'


def test_completed_scene_is_the_same_from_another_folder(tmp_path: Path) -> None:
    rows = "".join(f"{t / 10} {1 + t / 100} 1 1 0 0 0 1\n" for t in range(30))
    (tmp_path / "walk.txt").write_text(rows)
    walk = {"kind": "file", "path": "walk.txt", "format": "tum", "smooth": False}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        content = changed(("sources", 1, "trajectory"), walk)
        del content["sources"][1]["aim"]  # the file has orientations
        file = build_scene(content, tmp_path)
        other = tmp_path / "out" / "deep"
        other.mkdir(parents=True)
        (other / "scene.toml").write_text(completed_scene(file, other, duration=0.07))
        again = load_scene(other / "scene.toml")
    assert again.render == file.render | {"duration": 0.07}
    t = np.linspace(0, 2, 7)
    for a, b in zip(file.scene.sources, again.scene.sources, strict=True):
        np.testing.assert_array_equal(a.trajectory.position(t), b.trajectory.position(t))
    completed = tomllib.loads((other / "scene.toml").read_text())
    assert completed["air"]["relative_humidity"] == 0.5
    assert completed["render"]["motion"] == "retarded"


@pytest.mark.parametrize("value", [float("nan"), "text", [], {"odd": 1}, True], ids=repr)
def test_nonsense_anywhere_names_the_field(value: object) -> None:
    wrong = []
    for path in LEAVES:
        if isinstance(value, str) and path[-1] == "name":
            continue  # any text is a name
        match = written(path[: -1 if isinstance(path[-1], int) and value == [] else len(path)])
        told = refusal(changed(path, value), Path())
        if not told.startswith(match.rpartition(".kind")[0] or match):
            wrong.append(f"{written(path)}: {told}")
    assert wrong == []


def test_unknown_keys_are_errors() -> None:
    parents = sorted({path[:n] for path in LEAVES for n in range(len(path)) if not isinstance(path[n], int)}, key=repr)
    assert len(parents) > 15
    assert [p for p in parents if "surprise" not in refusal(changed((*p, "surprise"), 1), Path())] == []


REQUIRED = [
    ("format",), ("room",), ("sources",), ("receivers",), ("paths",), ("render",), ("room", "kind"), ("room", "size"),
    ("room", "walls"), ("sources", 0, "name"), ("sources", 0, "signal"), ("sources", 0, "signal", "frequency"),
    ("sources", 0, "trajectory"), ("sources", 0, "trajectory", "center"), ("receivers", 0, "trajectory", "position"),
    ("paths", "max_order"), ("render", "sampling_rate"), ("sources", 1, "signal", "pulse"),
]  # fmt: skip


@pytest.mark.parametrize("path", REQUIRED, ids=written)
def test_missing_fields_are_errors(path: tuple) -> None:
    content = copy.deepcopy(CONTENT)
    at = content
    for step in path[:-1]:
        at = at[step]
    del at[path[-1]]
    with pytest.raises(clsim.InputError) as caught:
        build_scene(content, Path())
    assert str(caught.value).startswith(written(path)), str(caught.value)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@pytest.mark.parametrize("draws", few([150, 400]))
def test_fuzzed_fields_give_an_input_error_or_a_scene(draws: int) -> None:
    given_some = given(path=st.sampled_from(LEAVES), value=anything)(it_is_an_input_error_or_a_scene)
    settings(max_examples=draws, deadline=None, suppress_health_check=[HealthCheck.too_slow])(given_some)()


def it_is_an_input_error_or_a_scene(path: tuple, value: object) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            build_scene(changed(path, value), Path())
        except clsim.InputError as error:
            assert error.field or error.problem


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(clsim.InputError, match="cannot be read"):
        load_scene(tmp_path / "missing.toml")
    for text in (b"format = ", b"\xff\xfe"):
        (tmp_path / "bad.toml").write_bytes(text)
        with pytest.raises(clsim.InputError, match="is no TOML file"):
            load_scene(tmp_path / "bad.toml")


def test_schema_names_every_kind() -> None:
    text = str(scene_schema())
    for word in ("shoebox", "mesh", "plan", "obstacles", "beam-tree", "tone", "waypoints", "bandlimited", "piston"):
        assert word in text


def test_air_without_absorption_stays_so_in_the_completed_scene(tmp_path: Path) -> None:
    file = build_scene(changed(("air", "absorption"), False), tmp_path)
    assert not file.scene.air.absorption
    completed = tomllib.loads(completed_scene(file, tmp_path))
    assert completed["air"]["absorption"] is False
    assert not build_scene(completed, tmp_path).scene.air.absorption
    assert "absorption" in scene_schema()["$defs"]["_Air"]["properties"]
    with pytest.raises(clsim.InputError, match=r"air\.absorption"):
        build_scene(changed(("air", "absorption"), 0.0), tmp_path)


def test_air_that_disperses_is_asked_for_and_told() -> None:
    file = build_scene(changed(("air",), {"dispersion": True, "speed_of_sound": 340.0}), Path())
    assert file.scene.air == clsim.Air(speed_of_sound=340.0, dispersion=True)
    told = [line for line in file.scene.describe() if line.startswith("air disperses")]
    assert len(told) == 2
    assert "'robot' sends about 40000 Hz goes 340.14" in told[0]
    assert "340.000 m/s at 0 Hz" in told[0]
    with pytest.raises(clsim.InputError, match="without absorption") as error:
        build_scene(changed(("air",), {"dispersion": True, "absorption": False}), Path())
    assert error.value.field == "air.dispersion"


def test_a_number_or_two_of_them_are_refused_where_they_are_wrong() -> None:
    for value, message in (
        ([19.0, float("nan")], r"air\.temperature_celsius\[1\]: must be finite, but is nan"),
        ([19.0, "x"], r"air\.temperature_celsius\[1\]: must be a number, but is 'x'"),
        ("warm", r"air\.temperature_celsius: must be a number, but is 'warm'"),
    ):
        with pytest.raises(clsim.InputError, match=message):
            build_scene(changed(("air", "temperature_celsius"), value), Path())
