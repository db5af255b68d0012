"""Files are whole or absent, and hold what they should."""

import errno
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile

import clsim
from clsim.files.atomic import atomic_path
from clsim.files.sound import WavWriter
from clsim.output.result_files import read_table, write_table
from clsim.paths.path_table import PathTable
from clsim.pictures.plots import envelope_picture, spectrogram_picture
from clsim.workflow.pictures import echogram_picture


@pytest.fixture
def table() -> PathTable:
    room = clsim.Shoebox((8, 6, 3), clsim.Material.from_reflection(0.8))
    tone = clsim.Signal.tone(40e3, duration=0.5, sampling_rate=192e3)
    source = clsim.Source("s", tone, clsim.Trajectory.line((2, 3, 1), (4, 3, 1), duration=1.0))
    scene = clsim.Scene(room, clsim.Air(), [source], [clsim.Receiver("a", clsim.Trajectory.fixed((7, 3, 1)))])
    return clsim.find_paths(scene, 2).table([0.0, 0.1, 0.2])


def test_wav_keeps_rate_and_samples(tmp_path, rng) -> None:
    samples = rng.normal(size=(1000, 3)).astype(np.float32)
    path = tmp_path / "a.wav"
    with WavWriter(path, 500e3, channels=3) as writer:
        writer.write(samples[:300])
        assert not path.exists()
        writer.write(samples[300:])
    read, rate = soundfile.read(path, dtype="float32")
    assert rate == 500_000
    np.testing.assert_array_equal(read, samples)


def test_interrupted_files_leave_nothing(tmp_path) -> None:
    def interrupted() -> None:
        with WavWriter(tmp_path / "a.wav", 192e3) as writer:
            writer.write(np.zeros(10, dtype=np.float32))
            raise KeyboardInterrupt

    def failed() -> None:
        with atomic_path(tmp_path / "b.txt") as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(RuntimeError):
        failed()
    assert list(tmp_path.iterdir()) == []


def test_a_read_only_disk_is_told_by_the_name_that_was_asked_for(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, *_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr(Path, "write_text", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)  # of names that are not there, too
    with pytest.raises(OSError, match=r"/page\.html'$"), atomic_path(tmp_path / "page.html") as temporary:
        temporary.write_text("x")


def test_wav_needs_a_whole_rate_and_a_folder(tmp_path) -> None:
    with pytest.raises(clsim.InputError, match="whole number of Hz"):
        WavWriter(tmp_path / "a.wav", 44_100.5)
    with pytest.raises(FileNotFoundError, match=r"No such file or directory: '.*a\.wav'"):
        WavWriter(tmp_path / "missing" / "a.wav", 44_100)
    with pytest.raises(IsADirectoryError, match=f"{tmp_path.name}'$"):
        WavWriter(tmp_path, 44_100)


def test_wav_grows_beyond_4_gib_only_when_announced(tmp_path) -> None:
    with WavWriter(tmp_path / "large.wav", 192e3, samples=2**31) as writer:
        writer.write(np.ones(3, dtype=np.float32))
    assert soundfile.info(tmp_path / "large.wav").format == "RF64"
    np.testing.assert_array_equal(soundfile.read(tmp_path / "large.wav")[0], np.ones(3))

    def unannounced() -> None:
        with WavWriter(tmp_path / "small.wav", 192e3) as writer:
            writer.write(np.broadcast_to(np.float32(0.0), (2**30,)))

    with pytest.raises(OSError, match="above 4 GiB"):
        unannounced()
    assert not (tmp_path / "small.wav").exists()


def test_table_survives_npz(tmp_path, table: PathTable) -> None:
    write_table(table, tmp_path / "t.npz")
    again = read_table(tmp_path / "t.npz")
    for name in PathTable.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(table, name))


def test_table_as_parquet_has_a_row_per_path_and_time(tmp_path, table: PathTable) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    write_table(table, tmp_path / "t.parquet")
    rows = parquet.read_table(tmp_path / "t.parquet").to_pydict()
    assert len(rows["delay"]) == 25 * 3
    p, t = 7, 2
    i = next(i for i in range(75) if rows["path"][i] == p and rows["times"][i] == table.times[t])
    assert rows["delay"][i] == table.delay[p, t]
    assert rows["arrival_z"][i] == table.arrival[p, t, 2]
    assert rows["objects"][i] == ",".join(table.object_names[w] for w in table.objects[p] if w >= 0)


def test_table_refuses_other_files(tmp_path, table: PathTable) -> None:
    with pytest.raises(clsim.InputError, match=r"\.npz or \.parquet"):
        write_table(table, tmp_path / "t.csv")
    for content in (b"PK", b"PK\x03\x04", b"", b"PK\x03\x04" + bytes(100)):
        (tmp_path / "no.npz").write_bytes(content)
        with pytest.raises(clsim.InputError, match="path table"):
            read_table(tmp_path / "no.npz")
    np.save(tmp_path / "array.npy", np.ones(3))
    with pytest.raises(clsim.InputError, match="path table"):
        read_table(tmp_path / "array.npy")


def test_table_without_paths_is_written(tmp_path, table: PathTable) -> None:
    names = ("times", "source_names", "receiver_names", "object_names")
    rows = [name for name in PathTable.__dataclass_fields__ if name not in names]
    empty = replace(table, **{name: getattr(table, name)[:0] for name in rows})
    write_table(empty, tmp_path / "t.npz")
    assert read_table(tmp_path / "t.npz").delay.shape == (0, 3)
    echogram_picture(empty, 0, 0, tmp_path / "e.png")
    parquet = pytest.importorskip("pyarrow.parquet")
    write_table(empty, tmp_path / "t.parquet")
    write_table(table, tmp_path / "full.parquet")
    read = parquet.read_table(tmp_path / "t.parquet")
    assert read.num_rows == 0
    assert read.schema == parquet.read_table(tmp_path / "full.parquet").schema


def test_pictures_are_drawn(tmp_path, table: PathTable) -> None:
    tone = np.sin(2 * np.pi * 40e3 * np.arange(20_000) / 192e3)
    spectrogram_picture(tone, 192e3, tmp_path / "s.png", title="tone", band=(38e3, 42e3))
    echogram_picture(table, 0, 1, tmp_path / "e.png")
    envelope_picture(tone, 192e3, tmp_path / "h.png", title="tone", arrivals=[(0.01, "direct", True)])
    for name in ("s", "e", "h"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_silence_is_drawn(tmp_path) -> None:
    spectrogram_picture(np.zeros(3), 48e3, tmp_path / "s.png", title="silence")
    assert (tmp_path / "s.png").exists()


def test_a_disk_too_full_for_an_hdf5_file_is_an_error_and_ends_nothing(tmp_path) -> None:
    pytest.importorskip("resource")
    pytest.importorskip("h5netcdf")
    code = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from clsim.output.stores import STORES, StoredSound
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
sound = StoredSound((("a", ""), ("b", "")), ("Pa", "Pa"), np.zeros((2, 3)), 192e3, 20_000, 18_432, "text" * 9000, "1", None)
for limit in (500, 30_000, 100_000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        STORES["hdf5"](Path(sys.argv[1]), sound, ["a", "b"]).create()
    except OSError as error:
        print(error.strerror)
"""
    # -B: bytecode of what it imports would be cut short by the limit, too, for all that import it after.
    done = subprocess.run([sys.executable, "-B", "-c", code, str(tmp_path)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert [line[:14] for line in done.stdout.splitlines()] == ["File too large"] * 3
