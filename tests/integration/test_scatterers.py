"""What everything else makes of scatterers, what is refused of them, and a sonar's own sound."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from failing import stopped_and_resumed
from made_results import read_table
from made_sonar import RATE, SCENE, level_db, sonar, sonar_paths

import clsim
from clsim.cli import main
from clsim.output.result_files import write_table
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import viewed
from clsim.render.methods.static import pairs_at_rest
from clsim.scene_file.scene import SceneFile, completed_scene
from clsim.study.content import computed
from clsim.study.file import load_study
from clsim.tracks.pruning import pruned


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> SceneFile:
    """Return the scene file, read."""
    return sonar(tmp_path_factory.mktemp("sonar"))


@pytest.fixture(scope="module")
def paths(file: SceneFile) -> PathSet:
    """Return its paths."""
    return sonar_paths(file)


BAD = [
    (lambda t: clsim.Scatterer.sphere("a", 0.0, t), "radius: must be above 0 m, but is 0"),
    (lambda t: clsim.Scatterer.sphere("a", 1e-110, t), "radius: must be at least 1e-06 m, but is 1e-110"),
    (lambda t: clsim.Scatterer.ellipsoid("a", (0.1, 0.1, 1e-300), t), r"semi_axes\[2\]: must be at least 1e-06 m"),
    (lambda t: clsim.Scatterer.sphere("a", 0.1, t, model="exact"), "model"),
    (lambda t: clsim.Scatterer.ellipsoid("a", (0.1, -0.1, 0.1), t), r"semi_axes\[1\]: must be above 0 m, but is -0.1"),
    (lambda t: clsim.Scatterer.point("a", 61.0, t), "target_strength_db: must be at most 60 dB, but is 61"),
    (lambda t: clsim.Scatterer.capsule("a", 0.1, 0.0, t), "length: must be above 0 m, but is 0"),
    (lambda t: clsim.Scatterer.capsule("a", -0.1, 0.1, t), "radius: must be above 0 m, but is -0.1"),
    (lambda t: clsim.Scatterer.point(" ", 0.0, t), "name: must be a text"),
    (lambda t: clsim.Scatterer.point("a", 0.0, (1, 2, 3)), "trajectory: must be a Trajectory"),
]


@pytest.mark.parametrize(("make", "message"), BAD)
def test_what_is_no_scatterer(make: Any, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        make(clsim.Trajectory.fixed((3.0, 2.0, 1.0)))


FIXED, LINE = clsim.Trajectory.fixed, clsim.Trajectory.line
REFUSED = [
    ([clsim.Scatterer.sphere("b", 1.0, FIXED((1.5, 2.0, 1.0)))], r"scatterers\[0\].*'sonar' is in 'b' or nearer.* at 0 s"),
    ([clsim.Scatterer.ellipsoid("b", (0.5, 0.1, 0.1), LINE((3, 2.05, 1), (1.2, 2.05, 1), 0.2))], "'sonar' is in 'b'"),
    ([clsim.Scatterer.capsule("b", 0.1, 0.5, LINE((3, 2, 1.2), (1, 2, 1.3), 0.2))], r"'sonar' is in 'b' or nearer.* at 0\.\d+ s"),
    ([clsim.Scatterer.point("b", 0.0, LINE((3, 2, 1), (7, 2, 1), 0.2))], r"scatterers\[0\].trajectory: must stay inside"),
    ([clsim.Scatterer.point("b", 0.0, LINE((1.5, 4, 1), (2.5, 4, 1), 0.01))], "must last as long as all signals"),
    ([clsim.Scatterer.point("b", 0.0, clsim.Trajectory.circle((3, 2.5, 1.5), 1.0, 0.015, 0.2))], "speed of sound"),
    ([clsim.Scatterer.capsule("b", 0.1, 0.9, clsim.Trajectory.waypoints(
        [0.0, 0.1, 0.102, 0.2], [(3, 2, 1.0)] * 4, [(0, 0, 0, 1), (0, 0, 0, 1), (0, 0.9, 0, 0.4358898943540674), (0, 1, 0, 0)],
    ))], r"scatterers\[0\].trajectory: must keep the surface below .*'b' may move at .* m/s, about 0.1(0[0-2])? s"),
    ([clsim.Scatterer.point("b", 0.0, FIXED((3, 2, 1)))] * 2, r"scatterers\[1\].name: must be unique"),
    ("b", "scatterers: must be a list"), ([3], r"scatterers\[0\]: must be a Scatterer"),
]  # fmt: skip


@pytest.mark.parametrize(("scatterers", "message"), REFUSED)
def test_what_cannot_be_in_a_scene(paths: PathSet, scatterers: Any, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.Scene(
            paths.scene.room, clsim.Air(), paths.scene.sources, paths.scene.receivers, scatterers=scatterers
        )  # fmt: skip
    # Beside the flat side of an ellipsoid there is room within its longest semi-axis.
    flat = clsim.Scatterer.ellipsoid("b", (0.02, 0.5, 0.5), FIXED((1.1, 2.0, 1.0)))
    clsim.Scene(paths.scene.room, clsim.Air(), paths.scene.sources, paths.scene.receivers, scatterers=[flat])


@pytest.mark.parametrize(
    "air",
    [
        clsim.Air(temperature_celsius=(20.0, 24.0), heights=(0.0, 3.0)),
        clsim.Air(fluctuation=clsim.Fluctuation(2e-6, 0.5, 0.3)),
    ],
)
def test_air_that_no_leg_knows_is_refused(paths: PathSet, air: clsim.Air) -> None:
    scene = clsim.Scene(
        paths.scene.room, air, paths.scene.sources, paths.scene.receivers, scatterers=paths.scene.scatterers
    )  # fmt: skip
    with pytest.raises(clsim.InputError, match="scatterers: must be left out where the air depends on the height"):
        clsim.find_paths(scene, 0)
    with pytest.raises(clsim.InputError, match="scatterers: must be left out where the air depends on the height"):
        clsim.scatterer_truth(scene, [0.1])


PEOPLE = """
[[scatterers]]
kind = "person"
name = "Ada"
height = 1.7
trajectory = { kind = "line", start = [4.0, 2.0, 0.0], end = [3.8, 2.0, 0.0], duration = 0.2 }
[[scatterers]]
kind = "captured-person"
name = "Bob"
path = "arm.csv"
segments = [{ start = "elbow", end = "wrist", radius = 0.04 }]
shape = "capsule"
translate = [1.0, 0.0, 0.0]
[[scatterers]]
kind = "hand"
name = "fist"
trajectory = { kind = "fixed", position = [2.0, 2.0, 1.5] }
opening = [[0.0, 1.0], [0.2, 0.0]]
"""


def test_people_in_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They are those from Python; the completed scene is the same one from elsewhere; what is wrong has its field."""
    rows = "\n".join(f"{t / 10},2,3,1,2.3,3,{1 + t / 30}" for t in range(4))
    (tmp_path / "arm.csv").write_text("t,elbow x,elbow y,elbow z,wrist x,wrist y,wrist z\n" + rows, "utf-8")
    text = SCENE.replace("[paths]", PEOPLE + "[paths]")
    (tmp_path / "scene.toml").write_text(text, "utf-8")
    file = clsim.load_scene(tmp_path / "scene.toml")
    people = [s for s in file.scene.scatterers if s.name not in ("hand", "ball", "bat")]
    way = clsim.Trajectory.line((4.0, 2.0, 0.0), (3.8, 2.0, 0.0), 0.2)
    arm = clsim.captured_person(
        "Bob", tmp_path / "arm.csv", segments=[("elbow", "wrist", 0.04)], shape="capsule", translate=(1.0, 0.0, 0.0)
    )
    fist = clsim.hand("fist", clsim.Trajectory.fixed((2.0, 2.0, 1.5)), opening=[(0.0, 1.0), (0.2, 0.0)])
    wanted = [*clsim.walking_person("Ada", 1.7, way), *arm, *fist]
    assert [s.name for s in people] == [s.name for s in wanted]
    for one, other in zip(people, wanted, strict=True):
        np.testing.assert_array_equal(one.trajectory.position(0.13), other.trajectory.position(0.13))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "again.toml").write_text(completed_scene(file, tmp_path / "other"), "utf-8")
    assert 'path = "../arm.csv"' in (tmp_path / "other" / "again.toml").read_text("utf-8")
    again = clsim.load_scene(tmp_path / "other" / "again.toml")
    assert [s.name for s in again.scene.scatterers] == [s.name for s in file.scene.scatterers]
    for old, new, message in (
        ("end = [3.8, 2.0, 0.0]", "end = [-99.0, 2.0, 0.0]", "scatterers[3].trajectory: must walk at 0.0901 to 2.7 m/s, but is at 515 m/s at 0 s"),
        ('end = "wrist"', 'end = "toe"', "scatterers[4].segments[0]: must name joints of the file (elbow, wrist), but names 'toe'"),
        ("opening = [[0.0, 1.0]", "opening = [[0.0, 2.0]", "scatterers[5].opening[0][1]: must be at most 1, but is 2"),
        ('path = "arm.csv"', 'path = "leg.csv"', "scatterers[4].path: cannot read"),
        ("position = [2.0, 2.0, 1.5]", "position = [1.0, 2.0, 1.05]", "'sonar' is in 'fist palm' or nearer to it at (1, 2, 1) m at 0 s"),
    ):  # fmt: skip
        (tmp_path / "scene.toml").write_text(text.replace(old, new), "utf-8")
        assert main(["check", str(tmp_path / "scene.toml")]) == 2
        assert message in capsys.readouterr().err


