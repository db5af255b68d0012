"""Arrays of receivers: grids, files, scene files, and what a run writes of many."""

from pathlib import Path

import numpy as np
import pytest
from scene_texts import along, receiver_at, scene_text, shoebox_of, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.scene_file import load_scene
from clsim.workflow import pictures, pipeline

SCENE = scene_text(
    source_at("robot", tone_of(40e3, 0.02, fade=0.005), along((2.0, 3.0, 1.5), (3.0, 3.0, 1.5), 0.5)),
    receiver_at(
        "ceiling",
        None,
        positions={"kind": "grid", "x": (0.5, 7.5, 5), "y": (0.5, 5.5, 4), "z": 2.9},
        directivity={"kind": "first-order"},
        aim=(0.0, 0.0, -1.0),
    ),
    receiver_at("table", None, positions={"kind": "file", "path": "mics.csv"}),
    receiver_at("one", (1.0, 1.0, 1.0)),
    room=shoebox_of(8.0, 6.0, 3.0),
    render={"duration": 0.04},
)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "mics.csv").write_text("x, y, z\n# two of them\n1.0, 2.0, 1.0\n2;2;1.5\n")
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def test_a_grid_goes_through_x_first() -> None:
    places = clsim.grid_positions((0.0, 2.0, 3), (5.0, 6.0, 2), (1.0, 1.5, 2))
    assert places.shape == (12, 3)
    np.testing.assert_array_equal(places[:4], [[0, 5, 1], [1, 5, 1], [2, 5, 1], [0, 6, 1]])
    np.testing.assert_array_equal(places[-1], [2, 6, 1.5])
    np.testing.assert_array_equal(clsim.grid_positions(1, 2, 3), [[1, 2, 3]])


def test_a_scene_file_holds_arrays_beside_single_receivers(scene: Path) -> None:
    receivers = load_scene(scene).scene.receivers
    assert [r.name for r in receivers] == [*(f"ceiling-{i}" for i in range(20)), "table-0", "table-1", "one"]
    places = np.concatenate([r.trajectory.position(np.zeros(1)) for r in receivers])
    np.testing.assert_array_equal(
        places[[0, 19, 20, 21, 22]], [[0.5, 0.5, 2.9], [7.5, 5.5, 2.9], [1, 2, 1], [2, 2, 1.5], [1, 1, 1]]
    )
    assert {id(r.directivity) for r in receivers[:20]} == {id(receivers[0].directivity)}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("x = [0.5, 7.5, 5]", "x = [0.5, 7.5, 0]", "receivers[0].positions.x[2]: must be from 1 to 100000, but is 0"),
        ("x = [0.5, 7.5, 5]", "x = [0.5, 7.5, 1]", "receivers[0].positions.x[2]: must be at least 2 between"),
        ("x = [0.5, 7.5, 5]", "x = [0.5, 7.5]", "receivers[0].positions.x: must be a number or first, last and count"),
        ("x = [0.5, 7.5, 5]", "x = [0.5, 7.5, 2.5]", "receivers[0].positions.x[2]: must be a whole number"),
        ("x = [0.5, 7.5, 5]", "x = [0.5, 9.5, 5]", "receivers[4].trajectory: must stay inside the room"),
        ("z = 2.9", "z = [1.0, 2.9, 90000]", "receivers[0].positions.x: must make at most 100000 positions"),
        ('"mics.csv"', '"nowhere.csv"', "receivers[1].positions.path: "),
        ('kind = "grid", x', 'kind = "grad", x', "receivers[0].positions.kind: "),
        ("[1.0, 1.0, 1.0] }", "[1.0, 1.0, 1.0] }\npositions = 3", "receivers[2]"),
    ],
)  # fmt: skip
def test_nonsense_is_an_error_in_a_line(scene: Path, capsys, old: str, new: str, message: str) -> None:
    assert SCENE.count(old) == 1
    scene.write_text(SCENE.replace(old, new))
    assert main(["check", str(scene)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must hold positions, but holds none"),
        ("x,y,z\n", "must hold positions, but holds none"),
        ("1,2,3\n1,2\n", "line 2 must be three finite numbers, but is '1,2'"),
        ("1,2,nan\n", "line 1 must be three finite numbers"),
        ("a,b,c\nd,e,f\n1,2,3\n", "line 2 must be three numbers, but is 'd,e,f'"),
        ("1,2,3\nx,y,z\n", "line 2 must be three numbers, but is 'x,y,z'"),
        (b"\xff\xfe\x00", "cannot be read"),
        ("<MicArray></MicArray>", "must hold positions, but holds none"),
        (
            "<MicArray><pos x='1' y='2'/></MicArray>",
            "pos 1 must have x, y and z, finite numbers, but has .'1', '2', ''",
        ),
        ("<a><pos x='1' y='2' z='3'/><pos x='inf' y='2' z='0'/></a>", "pos 2 must have x, y and z, finite numbers"),
        ("<MicArray><pos x='1'", "must be XML, but "),
        ("<?xml version='1.0' encoding='nonsense'?><a/>", "must be XML, but "),
        ("<!DOCTYPE a [<!ENTITY b '1'>]><a><pos x='&b;' y='2' z='3'/></a>", "must be XML without declarations"),
    ],
)
def test_files_without_positions_are_refused(tmp_path: Path, text, message: str) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(clsim.InputError, match=message):
        clsim.positions_from_file(path)


