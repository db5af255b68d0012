"""Outputs: sound files, stores, tables and pictures."""

import errno
import os
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from clsim_barn.columns import Columns
from made_results import read_table
from scene_texts import receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.files.atomic import atomic_path
from clsim.files.sound import wav_header, write_wav
from clsim.output import stores
from clsim.output.result_files import write_table
from clsim.paths.path_table import PathTable
from clsim.pictures.plots import spectrogram, spectrogram_picture
from clsim.workflow.pictures import echogram_picture

h5py = pytest.importorskip("h5py")


SCENE = scene_text(
    source_at("s", tone_of(40e3, 0.005, fade=0.001), (1.0, 1.0, 1.0)),
    receiver_at("left", (3.0, 1.0, 2.0)),
    receiver_at("right", (3.0, 2.0, 2.0)),
    max_order=0,
    render={"engine": "reference"},
)


class Named(Columns):
    """A store that refuses a name."""

    packages = ("numpy",)

    @staticmethod
    def problem_of(receiver: str) -> str:
        return "must not be called nobody" if receiver == "nobody" else ""


def test_a_store_is_a_class_and_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, error_of) -> None:
    scene = tmp_path / "s.toml"
    scene.write_text(SCENE, "utf-8")
    assert main(["run", str(scene), "-o", str(tmp_path / "wav"), "--no-plots"]) == 0
    assert '--store: must be one of "wav", "zarr", "hdf5", but is' in error_of(
        "run", scene, "-o", tmp_path / "npy", "--store", "columns"
    )
    monkeypatch.setitem(stores.STORES, "columns", Named)
    assert main(["run", str(scene), "-o", str(tmp_path / "npy"), "--store", "columns", "--no-plots"]) == 0
    for row, name in zip(np.load(tmp_path / "npy" / "sound.npy").T, ("left", "right"), strict=True):
        np.testing.assert_array_equal(row, soundfile.read(tmp_path / "wav" / f"{name}.wav", dtype="float32")[0])
    scene.write_text(SCENE.replace("left", "nobody"), "utf-8")
    capsys.readouterr()
    assert (
        error_of("run", scene, "-o", tmp_path / "other", "--store", "columns")
        == "receivers[0]: must not be called nobody"
    )


@pytest.mark.parametrize("kind", stores.STORES)
def test_stores_have_names_and_packages(kind: str) -> None:
    names = stores.STORES[kind].names(["a", "b"])
    assert len(names) == len(set(names)) > 0
    assert stores.STORES[kind].problem_of("a") == ""


WALLS = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")


def large_table(rng: np.random.Generator, paths: int, times: int, order: int) -> PathTable:
    delay = rng.random((paths, times))
    delay[3, 5:9] = np.nan
    return PathTable(
        times=np.arange(times) / 100.0, source=rng.integers(0, 2, paths, dtype=np.int32),
        receiver=rng.integers(0, 3, paths, dtype=np.int32), order=np.full(paths, order, dtype=np.int32),
        interactions=np.zeros((paths, order), dtype=np.int8), objects=rng.integers(0, 6, (paths, order), dtype=np.int8),
        direct=np.zeros(paths, dtype=np.bool_), delay=delay, doppler_factor=rng.random((paths, times)),
        doppler_shift=rng.random((paths, times)), gain=rng.random((paths, times)),
        departure=rng.random((paths, times, 3)), arrival=rng.random((paths, times, 3)),
        source_names=("robot", "beacon"), receiver_names=("a", "b", "the one with the long name"), object_names=WALLS,
    )  # fmt: skip


