"""What everything else makes of bodies and of their edges: files, tables, pages, truth, engines, resumed runs, studies."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from failing import stopped_and_resumed
from made_pages import data_of
from scene_texts import along, chirp_of, receiver_at, scene_text, shoebox_of, source_at, thing_at, tone_of

import clsim
from clsim.cli import main
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import view_scene, viewed
from clsim.render.methods.static import pairs_at_rest
from clsim.study.content import computed
from clsim.study.file import load_study

EDGES_OF_BODIES_SCENE = scene_text(
    source_at("beacon", tone_of(24e3, 0.11, 96e3, fade=0.002), (1.0, 1.4, 1.0)),
    receiver_at("ear", (3.0, 1.5, 1.2)),
    thing_at(
        "bodies",
        "door",
        {"kind": "swing", "axis_point": (2.0, 0.6, 0.0), "axis": (0, 0, 1), "angles": (0, -0.1), "times": (0, 0.2)},
        kind="box",
        size=(0.0, 0.9, 2.0),
        centre=(0.0, 0.5, 1.1),
        material={"reflection": 0.9},
    ),
    room=shoebox_of(reflection=0.5),
    max_order=0,
    paths={"diffraction": 1},
    render={"duration": 0.12, "chunk": 18432},
)


def test_a_door_is_run_and_gone_on_with(tmp_path, monkeypatch, capsys, device) -> None:
    """The line of sight is hidden all the time: all that is heard comes over edges of the door."""
    path = tmp_path / "scene.toml"
    path.write_text(EDGES_OF_BODIES_SCENE, "utf-8")
    without = tmp_path / "without.toml"
    without.write_text(EDGES_OF_BODIES_SCENE.replace("diffraction = 1", "diffraction = 0"), "utf-8")
    out = stopped_and_resumed(monkeypatch, path, tmp_path, other=without)
    assert "scene.paths.diffraction was 1 and is 0" in capsys.readouterr().err
    assert "diffraction = 1" in (out / "scene.completed.toml").read_text("utf-8")
    with np.load(out / "ground_truth.npz") as found:
        assert not found["line_of_sight"].any()
        assert found["body_names"].tolist() == ["door"]
        assert found["body_visible"].all(), "its nearest point, from the side of the source"
    recorded = clsim.load_recording(out)
    assert np.abs(recorded.pressure).max() > 0.01 / 2.0, "over the door's near edge"


def test_a_door_in_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str], device: None) -> None:
    """Every path by which something is heard is over an edge of the door, and is told so."""
    path = tmp_path / "scene.toml"
    path.write_text(EDGES_OF_BODIES_SCENE, "utf-8")
    file = clsim.load_scene(path)
    paths = clsim.find_paths(file.scene, **file.paths)
    assert len(clsim.find_paths(file.scene, 0)) == 0
    table = paths.table(np.array([0.04]))
    names = [table.name_objects(i) for i in np.flatnonzero(table.audible[:, 0])]
    assert names
    assert all("edge door" in name for name in names)
    assert main(["paths", str(path), "--at", "0.04"]) == 0
    assert "edge door" in capsys.readouterr().out
    exact = clsim.find_paths(file.scene, **{**file.paths, "diffraction_model": "btm"})
    assert exact.digest() != paths.digest()


RATE = 96e3
SCENE = scene_text(
    source_at(
        "sonar", chirp_of(24e3, 26e3, 0.03, 96e3, window="hann"), (0.21, 0.0, 0.3), mounted_on="robot",
        aim=(1.0, 0.0, 0.0),
    ),
    receiver_at("ear", (3.5, 2.6, 1.2)),
    receiver_at("own", (0.21, 0.05, 0.3), mounted_on="robot"),
    thing_at(
        "bodies",
        "door",
        {"kind": "swing", "axis_point": (2.5, 0.5, 0.0), "axis": (0, 0, 1), "angles": (0, 0.3), "times": (0, 0.3)},
        kind="box",
        size=(0.0, 0.9, 2.0),
        centre=(0.0, 0.5, 1.1),
        material={"reflection": 0.9},
    ),
    thing_at(
        "bodies",
        "robot",
        along((0.5, 1.0, 0.0), (0.8, 1.0, 0.0), 0.3),
        kind="faces",
        vertices=[(0.2, -0.2, 0.1), (0.2, 0.2, 0.1), (0.2, 0.2, 0.5), (0.2, -0.2, 0.5)],
        triangles=[(0, 1, 2), (0, 2, 3)],
        material={"reflection": 0.9},
    ),
    room=shoebox_of(reflection=0.8),
    rate=96e3,
    render={"duration": 0.06},
)  # fmt: skip
STUDY = 'format = 1\nscene = "scene.toml"\nkeep = ["ground_truth"]\n[[vary]]\nfield = "paths.max_order"\nvalues = [0]\n'


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the scene file, read."""
    path = tmp_path_factory.mktemp("bodies") / "scene.toml"
    path.write_text(SCENE, "utf-8")
    return clsim.load_scene(path)


