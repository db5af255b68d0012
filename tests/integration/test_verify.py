"""Stored sound in which a bit has changed is refused."""

import gc
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from exhaustive import few

import clsim
from clsim.cli import main
from clsim.study.file import load_study
from clsim.study.member import STORE, changed_results, row_of_group, run_member, study_to_settings
from clsim.study.run import create_store

pytestmark = [pytest.mark.usefixtures("device")]
TONE = {"kind": "tone", "frequency": 16e3, "duration": 0.02, "sampling_rate": 48e3, "fade": 0.005}
SCENE: dict[str, Any] = {
    "format": 1, "room": {"kind": "shoebox", "size": [4.0, 3.0, 2.0], "walls": {"reflection": 0.8}},
    "sources": [{"name": "s", "signal": TONE, "trajectory": {"kind": "fixed", "position": [1.0, 1.0, 1.0]}}],
    "receivers": [{"name": n, "trajectory": {"kind": "fixed", "position": [3.0, y, 1.0]}} for n, y in (("a", 1.0), ("b", 2.0))],
    "paths": {"max_order": 1}, "render": {"sampling_rate": 48e3},
}  # fmt: skip
FLIPS = int(os.environ.get("CLSIM_FLIPS", "10"))  # of each kind of store


def made(folder: Path, store: str, **render: Any) -> Path:
    scene = SCENE | {"render": SCENE["render"] | render}
    (folder / "scene.toml").write_text(tomli_w.dumps(scene), "utf-8")
    out = folder / "out"
    assert (
        main(["run", str(folder / "scene.toml"), "-o", str(out), "--store", store, "--no-plots", "--table", "none"])
        == 0
    )
    return out


def sound_files(out: Path) -> list[Path]:
    chunks = [path for path in (out / "recording.zarr" / "sound" / "c").rglob("*") if path.is_file()]
    return chunks or [*out.glob("*.wav")]


def refused(out: Path, **options: Any) -> bool:
    try:
        clsim.load_recording(out, **options)
    except clsim.InputError as error:
        assert error.field == "folder"
        return True
    return False


