"""Files that users name: what would hang, eat memory or was cut is refused before it is read."""

import io
import os
import struct
import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import soundfile
from exhaustive import few

import clsim
from clsim import AxialDirectivity, InputError, MeshRoom, Signal, Trajectory
from clsim.files.input_files import check_file, read_file, read_toml
from clsim.files.sound import wav_header
from clsim.scene.receiver_array import positions_from_file
from clsim.scene_file import load_scene

if TYPE_CHECKING:
    from collections.abc import Callable


COUNT, RATE = 48_000, 48_000
FORMATS = ["WAV", "WAVEX", "RF64", "AIFF", "W64", "AU", "CAF", "SVX", "MP3", "OGG", "FLAC"]
OPEN_ENDED = 2**32 - 1


def written(folder: Path, form: str, rng: np.random.Generator, count: int = COUNT) -> Path:
    path = folder / f"sound.{form}"
    soundfile.write(path, rng.uniform(-0.5, 0.5, count), RATE, format=form)
    return path


@pytest.mark.parametrize("form", few(FORMATS, kept=(0, 2, 3, 4, 5, 8, 9)))
def test_a_file_that_was_cut_is_refused(form: str, tmp_path: Path, rng: np.random.Generator) -> None:
    path = written(tmp_path, form, rng, 10 * COUNT if form in ("OGG", "MP3") else COUNT)
    data = path.read_bytes()
    clsim.Signal.from_wav(path)
    for share in (0.5, 0.8, 0.98):
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(InputError, match=r"^path: must be"):
            clsim.Signal.from_wav(path)


@pytest.mark.parametrize("form", few(["WAV", "MP3", "RF64", "AIFF", "W64", "AU", "OGG"], kept=(0, 1)))
def test_what_is_there_is_taken_where_that_is_asked_for(form: str, tmp_path: Path, rng: np.random.Generator) -> None:
    path = written(tmp_path, form, rng, 10 * COUNT)
    whole = clsim.Signal.from_wav(path).read(0, 10 * COUNT)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    part = clsim.Signal.from_wav(path, truncated=True)
    assert 0.4 * len(whole) < part.count < 0.55 * len(whole)
    most = part.count - 2000  # of compressed sound the last blocks lack what follows
    assert np.array_equal(part.read(0, most), whole[:most])


def test_of_every_maker(tmp_path: Path) -> None:
    path = tmp_path / "pulse.wav"
    soundfile.write(path, 0.5 * np.exp(-np.arange(400) / 20.0), RATE, subtype="FLOAT")
    path.write_bytes(path.read_bytes()[:-800])
    makers: list[Callable[..., Any]] = [clsim.Transducer.from_wav, clsim.Material.from_wav, clsim.Signal.from_wav]
    for make in makers:
        more = {"scale": 0.01, "outside": "hold"} if make == clsim.Material.from_wav else {}
        with pytest.raises(InputError, match="ends 800 bytes before its header says; truncated=True takes"):
            make(path, **more)
        make(path, truncated=True, **more)
    text = """
format = 1
room = { kind = "shoebox", size = [4, 3, 2], walls = { reflection = 0.5 } }
receivers = [{ name = "r", trajectory = { kind = "fixed", position = [2, 1, 1] } }]
paths = { max_order = 1 }
render = { sampling_rate = 48000 }
[[sources]]
name = "s"
trajectory = { kind = "fixed", position = [1, 1, 1] }
signal = { kind = "wav", path = "pulse.wav", truncated = true }
"""
    (tmp_path / "scene.toml").write_text(text, "utf-8")
    assert load_scene(tmp_path / "scene.toml").scene.sources[0].signal.count == 200
    (tmp_path / "scene.toml").write_text(text.replace(", truncated = true", ""), "utf-8")
    with pytest.raises(InputError, match=r"sources\[0\]\.signal\.path: must be whole"):
        load_scene(tmp_path / "scene.toml")


def test_lengths_that_nobody_knew_and_padding_are_no_cuts(tmp_path: Path) -> None:
    """Headers as ffmpeg and SoX write into a pipe; and a byte of padding, which some writers leave out."""
    path, samples = tmp_path / "piped.wav", np.zeros(1000, np.float32).tobytes()
    for told in (OPEN_ENDED, 2**31 - 4096):
        header = bytearray(wav_header(RATE, 1, 1000))
        header[4:8], header[-4:] = struct.pack("<I", min(told + 36, OPEN_ENDED)), struct.pack("<I", told)
        path.write_bytes(bytes(header) + samples)
        assert clsim.Signal.from_wav(path).count == 1000
    soundfile.write(path, np.zeros(1001), RATE, subtype="PCM_U8")
    data = path.read_bytes()
    path.write_bytes(data[:-1] if len(data) % 2 == 0 else data)
    assert clsim.Signal.from_wav(path).count == 1001


