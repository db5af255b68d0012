"""`clsim validate` and measured rooms: the yardstick, a made room whose values are known, what is wrong with files."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scene_texts import receiver_at, scene_text, shoebox_of, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.measured.rooms import MeasuredRoom, bras_room, data_folder, measured_room
from clsim.measured.simulated import mean_difference

SCENE = scene_text(
    source_at("S", tone_of(1e3, 0.1, 8e3, fade=0.01), (1, 1, 1)),
    receiver_at("R", (3.0, 2.0, 1.5)),
    room=shoebox_of(reflection=0.7),
    rate=8e3,
    render={"engine": "reference"},
)
MEASURED = """
name = "made"
source = "a test"
frequencies = [1000, 2000]
pairs = [["S", "R"]]
[states.bare]
scene = "scene.toml"
[states.bare.mean]
t30 = [[{t30[0]}], [{t30[1]}]]
c80 = [[{c80[0]}], [{c80[1]}]]
lf = [[0.1], [0.1]]
[[aims]]
parameters = ["t30", "c80"]
states = ["bare"]
low = 1000
high = 2000
most = 0.5
"""


@cache
def studio() -> MeasuredRoom:
    """Return the room that comes with clsim."""
    return measured_room("ptb-studio")


def test_the_yardstick_is_that_of_the_round_robin() -> None:
    """Best, quartile and median of the 17 programs, as computed from the published tables without clsim."""
    room = studio()
    up_to_2k = room.frequencies < 3000.0
    for state, known in zip(room.states, ([0.941, 1.147, 1.415], [1.074, 1.215, 1.413]), strict=True):
        assert len(state.participants) == 17
        found = [mean_difference(state, v, ("t30", "d50", "c80"), up_to_2k) for v in state.participants.values()]
        np.testing.assert_allclose(np.quantile(found, [0.0, 0.25, 0.5]), known, atol=6e-4)


def test_the_studio_is_closed_in_both_states() -> None:
    for state, sheets in zip(studio().states, (16, 8), strict=True):
        mesh = state.scene.scene.room.as_mesh()
        assert mesh.is_closed
        assert mesh.volume == pytest.approx(377.2, rel=1e-3)
        assert (np.count_nonzero(~mesh.shape.sheets), np.count_nonzero(mesh.shape.sheets)) == (662, sheets)


def made(folder: Path, t30: tuple[float, float], c80: tuple[float, float]) -> Path:
    (folder / "scene.toml").write_text(SCENE)
    (folder / "measured.toml").write_text(MEASURED.format(t30=t30, c80=c80))
    return folder / "measured.toml"


def test_a_room_whose_values_are_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is measured are clsim's own values, and times 10 % longer: 0 and 2 / 1.1 JND; the page is the same twice."""
    file = made(tmp_path, (1.0, 1.0), (0.0, 0.0))
    scene = clsim.load_scene(tmp_path / "scene.toml")
    paths = clsim.find_paths(scene.scene, **scene.paths)
    band = 500.0 / np.sqrt(2.0), 2040.0 * np.sqrt(2.0)
    own = clsim.room_measures(clsim.impulse_responses(paths, 8e3, band=band, lead="keep", tail_seed=3))
    rows = [list(own.frequencies).index(f) for f in (1000.0, 2000.0)]
    t30, c80 = (getattr(own, name)[0, 0, rows].tolist() for name in ("t30", "c80"))
    place = clsim.Trajectory.fixed((3.0, 2.0, 1.5))
    facing = [make("R", place, aim_at=(1, 1, 1)) for make in (clsim.Receiver.ambisonic, clsim.Receiver.binaural)]
    paths = clsim.find_paths(
        replace(scene.scene, receivers=[facing[0], replace(facing[1], name="head")]), **scene.paths
    )
    heard = clsim.impulse_responses(paths, 8e3, band=band, lead="keep", tail_seed=3)
    lateral = clsim.lateral_measures(heard, "R").lf[0, rows[0]]
    for factor, reached in ((1.0, "0.00 JND"), (1.1, f"{0.5 * 2.0 / 1.1:.2f} JND")):
        made(tmp_path, tuple(factor * t for t in t30), tuple(c80))
        for out in ("one", "other"):
            assert main(["validate", str(file), "--seeds", "3", "-o", str(tmp_path / out), "--force"]) == 0
        assert f"T30, C80, 1000 to 2000 Hz: {reached}, aim 0.50 JND" in capsys.readouterr().out
        page = (tmp_path / "one" / "measured_rooms.md").read_text("utf-8")
        assert page == (tmp_path / "other" / "measured_rooms.md").read_text("utf-8")
        assert (f"| 0.50 JND | {reached} | {reached} |") in page
        assert "seed 3 of rays" in page
        assert re.search(rf"\| LF \(%\) \| 1000 \| 10 \| {100.0 * lateral:.3g} \|", page)
        for name in re.findall(r"\((pictures/.*?)\)", page):
            assert (tmp_path / "one" / name).stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["nowhere"], "ROOM: must be one of"), (["ptb-studioo"], 'did you mean "ptb-studio"'),
        (["bras-cr2"], "--bras: must name the folder of the BRAS"), (["bras-cr2", "--bras", "."], "--bras: must hold the file"),
        (["bras-cr2", "--bras", "none"], "--bras: must be a folder"), (["ptb-studio", "--seeds", "1", "1"], "--seeds: must be"),
        (["ptb-studio", "--seeds", "-1"], "--seeds: must be"), (["none.toml"], "none.toml: cannot be read"),
    ],
)  # fmt: skip
def test_what_cannot_be_validated(arguments: list[str], problem: str, tmp_path, error_of, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert problem in error_of("validate", *arguments)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('"S", "R"', '"S", "X"', r"pairs\[0\] must name a source and a receiver"), ("t30 = [[0", "t30 = [[0.3, 0", "must have 2 bands x 1 pairs"),
        ('parameters = ["t30"', 'parameters = ["g"', r"aims\[0\].parameters must be one of"), ('states = ["bare"]', 'states = ["bear"]', r"aims\[0\].states"),
        ("low = 1000", 'low = "x"', r"aims\[0\].low: must be a number"), ("source =", "sauce =", "sauce: is no known key"),
        ("scene.toml", "none.toml", "none.toml: cannot be read"),
    ],
)  # fmt: skip
def test_files_with_something_wrong(old: str, new: str, problem: str, tmp_path: Path) -> None:
    file = made(tmp_path, (0.5, 0.5), (0.0, 0.0))
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(clsim.InputError, match=problem):
        measured_room(str(file))


