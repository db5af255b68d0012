"""Directivities in scene files, and the command that draws them."""

import tomllib
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import scipy.io
from exhaustive import few
from scene_texts import receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.output.plots import DirectivityDiagram, directivity_levels
from clsim.scene_file import load_scene
from clsim.scene_file.scene import build_scene, completed_scene, scene_schema

SCENE = scene_text(
    source_at("robot", tone_of(40e3, 0.01), (1, 1, 1), directivity="%s"), receiver_at("left", (3.0, 1.0, 2.0))
)
TABLE = "angle,30e3,50e3\n0,0,0\n45,-2,-6\n90,-10,-20\n"
PHASES = "angle,30e3,50e3\n0,0,0\n45,-10,-20\n90,-20,-40\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "beam.csv").write_text(TABLE)
    (tmp_path / "phase.csv").write_text(PHASES)
    values = 10 ** (np.array([[0.0, 0.0], [-2.0, -6.0], [-10.0, -20.0]]) / 20)
    np.savez(tmp_path / "beam.npz", theta=[0, 45, 90], frequencies=[30e3, 50e3], values=values + 0j)
    return tmp_path


def scene(folder: Path, directivity: str) -> clsim.Scene:
    return build_scene(tomllib.loads(SCENE % directivity), folder).scene


def refused(folder: Path, directivity: str) -> clsim.InputError:
    with pytest.raises(clsim.InputError) as error:
        scene(folder, directivity)
    return error.value


def test_tables_by_path(folder: Path) -> None:
    csv = scene(folder, '{ kind = "table", path = "beam.csv", rear = "hold" }').sources[0].directivity
    npz = scene(folder, '{ kind = "table", path = "beam.npz", rear = "hold", angle = "theta" }').sources[0].directivity
    cosine = np.cos(np.radians([0.0, 45.0, 90.0]))
    np.testing.assert_allclose(20 * np.log10(csv.gain(cosine, 50e3, 343.0)), [0, -6, -20], atol=1e-9)
    np.testing.assert_allclose(npz.gain(cosine, 50e3, 343.0), csv.gain(cosine, 50e3, 343.0), atol=1e-9)
    assert csv.name == "beam"
    both = '{ kind = "table", path = "beam.csv", phases_path = "phase.csv", rear = "zero", outside = "hold" }'
    complex_ = scene(folder, both).sources[0].directivity
    assert np.degrees(np.angle(complex_.gain(0.0, 50e3, 343.0))) == pytest.approx(-40.0)
    assert complex_.band == (0.0, np.inf)


def test_a_struct_by_its_fields(folder: Path) -> None:
    field = {
        "a": np.radians([0.0, 45.0, 90.0]), "f": [30e3, 50e3], "X": np.array([[1.0, 0.8, 0.3], [1.0, 0.5, 0.1]]) + 0j,
    }  # fmt: skip
    scipy.io.savemat(folder / "beam.mat", {"L10R": field})
    told = 'variable = "L10R", angle = "a", frequency = "f", values = "X", angle_unit = "radian", rear = "hold"'
    beam = scene(folder, f'{{ kind = "table", path = "beam.mat", {told} }}').sources[0].directivity
    np.testing.assert_allclose(beam.gain(np.cos(np.radians([0.0, 45.0, 90.0])), 50e3, 343.0), [1.0, 0.5, 0.1])


def test_names(folder: Path) -> None:
    held = scene(folder, '{ kind = "named", name = "T4010A1", outside = "hold" }').sources[0].directivity
    assert held.gain(0.0, 30e3, 343.0) == pytest.approx(10 ** (-15 / 20))
    assert refused(folder, '{ kind = "named", name = "T4010" }').field == "sources[0].directivity.name"