def test_parquet_is_written_in_pieces(tmp_path, rng: np.random.Generator) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    table = large_table(rng, paths=301, times=1000, order=30)
    write_table(
        large_table(rng, paths=9, times=9, order=2), tmp_path / "first.parquet"
    )  # loads pyarrow and its friends
    tracemalloc.start()
    try:
        write_table(table, tmp_path / "t.parquet")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # 100 000 rows of 16 columns, 8 bytes each, and a copy of one: 14 MB. Walls as text of four bytes a character,
    # all rows at once, would be 200 MB.
    assert peak < 30e6
    groups = parquet.ParquetFile(tmp_path / "t.parquet").metadata
    assert max(groups.row_group(i).num_rows for i in range(groups.num_row_groups)) <= 100_000


def test_parquet_pieces_join_without_a_seam(tmp_path, rng: np.random.Generator) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    table = large_table(rng, paths=301, times=1000, order=3)
    write_table(table, tmp_path / "t.parquet")
    read = parquet.read_table(tmp_path / "t.parquet")
    heard = np.isfinite(table.delay)
    assert read.num_rows == heard.sum() == 301_000 - 4
    path, time = np.nonzero(heard)
    np.testing.assert_array_equal(read["path"].to_numpy(), path)
    np.testing.assert_array_equal(read["times"].to_numpy(), table.times[time])
    np.testing.assert_array_equal(read["delay"].to_numpy(), table.delay[heard])
    np.testing.assert_array_equal(read["departure_y"].to_numpy(), table.departure[heard][:, 1])
    for name, names, index in (
        ("source", table.source_names, table.source),
        ("receiver", table.receiver_names, table.receiver),
    ):
        assert read[name].to_pylist() == [names[i] for i in index[path]]
    ways = [",".join(WALLS[w] for w in row) for row in table.objects]
    assert read["objects"].to_pylist() == [ways[p] for p in path]
    assert set(read["interactions"].to_pylist()) == {"0,0,0"}


RATE = 192e3


