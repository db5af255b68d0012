"""Sound files that have been cut are refused, or taken as far as they go where that is asked for."""

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import soundfile
from exhaustive import few

import clsim
from clsim.errors import InputError
from clsim.files.sound import wav_header
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
    """As ffmpeg and SoX write into a pipe; and a byte of padding, which some writers leave out."""
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


@pytest.mark.parametrize(
    ("form", "subtype", "cuts"),
    [
        ("W64", "PCM_16", (1, 2, 3)), ("RF64", "FLOAT", (1, 2)), ("CAF", "FLOAT", (1, 2)), ("CAF", "PCM_16", (1, 5)),
        ("OGG", "VORBIS", (1, 2, 300)), ("WAV", "PCM_16", (1,)), ("AIFF", "PCM_16", (1,)), ("FLAC", "PCM_16", (1,)),
    ],
)  # fmt: skip
def test_a_cut_of_a_byte_is_one(
    form: str, subtype: str, cuts: tuple[int, ...], tmp_path: Path, rng: np.random.Generator
) -> None:
    """Of the last sample, or of the last page, some bytes are missing; a byte that was never wanted is no cut."""
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
