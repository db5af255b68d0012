"""Recordings in files of other programs: FLAC, MATLAB, and MCAP with poses and ranges on one clock."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.io import loadmat

import clsim

FLAC_AND_MAT_RATE = 192e3


@pytest.fixture(scope="module")
def recording_of_flac_and_mat() -> clsim.Recording:
    tone = clsim.Signal.tone(40e3, 0.02, FLAC_AND_MAT_RATE, fade=0.005)
    sources = [clsim.Source("robot", tone, clsim.Trajectory.line((1, 1, 1), (1.2, 1, 1), 0.03))]
    ears = [clsim.Receiver(name, clsim.Trajectory.fixed((3, 1, z))) for name, z in (("a b", 1.5), ("c", 2))]
    room = clsim.Shoebox((4, 3, 2.5), clsim.Material.from_reflection(0.5))
    return clsim.render(
        clsim.find_paths(clsim.Scene(room, clsim.Air(), sources, ears), 1), FLAC_AND_MAT_RATE, engine="reference"
    )


def made(samples: np.ndarray, rate: float = FLAC_AND_MAT_RATE, **more: object) -> clsim.Recording:
    return clsim.Recording(samples, rate, tuple(f"r{i}" for i in range(len(samples))), None, (), **more)


def test_flac_holds_the_samples_to_its_last_bit(recording_of_flac_and_mat: clsim.Recording, tmp_path: Path) -> None:
    paths = clsim.write_flac(recording_of_flac_and_mat, tmp_path / "new")
    assert [path.name for path in paths] == ["a_b.flac", "c.flac"]
    peak = float(np.abs(recording_of_flac_and_mat.samples).max())
    for path, row, name in zip(
        paths, recording_of_flac_and_mat.samples, recording_of_flac_and_mat.receiver_names, strict=True
    ):
        with soundfile.SoundFile(path) as file:
            assert (file.samplerate, file.subtype, file.title) == (192_000, "PCM_24", name)
            key, _, words = file.comment.partition("=")
            scale, unit = words.split()
            read = file.read(dtype="float64") * float(scale)
        assert (key, unit) == ("full_scale", "Pa")
        assert peak < float(scale) <= 2.0 * peak  # one for both receivers
        assert np.abs(read - row).max() <= float(scale) * 2.0**-24
    assert len(list((tmp_path / "new").iterdir())) == 2


def test_flac_of_baseband_and_of_units(tmp_path: Path) -> None:
    """I and Q are channels; samples of few bits come back exactly; silence has the full scale 1, a peak of 1 that of 2."""
    samples = np.array([[0.5 + 0.25j, -1.0 - 0.125j], [1.0, -0.75j], [0.0, 0.0]], dtype=np.complex64)
    paths = clsim.write_flac(made(samples, 655_350.0, units=("Pa", "Pa", "V"), carrier=40e3), tmp_path)
    for path, row, comment in zip(paths, samples, ("2 Pa", "2 Pa", "1 V"), strict=True):
        with soundfile.SoundFile(path) as file:
            assert file.comment == f"full_scale={comment}"
            frames = file.read() * float(comment.split()[0])
        np.testing.assert_array_equal(frames, np.stack([row.real, row.imag], axis=1))


def test_what_flac_does_not_hold_is_refused(tmp_path: Path) -> None:
    one = np.ones((1, 4), dtype=np.float32)
    for rate in (655_360.0, 192_001.0, 44_100.5):
        with pytest.raises(
            clsim.InputError, match=r"recording: must have, for FLAC, a sampling rate of whole Hz .* but has"
        ):
            clsim.write_flac(made(one, rate), tmp_path)
    clsim.write_flac(made(one, 44_101.0), tmp_path, full_scale=1.001)
    assert soundfile.info(tmp_path / "r0.flac").samplerate == 44_101
    with pytest.raises(
        clsim.InputError, match="full_scale: must be above all samples, whose largest is 1 Pa, but is 1"
    ):
        clsim.write_flac(made(one), tmp_path, full_scale=1.0)
    with pytest.raises(clsim.InputError, match="recording: must be finite"):
        clsim.write_flac(made(one * np.nan), tmp_path)


def test_mat_holds_sound_and_truth(recording_of_flac_and_mat: clsim.Recording, tmp_path: Path) -> None:
    clsim.write_mat(recording_of_flac_and_mat, tmp_path / "run.mat", rate=200.0)
    read = loadmat(tmp_path / "run.mat")
    np.testing.assert_array_equal(read["samples"], recording_of_flac_and_mat.samples)
    assert read["samples"].dtype == np.float32
    assert read["sampling_rate"].item() == FLAC_AND_MAT_RATE
    assert [cell.item() for cell in read["receiver_names"].ravel()] == ["a b", "c"]
    assert [cell.item() for cell in read["units"].ravel()] == ["Pa", "Pa"]
    times = read["times"].ravel()
    np.testing.assert_array_equal(times, np.arange(len(times)) / 200.0)
    assert 0.02 <= times[-1] <= 0.03  # no longer than the motion
    assert recording_of_flac_and_mat.paths is not None
    exact = clsim.direct_path(recording_of_flac_and_mat.paths, times)
    np.testing.assert_array_equal(read["delay"], exact.delay)
    np.testing.assert_array_equal(read["line_of_sight"].astype(bool), exact.line_of_sight)
    walk = recording_of_flac_and_mat.paths.scene.sources[0].trajectory.position(times)
    np.testing.assert_array_equal(read["source_positions"][0], walk)
    assert read["receiver_positions"].shape == (2, len(times), 3)


def test_mat_of_baseband_and_of_too_much(tmp_path: Path) -> None:
    envelope = np.array([[1.0 + 2.0j, 3.0]], dtype=np.complex64)
    clsim.write_mat(made(envelope, carrier=40e3), tmp_path / "b.mat")
    read = loadmat(tmp_path / "b.mat")
    np.testing.assert_array_equal(read["samples"], envelope)
    assert read["carrier"].item() == 40e3
    assert "delay" not in read
    long = np.broadcast_to(np.zeros(1, dtype=np.float32), (4, 2**28))  # takes no memory
    with pytest.raises(clsim.InputError, match=r"less than 2 GiB of samples for \.mat, but has 4\.0 GiB"):
        clsim.write_mat(made(long), tmp_path / "long.mat")
    assert [path.name for path in tmp_path.iterdir()] == ["b.mat"]


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


def test_sound_is_whole_and_stamped_to_the_nanosecond(recording: clsim.Recording, messages: dict[str, list[Any]]):
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


def test_what_cannot_be_written_is_refused(recording: clsim.Recording, tmp_path, monkeypatch) -> None:
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