@pytest.fixture(scope="module")
def paths(file: Any) -> PathSet:
    """Return its paths."""
    return clsim.find_paths(file.scene, **file.paths)


def test_a_body_carries_ends(file: Any) -> None:
    scene = file.scene
    assert scene.sources[0].trajectory.position(0.1) == pytest.approx([0.81, 1.0, 0.3], abs=1e-12)
    assert scene.receivers[1].trajectory.velocity(0.1) == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    turn = clsim.Trajectory.swing((1, 1, 0), (0, 0, 1), [0.0, np.pi / 2], [0.0, 1.0])
    carried = clsim.Trajectory.carried(turn, clsim.Trajectory.line((0, 0, 0), (1, 0, 0), 1.0), (1, 0, 0))
    assert carried.position(1.0) == pytest.approx([1.0, 2.0, 0.0], abs=1e-9)
    assert carried.velocity(1.0) == pytest.approx([-np.pi / 2, 1.0, 0.0], abs=1e-9)
    times = np.array([0.2, 0.7])
    slope = (carried.position(times + 1e-6) - carried.position(times - 1e-6)) / 2e-6
    assert carried.velocity(times) == pytest.approx(slope, abs=1e-8)
    assert np.linalg.norm(slope, axis=1).max() < carried.speed_over(np.zeros(1), np.ones(1))[0]
    assert carried.orientation(1.0) == pytest.approx(turn.orientation(1.0), abs=1e-12)
    assert (carried.start, carried.end) == (0.0, 1.0)


def test_tables_truth_vertices_and_pages_know_them(paths: PathSet, tmp_path: Path) -> None:
    assert paths.object_names[-2:] == ("door", "robot")
    table = paths.table(np.array([0.05]))
    ways = [table.name_objects(i) for i in range(len(paths))]
    row = next(i for i, way in enumerate(ways) if way == "door" and table.receiver[i] == 1)
    assert paths.interactions[row].tolist() == [3]
    assert table.doppler_shift[row, 0] > 100.0  # driven towards the door at 1 m/s
    corners = paths.vertices(0.05)[row]
    length = np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()
    assert length == pytest.approx(table.delay[row, 0] * paths.scene.air.speed_of_sound, rel=1e-12)
    assert abs(corners[1, 0] - 2.5) < 0.05
    truth = clsim.direct_path(paths, np.array([0.05]))
    assert truth.line_of_sight[0, :, 0].tolist() == [True, True]
    view = viewed(paths, duration=0.06, frames=3)
    assert [body.name for body in view["bodies"]] == ["door", "robot"]
    assert view["bodies"][0].corners(2) == pytest.approx(
        paths.scene.bodies[0].placed(paths.scene.bodies[0].mesh.vertices, np.array(0.06))
    )
    assert any("door" in label for label in view["frames"][0].labels)
    view_scene(paths, tmp_path / "view.html", duration=0.06, frames=3)
    data = data_of(tmp_path / "view.html")
    assert [drawn["trace"]["name"] for drawn in data["bodies"]] == ["door", "robot"]
    for drawn, body in zip(data["bodies"], paths.scene.bodies, strict=True):  # moved as the page's script does
        for time, pose in zip(data["times"], drawn["poses"], strict=True):
            at, axes = np.array(pose[:3]), np.reshape(pose[3:], (3, 3))
            placed = body.placed(body.mesh.vertices, np.array(time))
            assert np.array(drawn["corners"]) @ axes + at == pytest.approx(placed, abs=1e-3)


