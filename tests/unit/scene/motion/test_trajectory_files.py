"""Motion from files and rosbags: formats, smoothing, and two recordings."""

import math
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motion_rows import by_points, motion, refused, write
from scenes import DATA
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from clsim.errors import ClsimWarning, InputError
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene_file import load_scene
from clsim.scene_file.scene import referenced_files

COUNT = 12
STAMPS = [1_700_000_000_999_999_990 + 33_333_333 * i + i * i for i in range(COUNT)]  # over a whole second, uneven
_T = np.linspace(0.0, 1.0, COUNT)
PLACES = np.stack([1.0 + np.sin(_T), np.cos(_T), 1.0 + 0.1 * _T], axis=1)
TURNS = Rotation.from_rotvec(np.outer(_T, [0.3, -0.2, 0.5])).as_quat()
KINDS = {
    "/pose": "geometry_msgs/msg/PoseStamped", "/odom": "nav_msgs/msg/Odometry",
    "/vicon": "geometry_msgs/msg/TransformStamped", "/guess": "geometry_msgs/msg/PoseWithCovarianceStamped",
}  # fmt: skip


def content(types: Any, kind: str, i: int, place: np.ndarray) -> Any:
    """Return message i of a kind."""
    x, y, z = place.tolist()
    point, vector = types["geometry_msgs/msg/Point"](x, y, z), types["geometry_msgs/msg/Vector3"](x, y, z)
    turn = types["geometry_msgs/msg/Quaternion"](*TURNS[i].tolist())
    stamp = types["builtin_interfaces/msg/Time"](*divmod(STAMPS[i], 10**9))
    header = types["std_msgs/msg/Header"](stamp, "odom_frame")
    pose = types["geometry_msgs/msg/Pose"](point, turn)
    if kind.endswith("PoseStamped"):
        return types[kind](header, pose)
    if kind.endswith("TransformStamped"):
        return types[kind](header, "tag", types["geometry_msgs/msg/Transform"](vector, turn))
    guess = types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
    if kind.endswith("PoseWithCovarianceStamped"):
        return types[kind](header, guess)
    nothing = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = types["geometry_msgs/msg/TwistWithCovariance"](
        types["geometry_msgs/msg/Twist"](nothing, nothing), np.zeros(36)
    )
    return types[kind](header, "tag", guess, twist)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of ROS 2 with a topic of each kind, one with a pose that is not finite, and one of texts."""
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    folder = tmp_path_factory.mktemp("bags") / "run"
    with Writer(folder, version=8) as writer:
        for topic, kind in {**KINDS, "/lost": KINDS["/pose"]}.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for i, place in enumerate(PLACES):
                bad = topic == "/lost" and i == 3
                message = content(store.types, kind, i, place * np.nan if bad else place)
                late = STAMPS[i] + 5_000_000 + 1000 * (i % 3)  # when it was written
                writer.write(connection, late, store.serialize_cdr(message, kind))
        connection = writer.add_connection("/words", "std_msgs/msg/String", typestore=store)
        word = store.types["std_msgs/msg/String"]("hello")
        writer.write(connection, STAMPS[0], store.serialize_cdr(word, "std_msgs/msg/String"))
    return folder


def by_points_of_bags(path: Path, topic: str, **more: Any) -> Trajectory:
    with pytest.warns(ClsimWarning, match="Doppler noise"):
        return Trajectory.from_file(path, "rosbag", topic=topic, smooth=False, **more)


@pytest.mark.parametrize("topic", KINDS)
def test_every_kind_of_pose_comes_back(bag: Path, topic: str) -> None:
    """At the stamps, whole nanoseconds apart, are the positions and orientations that were written."""
    found = by_points_of_bags(bag, topic)
    times = np.array([(stamp - STAMPS[0]) / 1e9 for stamp in STAMPS])
    assert (found.start, found.end) == (0.0, times[-1])
    np.testing.assert_allclose(found.position(times), PLACES, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(found.orientation(times), TURNS, rtol=0.0, atol=1e-15)
    assert found.notes[0] == f"Poses of {topic} in the frame 'odom_frame'."


def test_one_file_of_a_bag_is_enough(bag: Path) -> None:
    (file,) = bag.glob("*.db3")
    assert by_points_of_bags(file, "/pose").position(0.0).tolist() == PLACES[0].tolist()


def test_faults_are_told_by_the_message(bag: Path) -> None:
    with pytest.raises(InputError, match="path: run, message 4: must be a pose of finite numbers"):
        Trajectory.from_file(bag, "rosbag", topic="/lost")
    found = by_points_of_bags(bag, "/lost", repair=["nan"])
    assert "Dropped 1 of 12 rows (no finite number), the first in message 4." in found.notes
    with pytest.raises(InputError, match=r"path: run, message 2: must not be faster than 0.1 m/s .* from message 1 "):
        Trajectory.from_file(bag, "rosbag", topic="/pose", max_speed=0.1)


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        (None, "topic: must name the topic of a bag, such as '/robot/pose', but is None"),
        ("/nowhere", "topic: must be one with poses in run (/guess, /lost, /odom, /pose, /vicon), but is '/nowhere'"),
        (
            "/words",
            "topic: must be of PoseStamped, PoseWithCovarianceStamped, Odometry, TransformStamped, but /words is",
        ),
    ],
)
def test_topics_without_poses_are_refused(bag: Path, topic: str | None, message: str) -> None:
    with pytest.raises(InputError) as caught:
        Trajectory.from_file(bag, "rosbag", topic=topic)
    assert str(caught.value).startswith(message)


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    with pytest.raises(InputError, match=r"path: .*nowhere.bag cannot be read: No such file"):
        Trajectory.from_file(tmp_path / "nowhere.bag", "rosbag", topic="/a")
    for name in ("a.bag", "a.mcap", "a.db3", "a.txt"):
        (tmp_path / name).write_bytes(b"this is no bag" * 100)
        with pytest.raises(InputError, match=f"path: .*{name} must be a ROS bag, but cannot be read as one"):
            Trajectory.from_file(tmp_path / name, "rosbag", topic="/a")


def test_without_the_package_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(InputError, match=r"format: a ROS bag needs rosbags: pip install 'clsim\[ros\]'"):
        Trajectory.from_file(tmp_path, "rosbag", topic="/a")
    with pytest.raises(InputError, match="topic: must be left out for the format 'tum', but is '/a'"):
        Trajectory.from_file(tmp_path, "tum", topic="/a")


def test_a_scene_file_names_a_bag(bag: Path) -> None:
    """The bag's files are the scene's: what is rendered from them is known by their contents."""
    scene = bag.parent / "scene.toml"
    scene.write_text(f"""format = 1
