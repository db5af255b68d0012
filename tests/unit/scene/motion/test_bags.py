"""Motion from ROS bags that the package rosbags writes: stamps, positions and orientations as they went in."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
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


def by_points(path: Path, topic: str, **more: Any) -> Trajectory:
    with pytest.warns(ClsimWarning, match="Doppler noise"):
        return Trajectory.from_file(path, "rosbag", topic=topic, smooth=False, **more)


@pytest.mark.parametrize("topic", KINDS)
def test_every_kind_of_pose_comes_back(bag: Path, topic: str) -> None:
    """At the stamps, whole nanoseconds apart, are the positions and orientations that were written."""
    found = by_points(bag, topic)
    times = np.array([(stamp - STAMPS[0]) / 1e9 for stamp in STAMPS])
    assert (found.start, found.end) == (0.0, times[-1])
    np.testing.assert_allclose(found.position(times), PLACES, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(found.orientation(times), TURNS, rtol=0.0, atol=1e-15)
    assert found.notes[0] == f"Poses of {topic} in the frame 'odom_frame'."


def test_one_file_of_a_bag_is_enough(bag: Path) -> None:
    (file,) = bag.glob("*.db3")
    assert by_points(file, "/pose").position(0.0).tolist() == PLACES[0].tolist()


def test_faults_are_told_by_the_message(bag: Path) -> None:
    with pytest.raises(InputError, match="path: run, message 4: must be a pose of finite numbers"):
        Trajectory.from_file(bag, "rosbag", topic="/lost")
    found = by_points(bag, "/lost", repair=["nan"])
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