def test_sofa_files(folder: Path) -> None:
    sofar = pytest.importorskip("sofar")
    sofa = sofar.Sofa("FreeFieldDirectivityTF")
    for name in ("EmitterDescriptions", "Description"):
        sofa.delete(name)
    sofa.ReceiverPosition = np.array([[0, 0, 1], [90, 0, 1], [180, 0, 1], [270, 0, 1], [0, 90, 1], [0, -90, 1.0]])
    sofa.N, sofa.Data_Real, sofa.Data_Imag = np.array([40e3]), np.arange(1.0, 7.0)[None, :, None], np.zeros((1, 6, 1))
    sofar.write_sofa(str(folder / "beam.sofa"), sofa)
    table = scene(folder, '{ kind = "sofa", path = "beam.sofa" }').sources[0].directivity
    np.testing.assert_allclose(table.gain_towards(np.eye(3), 40e3, 343.0), [1, 2, 5], atol=1e-9)
    assert main(["plot", "directivity", "--table", str(folder / "beam.sofa"), "-o", str(folder / "sofa.png")]) == 0
    assert refused(folder, '{ kind = "sofa", path = "beam.sofa", measurement = 1 }').field.endswith(".measurement")
    beam = DirectivityDiagram("", table, np.array([40e3]), 343.0)
    up, left = (directivity_levels(beam, np.array([np.pi / 2]), upright=upright)[0, 0] for upright in (True, False))
    assert up - left == pytest.approx(20 * np.log10(5 / 2))


@pytest.mark.parametrize(
    ("directivity", "field", "message"),
    [
        ('{ kind = "table" }', "path", "missing"),
        ('{ kind = "table", path = 3 }', "path", "text"),
        ('{ kind = "table", path = "beam.csv" }', "angles_degrees", 'rear="hold"'),
        ('{ kind = "table", path = "beam.csv", rear = "back" }', "rear", '"hold"'),
        ('{ kind = "table", path = "missing.csv" }', "path", "cannot be read"),
        ('{ kind = "table", path = "beam.wav" }', "path", "must end in"),
        ('{ kind = "table", path = "beam.csv", angle = "a", rear = "hold" }', "angle", "left out"),
        ('{ kind = "table", path = "beam.csv", angle_unit = "radian" }', "angle_unit", "left out"),
        ('{ kind = "table", path = "beam.npz", variable = "L10R" }', "variable", "left out"),
        ('{ kind = "table", path = "beam.npz", rear = "hold" }', "angle", '"theta"'),
        ('{ kind = "table", path = "beam.npz", phases_path = "phase.csv" }', "phases_path", "left out"),
        ('{ kind = "table", path = "beam.csv", phases_path = "no.csv", rear = "hold" }', "phases_path", "no.csv"),
        ('{ kind = "table", path = "beam.csv", rear = "hold", surprise = 1 }', "surprise", "no known key"),
        ('{ kind = "sofa", path = "missing.sofa" }', "path", "No such file"),
        ('{ kind = "sofa" }', "path", "missing"),
        ('{ kind = "tabel" }', "kind", 'did you mean "table"?'),
        ('{ path = "beam.csv" }', "kind", '"sofa"'),
    ],
)
def test_bad_fields_are_named(folder: Path, directivity: str, field: str, message: str) -> None:
    error = refused(folder, directivity)
    assert error.field == f"sources[0].directivity.{field}", str(error)
    assert message in error.problem


def test_completed_scenes_find_their_tables_again(folder: Path) -> None:
    text = SCENE % '{ kind = "table", path = "beam.csv", phases_path = "phase.csv", rear = "hold" }'
    (folder / "scene.toml").write_text(text)
    file = load_scene(folder / "scene.toml")
    (folder / "out").mkdir()
    (folder / "out" / "scene.toml").write_text(completed_scene(file, folder / "out"))
    again = load_scene(folder / "out" / "scene.toml").scene.sources[0].directivity
    np.testing.assert_array_equal(again.values, file.scene.sources[0].directivity.values)


def test_the_schema_names_the_kinds() -> None:
    text = str(scene_schema())
    for word in ("table", "sofa", "named", "phases_path", "relative_to_axis"):
        assert word in text