def test_what_is_behind_a_body_is_hidden_when_it_passes() -> None:
    """A sheet that slides into the line of sight of two ends: silent from when sound meets its edge, to a sample."""
    wall = clsim.Material.from_reflection(0.5)
    slide = clsim.Trajectory.line((1.0, -0.1, 1.0), (1.0, 0.9, 1.0), 0.5)
    sheet = clsim.Body.box("sheet", (0.0, 1.0, 1.0), wall, slide, centre=(0.0, 0.6, 0.0))
    tone, at = clsim.Signal.tone(40e3, 0.4, RATE), clsim.Trajectory.fixed
    scene = clsim.Scene(
        clsim.Shoebox((6.0, 5.0, 3.0), wall), clsim.Air(speed_of_sound=343.0),
        [clsim.Source("s", tone, at((0.4, 2.0, 1.0)))], [clsim.Receiver("r", at((4.0, 2.0, 1.0)))], bodies=[sheet],
    )  # fmt: skip
    found = clsim.find_paths(scene, 0, engine="reference")
    # The upper edge is at y = 1 m + 2 m/s t; sound needs 3 m on to the receiver.
    assert (found.start.tolist(), len(found)) == ([-np.inf], 1)
    assert found.end[0] == pytest.approx((2.0 - 1.0) / 2.0 + 3.0 / 343.0, abs=1.0 / RATE)
    truth = clsim.direct_path(found, [0.5, 0.51])
    assert truth.line_of_sight[0, 0].tolist() == [True, False]


def test_runs_are_resumed_and_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str], device: None) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE, "utf-8")
    assert main(["check", str(scene)]) == 0
    assert "body 'door': 1 face, 0 x 0.9 x 2 m, no point of it faster than 0.95 m/s" in capsys.readouterr().out
    assert main(["run", str(scene), "-o", str(tmp_path / "a"), "--no-plots"]) == 0
    with np.load(tmp_path / "a" / "ground_truth.npz") as found:
        assert found["body_names"].tolist() == ["door", "robot"]
        assert found["body_radial_speed"][0, 0, 1].max() < -0.3  # driven towards the door at 1 m/s, which swings away
    complete = (tmp_path / "a" / "scene.completed.toml").read_text("utf-8")
    assert complete.count("[[bodies]]") == 2
    assert complete.count("mounted_on") == 2
    again = tmp_path / "again.toml"
    again.write_text(complete, "utf-8")
    capsys.readouterr()
    assert main(["run", str(again), "-o", str(tmp_path / "a"), "--no-plots", "--resume"]) == 0
    assert "already finished" in capsys.readouterr().err, "the completed scene is the same run"