def centres(raster) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of the rows and times of the columns."""
    rows, columns = raster.level.shape
    frequencies = raster.low + (np.arange(rows) + 0.5) * (raster.high - raster.low) / rows
    return frequencies, (np.arange(columns) + 0.5) * raster.duration / columns


@pytest.mark.parametrize("band", [(39e3, 41e3), (0.0, 96e3)])
def test_a_sine_has_its_level_at_its_frequency(band: tuple[float, float]) -> None:
    tone = np.sqrt(2.0) * np.sin(2 * np.pi * 40.4e3 * np.arange(100_000) / RATE)
    raster = spectrogram(tone, RATE, band)
    # 1 Pa rms. Between two bins a Hann window loses up to 1.43 dB; it never gains but by its own other half, -90 dB.
    peaks = raster.level.max(axis=0)
    assert np.all(peaks < 20 * np.log10(1.0 / 20e-6) + 0.01)
    assert np.all(peaks > 20 * np.log10(1.0 / 20e-6) - 1.43)
    frequencies, _ = centres(raster)
    height = (raster.high - raster.low) / len(frequencies)
    np.testing.assert_allclose(frequencies[raster.level.argmax(axis=0)], 40.4e3, atol=height)


@pytest.mark.parametrize("offset", [-400.0, 0.0, 300.0])
def test_an_envelope_has_its_level_at_its_offset(offset: float) -> None:
    envelope = np.sqrt(2.0) * np.exp(2j * np.pi * offset * np.arange(8000) / 2000.0)
    raster = spectrogram(envelope.astype(np.complex64), 2000.0, (-1000.0, 1000.0), 200)
    peaks, level = raster.level.max(axis=0), 20 * np.log10(1.0 / 20e-6)
    assert np.all((peaks < level + 0.01) & (peaks > level - 1.43))
    frequencies, _ = centres(raster)
    height = (raster.high - raster.low) / len(frequencies)
    np.testing.assert_allclose(frequencies[raster.level.argmax(axis=0)], offset, atol=height)
    assert (raster.low, raster.high) == pytest.approx((-1000.0, 1000.0), abs=2 * height)


def test_white_noise_has_its_density(rng: np.random.Generator) -> None:
    noise = rng.normal(size=400_000)
    segment = 1024
    raster = spectrogram(noise, RATE, (10e3, 20e3), segment)
    power = np.mean(10 ** (raster.level / 10)) * (20e-6) ** 2
    # Variance 1 over 96 kHz, in a window's noise bandwidth of 1.5 bins of 187.5 Hz.
    # 400 000 / 1024 * 53 independent values: a deviation of 1 %.
    assert power == pytest.approx(1.5 * RATE / segment / 96e3, rel=0.05)


def test_a_click_is_in_its_column() -> None:
    sound = np.zeros(200_000)
    sound[150_000] = 1.0
    raster = spectrogram(sound, RATE, (0.0, 96e3), 512)
    _, times = centres(raster)
    # The click lies within the windows, 512 samples long, of its columns alone.
    power = 10 ** (raster.level.max(axis=0).astype(np.float64) / 10)
    assert (power @ times) / power.sum() == pytest.approx(150_000 / RATE, abs=raster.duration / len(times))
    assert np.all(raster.level[:, np.abs(times - 150_000 / RATE) > 512 / RATE] < 0.0)


class Long:
    """Silence, which counts what is read at once."""

    def __init__(self, duration: float) -> None:
        self.count = int(duration * RATE)
        self.largest = 0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, part: slice) -> np.ndarray:
        self.largest = max(self.largest, part.stop - part.start)
        return np.zeros(part.stop - part.start, dtype=np.float32)


@pytest.mark.parametrize(("duration", "band"), [(60.0, (0.0, 96e3)), (10.0, (39.9e3, 40.1e3)), (5.0, (40e3, 40e3))])
def test_long_sound_is_read_in_pieces(duration: float, band: tuple[float, float]) -> None:
    sound = Long(duration)
    raster = spectrogram(sound, RATE, band)
    assert raster.level.shape[0] <= 600
    assert raster.level.shape[1] <= 1200
    assert 0 < sound.largest <= 65536


@pytest.mark.parametrize("count", [1, 3, 130])
def test_short_sound(count: int) -> None:
    raster = spectrogram(np.ones(count), RATE, (0.0, 96e3))
    assert np.all(np.isfinite(raster.level))


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
    write_wav(path, 500e3, samples)
    read, rate = soundfile.read(path, dtype="float32")
    assert rate == 500_000
    np.testing.assert_array_equal(read, samples)


def test_interrupted_files_leave_nothing(tmp_path) -> None:
    def interrupted() -> None:
        with atomic_path(tmp_path / "a.wav") as temporary:
            write_wav(temporary, 192e3, np.zeros(10, dtype=np.float32))
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
        write_wav(tmp_path / "a.wav", 44_100.5, np.zeros(3))
    sound = clsim.Recording(np.zeros((1, 3), np.float32), 44_100, ("r",), None, ())
    with pytest.raises(FileNotFoundError, match=r"No such file or directory: '.*a\.wav'"):
        sound.save(tmp_path / "missing" / "a.wav")
    (tmp_path / "folder.wav").mkdir()
    with pytest.raises(IsADirectoryError, match=r"folder\.wav'$"):
        sound.save(tmp_path / "folder.wav")
    assert list(tmp_path.iterdir()) == [tmp_path / "folder.wav"]


@pytest.mark.parametrize("names", [(), ("a", "b"), ("a", "bc")])  # of an even and an odd number of bytes
def test_wav_beyond_4_gib_is_rf64(tmp_path, names: tuple[str, ...]) -> None:
    rows = len(names) or 1
    (tmp_path / "large.wav").write_bytes(wav_header(192e3, rows, 2**30, names) + np.ones((3, rows), "<f4").tobytes())
    assert soundfile.info(tmp_path / "large.wav").format == "RF64"
    np.testing.assert_array_equal(soundfile.read(tmp_path / "large.wav", 3)[0], np.ones((3, rows)).squeeze())


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
    spectrogram_picture(np.exp(1j * tone), 192e3, tmp_path / "h.png", title="envelope", carrier=40e3)
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