@pytest.mark.parametrize("store", ["zarr", "wav"])
def test_a_flipped_bit(store: str, tmp_path: Path, rng: np.random.Generator, capsys: Any) -> None:
    out = made(tmp_path, store)
    assert not refused(out, verify=True)
    assert main(["verify", str(out)]) == 0
    silent = 0
    for k in range(FLIPS):
        path = sound_files(out)[k % len(sound_files(out))]
        whole = path.read_bytes()
        data, at = bytearray(whole), int(rng.integers(8 * len(whole)))
        data[at // 8] ^= 1 << at % 8
        path.write_bytes(data)
        silent += not refused(out)
        assert refused(out, verify=True)
        if k < 2:
            capsys.readouterr()
            assert main(["verify", str(out)]) == 1
            assert "has changed since" in capsys.readouterr().out
        path.write_bytes(whole)
    assert not refused(out, verify=True)
    if store == "zarr":  # whose chunks have checksums
        assert silent == 0


def test_a_store_without_checksums_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsim.output.stores._compressors", lambda: "auto")  # as they were written before
    assert not refused(made(tmp_path, "zarr"), verify=True)


def chunks_of(path: Path) -> list[tuple[int, int]]:
    """First byte and length of each chunk of the sound, found by its samples: those of the file in one piece."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path) as file:
        samples, chunks = file["sound"][:], file["sound"].chunks
    whole, found = path.read_bytes(), []
    for row in samples:
        for k in range(0, len(row), chunks[1]):
            content = row[k : k + chunks[1]]
            if content.any():
                found.append((whole.index(content.tobytes()), 4 * chunks[1]))
    return found


@pytest.mark.parametrize("flips", few([6, 40], kept=(0,)))
def test_a_flipped_bit_in_an_hdf5_file_is_refused_without_an_option(flips: int, tmp_path, rng) -> None:
    """Bits of samples and of checksums, in several chunks of each receiver."""
    out = made(tmp_path, "hdf5", chunk=1, sampling_rate=192e3)
    path = out / "recording.h5"
    whole, places = path.read_bytes(), chunks_of(path)
    assert len(places) == len(set(places)) >= 2
    assert not refused(out)
    for k in range(flips):
        begin, length = places[k % len(places)]
        data, at = bytearray(whole), int(rng.integers(8 * begin, 8 * (begin + length + 4)))
        data[at // 8] ^= 1 << at % 8
        path.write_bytes(data)
        with pytest.raises(clsim.InputError, match="must hold the sound that was written, but") as error:
            clsim.load_recording(out)
        assert "\n" not in str(error.value)
    path.write_bytes(whole)
    assert main(["verify", str(out)]) == 0


def test_damaged_attributes_of_an_hdf5_file_are_one_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its package reports what it cannot close, as a traceback, when the file is collected."""
    pytest.importorskip("h5netcdf")
    out = made(tmp_path, "hdf5")
    path = out / "recording.h5"
    whole, said = path.read_bytes(), []
    monkeypatch.setattr(sys, "unraisablehook", said.append)
    for at in (96, 224, 352, len(whole) // 2):
        path.write_bytes(whole[:at] + b"\xff" * 16 + whole[at + 16 :])
        assert refused(out) or at > 352
        gc.collect()
        assert said == []


LOADING = """
import sys
import clsim
for folder in sys.argv[1:]:
    try:
        clsim.load_recording(folder)
    except clsim.InputError as error:
        print(error)
"""


def test_a_damaged_list_of_strings_of_an_hdf5_file_is_refused(tmp_path: Path) -> None:
    """The HDF5 library does not return from one whose free space, or an object, has no length: in a process of its own."""
    pytest.importorskip("h5netcdf")
    out = made(tmp_path, "hdf5")
    path = out / "recording.h5"
    whole = path.read_bytes()
    heap = whole.index(b"GCOL")
    free = heap + 16
    while whole[free]:
        free += 16 + -(-int.from_bytes(whole[free + 8 : free + 16], "little") // 8) * 8
    folders = [out, shutil.copytree(out, tmp_path / "other")]
    for folder, at, size in zip(folders, (free, heap + 16), (0, 2**64 - 16), strict=True):
        damaged = whole[: at + 8] + size.to_bytes(8, "little") + whole[at + 16 :]
        (folder / path.name).write_bytes(damaged)
    line = [sys.executable, "-c", LOADING, *map(str, folders)]
    told = subprocess.run(line, capture_output=True, text=True, timeout=60)
    lines = told.stdout.splitlines()
    assert [line.startswith("folder: must be a store of clsim") for line in lines] == [True, True], told.stderr


def test_an_hdf5_file_of_one_block_is_read(tmp_path: Path) -> None:
    """A store as earlier versions wrote it; its library writes the same variables anew, without chunks."""
    h5py = pytest.importorskip("h5py")
    out = made(tmp_path, "hdf5")
    wanted = clsim.load_recording(out).samples
    with h5py.File(out / "recording.h5", "r+") as file:
        new = file.create_dataset("block", data=file["sound"][:])
        for name, value in file["sound"].attrs.items():
            if name not in ("DIMENSION_LIST", "_Netcdf4Coordinates", "_Netcdf4Dimid"):
                new.attrs[name] = value
        del file["sound"]
        file.move("block", "sound")
        for axis, scale in enumerate(("receiver", "time")):
            file["sound"].dims[axis].attach_scale(file[scale])
        assert file["sound"].chunks is None
    np.testing.assert_array_equal(clsim.load_recording(out).samples, wanted)
    assert wanted.any()


def test_a_chunk_that_is_missing_is_no_silence(tmp_path: Path) -> None:
    """Also one of zeros, behind the sound."""
    out = made(tmp_path, "zarr", chunk=1, duration=1.0)
    samples = clsim.load_recording(out).samples
    assert samples.any()
    assert not samples[:, -1000:].any()
    for path in (sorted(sound_files(out))[0], sorted(sound_files(out))[-1]):
        moved = path.rename(tmp_path / "moved")
        assert refused(out)
        with pytest.raises(clsim.InputError, match=r"chunks of .*recording\.zarr are missing"):
            clsim.open_store(out)
        moved.rename(path)
    assert not refused(out)


def test_a_chunk_that_is_missing_in_a_study(study_made: Path) -> None:
    """`verify` names its array, `open_store` refuses it, and going on runs that member again."""
    sound = study_made / "study.zarr" / "m000001" / "sound"
    whole = clsim.open_store(sound.parent).sound.values
    next(path for path in sorted((sound / "c").rglob("*")) if path.is_file()).unlink()
    assert changed_results(study_made / STORE)[0] == ["study.zarr/m000001/sound"]
    with pytest.raises(clsim.InputError, match=r"chunks of .* are missing"):
        clsim.open_store(sound.parent)
    assert row_of_group(sound.parent) is None  # so that it is run again
    assert row_of_group(sound.parents[1] / "m000000") is not None
    assert whole.any()


def test_changed_metadata_of_a_study(study_made: Path, capsys: Any) -> None:
    """Damages of the store, a member and an array: a bit that leaves JSON, white space, missing metadata, a missing member."""
    store = study_made / STORE
    assert main(["verify", str(study_made)]) == 0
    for path, old, new in (
        (store / "zarr.json", b'"0.', b'"1.'),
        (store / "zarr.json", b"}", b"} "),
        (store / "m000001" / "zarr.json", b"amplitude = 2.0", b"amplitude = 3.0"),
        (store / "m000001" / "zarr.json", b"sha256", b"sha257"),
        (store / "m000001" / "sound" / "zarr.json", b"float32", b"int32"),
    ):
        whole = path.read_bytes()
        assert old in whole
        path.write_bytes(whole.replace(old, new, 1))
        capsys.readouterr()
        assert main(["verify", str(study_made)]) == 1
        group = "study.zarr" if path.parent == store else "study.zarr/m000001"
        assert capsys.readouterr().out.startswith(f"{study_made / group}: has changed since it was written")
        assert group == "study.zarr" or row_of_group(store / "m000001") is None  # it is run again
        path.unlink()
        assert main(["verify", str(study_made)]) == 1
        path.write_bytes(whole)
    assert main(["verify", str(study_made)]) == 0
    (study_made / "index.jsonl").write_text('{"member": 1, "status": "finished"}\n', "utf-8")
    (store / "m000001").rename(store.parent / "moved")
    assert main(["verify", str(study_made)]) == 1
    assert "m000001: has changed since it was written, or is missing" in capsys.readouterr().out


@pytest.fixture
def study_made(tmp_path: Path) -> Path:
    """Two members, made in this process, as a worker makes them."""
    pytest.importorskip("zarr")
    out = tmp_path / "out"
    out.mkdir()
    write_study(tmp_path)
    (out / "study.json").write_text(json.dumps(study_to_settings(load_study(tmp_path / "study.toml"))), "utf-8")
    create_store(out)
    for number in range(2):
        assert run_member(str(out), number, None)["status"] == "finished"
    return out


def write_study(folder: Path) -> None:
    (folder / "scene.toml").write_text(tomli_w.dumps(SCENE), "utf-8")
    study = {
        "format": 1, "scene": "scene.toml", "keep": ["recording"],
        "vary": [{"field": "sources[0].signal.amplitude", "values": [1.0, 2.0]}],
    }  # fmt: skip
    (folder / "study.toml").write_text(tomli_w.dumps(study), "utf-8")


@pytest.mark.exhaustive
def test_a_flipped_bit_in_a_study(tmp_path: Path, capsys: Any) -> None:
    write_study(tmp_path)
    out = tmp_path / "out"
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(out), "--workers", "1"]) == 0
    assert main(["verify", str(out)]) == 0
    path = next(path for path in (out / "study.zarr" / "m000001" / "sound" / "c").rglob("*") if path.is_file())
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    capsys.readouterr()
    assert main(["verify", str(out)]) == 1
    assert "m000001/sound: has changed" in capsys.readouterr().out
    assert main(["verify", str(tmp_path)]) == 2