[room]
kind = "shoebox"
size = [4.0, 4.0, 3.0]
walls = {{ reflection = 0.5 }}
[[sources]]
name = "s"
signal = {{ kind = "tone", frequency = 5000.0, duration = 0.1, sampling_rate = 48000.0 }}
trajectory = {{ kind = "file", path = "{bag.name}", format = "rosbag", topic = "/odom", translate = [0.0, 1.0, 0.0] }}
[[receivers]]
name = "r"
trajectory = {{ kind = "fixed", position = [3.0, 3.0, 1.0] }}
[paths]
max_order = 0
[render]
sampling_rate = 48000.0
""")
    file = load_scene(scene)
    end = file.scene.sources[0].trajectory
    np.testing.assert_allclose(end.position(0.0), PLACES[0] + [0.0, 1.0, 0.0], atol=1e-3)
    assert {path.name for path in referenced_files(file)} == {path.name for path in bag.iterdir()}


TUM_FILE = DATA / "trajectories" / "freiburg1_xyz-groundtruth.txt"
EUROC_FILE = DATA / "trajectories" / "V102_groundtruth.csv"


def real(path):
    if not path.exists():
        pytest.skip(f"no real data: {path} is missing")
    return path


# Formats


def test_all_formats_hold_the_same_motion(tmp_path, rows, euroc_rows):
    files = {
        "tum": write(tmp_path / "a.txt", rows, "# t x y z qx qy qz qw", " "),
        "euroc": write(tmp_path / "b.csv", euroc_rows, "#timestamp, p_x"),
        "csv": write(tmp_path / "c.csv", rows),
    }
    t, x, q = motion()
    for form, path in files.items():
        trajectory = by_points(path, form)
        assert (trajectory.start, trajectory.end) == (0.0, pytest.approx(5.9, abs=1e-12))
        np.testing.assert_allclose(trajectory.position(t), x, atol=1e-12)
        turn = Rotation.from_quat(trajectory.orientation(t)).inv() * Rotation.from_quat(q)
        assert turn.magnitude().max() < 1e-7
        assert trajectory.has_orientation
        assert trajectory.residual is None


def test_csv_columns_may_stand_in_any_order_beside_others(tmp_path, rows):
    mixed = [[row[3], "good", row[0], row[1], row[2]] for row in rows]
    trajectory = by_points(write(tmp_path / "a.csv", mixed, "z, quality ,t,x,y"), "csv")
    t, x, _ = motion()
    np.testing.assert_allclose(trajectory.position(t), x, atol=1e-12)
    assert not trajectory.has_orientation
    assert trajectory.notes[0] == "Columns not used: quality."


def test_comments_blank_lines_byte_order_mark_and_crlf_are_no_rows(tmp_path, rows):
    text = "\ufeff# made by hand\r\n\r\nt,x,y,z\r\n" + "".join(
        f"{row[0]},{row[1]},{row[2]},{row[3]}\r\n# between\r\n" for row in rows
    )
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("utf-8"))
    np.testing.assert_allclose(by_points(path, "csv").position(motion()[0]), motion()[1], atol=1e-12)


def test_columns_have_other_names_and_time_another_unit(tmp_path, rows):
    own = by_points(write(tmp_path / "a.csv", rows), "csv")
    alias = by_points(write(tmp_path / "b.csv", rows, "Time,pos_x,PY,position_z,q_x,quat_y,orientation_z,qw"), "csv")
    milli = [[1e3 * row[0], *row[1:]] for row in rows]
    path = write(tmp_path / "c.csv", milli, "t (ms),x,y,z,qx,qy,qz,qw")
    given = by_points(path, "csv", columns={"t": "t (ms)"}, time_scale=1e-3)
    swapped = by_points(path, "csv", columns={"t": "t (ms)", "x": "y", "y": "x"}, time_scale=1e-3)
    times = np.linspace(0.0, 5.9, 60)
    for other in (alias, given):
        np.testing.assert_allclose(other.position(times), own.position(times), atol=1e-9)
        np.testing.assert_allclose(other.orientation(times), own.orientation(times), atol=1e-9)
    np.testing.assert_allclose(swapped.position(times)[:, [1, 0, 2]], own.position(times), atol=1e-9)


def test_nanoseconds_since_1970_lose_nothing(tmp_path, euroc_rows):
    # float64 would round 1.4e18 ns to 256 ns; the third row stands out by 3 ns, which must be seen.
    euroc_rows[2][0] += 3
    trajectory = by_points(write(tmp_path / "a.csv", euroc_rows, ""), "euroc")
    knots = trajectory.curve.polynomial.x[1:-1]
    assert knots[2] - 0.2 == pytest.approx(3e-9, abs=1e-15)


def test_time_offset_is_the_time_of_the_first_row(tmp_path, rows):
    path = write(tmp_path / "a.csv", rows)
    late = by_points(path, "csv", time_offset=-2.5)
    assert (late.start, late.end) == (-2.5, pytest.approx(3.4, abs=1e-12))
    np.testing.assert_allclose(late.position(-2.5 + 0.35), by_points(path, "csv").position(0.35), atol=1e-12)


def test_placement_scales_then_turns_then_moves(tmp_path, rows):
    path = write(tmp_path / "a.csv", rows)
    quarter = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))  # +x to +y
    placed = by_points(path, "csv", scale=0.5, rotate=quarter, translate=(10, 20, 30))
    plain = by_points(path, "csv")
    t = np.linspace(0.0, 5.9, 101)
    x = plain.position(t)
    expected = np.stack([10 - 0.5 * x[:, 1], 20 + 0.5 * x[:, 0], 30 + 0.5 * x[:, 2]], axis=1)
    np.testing.assert_allclose(placed.position(t), expected, atol=1e-12)
    axes = Rotation.from_quat(placed.orientation(t)).apply([1.0, 0, 0])
    before = Rotation.from_quat(plain.orientation(t)).apply([1.0, 0, 0])
    np.testing.assert_allclose(axes, np.stack([-before[:, 1], before[:, 0], before[:, 2]], axis=1), atol=1e-12)


# Smoothing


def noisy_rows(rows, deviation, count=60):
    noise = deviation * np.random.default_rng(5).normal(size=(count, 3))
    return [[row[0], *(np.array(row[1:4]) + noise[i]), *row[4:]] for i, row in enumerate(rows)]


def test_smoothing_by_default_states_its_residual(tmp_path, rows):
    path = write(tmp_path / "a.csv", noisy_rows(rows, 1e-3))
    trajectory = Trajectory.from_file(path, "csv")
    assert trajectory.residual.shape == (3,)
    assert np.all((trajectory.residual > 3e-4) & (trajectory.residual < 1.5e-3))
    moved = ", ".join(f"{1e3 * r:.3g}" for r in trajectory.residual)
    assert f"moved by {moved} mm rms" in trajectory.notes[-1]
    assert "generalised cross-validation" in trajectory.notes[-1]
    rough = by_points(path, "csv")
    t, x, _ = motion()
    left = np.std(trajectory.position(t) - x)
    assert left < 0.8 * np.std(rough.position(t) - x)
    np.testing.assert_allclose(  # the residual is what was moved
        np.sqrt(np.mean((trajectory.position(t) - rough.position(t)) ** 2, axis=0)), trajectory.residual, rtol=1e-9
    )


def test_smoothing_commutes_with_the_placement(tmp_path, rows):
    path = write(tmp_path / "a.csv", noisy_rows(rows, 1e-3))
    turn = Rotation.from_rotvec([0.4, -0.7, 1.1])
    placed = Trajectory.from_file(path, "csv", rotate=turn.as_quat(), translate=(1, 2, 3))
    t = np.linspace(0.0, 5.9, 77)
    expected = turn.apply(Trajectory.from_file(path, "csv").position(t)) + np.array([1, 2, 3])
    np.testing.assert_allclose(placed.position(t), expected, atol=1e-12)


def test_residual_by_name_is_left(tmp_path, rows):
    trajectory = Trajectory.from_file(write(tmp_path / "a.csv", rows), "csv", smooth=2e-3)
    np.testing.assert_allclose(trajectory.residual[:2], 2e-3, rtol=1e-5)
    assert "a residual of 2 mm" in trajectory.notes[-1]


def test_doppler_noise_is_told_where_nothing_is_smoothed(tmp_path):
    # 2000 points at 100 Hz, white noise of 0.1 mm on y: 1.573 * 1e-4 / 0.01 s = 15.7 mm/s, 1.83 Hz.
    t, x, _ = motion(2000, 0.01)
    clean = CubicSpline(t, x)
    x = x + [1e-5, 1e-4, 1e-5] * np.random.default_rng(6).normal(size=x.shape)
    path = write(tmp_path / "a.csv", np.column_stack([t, x]).tolist(), "t,x,y,z")
    with pytest.warns(ClsimWarning, match=r"1\.8 Hz of Doppler noise at 40 kHz") as caught:
        trajectory = Trajectory.from_file(path, "csv", smooth=False)
    assert Path(caught[0].filename).name == Path(__file__).name
    fine = np.linspace(1.0, 19.0, 50_001)
    noise = np.sqrt(np.mean((trajectory.velocity(fine) - clean(fine, 1)) ** 2, axis=0))
    np.testing.assert_allclose(noise, [1.573e-3, 1.573e-2, 1.573e-3], rtol=0.05)  # 2000 points: 3 * 1.6 %


def test_violent_motion_warns_of_its_acceleration(tmp_path):
    t = 0.01 * np.arange(301)
    x = 0.05 * np.sin(10.0 * math.pi * t)  # 49 m/s² along x and y, 70 m/s² together
    path = write(tmp_path / "a.csv", np.column_stack([t, x, x, 0 * x]).tolist(), "t,x,y,z")
    with pytest.warns(ClsimWarning, match=r"accelerates by (69|70)[.\d]* m/s²") as caught:
        Trajectory.from_file(path, "csv")
    assert Path(caught[0].filename).name == Path(__file__).name
    slow = write(tmp_path / "b.csv", np.column_stack([t, x, 0 * x, 0 * x]).tolist(), "t,x,y,z")
    Trajectory.from_file(slow, "csv")


# Real files


def high_pass_speed(trajectory, rate):
    """Return the rms over all axes of the speed's content above 12 Hz, m/s."""
    t = np.arange(trajectory.start, trajectory.end, 1.0 / rate)
    spectrum = np.fft.rfft(trajectory.velocity(t) * np.hanning(len(t))[:, None], axis=0)
    high = np.fft.rfftfreq(len(t), 1.0 / rate) > 12.0
    power = 2.0 * np.sum(np.abs(spectrum[high]) ** 2) / len(t) / np.sum(np.hanning(len(t)) ** 2)
    return math.sqrt(power)