def test_files_name_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for old, new, message in (
        ("radius = 0.03", "radius = -0.03", "scatterers[1].radius"), ('kind = "sphere"', 'kind = "cube"', "scatterers[1].kind"),
        ("correlation_time = 0.05", "correlation_time = 0.0", "scatterers[2].fluctuation.correlation_time"),
        ("scattering_order = 1", "scattering_order = 4", "paths.scattering_order"),
        ("scattering_order = 1", 'direct = [{ source = "sonar", receiver = "nose" }]', "paths.direct: must name a receiver"),
        ("[paths]", "[air]\ntemperature_celsius = [20.0, 24.0]\n[paths]", "scene.toml: scatterers: must be left out where the air depends on"),
        ("scattering_order = 1", "direct = 0", "paths.direct: must be true, false or a level below 0 dB"),
        ("scattering_order = 1", 'direct = [{ source = "sonar" }]', "paths.direct[0].receiver: must be given"),
    ):  # fmt: skip
        (tmp_path / "scene.toml").write_text(SCENE.replace(old, new), "utf-8")
        assert main(["check", str(tmp_path / "scene.toml")]) == 2
        assert message in capsys.readouterr().err


def test_a_sonar_without_its_cross_talk(file: SceneFile, paths: PathSet) -> None:
    """Echoes alone, or with the room; nothing else changes."""
    echoes = clsim.find_paths(file.scene, 0, direct=False)
    assert echoes.order.tolist() == [1, 1, 1]
    assert [echoes.object_names[i] for i in echoes.objects[:, 0]] == ["hand", "ball", "bat"]
    wanted = clsim.render(
        PathSet(file.scene, clsim.find_paths(file.scene, 0).families[1:]), RATE, duration=0.06
    ).pressure
    np.testing.assert_array_equal(clsim.render(echoes, RATE, duration=0.06).pressure, wanted)
    assert np.any(wanted)
    both = clsim.find_paths(file.scene, 1, scattering_order=1, direct=False)
    assert len(both) == len(paths) - 1
    assert both.order.min() == 1
    bare = clsim.Scene(file.scene.room, clsim.Air(), file.scene.sources, file.scene.receivers)
    nothing = clsim.find_paths(bare, 0, direct=False)
    assert len(nothing) == 0
    assert not np.any(clsim.render(nothing, RATE, duration=0.01).pressure)
    with pytest.raises(clsim.InputError, match="direct: must be True, False or a level below 0 dB, but is 0"):
        clsim.find_paths(file.scene, 0, direct=0)