def test_positions_of_other_programs(tmp_path: Path) -> None:
    """Acoular's XML, blanks within the numbers and comments between them; pyroomacoustics' arrays, turned."""
    path = tmp_path / "tub.xml"
    path.write_text(
        '<?xml version="1.0" encoding="utf-8"?>\n<!-- made by hand -->\n<MicArray name="tub">\n'
        '  <pos Name="Point 1" x=" 0.1" y="-2e-1" z="0"/>\n  <pos Name="Point 2" x="1" y="2" z="3.5"/>\n</MicArray>\n'
    )
    np.testing.assert_array_equal(clsim.positions_from_file(path), [[0.1, -0.2, 0.0], [1.0, 2.0, 3.5]])
    others = pytest.importorskip("pyroomacoustics", reason="pyroomacoustics is not installed")
    array = others.MicrophoneArray(np.array([[0.1, 0.2], [1.0, 1.1], [2.0, 2.2]]), 48_000)
    ends = clsim.receiver_array("m", array.R.T)
    places = [end.trajectory.position(0.0).tolist() for end in ends]
    assert places == [[0.1, 1.0, 2.0], [0.2, 1.1, 2.2]]


def test_elements_go_and_turn_with_the_array_s_frame() -> None:
    """Samples are those of receivers whose own trajectories were worked out by hand, to -100 dB."""
    times = np.linspace(0.0, 0.5, 51)
    angle, middle = 0.8 * times, np.stack([2.0 + 0.5 * times, 2.0 + 0.0 * times, 1.2 + 0.0 * times], axis=1)
    poses = np.stack([0.0 * angle, 0.0 * angle, np.sin(0.5 * angle), np.cos(0.5 * angle)], axis=1)
    frame = clsim.Trajectory.waypoints(times, middle, poses)
    places = np.array([[0.1, 0.0, 0.0], [0.0, 0.07, 0.02]])
    patterns = [clsim.FirstOrder(0.5), clsim.FirstOrder(0.0)]
    array = clsim.receiver_array("array", places, frame, directivities=patterns, aims=[[1, 0, 0], [0, 1, 0]])
    alone = []
    for i, (x, y, z) in enumerate(places.tolist()):
        cos, sin = np.cos(angle), np.sin(angle)
        way = middle + np.stack([cos * x - sin * y, sin * x + cos * y, z + 0.0 * angle], axis=1)
        half = 0.5 * (angle + (0.0, 0.5 * np.pi)[i])
        turned = np.stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)], axis=1)
        alone.append(clsim.Receiver(f"one {i}", clsim.Trajectory.waypoints(times, way, turned), patterns[i]))
    source = clsim.Source(
        "s", clsim.Signal.noise(0.3, 16e3, 1, band=(300.0, 5e3), fade=0.02), clsim.Trajectory.fixed((4.0, 3.5, 1.4))
    )
    room = clsim.Shoebox((6.0, 5.0, 3.0), clsim.Material.from_reflection(0.7))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [*array, *alone]), max_order=1)
    found = clsim.render(paths, 16e3, duration=0.35)
    assert found.channels == (("array", "0"), ("array", "1"), ("one 0", ""), ("one 1", ""))
    assert found.receiver_names[:2] == ("array 0", "array 1")
    signals, own = clsim.array_signals(found)
    np.testing.assert_array_equal(own, places)
    np.testing.assert_array_equal(signals, found.samples[found.rows_of("array")])
    others = found.samples[2:].astype(float)
    assert np.linalg.norm(signals - others) <= 1e-5 * np.linalg.norm(others)
    assert found.reception_times(1)[0] == 0.0


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"directivities": [clsim.Omni()]}, "directivities: must be one for each of 2 positions, but are 1"),
        ({"aims": [[1, 0, 0]] * 2, "aim": (1, 0, 0)}, "aims: must be left out where aim is given"),
        ({"directivity": clsim.Ambisonic(1)}, "directivity: must have one channel in an array"),
        ({"trajectory": (1.0, 2.0, 3.0)}, "trajectory: must be a Trajectory"),
        ({"aim": "forward"}, "aim: must"),
    ],
)
def test_nonsense_of_arrays_is_refused(more, message: str) -> None:
    arguments = {"trajectory": clsim.Trajectory.fixed((1.0, 1.0, 1.0))} | more
    with pytest.raises(clsim.InputError, match=message):
        clsim.receiver_array("a", [[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], **arguments)


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("store", ["wav", "hdf5"])
def test_a_run_with_an_array_is_read_back_as_one_receiver(tmp_path: Path, store: str) -> None:
    text = SCENE.replace(
        'positions = { kind = "file", path = "mics.csv" }',
        'positions = { kind = "file", path = "mics.csv" }\n'
        'trajectory = { kind = "line", start = [1.0, 1.0, 1.0], end = [1.5, 1.0, 1.0], duration = 0.5 }',
    )
    (tmp_path / "mics.csv").write_text("0.0, 0.1, 0.0\n0.0, -0.1, 0.0\n")
    (tmp_path / "scene.toml").write_text(text.replace("[0.5, 7.5, 5]", "[0.5, 7.5, 2]").replace("[0.5, 5.5, 4]", "1.0"))
    folder = tmp_path / "out"
    assert main(["run", str(tmp_path / "scene.toml"), "-o", str(folder), "--store", store, "--no-plots"]) == 0
    found = clsim.load_recording(folder, ["table"], paths=True)
    assert found.channels == (("table", "0"), ("table", "1"))
    signals, own = clsim.array_signals(found, "table")
    np.testing.assert_array_equal(own, [[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])
    assert signals.shape == (2, 7680)
    np.testing.assert_array_equal(signals, clsim.load_recording(folder).samples[2:4])
    with pytest.raises(clsim.InputError, match=r"must name an array of the scene, one of .'table'., but is 'one'"):
        clsim.array_signals(found, "one")


@pytest.mark.parametrize(
    ("name", "positions", "message"),
    [("", [[1, 2, 3]], "name: must be a text"), ("a", [[1, 2]], "positions: must have the shape"), ("a", [], "positions: must")],
)  # fmt: skip
def test_arrays_of_nothing_are_refused(name: str, positions, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.receiver_array(name, positions)


@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_run_tells_the_truth_about_all_and_draws_some(scene: Path, tmp_path, capsys, monkeypatch) -> None:
    assert pipeline.MOST_DRAWN == 16
    for module in (pipeline, pictures):
        monkeypatch.setattr(module, "MOST_DRAWN", 2)  # each takes half a second
    out = tmp_path / "out"
    assert main(["run", str(scene), "-o", str(out)]) == 0
    assert "pictures are of the first 2 receivers of 23" in capsys.readouterr().err
    assert len(list(out.glob("*.wav"))) == 23
    assert len(list(out.glob("*_echogram.png"))) == 2
    with np.load(out / "ground_truth.npz") as truth:
        assert truth["receiver_names"][20] == "table-0"
        speed = clsim.Air().speed_of_sound
        for r, place in ((0, (0.5, 0.5, 2.9)), (20, (1.0, 2.0, 1.0)), (22, (1.0, 1.0, 1.0))):
            times, delay = truth["times"], truth["delay"][0, r]
            there = np.stack([2.0 + 2.0 * (times - delay), 0 * times + 3.0, 0 * times + 1.5], axis=1)
            np.testing.assert_allclose(delay * speed, np.linalg.norm(there - place, axis=1), atol=1e-9)
        assert truth["line_of_sight"].all()
        assert truth["radial_speed"].shape == truth["delay"].shape == (1, 23, len(times))
    again = load_scene(out / "scene.completed.toml")
    assert len(again.scene.receivers) == 23


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (clsim.Receiver("array", clsim.Trajectory.fixed((2.0, 2.0, 1.0))), "an array is 'array' too"),
        (clsim.Receiver("hoa ACN0", clsim.Trajectory.fixed((2.0, 2.0, 1.0))), r"but \[2\] has 'hoa ACN0' too"),
    ],
)
def test_rows_with_the_same_name_are_refused(other, message) -> None:
    """A receiver with the name of an array, or of another one's channel, would hide it in files and stores."""
    pose = clsim.Trajectory.fixed((3.0, 3.0, 1.0))
    receivers = clsim.receiver_array("array", [[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]], pose)
    receivers += [clsim.Receiver.ambisonic("hoa", clsim.Trajectory.fixed((5.0, 3.0, 1.0))), other]
    tone = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=16e3)
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.5))
    with pytest.raises(clsim.InputError, match=message):
        clsim.Scene(room, clsim.Air(), [source], receivers)
