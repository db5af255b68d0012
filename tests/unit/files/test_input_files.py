"""Files that users name: what would hang or eat memory is refused before it is read."""

import io
import os
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import soundfile

import clsim
from clsim import AxialDirectivity, InputError, MeshRoom, Signal, Trajectory
from clsim.files.input_files import check_file, read_file, read_toml
from clsim.scene.receiver_array import positions_from_file
from clsim.scene_file import load_scene

READERS = {
    "scene.toml": load_scene,
    "poses.csv": lambda path: Trajectory.from_file(path, "csv"),
    "room.obj": lambda path: MeshRoom.from_file(path, materials=clsim.Material.from_reflection(0.9)),
    "room.stl": lambda path: MeshRoom.from_file(path, materials=clsim.Material.from_reflection(0.9)),
    "beam.csv": AxialDirectivity.from_csv,
    "beam.npz": AxialDirectivity.from_npz,
    "beam.mat": AxialDirectivity.from_mat,
    "beam.sofa": clsim.SphericalDirectivity.from_sofa,
    "places.txt": positions_from_file,
    "sound.wav": Signal.from_wav,
}


@pytest.mark.parametrize("name", READERS)
def test_named_pipes_and_devices_are_no_files(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match="it is a named pipe, not a file"):
        READERS[name](tmp_path / name)
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to("/dev/zero")
    with pytest.raises(InputError, match="it is a device, not a file"):
        READERS[name](tmp_path / name)


def test_what_is_no_file_is_named_without_the_package_that_would_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "netCDF4", None)
    with pytest.raises(InputError, match="No such file"):
        READERS["beam.sofa"](tmp_path / "beam.sofa")


@pytest.mark.parametrize("name", READERS)
def test_files_that_are_too_large_are_not_read(name: str, tmp_path: Path) -> None:
    with (tmp_path / name).open("wb") as file:
        file.truncate(2**36)  # without a byte on the disk
    with pytest.raises(InputError, match=r"MiB, and .* are the most that is read"):
        READERS[name](tmp_path / name)


def test_names_that_no_file_can_have_are_told(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="no file can be called"):
        check_file(tmp_path / "a\0b", 1)
    with pytest.raises(OSError, match="Is a directory"):
        check_file(tmp_path, 1)


def test_a_file_without_a_size_is_read_up_to_the_bound() -> None:
    assert len(read_file("/proc/self/maps", 100)) == 101


def claiming(samples: int) -> bytes:
    """Return a FLAC file that says that it holds so many samples."""
    file = io.BytesIO()
    soundfile.write(file, np.sin(np.arange(2000) / 5.0), 48_000, format="FLAC")
    data = bytearray(file.getvalue())
    data[21] = (data[21] & 0xF0) | samples >> 32
    data[22:26] = struct.pack(">I", samples & 0xFFFFFFFF)
    return bytes(data)


@pytest.mark.parametrize("samples", [2**36 - 1, 2**28 + 1, 10**8])
def test_sound_that_claims_more_than_its_bytes_hold_is_refused(samples: int, tmp_path: Path) -> None:
    path = tmp_path / "sound.flac"
    path.write_bytes(claiming(samples))
    with pytest.raises(InputError, match=f"path: must hold sound, .* says that it holds {samples} samples"):
        Signal.from_wav(path)


def test_sound_that_ends_before_it_says_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sound.flac"
    path.write_bytes(claiming(2000))
    assert Signal.from_wav(path).count == 2000
    path.write_bytes(claiming(200_000))
    with pytest.raises(InputError, match="path: must be "):
        Signal.from_wav(path)


@pytest.mark.parametrize("frames", [700_000, 10_000])
def test_an_mp3_that_claims_more_than_its_bytes_hold_is_refused(frames: int, tmp_path: Path) -> None:
    file = io.BytesIO()
    soundfile.write(file, np.sin(np.arange(20_000) / 5.0), 48_000, format="MP3")
    data = bytearray(file.getvalue())
    at = max(data.find(b"Xing"), data.find(b"Info"))
    (tmp_path / "sound.mp3").write_bytes(data)
    assert Signal.from_wav(tmp_path / "sound.mp3").count == 20_000
    data[at + 8 : at + 12] = struct.pack(">I", frames)
    (tmp_path / "sound.mp3").write_bytes(data)
    with pytest.raises(InputError, match="path: must hold sound, and its bytes hold"):
        Signal.from_wav(tmp_path / "sound.mp3")


def test_archives_that_unpack_to_too_much_are_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "beam.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("values.npy", b"")
        archive.filelist[0].file_size = 2**29  # what the archive will say
    with pytest.raises(InputError, match=r"path: cannot be read: .*: it unpacks to 512 MiB"):
        AxialDirectivity.from_npz(path)
    path.rename(tmp_path / "room.zip")
    with pytest.raises(InputError, match=r"must be of a known format .* but ends with '\.zip'"):
        READERS["room.stl"](tmp_path / "room.zip")


def test_meshes_that_claim_or_name_too_much_are_refused(tmp_path: Path) -> None:
    import json

    def glb(header: dict) -> Path:
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        path = tmp_path / "room.glb"
        path.write_bytes(struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text)
        return path

    claimed = {"asset": {"version": "2.0"}, "accessors": [{"count": 10**9, "componentType": 5126, "type": "VEC3"}]}
    with pytest.raises(InputError, match="must hold at most 16777216 points, but says 1000000000"):
        READERS["room.stl"](glb(claimed))
    os.mkfifo(tmp_path / "skin.png")
    (tmp_path / "room.ply").write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    assert len(READERS["room.stl"](tmp_path / "room.ply").walls) == 1  # the picture is not needed, nor waited for


def test_a_file_that_ends_the_process_which_reads_it_is_refused(tmp_path: Path, monkeypatch) -> None:
    from scipy.io import savemat

    path = tmp_path / "beam.mat"
    savemat(path, {"angles": [0.0, 90.0], "frequencies": [40e3], "values": [[1.0], [0.5]]})
    killer = tmp_path / "mat_process.py"
    killer.write_text("import os\nos.abort()\n")
    monkeypatch.setattr("clsim.scene.directivity.text_files.__file__", str(tmp_path / "directivity_files.py"))
    with pytest.raises(
        InputError, match=r"path: must be a MATLAB file, but is not: .* \(reading it ends the process\)"
    ):
        AxialDirectivity.from_mat(path)


def test_a_matlab_file_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    path = tmp_path / "beam.mat"
    savemat(path, {"values": np.zeros((1000, 40_000), np.uint8)}, do_compression=True)  # told as if of float64
    with pytest.raises(InputError, match=r"must be a MATLAB file, but is not: .* it holds more than"):
        AxialDirectivity.from_mat(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = " + "[" * 3000 + "]" * 3000, "must not hold tables and lists so deep"),
        ("a = " + "[" * 100 + "]" * 100, r"a\[0\]\[0\].*: must not be deeper than 64"),
        ("a = 1" + "0" * 5000, "must hold numbers of 64 bits, but holds one of thousands of digits"),
        ("[a]\nb = [0, 1" + "0" * 400 + "]", r"^a\.b\[1\]: must be a number of 64 bits, but is one of 1329"),
        ("a = 0x" + "f" * 5000, "^a: must be a number of 64 bits, but is one of 20000"),
    ],
)
def test_toml_that_python_gives_up_on_is_told(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_toml(tmp_path / "a.toml")


def test_toml_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("seed = 18446744073709551615", "utf-8-sig")
    assert read_toml(tmp_path / "a.toml") == {"seed": 2**64 - 1}
