"""Study files: what is varied becomes members, and everything else is an error that names the field."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.study.file import Study, checked, load_study, parsed, replaced

SCENE = scene_text(
    source_at("robot", tone_of(40e3, 0.01, fade=0.002), along((1, 1, 1), (2, 1, 1), 1.0)),
    receiver_at("left", (3.0, 1.0, 2.0)),
    receiver_at("right", (3.0, 2.0, 2.0)),
)


def study(folder: Path, text: str, limit: int = 1000) -> Study:
    (folder / "scene.toml").write_text(SCENE, "utf-8")
    (folder / "study.toml").write_text(f'format = 1\nscene = "scene.toml"\n{text}', "utf-8")
    return load_study(folder / "study.toml", limit)


def test_values_and_ranges_are_combined(tmp_path: Path) -> None:
    found = study(
        tmp_path,
        """
        [[vary]]
        field = "paths.max_order"
        values = [0, 1]
        [[vary]]
        field = "room.walls.reflection"
        name = "reflection"
        range = { start = 0.5, stop = 0.9, count = 3 }
        """,
    )
    wanted = [{"paths.max_order": n, "reflection": r} for n in (0, 1) for r in (0.5, 0.7, 0.9)]
    assert [m.number for m in found.members] == list(range(6))
    for member, parameters in zip(found.members, wanted, strict=True):
        assert member.parameters == pytest.approx(parameters)
    content = found.content_of(found.members[4])
    assert content["paths"]["max_order"] == 1
    assert content["room"]["walls"]["reflection"] == pytest.approx(0.7)
    assert found.content == tomllib.loads(SCENE)  # the scene itself stays
    assert len(checked(found, lambda amount: None)) == 0


def test_fields_that_belong_together_vary_together(tmp_path: Path) -> None:
    found = study(
        tmp_path,
        """
        [[vary]]
        field = ["sources[0].trajectory.end[0]", "sources[0].trajectory.duration"]
        name = ["end", "duration"]
        values = [[2.0, 1.0], [3.0, 2.0]]
        """,
    )
    assert [m.parameters for m in found.members] == [{"end": 2.0, "duration": 1.0}, {"end": 3.0, "duration": 2.0}]
    assert found.content_of(found.members[1])["sources"][0]["trajectory"]["end"] == [3.0, 1, 1]


RANDOM = """
draws = 4000
seed = %d
[[vary]]
field = "air.relative_humidity"
random = { uniform = [0.2, 0.8] }
[[vary]]
field = "air.temperature_celsius"
random = { normal = [20.0, 2.0] }
[[vary]]
field = "sources[0].signal.frequency"
random = { log_uniform = [20e3, 40e3] }
[[vary]]
field = "sources[0].trajectory.start"
random = { uniform = [[0.5, 0.5, 0.5], [1.5, 1.0, 2.0]] }
[[vary]]
field = "paths.max_order"
random = { choice = [0, 2] }
"""


def column(found: Study, name: str) -> np.ndarray:
    return np.array([m.parameters[name] for m in found.members])


def test_random_fields_are_drawn_together_from_their_distributions(tmp_path: Path) -> None:
    found = study(tmp_path, RANDOM % 1, limit=4000)
    assert len(found.members) == 4000
    n = 4000
    humidity = column(found, "air.relative_humidity")
    assert 0.2 <= humidity.min() < 0.21
    assert 0.79 < humidity.max() <= 0.8
    assert abs(humidity.mean() - 0.5) < 5 * 0.6 / np.sqrt(12 * n)
    temperature = column(found, "air.temperature_celsius")
    assert abs(temperature.mean() - 20.0) < 5 * 2.0 / np.sqrt(n)
    assert abs(temperature.std() - 2.0) < 5 * 2.0 / np.sqrt(2 * n)
    octave = np.log2(column(found, "sources[0].signal.frequency") / 20e3)
    assert abs(octave.mean() - 0.5) < 5 / np.sqrt(12 * n)
    start = column(found, "sources[0].trajectory.start")
    assert start.shape == (n, 3)
    assert np.all((start >= [0.5, 0.5, 0.5]) & (start <= [1.5, 1.0, 2.0]))
    assert abs(np.mean(column(found, "paths.max_order") == 2) - 0.5) < 5 * 0.5 / np.sqrt(n)
    assert abs(np.corrcoef(humidity, temperature)[0, 1]) < 5 / np.sqrt(n)


def test_draws_depend_on_seed_and_field_only(tmp_path: Path) -> None:
    one, again, other = (study(tmp_path, RANDOM % seed, limit=4000) for seed in (1, 1, 2))
    assert [m.parameters for m in one.members] == [m.parameters for m in again.members]
    assert not np.any(column(one, "air.relative_humidity") == column(other, "air.relative_humidity"))
    fewer = study(tmp_path, "draws = 4000\nseed = 1\n" + RANDOM[RANDOM.index('[[vary]]\nfield = "air.temp') :], 4000)
    np.testing.assert_array_equal(
        column(one, "air.temperature_celsius"), column(fewer, "air.temperature_celsius")
    )  # another field less changes nothing


ONE = '[[vary]]\nfield = "paths.max_order"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "vary: must be given, but is missing"),
        ("vary = []", "vary: "),
        (ONE, "vary[0]: must have one of values, range, random, but has none"),
        (ONE + "values = [1]\nrange = { start = 0, stop = 1, count = 2 }", "but has values and range"),
        (ONE + "values = []", "vary[0].values: must hold at least one, but is empty"),
        (ONE + "range = { start = 0, stop = 1, count = 0 }", "vary[0].range.count"),
        (ONE + "range = { start = nan, stop = 1, count = 2 }", "vary[0].range.start"),
        (ONE + "random = { uniform = [0, 1] }", "must come with draws"),
        ("draws = 0\n" + ONE + "random = { uniform = [0, 1] }", "draws: must be at least 1, but is 0"),
        ("draws = 2\n" + ONE + "random = { uniform = [1, 0] }", "random.uniform: must be low and high"),
        ("draws = 2\n" + ONE + "random = { uniform = [0, 1, 2] }", "random.uniform: must be two numbers"),
        ("draws = 2\n" + ONE + 'random = { uniform = ["a", "b"] }', "random.uniform: must be two numbers"),
        ("draws = 2\n" + ONE + "random = { uniform = [0, inf] }", "random.uniform: must be finite"),
        ("draws = 2\n" + ONE + "random = { log_uniform = [0, 1] }", "random.log_uniform: must be above 0"),
        ("draws = 2\n" + ONE + "random = { normal = [0, -1] }", "random.normal: must be mean and standard deviation"),
        ("draws = 2\n" + ONE + "random = { choice = [] }", "random.choice: must hold at least one"),
        ("draws = 2\n" + ONE + "random = { }", "random: must have one distribution, but has none"),
        ("draws = 2\n" + ONE + "values = [1]", "draws: must be left out, because nothing is random"),
        (ONE + "values = [1]\n" + ONE + "values = [1]", "vary[1].field: must be varied once"),
        (ONE + 'values = [1]\nname = "member"', "vary[0].name: must be a name that is not taken, but is 'member'"),
        (ONE + 'values = [1]\nname = ["a", "b"]', "vary[0].name: must be one per field, 1, but are 2"),
        ('[[vary]]\nfield = ["a", "b"]\nvalues = [1]', "vary[0].values[0]: must be a list of one value per field, 2"),
        ('[[vary]]\nfield = ""\nvalues = [1]', "vary[0].field: must be a dotted path"),
        ('[[vary]]\nfield = "room..size"\nvalues = [1]', "vary[0].field: must be a dotted path"),
        ('[[vary]]\nfield = "[0]"\nvalues = [1]', "vary[0].field: must be a dotted path"),
        ('[[vary]]\nfield = "sources[1].start"\nvalues = [1]', "sources has 1 entries and none [1]"),
        (
            '[[vary]]\nfield = "room[0]"\nvalues = [1]',
            "vary[0].field: must be a field of the scene, but room is no list",
        ),
        ('[[vary]]\nfield = "sources.start"\nvalues = [1]', "but sources is no table"),
        ('metrics = "m:f"\nkeep = ["ground_truth"]\n' + ONE + "values = [1]", "metrics: must be given"),
        ('keep = ["metrics"]\n' + ONE + "values = [1]", "metrics: must be given"),
        ('keep = ["sound"]\n' + ONE + "values = [1]", "keep[0]"),
        ("keep = []\n" + ONE + "values = [1]", "keep: must name what is kept, but is empty"),
        ('metrics = "m"\n' + ONE + "values = [1]", 'metrics: must be "module:function", but is'),
        ("table_rate = 0.0\n" + ONE + "values = [1]", "table_rate: must be above 0"),
        ("colour = 1\n" + ONE + "values = [1]", "colour: is no known key"),
        (ONE + "values = [" + "1," * 1001 + "]", "must give at most 1000 members, but gives 1001 (--limit 1001 allows"),
        (ONE + "range = { start = 0, stop = 1, count = 1_000_000_000_000 }", "members, but gives 1000000000000 "),
        ("draws = 1_000_000_000_000\n" + ONE + "random = { normal = [0, 1] }", "members, but gives 1000000000000 "),
    ],
)
def test_bad_studies_are_told(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(clsim.InputError) as caught:
        study(tmp_path, text)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("field", "values", "message"),
    [
        (
            "room.walls.reflektion",
            "[0.5]",
            "vary: must name fields of the scene, but room.walls.reflektion is no known",
        ),
        ("rooms.size", "[[1, 1, 1]]", "vary: must name fields of the scene, but rooms is no known key"),
        (
            "air.relative_humidity",
            "[0.5, 2.0]",
            "member 1 (air.relative_humidity = 2.0): air.relative_humidity: must be",
        ),
        ("receivers[*].trajectory.position", "[[1.0, 1.0, 9.0]]", "receivers[0].trajectory: must stay inside the room"),
        (
            "paths.max_order",
            "[1, -2]",
            "member 1 (paths.max_order = -2): paths.max_order: must be at least 0, but is -2",
        ),
        ("render.chunk", "[0]", "member 0 (render.chunk = 0): render.chunk: must be at least 1, but is 0"),
        ("paths.max_order", '["two"]', 'member 0 (paths.max_order = "two"): paths.max_order'),
    ],
)
def test_every_members_scene_is_checked(field: str, values: str, message: str, tmp_path: Path) -> None:
    found = study(tmp_path, f'[[vary]]\nfield = "{field}"\nvalues = {values}')
    with pytest.raises(clsim.InputError) as caught:
        checked(found, lambda amount: None)
    assert message in str(caught.value)


def test_missing_files_are_told(tmp_path: Path) -> None:
    with pytest.raises(clsim.InputError, match="cannot be read"):
        load_study(tmp_path / "none.toml")
    (tmp_path / "study.toml").write_text('format = 1\nscene = "no.toml"\n' + ONE + "values = [1]", "utf-8")
    with pytest.raises(clsim.InputError, match=r"^scene: .*no\.toml: cannot be read"):
        load_study(tmp_path / "study.toml")
    (tmp_path / "study.toml").write_text("format = ", "utf-8")
    with pytest.raises(clsim.InputError, match="is no TOML file"):
        load_study(tmp_path / "study.toml")


def test_paths_of_fields(rng: np.random.Generator) -> None:
    assert parsed("a.b[3][*].c_1") == ["a", "b", 3, "*", "c_1"]
    content = {"a": [{"b": [1, 2]}, {}]}
    assert replaced(content, "a[0].b[1]", 5) == {"a": [{"b": [1, 5]}, {}]}
    assert replaced(content, "a[*].c.d", 5) == {"a": [{"b": [1, 2], "c": {"d": 5}}, {"c": {"d": 5}}]}
    assert json.dumps(content) == '{"a": [{"b": [1, 2]}, {}]}'
    value = {"kind": "fixed"}
    made = replaced(content, "a[*].t", value)
    made["a"][0]["t"]["kind"] = "line"
    assert made["a"][1]["t"] == value == {"kind": "fixed"}  # no two fields share a value
