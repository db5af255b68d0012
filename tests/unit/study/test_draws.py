"""Draws against the closed forms of their distributions; places inside rooms; reverberation times that are aimed at."""

import math
import tomllib
from pathlib import Path

import made_studies
import numpy as np
import pytest
from scipy import stats

import clsim
from clsim.scene_file.scene import build_scene
from clsim.study.file import Study, load_study

SCENE = made_studies.SCENE.replace("40e3, duration = 0.02", "4e3, duration = 0.01").replace("0.005", "0.002").replace("192e3", "16e3")  # fmt: skip
COUNT = 2000
LEAST = 1e-3  # of p: a right distribution falls below at one seed in a thousand, and the seed is fixed


def study(folder: Path, vary: str, count: int = COUNT, scene: str = SCENE, seed: int = 3) -> Study:
    (folder / "scene.toml").write_text(scene, "utf-8")
    top = f'format = 1\nscene = "scene.toml"\ndraws = {count}\nseed = {seed}\n'
    (folder / "study.toml").write_text(top + vary, "utf-8")
    return load_study(folder / "study.toml", 10_000)


def drawn(folder: Path, random: str, field: str = "air.relative_humidity", **more: object) -> np.ndarray:
    found = study(folder, f'[[vary]]\nfield = "{field}"\nrandom = {{ {random} }}\n', **more)  # type: ignore[arg-type]
    return np.array([next(iter(member.parameters.values())) for member in found.members])


@pytest.mark.parametrize(
    ("random", "law"),
    [
        ("uniform = [0.2, 0.8]", stats.uniform(0.2, 0.6)),
        ("log_uniform = [0.01, 10.0]", stats.loguniform(0.01, 10.0)),
        ("normal = [20.0, 2.0]", stats.norm(20.0, 2.0)),
    ],
)
def test_numbers_have_their_distributions(tmp_path: Path, random: str, law: stats.rv_continuous) -> None:
    values = drawn(tmp_path, random)
    assert stats.kstest(values, law.cdf).pvalue > LEAST
    assert stats.kstest(values, lambda x: law.cdf(x) ** 1.2).pvalue < LEAST, "the test sees another law"


def test_choices_are_equally_likely(tmp_path: Path) -> None:
    counts = np.bincount(drawn(tmp_path, "choice = [0, 1, 2]", "paths.max_order"))
    assert stats.chisquare(counts).pvalue > LEAST


def test_more_draws_begin_with_the_same(tmp_path: Path) -> None:
    for random in ("uniform = [0, 1]", "normal = [0, 1]", "choice = [1, 2, 3]", "inside = 0.3"):
        few, many = (drawn(tmp_path, random, count=count) for count in (5, 50))
        assert np.array_equal(few, many[:5]), random
        assert not np.array_equal(few, drawn(tmp_path, random, count=5, seed=4)), random


def test_places_fill_what_a_margin_leaves_of_each_room(tmp_path: Path) -> None:
    places = drawn(tmp_path, "inside = 0.5", "sources[0].trajectory.start")
    for axis, size in enumerate((4.0, 3.0, 2.5)):
        assert stats.kstest(places[:, axis], stats.uniform(0.5, size - 1.0).cdf).pvalue > LEAST
    assert np.abs(np.corrcoef(places.T) - np.eye(3)).max() < 4.0 / math.sqrt(COUNT)


def test_places_are_in_the_members_own_room(tmp_path: Path) -> None:
    text = """
    [[vary]]
    field = "sources[0].trajectory.start"
    random = { inside = 0.5 }
    [[vary]]
    field = "room.size"
    random = { uniform = [[2.0, 2.0, 2.0], [9.0, 9.0, 4.0]] }
    """
    members = study(tmp_path, text, 500).members
    sizes, places = (np.array([list(m.parameters.values())[i] for m in members]) for i in (1, 0))
    shares = (places - 0.5) / (sizes - 1.0)
    assert (shares.min() >= 0.0) & (shares.max() <= 1.0)
    for axis in range(3):
        assert stats.kstest(shares[:, axis], "uniform").pvalue > LEAST


def test_fields_are_drawn_apart_from_each_other(tmp_path: Path) -> None:
    text = '[[vary]]\nfield = "%s"\nrandom = { uniform = [0.0, 1.0] }\n'
    found = study(tmp_path, text % "air.relative_humidity" + text % "min_distance").members
    one, other = np.array([list(member.parameters.values()) for member in found]).T
    assert abs(np.corrcoef(one, other)[0, 1]) < 4.0 / math.sqrt(COUNT)


PLAN = SCENE.replace('kind = "shoebox"\nsize = [4.0, 3.0, 2.5]\nwalls = ', (
    'kind = "plan"\noutline = [[0, 0], [6, 0], [6, 2], [2, 2], [2, 5], [0, 5]]\nheight = 2.5\nmaterials = '
))  # fmt: skip


def test_places_keep_their_margin_in_a_room_with_a_corner(tmp_path: Path) -> None:
    places = drawn(tmp_path, "inside = 0.4", "sources[0].trajectory.start", count=300, scene=PLAN)
    x, y, z = places.T
    assert np.all((z >= 0.4) & (z <= 2.1) & (x >= 0.4) & (y >= 0.4) & (x <= 5.6) & (y <= 4.6))
    beyond = np.stack([np.maximum(2.0 - x, 0.0), np.maximum(2.0 - y, 0.0)])  # of the quadrant that is no room
    assert np.hypot(*beyond).min() >= 0.4 - 1e-9
    along = np.mean(x > 2.0), np.mean(y > 2.0)
    assert min(along) > 0.2, "both wings have places"