def test_studies_compute_them(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    study = load_study(tmp_path / "study.toml")
    content = computed(study, study.members[0], None, tmp_path / "member").content.variables
    assert content["line_of_sight"].values.all()
    truth = clsim.body_truth(clsim.load_scene(tmp_path / "scene.toml").scene, content["times"].values)
    assert content["body"].values.tolist() == ["door", "robot"]
    np.testing.assert_array_equal(content["body_range"].values, truth.range)
    assert content["body_visible"].dims == ("body", "source", "receiver", "times")


def test_engines_agree_and_nothing_that_moves_is_convolved(paths: PathSet, device: None) -> None:
    exact, heard = (clsim.render(paths, RATE, duration=0.05, engine=e).pressure for e in ("reference", "opencl"))
    assert np.linalg.norm(heard - exact) < 10 ** (-85 / 20) * np.linalg.norm(exact)
    assert not pairs_at_rest(clsim.track(paths), clsim.RenderOptions(RATE))


def test_without_bodies_nothing_is_looked_for(file: Any) -> None:
    scene = file.scene
    bare = clsim.Scene(scene.room, scene.air, scene.sources, scene.receivers)
    found = clsim.find_paths(bare, 1, body_order=1, body_step=0.001)
    assert len(found.families) == 1
    assert found.digest() == clsim.find_paths(bare, 1).digest()


WOOD = clsim.Material.from_reflection(0.9)
FIXED, LINE, SWING = clsim.Trajectory.fixed, clsim.Trajectory.line, clsim.Trajectory.swing


def box(trajectory: Any, size: Any = (0.2, 0.2, 0.2), name: str = "b") -> clsim.Body:
    return clsim.Body.box(name, size, WOOD, trajectory)


IN = FIXED((2.0, 2.0, 1.0))
REFUSED: list[Any] = [
    (lambda: [box(LINE((2, 2, 1), (3.97, 2, 1), 0.3))], r"bodies\[0\].trajectory: .*'b' goes through the wall 'x_max' by 0\.01 m at 0"),
    (lambda: [box(LINE((1.0, 2.0, 1), (1.0, 0.9, 1), 0.3), (0.9, 0.2, 0.9))], "'s' is in 'b' or meets a face of it at 0"),
    (lambda: [box(FIXED((1.0, 1.0, 1.0)))], "'s' is in 'b' or meets a face of it at 0 s"),
    (lambda: [box(LINE((2, 2, 1), (2.5, 2, 1), 0.3)), box(FIXED((2.3, 2, 1)), name="c")], r"bodies\[1\].*'c' goes through 'b'"),
    (lambda: [box(SWING((2, 2, 1), (0, 0, 1), [0, 12.0, 0], [0, 0.006, 0.3]))], "must keep every point below the speed of sound"),
    (lambda: [box(LINE((2, 2, 1), (2.1, 2, 1), 0.01))], "must last as long as all signals"),
    (lambda: [box(SWING((2, 2, 1), (0, 0, 0), [0, 1.0], [0, 0.3]))], "axis: must be a direction, but is 0, 0, 0"),
    (lambda: [box(IN), box(IN)], r"bodies\[1\].name: must be unique"),
    (lambda: [box(IN, (0.1, 0.0, 0.0))], "size: must be at least 1e-05 m, or 0 along one axis"),
    (lambda: [clsim.Body("b", 3, IN)], "mesh: must be a MeshRoom"),
    (lambda: "b", "bodies: must be a list"), (lambda: [3], r"bodies\[0\]: must be a Body"),
]  # fmt: skip


@pytest.mark.parametrize(("bodies", "message"), REFUSED, ids=range(len(REFUSED)))
def test_what_cannot_be_in_a_scene(bodies: Any, message: str) -> None:
    tone = clsim.Signal.tone(40e3, 0.1, RATE)
    ends = [clsim.Source("s", tone, FIXED((1.0, 1.0, 1.0)))], [clsim.Receiver("r", FIXED((3.0, 1.0, 1.0)))]
    with pytest.raises(clsim.InputError, match=message):
        clsim.Scene(clsim.Shoebox((4.0, 3.0, 2.5), WOOD), clsim.Air(), *ends, bodies=bodies())


def test_what_a_mesh_refuses_and_who_carries() -> None:
    tone = clsim.Signal.tone(40e3, 0.1, RATE)
    source, ear = clsim.Source("s", tone, FIXED((1.0, 1.0, 1.0))), clsim.Receiver("r", FIXED((3.0, 1.0, 1.0)))
    room = clsim.MeshRoom.joined([
        clsim.Shoebox((4.0, 3.0, 2.5), WOOD),
        clsim.MeshRoom([(2, 0, 0), (2, 1, 0), (2, 1, 2), (2, 0, 2)], [(0, 1, 2), (0, 2, 3)], WOOD),
    ])  # fmt: skip
    through = [box(LINE((1.5, 0.4, 1), (2.5, 0.4, 1), 0.3))]
    with pytest.raises(clsim.InputError, match="'b' goes through the wall"):
        clsim.Scene(room, clsim.Air(), [source], [ear], bodies=through)
    edge = [box(LINE((1.5, 1.0, 1), (2.5, 1.0, 1), 0.3), (0.1, 0.6, 3e-3))]  # its own edges pass beside the sheet's
    with pytest.raises(clsim.InputError, match="'b' goes through the wall"):
        clsim.Scene(room, clsim.Air(), [source], [ear], bodies=edge)
    assert clsim.Scene(room, clsim.Air(), [source], [ear], bodies=[box(LINE((1.5, 2, 1), (2.5, 2, 1), 0.3))]).bodies
    carried = clsim.Source("s", tone, FIXED((0.3, 0.0, 0.0)), mounted_on="cart")
    with pytest.raises(clsim.InputError, match=r"sources\[0\].mounted_on: must name a body \('b'\), but is 'cart'"):
        clsim.Scene(room, clsim.Air(), [carried], [ear], bodies=[box(IN)])
    with pytest.raises(clsim.InputError, match="mounted_on: must name a body, but is 3"):
        clsim.Source("s", tone, IN, mounted_on=3)
    layered = clsim.Air(temperature_celsius=(15.0, 25.0), heights=(0.0, 2.5))
    with pytest.raises(clsim.InputError, match="bodies: must be left out where the air depends on the height"):
        clsim.find_paths(clsim.Scene(room, layered, [source], [ear], bodies=[box(IN)]), 1)
    fast = [box(LINE((0.5, 2.0, 1.0), (3.5, 2.0, 1.0), 0.1))]
    with pytest.raises(clsim.InputError, match="body_order: must be so low that bodies change the length"):
        clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [ear], bodies=fast), 3)
