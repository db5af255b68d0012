"""An MCAP file as the `mcap` reader and ROS 2's CDR give it back: sound, poses and ranges on one clock."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsim

START = 1_700_000_000_123_456_789
RATE = 44_100.0  # of which a sample is no whole number of nanoseconds


@pytest.fixture(scope="module")
def recording() -> clsim.Recording:
    tone = clsim.Signal.tone(5e3, 0.1, RATE, fade=0.01)
    walk = clsim.Trajectory.line((1, 1, 1), (1.5, 1, 1), 1.0)
    sources = [clsim.Source("robot", tone, walk)]
    ears = [
        clsim.Receiver(name, clsim.Trajectory.fixed((3, 1, z)), aim=(0, 0, -1)) for name, z in (("a b", 1.5), ("c", 2))
    ]
    room = clsim.Shoebox((4, 3, 2.5), clsim.Material.from_reflection(0.5))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), sources, ears), 1)
    return clsim.render(paths, RATE, engine="reference")


@pytest.fixture(scope="module")
def messages(recording: clsim.Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """Return messages by topic, each (log time, content)."""
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    path = tmp_path_factory.mktemp("mcap") / "run.mcap"
    clsim.write_mcap(recording, path, start=START, rate=50.0)
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for _, channel, message, content in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


def stamp(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def test_sound_is_whole_and_stamped_to_the_nanosecond(
    recording: clsim.Recording, messages: dict[str, list[Any]]
) -> None:
    for row, name in zip(recording.samples, ("a_b", "c"), strict=True):
        pieces = messages[f"/{name}/audio"]
        samples = np.concatenate([np.frombuffer(bytes(content.audio.data), "<f4") for _, content in pieces])
        np.testing.assert_array_equal(samples, row)
        first = 0
        for log_time, content in pieces:
            assert log_time == stamp(content.header) == START + round(first * 10**9 / 44_100)
            first += len(content.audio.data) // 4
        info = messages[f"/{name}/audio_info"][0][1]
        assert (info.channels, info.sample_rate, info.sample_format) == (1, 44_100, "F32LE")


def test_poses_and_ranges_are_the_ground_truth(recording: clsim.Recording, messages: dict[str, list[Any]]) -> None:
    paths = recording.paths
    assert paths is not None
    poses, ranges = messages["/robot/pose"], messages["/robot/c/range"]
    times = np.arange(len(poses)) / 50.0
    assert len(poses) == len(ranges) == len(messages["/tf"]) == 6
    exact = clsim.direct_path(paths, times)
    for t, (log_time, content) in enumerate(poses):
        assert log_time == stamp(content.header) == START + t * 20_000_000
        place = content.pose.position
        np.testing.assert_array_equal([place.x, place.y, place.z], paths.scene.sources[0].trajectory.position(times[t]))
        assert ranges[t][0] == stamp(ranges[t][1].header) == log_time
        assert ranges[t][1].range == np.float32(paths.scene.air.speed_of_sound * exact.delay[0, 1, t])
        transforms = messages["/tf"][t][1].transforms
        assert {messages["/tf"][t][0], *(stamp(one.header) for one in transforms)} == {log_time}
        assert [one.child_frame_id for one in transforms] == ["robot", "a_b", "c"]
        turn = transforms[2].transform.rotation
        turned = paths.scene.receivers[1].orientation(np.zeros(1))[0]
        np.testing.assert_array_equal([turn.x, turn.y, turn.z, turn.w], turned)


def test_what_cannot_be_written_is_refused(
    recording: clsim.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcap_ros2", None)
    with pytest.raises(clsim.InputError, match=r"an MCAP file needs .*mcap_ros2: pip install 'clsim\[ros\]'"):
        clsim.write_mcap(recording, tmp_path / "x.mcap")
    monkeypatch.undo()
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")
    bare = clsim.Recording(recording.samples, RATE, ("a", "b"), None, ())
    with pytest.raises(clsim.InputError, match="recording: must have its paths for MCAP"):
        clsim.write_mcap(bare, tmp_path / "x.mcap")
    with pytest.raises(clsim.InputError, match="start: must be from 0"):
        clsim.write_mcap(recording, tmp_path / "x.mcap", start=-1)
    assert not list(tmp_path.iterdir())