def test_an_array_is_placed_as_a_whole(tmp_path: Path) -> None:
    found = study(
        tmp_path,
        """
        [[vary]]
        field = ["receivers[0].trajectory.position", "receivers[1].trajectory.position"]
        name = ["left", "right"]
        random = { inside = { margin = 0.2, offsets = [[0, 0, 0], [0.1, 0, -0.3]] } }
        """,
        200,
    )
    left, right = (np.array([m.parameters[name] for m in found.members]) for name in ("left", "right"))
    assert np.allclose(right - left, [0.1, 0.0, -0.3], atol=1e-15)
    assert min(left.min(), right.min()) >= 0.2
    assert ((4.0, 3.0, 2.5) - np.maximum(left, right)).min() >= 0.2 - 1e-9
    assert stats.kstest(left[:, 2], stats.uniform(0.5, 1.8).cdf).pvalue > LEAST


def test_files_are_drawn_by_a_pattern(tmp_path: Path) -> None:
    (tmp_path / "speech").mkdir()
    for name in ("b.wav", "a.wav", "c.txt"):
        (tmp_path / "speech" / name).touch()
    values = drawn(tmp_path, 'file = "speech/*.wav"', "sources[0].signal.path")
    assert sorted(set(values)) == ["speech/a.wav", "speech/b.wav"]
    assert abs(np.mean(values == "speech/a.wav") - 0.5) < 4.0 * 0.5 / math.sqrt(COUNT)


@pytest.mark.parametrize(
    ("random", "message"),
    [
        ('file = "speech/*.wav"', "vary[0].random.file: must match files beside the study file, but 'speech/*.wav'"),
        ('file = ""', "vary[0].random.file: must"),
        ("inside = -1.0", "vary[0].random.inside.margin: must be at least 0 m, but is -1 m"),
        ("inside = 2.0", "inside: must leave a place in each room, but 2 m off the walls is none"),
        ("inside = { margin = 0.1, offsets = [[0, 0, 0], [1, 0, 0]] }", "offsets: must be one per field, 1, but are 2"),
        ("inside = { margin = 0.1, offset = 1 }", "vary[0].random.inside"),
        ("inside = 0.1, uniform = [0, 1]", "vary[0].random: must have one distribution, but has uniform and inside"),
    ],
)
def test_bad_draws_are_told(tmp_path: Path, random: str, message: str) -> None:
    with pytest.raises(clsim.InputError) as caught:
        drawn(tmp_path, random, "sources[0].trajectory.start", count=2)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("top", "message"),
    [
        ("noise = { snr = 3.0 }", "noise.snr"),
        ("noise = { snr_db = 300.0 }", "noise.snr_db: must be at most 200 dB, but is 300 dB"),
        ('noise = { snr_db = 3.0, field = "flat" }', "noise.field: must be"),
        ("shards = { members = 0 }", "shards.members: must be at least 1, but is 0"),
        ('shards = { format = "mp3" }', "shards.format: must be"),
        ('keep = ["noise"]', "keep: must leave out noise, because there is no table [noise]"),
    ],
)
def test_bad_tables_are_told(tmp_path: Path, top: str, message: str) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    text = f'format = 1\nscene = "scene.toml"\n{top}\n[[vary]]\nfield = "paths.max_order"\nvalues = [0]\n'
    (tmp_path / "study.toml").write_text(text, "utf-8")
    with pytest.raises(clsim.InputError) as caught:
        load_study(tmp_path / "study.toml")
    assert message in str(caught.value)


def aimed(walls: str, room: str = "[6.0, 5.0, 3.0]") -> clsim.Scene:
    text = SCENE.replace("{ reflection = 0.9 }", walls).replace("[4.0, 3.0, 2.5]", room)
    content = tomllib.loads(text) | {"air": {"absorption": False, "speed_of_sound": 343.2}}
    return build_scene(content, Path()).scene


def test_walls_have_the_reverberation_time_that_is_aimed_at() -> None:
    reflected = aimed("{ reverberation_time = 0.4 }").room.faces.materials[0].energy_at(np.array([1e3]), 1.0, 343.2)
    volume, surface = 6.0 * 5.0 * 3.0, 2.0 * (6.0 * 5.0 + 6.0 * 3.0 + 5.0 * 3.0)
    assert 55.262 * volume / (343.2 * surface * -np.log(reflected)) == pytest.approx(0.4, rel=1e-4)  # Eyring's time
    paths = clsim.find_paths(aimed("{ reverberation_time = 0.4 }"), 26)
    responses = clsim.impulse_responses(paths, 8e3, tail="off", lead="keep")
    found = clsim.room_measures(responses)
    assert np.mean(found.edt[..., -2:]) == pytest.approx(0.4, rel=0.15)  # of the images themselves


def test_reverberation_times_by_frequency() -> None:
    scene = aimed("{ reverberation_time = { frequencies = [250.0, 4000.0], seconds = [0.6, 0.3] } }")
    low, high = scene.room.faces.materials[0].energy_at(np.array([250.0, 4000.0]), 1.0, 343.2).ravel()
    assert np.log(high) / np.log(low) == pytest.approx(2.0, rel=1e-4)


@pytest.mark.parametrize(
    ("walls", "message"),
    [
        ("{ reverberation_time = 0.0 }", "room.walls.reverberation_time: must be above 0 s, but is 0 s"),
        ("{ default = { reverberation_time = 0.4 } }", "must be in the one material of all walls of a shoebox"),
        ("{ reverberation_time = 0.4, reflection = 0.9 }", "room.walls: must have one of "),
    ],
)
def test_bad_times_are_told(walls: str, message: str) -> None:
    with pytest.raises(clsim.InputError) as caught:
        aimed(walls)
    assert message in str(caught.value)