def test_polygons_in_scene_files(tmp_path: Path) -> None:
    """Polygons by material from a file: materials left out, unknown names, corners that are none."""
    text = (data_folder() / "ptb_studio" / "open.toml").read_text()
    polygons = (data_folder() / "ptb_studio" / "studio.toml").read_text()
    for old, new, where, problem in (
        ("curtain, closed", "curtain, shut", "scene", r"room.leave_out\[0\]: .*must be one of"),
        ('leave_out = ["curtain, closed"]', "", "scene", "room.materials: must name the group 'curtain, closed'"),
        ("1 = [1, 2, 5, 3, 4]", "1 = [1, 2, 5, 3, 4444]", "polygons", r"polygons.parquet.1\[4\]: .*must name a corner, but is 4444"),
        ("1 = [1, 2, 5, 3, 4]", "1 = [1, 2]", "polygons", r"room.polygons\[0\]: must be three corner numbers"),
        ("[corners]", "[corner]", "polygons", "room.path: .*corner: is no known key"),
    ):  # fmt: skip
        (tmp_path / "open.toml").write_text(text.replace(old, new) if where == "scene" else text)
        (tmp_path / "studio.toml").write_text(polygons.replace(old, new) if where == "polygons" else polygons)
        with pytest.raises(clsim.InputError, match=problem):
            clsim.load_scene(tmp_path / "open.toml")


def test_the_files_of_the_bras(tmp_path: Path) -> None:
    """A box in place of its room: files in subfolders, rounded centres of thirds, shares in per cent."""
    corners = [(x, y, z) for z in (0, 3) for y in (0, 4) for x in (0, 5)]
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    names = ["concrete", "windows", "ceiling", "plaster", "floor"]
    lines = ["AC3Db", *(f'MATERIAL "mat_scene09_{n}" rgb 1 1 1' for n in names), "OBJECT poly", "numvert 8"]
    lines += [f"{x} {z} {-y}" for x, y, z in corners] + ["numsurf 6"]
    for i, side in enumerate(sides):
        lines += ["SURF 0x0", f"mat {i % 5}", "refs 4", *(f"{k} 0 0" for k in side)]
    (tmp_path / "mesh").mkdir()
    (tmp_path / "mesh" / "scene9.ac").write_text("\n".join([*lines, "kids 0", ""]))
    for name in names:
        (tmp_path / f"material_{name}.csv").write_text("125, 1000\n0.1, 0.2\n0.05, 0.05\n")
    for name, values in (("T20", "1,2"), ("EDT", "1,2"), ("C80", "-1,2"), ("D50", "40,60")):
        (tmp_path / f"measured_{name}.csv").write_text(f"155,1000\n{values}\n\n")
    (tmp_path / "positions.csv").write_text("name,x_m,y_m,z_m\nLS1,1,1,1\nMP1,3,2,1\n")
    room = bras_room(tmp_path)
    assert room.states[0].scene.scene.room.volume == pytest.approx(60.0)
    np.testing.assert_allclose(room.frequencies, [157.49, 1000.0], rtol=1e-4)
    np.testing.assert_allclose(room.states[0].mean["d50"], [[0.4], [0.6]])
    (tmp_path / "measured_T20.csv").write_text("155,x\n1,2\n")
    with pytest.raises(clsim.InputError, match="--bras"):
        bras_room(tmp_path)