def wide_scene(scene: clsim.Scene, scatterers: Any = ()) -> clsim.Scene:
    """Return a scene with two ears more."""
    far = [clsim.Receiver(name, clsim.Trajectory.fixed((1.0, y, 1.2))) for name, y in (("left", 1.5), ("right", 2.5))]
    return clsim.Scene(scene.room, scene.air, scene.sources, [*scene.receivers, *far], scatterers=scatterers)


def test_cross_talk_by_pair(file: SceneFile, device: None) -> None:
    """A baffle's 20 dB for one ear, nothing for another; all else stays."""
    wide = wide_scene(file.scene)
    free = clsim.find_paths(wide, 1)
    wanted = {("sonar", "ear"): -20.0, ("sonar", "right"): False, ("sonar", "left"): True}
    found = clsim.find_paths(wide, 1, direct=wanted)
    assert len(found) == len(free) - 1
    assert found.digest() != clsim.find_paths(wide, 1, direct=wanted | {("sonar", "ear"): -20.5}).digest()
    parts = [
        clsim.PathSet(wide, (free.families[0].part(np.flatnonzero(rows)),))
        for rows in (free.order == 0, free.order > 0)
    ]
    for engine in ("opencl", "reference"):
        direct, echoes = (clsim.render(part, RATE, duration=0.04, engine=engine).pressure for part in parts)
        heard = clsim.render(found, RATE, duration=0.04, engine=engine).pressure
        levels = np.array([0.1, 1.0, 0.0])[:, None]
        assert level_db(heard - echoes - levels * direct, heard) < -110.0
    assert clsim.direct_path(found, [0.03]).line_of_sight[0, :, 0].tolist() == [True, True, False]