def mp3(folder: Path, rng: np.random.Generator, channels: int, rate: int, mode: str = "CONSTANT") -> bytes:
    path = folder / "made.mp3"
    samples = rng.uniform(-0.5, 0.5, (rate // 2, channels))
    soundfile.write(path, samples, rate, format="MP3", bitrate_mode=mode)
    return path.read_bytes()


TAGS = {"none": (b"", b""), "of both kinds": (b"ID3\x04\0\0\0\0\x01\x02" + bytes(130), b"TAG" + bytes(125))}


@pytest.mark.parametrize("tags", TAGS)
@pytest.mark.parametrize(("channels", "rate", "mode"), few([
    (1, 44100, "CONSTANT"), (2, 44100, "CONSTANT"), (1, 24000, "VARIABLE"), (2, 8000, "CONSTANT"), (2, 48000, "VARIABLE")
], kept=(0, 2)))  # fmt: skip
def test_a_cut_mp3_is_refused_to_the_byte(channels: int, rate: int, mode: str, tags: str, tmp_path, rng) -> None:
    """Cuts are seen in a tag of the title, in the last frame, and between frames; a tag that was cut costs no sound."""
    path, sound = tmp_path / "sound.mp3", mp3(tmp_path, rng, channels, rate, mode)
    before, behind = TAGS[tags]
    for whole in (before + sound + behind, before + sound + behind[:60], before + sound):
        path.write_bytes(whole)
        assert clsim.Signal.from_wav(path).count == rate // 2
    for cut in (1, 2, 3, 4, 40, 300, 1000, len(sound) // 2):
        path.write_bytes((before + sound)[:-cut])
        with pytest.raises(InputError, match=r"^path: must be whole, but .* bytes before its header says; truncated="):
            clsim.Signal.from_wav(path)
        assert clsim.Signal.from_wav(path, truncated=True).count


def test_an_mp3_without_a_length_is_refused_within_a_frame_and_warned_of_else(tmp_path, rng) -> None:
    """Frames of 417 or 418 bytes: 144 * 128000 / 44100, and a byte of padding in some."""
    path, sound = tmp_path / "sound.mp3", mp3(tmp_path, rng, 1, 44100)
    frames = sound[sound.index(b"\xff\xfb", 4) :]  # without the first one, which has the header
    path.write_bytes(frames)
    with pytest.warns(clsim.ClsimWarning, match="does not state its length"):
        clsim.Signal.from_wav(path)
    for cut in (1, 2, 100, 200):
        path.write_bytes(frames[:-cut])
        with pytest.raises(InputError, match="ends within a frame; truncated=True"):
            clsim.Signal.from_wav(path)
    # A header that gives frames alone: a cut between two of them.
    at = max(sound.find(b"Info"), sound.find(b"Xing"))
    known = sound[: at + 7] + b"\x01" + sound[at + 8 :]
    last = max(i for i in range(len(sound) - 420, len(sound)) if sound[i : i + 2] == b"\xff\xfb")
    path.write_bytes(known)
    clsim.Signal.from_wav(path)
    path.write_bytes(known[:last])
    with pytest.raises(InputError, match="ends 1 frames before its header says"):
        clsim.Signal.from_wav(path)


@pytest.mark.parametrize("form", ["VOC", "NIST", "PAF", "IRCAM", "AVR"])
def test_formats_that_do_not_tell_their_length_are_warned_of(form: str, tmp_path, rng) -> None:
    path = tmp_path / "sound"
    soundfile.write(path, rng.uniform(-0.5, 0.5, 1000), 8000, format=form, subtype="PCM_16")
    with pytest.warns(clsim.ClsimWarning, match=r"sound does not state its length \("):
        clsim.Signal.from_wav(path)


@pytest.mark.parametrize(
    ("form", "subtype", "cuts"),
    [
        ("W64", "PCM_16", (1, 2, 3)), ("RF64", "FLOAT", (1, 2)), ("CAF", "FLOAT", (1, 2)), ("CAF", "PCM_16", (1, 5)),
        ("OGG", "VORBIS", (1, 2, 300)), ("WAV", "PCM_16", (1,)), ("AIFF", "PCM_16", (1,)), ("FLAC", "PCM_16", (1,)),
    ],
)  # fmt: skip
def test_a_cut_of_a_byte_is_one(form: str, subtype: str, cuts: tuple[int, ...], tmp_path, rng) -> None:
    """Some bytes of the last sample or of the last page are missing; a missing byte of padding is no cut."""
    path = tmp_path / "sound"
    soundfile.write(path, rng.uniform(-0.5, 0.5, COUNT), RATE, format=form, subtype=subtype)
    data = path.read_bytes()
    for more in (b"", b"\0"):
        path.write_bytes(data + more)
        assert clsim.Signal.from_wav(path).count == COUNT
    for cut in cuts:
        path.write_bytes(data[:-cut])
        with pytest.raises(InputError, match=r"^path: must be"):
            clsim.Signal.from_wav(path)


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


def test_what_is_no_file_is_named_without_the_package_that_would_read_it(tmp_path, monkeypatch) -> None:
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
