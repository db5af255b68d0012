"""FLAC and .mat files as soundfile and scipy give them back."""

from pathlib import Path

import numpy as np
import pytest
import soundfile
from scipy.io import loadmat

import clsim

RATE = 192e3


@pytest.fixture(scope="module")
def recording() -> clsim.Recording:
    tone = clsim.Signal.tone(40e3, 0.02, RATE, fade=0.005)
    sources = [clsim.Source("robot", tone, clsim.Trajectory.line((1, 1, 1), (1.2, 1, 1), 0.03))]
    ears = [clsim.Receiver(name, clsim.Trajectory.fixed((3, 1, z))) for name, z in (("a b", 1.5), ("c", 2))]
    room = clsim.Shoebox((4, 3, 2.5), clsim.Material.from_reflection(0.5))
    return clsim.render(clsim.find_paths(clsim.Scene(room, clsim.Air(), sources, ears), 1), RATE, engine="reference")


def made(samples: np.ndarray, rate: float = RATE, **more: object) -> clsim.Recording:
    return clsim.Recording(samples, rate, tuple(f"r{i}" for i in range(len(samples))), None, (), **more)


def test_flac_holds_the_samples_to_its_last_bit(recording: clsim.Recording, tmp_path: Path) -> None:
    paths = clsim.write_flac(recording, tmp_path / "new")
    assert [path.name for path in paths] == ["a_b.flac", "c.flac"]
    peak = float(np.abs(recording.samples).max())
    for path, row, name in zip(paths, recording.samples, recording.receiver_names, strict=True):
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


def test_mat_holds_sound_and_truth(recording: clsim.Recording, tmp_path: Path) -> None:
    clsim.write_mat(recording, tmp_path / "run.mat", rate=200.0)
    read = loadmat(tmp_path / "run.mat")
    np.testing.assert_array_equal(read["samples"], recording.samples)
    assert read["samples"].dtype == np.float32
    assert read["sampling_rate"].item() == RATE
    assert [cell.item() for cell in read["receiver_names"].ravel()] == ["a b", "c"]
    assert [cell.item() for cell in read["units"].ravel()] == ["Pa", "Pa"]
    times = read["times"].ravel()
    np.testing.assert_array_equal(times, np.arange(len(times)) / 200.0)
    assert 0.02 <= times[-1] <= 0.03  # no longer than the motion
    assert recording.paths is not None
    exact = clsim.direct_path(recording.paths, times)
    np.testing.assert_array_equal(read["delay"], exact.delay)
    np.testing.assert_array_equal(read["line_of_sight"].astype(bool), exact.line_of_sight)
    walk = recording.paths.scene.sources[0].trajectory.position(times)
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