def test_the_truth_about_every_scatterer_as_seen_from_every_pair(file: SceneFile) -> None:
    seen = wide_scene(file.scene, file.scene.scatterers)
    truth = clsim.scatterer_truth(seen, [0.03])
    table, names = clsim.find_paths(seen, 0).table([0.03]), [s.name for s in seen.scatterers]
    for i in np.flatnonzero(table.order):
        here = names.index(table.name_objects(i)), 0, table.receiver[i], 0
        assert truth.delay[here] == pytest.approx(table.delay[i, 0], rel=1e-14)
        np.testing.assert_allclose(truth.bearing[here], table.arrival[i, 0], atol=1e-12)
    assert truth.delay.shape == (3, 1, 3, 1)


def test_cross_talk_in_files(tmp_path: Path) -> None:
    text = SCENE.replace("scattering_order = 1", 'direct = [{ source = "sonar", receiver = "ear", level_db = -20.0 }]')
    (tmp_path / "scene.toml").write_text(text, "utf-8")
    read = clsim.load_scene(tmp_path / "scene.toml")
    assert read.paths["direct"] == {("sonar", "ear"): -20.0}
    (tmp_path / "again.toml").write_text(completed_scene(read, tmp_path), "utf-8")
    assert clsim.load_scene(tmp_path / "again.toml").paths == read.paths
    (tmp_path / "scene.toml").write_text(text.replace(", level_db = -20.0", ""), "utf-8")
    assert clsim.load_scene(tmp_path / "scene.toml").paths["direct"] == {("sonar", "ear"): False}