def test_hand_held_trajectory_has_one_gap_and_is_refused_until_it_is_allowed():
    problem = refused(real(TUM_FILE), "tum").problem
    assert "line 1022: must follow within 0.05 s (5 median steps)" in problem
    assert "0.1101 s after" in problem


def test_hand_held_trajectory_loses_its_noise():
    rough = by_points(real(TUM_FILE), "tum", max_gap=0.2)
    assert "2.8 Hz of Doppler noise" in rough.notes[-1]
    smooth = Trajectory.from_file(TUM_FILE, "tum", repair=("gaps",))
    assert "Bridged 1 gap" in smooth.notes[0]
    assert smooth.end == pytest.approx(30.0896, abs=1e-9)
    # Noise by third to fifth differences is 66 to 154 µm; smoothing must take that and stay below it.
    assert np.all((smooth.residual > 50e-6) & (smooth.residual < 155e-6))
    assert high_pass_speed(rough, 200.0) > 0.015
    assert high_pass_speed(smooth, 200.0) < 0.004
    t = np.linspace(0.0, smooth.end, 5001)
    assert np.linalg.norm(smooth.position(t) - rough.position(t), axis=1).max() < 2e-3
    assert np.allclose(np.linalg.norm(smooth.orientation(t), axis=1), 1.0, rtol=1e-14)
    assert smooth.peak_speed(0.0, smooth.end)[0] == pytest.approx(0.589, abs=0.01)


def test_drone_trajectory_loads_as_it_is():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trajectory = Trajectory.from_file(real(EUROC_FILE), "euroc")
    assert trajectory.end == pytest.approx(83.505, abs=1e-6)
    assert np.all((trajectory.residual > 1e-6) & (trajectory.residual < 30e-6))
    np.testing.assert_allclose(trajectory.position(0.0), (0.515356, 1.996773, 0.971104), atol=1e-4)
    # First quaternion, w x y z in the file.
    np.testing.assert_allclose(trajectory.orientation(0.0), (0.789985, -0.205376, 0.554528, 0.161996), atol=2e-4)
    assert trajectory.peak_speed(0.0, trajectory.end)[0] == pytest.approx(2.19, abs=0.02)
    # The file's own velocities at 41.75 s are those of the curve.
    row = np.loadtxt(EUROC_FILE, delimiter=",", comments="#", skiprows=8000, max_rows=1)
    time = (row[0] - 1403715524907143168) * 1e-9
    np.testing.assert_allclose(trajectory.velocity(time), row[8:11], atol=0.02)