def test_levels_of_a_picture() -> None:
    angles = np.radians([0.0, 40.0, -40.0, 90.0])
    beam = DirectivityDiagram("", clsim.Directivity.named("MA40S4S"), np.array([40e3, 80e3]), 343.0)
    expected = 20 * np.log10(np.abs(beam.directivity.gain(np.cos(angles)[:, None], beam.frequencies, 343.0)))
    np.testing.assert_allclose(directivity_levels(beam, angles), np.maximum(expected, -40.0), atol=1e-9)
    silent = DirectivityDiagram("", clsim.FirstOrder(), np.array([1e3]), 343.0)
    assert directivity_levels(silent, np.array([np.pi]))[0, 0] == -40.0
    loud = DirectivityDiagram("", clsim.AxialDirectivity([0, 180], [1e3], [[4.0], [2.0]]), np.array([1e3]), 343.0)
    np.testing.assert_allclose(directivity_levels(loud, np.array([0.0, np.pi]))[:, 0], [0.0, -6.0206], atol=1e-4)


@pytest.mark.parametrize(
    "arguments",
    few(
        [
            ["directivity", "scene.toml"],
            ["directivity", "scene.toml", "--end", "left", "--frequencies", "20e3", "35e3"],
            ["directivity", "--name", "T4010A1"],
            ["directivity", "--name", "MA40S4S"],
            ["directivity", "--name", "T4010A1", "--hold", "--frequencies", "30e3"],
            ["directivity", "--table", "beam.csv", "--rear", "mirror"],
            ["air"],
            ["air", "--temperature", "5", "--pressure", "80e3", "--humidity", "0.2", "0.8"],
        ],
        (1, 4, 5, 7),
    ),
    ids=" ".join,
)
def test_pictures_are_drawn(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys, arguments: list[str]) -> None:
    monkeypatch.chdir(folder)
    Path("scene.toml").write_text(SCENE % '{ kind = "table", path = "beam.csv", rear = "hold" }')
    assert main(["plot", *arguments, "-o", "picture.png"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "picture.png\n"
    assert printed.err == ""
    picture = matplotlib.image.imread("picture.png")
    assert min(picture.shape[:2]) > 300
    assert picture.std() > 0.05  # something was drawn
    assert not list(folder.glob(".*"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["directivity"], "SCENE, --name and --table"),
        (["directivity", "scene.toml", "--name", "T4010A1"], "is given 2"),
        (["directivity", "--name", "T4010A1", "--end", "left"], "--end"),
        (["directivity", "scene.toml", "--end", "right"], 'must be one of "robot", "left", but is \'right\''),
        (["directivity", "scene.toml", "--frequencies", "60e3"], "--frequencies (for robot): must lie within"),
        (["directivity", "--name", "T4010A1", "--frequencies", "nan"], "--frequencies: must be finite"),
        (["directivity", "--name", "T4010A1", "--frequencies", "-1"], "--frequencies: must be above 0 Hz"),
        (["directivity", "--name", "T4010A1", "--frequencies", "30e3"], "within the table"),
        (["directivity", "--name", "nobody"], "--name: must be one of"),
        (["directivity", "--table", "beam.csv"], "--table.angles_degrees: must reach 180"),
        (["directivity", "--table", "nothing.npz"], "--table.path: cannot be read"),
        (["directivity", "--table", "nothing.sofa"], "--table.path: cannot be read"),
        (["directivity", "missing.toml"], "missing.toml: cannot be read"),
        (["air", "--humidity", "50"], "--humidity: must be"),
        (["air", "--temperature", "nan"], "--temperature: must be finite"),
        (["air", "--pressure", "101"], "--pressure: must be at least"),
        (["air", "-o", "picture.pdf"], "--output: must end in .png"),
        (["air", "-o", "nowhere/picture.png"], "nowhere"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_errors_are_one_line_and_status_2(folder, monkeypatch, error_of, arguments: list[str], message: str) -> None:
    monkeypatch.chdir(folder)
    Path("scene.toml").write_text(SCENE % '{ kind = "table", path = "beam.csv", rear = "hold" }')
    output = [] if "-o" in arguments else ["-o", "picture.png"]
    assert message in error_of("plot", *arguments, *output)
    assert not Path("picture.png").exists()