@pytest.mark.parametrize(
    ("direct", "message"),
    [
        ({("sonar", "nose"): False}, r"direct: must name a receiver of the scene \('ear'\), but names 'nose'"),
        ({("bat", "ear"): False}, r"direct: must name a source of the scene \('sonar'\), but names 'bat'"),
        ({"sonar": False}, "direct: must have pairs"), ({("sonar", "ear"): 3.0}, r"direct\[sonar, ear\]: must be True, False"),
        (np.inf, "direct: must be True, False"), (-np.inf, "direct: must be finite"),
    ],
)  # fmt: skip
def test_what_cannot_be_cross_talk(file: SceneFile, direct: Any, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.find_paths(file.scene, 0, direct=direct)


STUDY = """
format = 1
scene = "scene.toml"
keep = ["ground_truth"]
[[vary]]
field = "scatterers[1].radius"
values = [0.03, 0.06]
"""


def test_tables_vertices_and_pages_know_them(paths: PathSet, tmp_path: Path) -> None:
    table = paths.table(np.array([0.05, 0.1]))
    echoes = slice(7, 7 + 3 * 7 * 7)  # behind them are shadows of the hand
    assert np.flatnonzero((paths.interactions == 5).any(axis=1)).tolist() == list(range(echoes.stop, len(paths)))
    assert echoes.stop < len(paths)
    assert paths.object_names[-3:] == ("hand", "ball", "bat")
    row = [table.name_objects(i) for i in range(len(paths))].index("z_min, hand, y_max")
    assert paths.interactions[row].tolist() == [0, 2, 0]
    assert paths.order[row] == 3
    assert not table.direct[echoes].any()
    corners = paths.vertices(0.1)[row]
    assert np.linalg.norm(np.diff(corners, axis=0), axis=1).sum() == pytest.approx(
        table.delay[row, 1] * paths.scene.air.speed_of_sound, rel=1e-3
    )
    assert corners[1, 2] == pytest.approx(0.0, abs=1e-12)
    assert corners[3, 1] == pytest.approx(5.0, abs=1e-12)
    assert np.linalg.norm(corners[2] - [2.95, 2.1, 1.05]) < 0.1
    write_table(table, tmp_path / "paths.npz")
    assert read_table(tmp_path / "paths.npz").name_objects(row) == "z_min, hand, y_max"
    view = viewed(paths, duration=0.06, frames=3)
    hand = next(end for end in view["ends"] if end.name == "hand")
    np.testing.assert_allclose(hand.positions[-1], [2.97, 2.06, 1.03], atol=1e-9)
    assert any("hand" in label for label in view["frames"][0].labels)


def test_the_truth_about_scatterers(paths: PathSet) -> None:
    times = np.linspace(0.02, 0.1, 5)
    truth, table = clsim.scatterer_truth(paths.scene, times), paths.table(times)
    assert truth.scatterer_names == ("hand", "ball", "bat")
    for which, name in enumerate(truth.scatterer_names):
        row = [table.name_objects(i) for i in range(len(paths))].index(name)
        np.testing.assert_allclose(truth.delay[which, 0, 0], table.delay[row], rtol=1e-14)
        np.testing.assert_allclose(truth.bearing[which, 0, 0], table.arrival[row], atol=1e-12)
        place = [1.0, 2.2, 1.0] + truth.range[which, 0, 0, :, None] * truth.bearing[which, 0, 0]
        np.testing.assert_allclose(place[0], paths.vertices(float(times[0]))[row, 1], atol=1e-12)
    ball = truth.range[1, 0, 0]
    np.testing.assert_allclose(ball, np.hypot(2.0, 0.8) - 0.03, atol=2e-4)  # bistatic, 0.2 m
    np.testing.assert_array_equal(truth.radial_speed[1], 0.0)
    hand = 0.5 * paths.scene.air.speed_of_sound * np.gradient(truth.delay[0, 0, 0], times)
    np.testing.assert_allclose(truth.radial_speed[0, 0, 0, 1:-1], hand[1:-1], atol=1e-3)
    with pytest.raises(clsim.InputError, match="must hold scatterers"):
        clsim.scatterer_truth(
            clsim.Scene(paths.scene.room, clsim.Air(), paths.scene.sources, paths.scene.receivers), times
        )


@pytest.fixture(scope="module")
def direct(file: Any) -> PathSet:
    """Return the paths by no wall."""
    return clsim.find_paths(file.scene, 0)


def test_engines_and_sums(direct: PathSet, device: None) -> None:
    paths = direct
    exact = clsim.render(paths, RATE, duration=0.06, engine="reference").pressure[0]
    heard = clsim.render(paths, RATE, duration=0.06).pressure[0]
    assert level_db(heard - exact, exact) < -85.0
    parts = [clsim.render(PathSet(paths.scene, (f,)), RATE, duration=0.06).pressure[0] for f in paths.families]
    assert level_db(parts[0] + parts[1] - heard, heard) < -85.0
    assert level_db(parts[1], heard) > -50.0


def test_pruning_knows_bounds(paths: PathSet) -> None:
    tracks, note = pruned(clsim.track(paths), -60.0, 0.06)
    left = sum(len(pair) for pair in tracks.pairs)
    assert 7 < left < len(paths)
    assert "are left out" in note


def test_baseband_holds_the_same(direct: PathSet, device: None) -> None:
    alone = PathSet(direct.scene, direct.families[1:])
    wide = clsim.render(alone, RATE, duration=0.06).pressure[0]
    narrow = clsim.render(alone, RATE, duration=0.06, baseband=clsim.Baseband(25e3, 4e3, 8e3))
    step = round(RATE / 8e3)
    times = np.arange(len(wide)) / RATE
    assert len(narrow.pressure[0]) == len(wide) // step
    middle = slice(len(narrow.pressure[0]) // 3, 2 * len(narrow.pressure[0]) // 3)
    carrier = np.exp(2j * np.pi * 25e3 * times[::step][middle])
    got = np.real(narrow.pressure[0][middle] * carrier)
    assert level_db(got - wide[::step][middle], wide[::step][middle]) < -60.0


def test_what_rests_is_convolved(direct: PathSet) -> None:
    scene = direct.scene
    for things, count in ((scene.scatterers[1:2], 2), (scene.scatterers, 1)):
        some = clsim.Scene(scene.room, scene.air, scene.sources, scene.receivers, scatterers=things)
        options = clsim.RenderOptions(RATE)
        assert len(pairs_at_rest(clsim.track(clsim.find_paths(some, 1, scattering_order=1)), options)) == count
    one = PathSet(scene, direct.families[1:])
    found = clsim.impulse_responses(one, RATE, at=0.1, lead="keep", band=(20e3, 30e3), tail="off").samples[0, 0]
    gains = one.table(np.array([0.1]), motion="quasi-static").gain
    # The band of 10 kHz has a taper of 5 kHz on either side, of which half counts.
    assert np.abs(found).max() == pytest.approx(np.abs(gains).max() * 2.0 * 15e3 / RATE, rel=0.02)
    with pytest.raises(clsim.InputError, match=r"scatterers\[0\].trajectory, up to 0.2 s"):
        clsim.impulse_responses(direct, RATE, at=0.3)


def test_without_scatterers_nothing_is_looked_for(paths: PathSet) -> None:
    scene = clsim.Scene(paths.scene.room, paths.scene.air, paths.scene.sources, paths.scene.receivers)
    found = clsim.find_paths(scene, 1, scattering_order=1)
    assert len(found.families) == 1
    assert found.digest() == clsim.find_paths(scene, 1).digest()
    assert paths.families[0].digest() == found.families[0].digest()


def test_a_run_that_was_stopped_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: None) -> None:
    """Bit for bit, of a sonar's echoes alone; and the completed scene is the same scene."""
    scene = tmp_path / "scene.toml"
    text = SCENE.replace("duration = 0.2 }", "duration = 0.6 }").replace("duration = 0.06", "duration = 0.5")
    text = text.replace("duration = 0.02,", "duration = 0.5,").replace("scattering_order = 1", "direct = false")
    scene.write_text(text.replace("max_order = 1", "max_order = 0\nscattering_order = 0"), "utf-8")
    whole = (stopped_and_resumed(monkeypatch, scene, tmp_path) / "ear.wav").read_bytes()
    assert np.any(np.frombuffer(whole[100_000:140_000], dtype=np.uint8))
    with np.load(tmp_path / "a" / "ground_truth.npz") as found:
        truth = clsim.scatterer_truth(clsim.load_scene(scene).scene, found["times"])
        assert found["scatterer_names"].tolist() == ["hand", "ball", "bat"]
        np.testing.assert_array_equal(found["scatterer_range"], truth.range)
        np.testing.assert_array_equal(found["scatterer_bearing"], truth.bearing)
        assert not found["line_of_sight"].any()  # left out, it is not heard
    complete = (tmp_path / "a" / "scene.completed.toml").read_text("utf-8")
    assert "scattering_order = 0" in complete
    assert "direct = false" in complete
    assert complete.count("[[scatterers]]") == 3
    again = tmp_path / "again.toml"
    again.write_text(complete, "utf-8")
    assert main(["run", str(again), "-o", str(tmp_path / "b"), "--no-plots", "--resume"]) == 0


def test_studies_keep_the_truth_about_scatterers(file: Any, tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    text = SCENE.replace("scattering_order = 1", "scattering_order = 0").replace("max_order = 1", "max_order = 0")
    (tmp_path / "scene.toml").write_text(text, "utf-8")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    study = load_study(tmp_path / "study.toml")
    content = computed(study, study.members[0], None, tmp_path / "member").content.variables
    truth = clsim.scatterer_truth(file.scene, content["times"].values)
    assert content["scatterer"].values.tolist() == ["hand", "ball", "bat"]
    assert content["scatterer_radial_speed"].dims == ("scatterer", "source", "receiver", "times")
    assert content["scatterer_bearing"].values.shape == truth.bearing.shape
    np.testing.assert_array_equal(content["scatterer_range"].values, truth.range)
    assert content["scatterer_delay"].attrs["units"] == "s"
    larger = (
        computed(study, study.members[1], None, tmp_path / "other").content.variables["scatterer_range"].values
        - truth.range
    )
    np.testing.assert_array_equal(larger[[0, 2]], 0.0)
    np.testing.assert_allclose(larger[1], -0.03, atol=1e-3)  # of the ball: its surface is nearer by 3 cm


def test_walls_hide_scatterers_for_as_long_as_they_are_in_the_way() -> None:
    """A screen before a point that walks by: heard from when its sound gets past the edge, to a sample."""
    walls = clsim.Material.from_reflection(0.5)
    screen = clsim.MeshRoom([(2, 0, 0), (2, 2.5, 0), (2, 2.5, 3), (2, 0, 3)], [(0, 1, 2), (0, 2, 3)], walls)
    room = clsim.MeshRoom.joined([clsim.Shoebox((6, 5, 3), walls), screen])
    way = clsim.Trajectory.line((4.0, 1.0, 1.0), (4.0, 4.0, 1.0), 1.0)
    at = [clsim.Trajectory.fixed((1.0, y, 1.0)) for y in (2.0, 2.2)]
    tone = clsim.Signal.tone(40e3, 1.0, RATE)
    scene = clsim.Scene(
        room, clsim.Air(speed_of_sound=343.0), [clsim.Source("s", tone, at[0])], [clsim.Receiver("r", at[1])],
        scatterers=[clsim.Scatterer.point("p", 0.0, way)],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 0, engine="reference")
    row = np.flatnonzero(paths.interactions[:, 0] == 2)
    assert len(row) == 1
    # Seen from the source past the edge at y = 2.5 m when it is at 3.5 m, which is after it is seen from the receiver.
    event = (3.5 - 1.0) / 3.0
    assert paths.start[row[0]] == pytest.approx(event + np.linalg.norm([3.0, 1.3, 0.0]) / 343.0, abs=2.0 / RATE)
    assert paths.end[row[0]] == np.inf


def test_in_wind_there_and_back_are_not_alike(paths: PathSet) -> None:
    """Along the wind from a source to a point and back to it, ``d / (c + w) + d / (c - w)``."""
    at = [clsim.Trajectory.fixed(p) for p in ((1.0, 2.0, 1.0), (1.0, 2.011, 1.0), (4.0, 2.0, 1.0))]
    ends = [clsim.Source("s", paths.scene.sources[0].signal, at[0])], [clsim.Receiver("r", at[1])]
    air = clsim.Air(speed_of_sound=340.0, wind=(10.0, 0.0, 0.0))
    scene = clsim.Scene(paths.scene.room, air, *ends, scatterers=[clsim.Scatterer.point("p", 0.0, at[2])])
    delay = clsim.scatterer_truth(scene, [0.1]).delay.ravel()[0]
    assert delay == pytest.approx(3.0 / 350.0 + 3.0 / 330.0, rel=2e-5)


def test_what_leaves_the_line_between_the_ends_in_wind_is_found_all_along(paths: PathSet) -> None:
    """Where its shadow ends the specular point jumps, and by that wind shows the ends elsewhere: behind it again, or not."""
    ways = [((0.5, 0.6, 0.9), (0.7, 0.9, 1.1)), ((3.6, 3.0, 1.4), (3.4, 2.9, 1.5)), ((2.0, 1.8, 1.2), (2.0, 2.2, 1.2))]
    source, receiver, across = (clsim.Trajectory.line(*way, 0.1) for way in ways)
    scene = clsim.Scene(
        clsim.Shoebox((4.2, 4.0, 2.4), clsim.Material.from_reflection(0.5)), clsim.Air(wind=(4.0, -3.0, 1.0)),
        [clsim.Source("s", paths.scene.sources[0].signal, source)], [clsim.Receiver("r", receiver)],
        scatterers=[clsim.Scatterer.ellipsoid("e", (0.09, 0.3, 0.15), across, shadow=False)],
    )  # fmt: skip
    scattered = clsim.find_paths(scene, 0, scattering_order=0).families[-1]
    times = np.arange(0.082, 0.088, 5e-6)
    found = scattered.arrivals(np.array([0]), times)
    assert found.more["strength"][0, 0] == 0.0
    assert found.more["strength"][0, -1] > 0.0
    assert np.all(np.diff(found.more["strength"][0] > 0.0, prepend=0)[1:] >= 0)
    # A jump along a surface that sound grazes is hardly one of the delay: within 0.1 µs of what changes evenly.
    assert np.abs(found.delay[0] - np.polyval(np.polyfit(times, found.delay[0], 2), times)).max() < 1e-7
