"""Sound files: reading of users' files, and WAV files of 32-bit floats."""

from __future__ import annotations

import mmap
import os
import re
import struct
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import LOUDEST, as_flag, as_number
from clsim.errors import InputError, warn
from clsim.files.input_files import check_file

_BIT_RATES = {  # kbit/s of layer III, by whether it is MPEG 1
    True: (0, 32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320),
    False: (0, 8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160),
}
_RATES = {3: (44100, 48000, 32000), 2: (22050, 24000, 16000), 0: (11025, 12000, 8000)}  # Hz, by version
_MONO = 3
_HAS_FRAMES, _HAS_BYTES = 1, 2  # flags of the encoder's header


def _frame_length(header: bytes) -> int:
    """Length of the frame with this header of four bytes; 0 if it is none of layer III, or of free bit rate."""
    if len(header) < 4 or header[0] != 0xFF or header[1] & 0xE6 != 0xE2:
        return 0
    version, rate, index = header[1] >> 3 & 3, header[2] >> 2 & 3, header[2] >> 4
    if version not in _RATES or rate == 3 or index in (0, 15):
        return 0
    first = version == 3
    bits = _BIT_RATES[first][index] * 1000
    return (144 if first else 72) * bits // _RATES[version][rate] + (header[2] >> 1 & 1)


def _begin(data: mmap.mmap) -> int:
    """Byte at which the first frame begins, behind all ID3v2 tags."""
    at = 0
    while data[at : at + 3] == b"ID3" and len(data) >= at + 10:
        flags, a, b, c, d = data[at + 5 : at + 10]
        at += 10 + (a << 21 | b << 14 | c << 7 | d) + (10 if flags & 16 else 0)
    return at


def _declared(frame: bytes) -> tuple[int, int]:
    """Frames and bytes that a Xing or Info header declares; 0 for what it leaves out."""
    first, mono = frame[1] & 8, frame[3] >> 6 == _MONO
    at = 4 + ((17 if mono else 32) if first else (9 if mono else 17))
    if frame[at : at + 4] not in (b"Xing", b"Info"):
        return 0, 0
    (flags,) = struct.unpack(">I", frame[at + 4 : at + 8])
    values = iter(struct.unpack(">II", frame[at + 8 : at + 16]))
    frames = next(values) if flags & _HAS_FRAMES else 0
    return frames, next(values) if flags & _HAS_BYTES else 0


def cut_of_mp3(path: str | PathLike[str]) -> tuple[str, bool]:
    """Look for a cut at the end of an MP3 file: its description, or "", and whether the file declares a length."""
    # ISO/IEC 11172-3, 2.4.2.3, header of a frame; the Xing header as LAME writes it: flags, frames, bytes. Without a
    # declaration a file that was cut between two frames looks whole.
    with Path(path).open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as data:
        size, begin = len(data), _begin(data)
        length = _frame_length(data[begin : begin + 4])
        if not length:  # something before the first frame that is unknown here
            return "", False
        frames, octets = _declared(data[begin : begin + length].ljust(64, b"\0"))
        if begin + octets > size:
            return f"ends {begin + octets - size} bytes before its header says", True
        at, count = begin, 0
        while length := _frame_length(data[at : at + 4]):
            at, count = at + length, count + 1
        if at > size or (size - at < 4 and data[at : at + 1] == b"\xff"):
            return "ends within a frame", bool(frames or octets)
        missing = frames - (count - 1)  # the header is in a frame of its own
        if frames and at == size and missing > 0:
            return f"ends {missing} frames before its header says", True
        return "", bool(frames or octets)


_LARGEST = 2**35  # bytes of a file, whatever its channels
_LONGEST = 2**28  # samples of a channel, 1 GiB: 23 minutes at 192 kHz
_MOST_PER_BYTE, _MPEG_PER_BYTE = 5000, 25  # samples: silence in FLAC, and 24 kHz at 8 kbit/s
_BLOCK = 2**20  # samples of all channels read at a time
# What libsndfile notes of a chunk that is longer than the rest of the file.
_CUT = re.compile(r"^ *([\w .]+?) *: (\d+) \(should be (\d+)\)", re.MULTILINE)
_WHOLE_FILE = {"RIFF": 1, "Riff size": 1, "FORM": 1, "riff": 7}  # bytes of padding that writers leave out at the end
# Lengths that programs write which do not know them, as they write into a pipe: of ffmpeg and of AU; of SoX.
_UNKNOWN = (range(2**32 - 1, 2**32), range(2**31 - 4096, 2**31))
_OGG_PAGE, _LAST_PAGE = 27 + 255 + 255 * 255, 4  # bytes of a page at most, and the flag of the last one
# Chunks of a format: offset of the first, layout of name and length, bytes that the length leaves out, the name of the
# chunk of samples, and the alignment.
_CHUNKS = {
    "RF64": (12, "<4sI", 8, b"data", 2),
    "W64": (40, "<16sq", 0, b"data\xf3\xac\xd3\x11\x8c\xd1\x00\xc0\x4f\x8e\xdb\x8a", 8),
    "CAF": (8, ">4sq", 12, b"data", 1),
}
# Formats whose cuts are seen.
_STATES_LENGTH = {"WAV", "WAVEX", "RF64", "AIFF", "W64", "AU", "CAF", "SVX", "OGG", "FLAC"}
_PADDING = 5000  # samples by which compressed sound can be shorter than its file says
_LARGEST_WAV = 2**32 - 2**16  # bytes; beyond that RF64
_IEEE_FLOAT = 3  # WAVE_FORMAT_IEEE_FLOAT


def as_scale(value: Any) -> float:
    """Convert to the value of full scale; 0 is refused, since it silences every sample."""
    scale = as_number("scale", value, at_least=-LOUDEST, at_most=LOUDEST)
    if scale == 0.0:
        raise InputError("scale", "must not be 0: all samples would be 0")
    return scale


def missing_bytes(log: str) -> int:
    """Return the number of bytes by which a file is shorter than its header says, by libsndfile's log of its header."""
    found = [(name, int(declared), int(there)) for name, declared, there in _CUT.findall(log)]
    known = [(name, size - there) for name, size, there in found if not any(size in some for some in _UNKNOWN)]
    return max((less for name, less in known if less > _WHOLE_FILE.get(name, 0)), default=0)


def _end_of_data(raw: BinaryIO, form: str, size: int) -> int:
    """Return the end of a file's data chunk by its declared length, in bytes; 0 if the format or the length has none.

    libsndfile allows a few bytes less in these formats.
    """
    if form not in _CHUNKS:
        return 0
    at, layout, header, wanted, align = _CHUNKS[form]
    length, of_samples = struct.calcsize(layout), 0
    while at + length <= size:
        raw.seek(at)
        name, declared = struct.unpack(layout, raw.read(length))
        if form == "RF64" and name == b"ds64":
            (of_samples,) = struct.unpack("<8xQ", raw.read(16).ljust(16, b"\0"))
        if name == wanted:
            if form == "RF64" and declared == _UNKNOWN[0][0]:
                declared = of_samples
            return at + header + declared if 0 < declared < 2**62 else 0
        at += max(length, header + declared + -declared % align)
    return 0


def _check_whole(path: str | PathLike[str], file: Any) -> None:
    """Refuse a file that has been cut, as far as its format shows that; warn where it does not."""
    size, stated = Path(path).stat().st_size, file.format in _STATES_LENGTH
    with Path(path).open("rb") as raw:
        missing = max(missing_bytes(file.extra_info), _end_of_data(raw, file.format, size) - size)
        problem = f"ends {missing} bytes before its header says" if missing else ""
        if file.format == "OGG":
            raw.seek(max(0, size - _OGG_PAGE))
            page = raw.read().rpartition(b"OggS")[2]  # version, flags, 20 bytes, number of segments, their lengths
            count = page[22] if len(page) > 22 else 0
            if not count or not page[1] & _LAST_PAGE or len(page) < 23 + count + sum(page[23 : 23 + count]):
                problem = "ends before its last page does"
    if file.format == "MP3":
        problem, stated = cut_of_mp3(path)
    if problem:
        raise InputError("path", f"must be whole, but {path} {problem}; truncated=True takes what is there")
    if not stated:
        warn(f"{path} does not state its length ({file.format_info}): if it was cut, the signal is as short")


def read_sound_file(
    path: str | PathLike[str], channel: int, truncated: bool = False
) -> tuple[NDArray[np.float32], float]:
    """Return one channel of a sound file, (n,), full scale being 1, and its sampling rate in Hz."""
    import soundfile

    as_flag("truncated", truncated)
    if not isinstance(path, str | PathLike):
        raise InputError("path", f"must be a path, but is {path!r:.80}")
    try:
        check_file(path, _LARGEST)
        with soundfile.SoundFile(path) as file:
            if channel >= file.channels:
                raise InputError("channel", f"must be below {file.channels}, the file's channels, but is {channel}")
            densest = _MPEG_PER_BYTE if file.format == "MP3" else _MOST_PER_BYTE
            most = min(_LONGEST, densest * Path(path).stat().st_size)
            if not file.frames:
                raise InputError("path", f"must hold sound, but {path} is empty")
            if not 0 < file.frames <= most:
                claim = f"{path} says that it holds {file.frames} samples"
                raise InputError("path", f"must hold sound, and its bytes hold {most} samples at most, but {claim}")
            if not truncated:
                _check_whole(path, file)
            return _channel(file, channel, path, truncated), float(file.samplerate)
    except FileNotFoundError as error:
        raise InputError("path", f"must be a sound file, but there is no file {str(path)!r}") from error
    except (OSError, RuntimeError) as error:
        raise InputError("path", f"must be a sound file, but {getattr(error, 'strerror', None) or error}") from error


def _channel(file: Any, channel: int, path: str | PathLike[str], truncated: bool) -> NDArray[np.float32]:
    """Return the samples of a channel; memory is taken as they come, not as the file says."""
    parts, count = [np.empty(0, np.float32)], 0
    # SoundFile.blocks yields what was in memory where a file ends before it says.
    while len(block := file.read(max(1, _BLOCK // file.channels), dtype="float32", always_2d=True)):
        part = block[:, channel].copy()
        bad = np.flatnonzero(~(np.abs(part) <= LOUDEST))
        if len(bad):
            raise InputError("path", f"must hold finite samples, but [{count + bad[0]}] of {path} is {part[bad[0]]:g}")
        parts.append(part)
        count += len(part)
    if not count or (count < file.frames - _PADDING and not truncated):
        advice = "; truncated=True takes what is there" if count else ""
        problem = f"must be whole, but {path} says that it holds {file.frames} samples and has {count}"
        raise InputError("path", problem + advice)
    return np.concatenate(parts)


def write_wav(path: Path, sampling_rate: float, frames: NDArray[Any]) -> None:
    """Write frames (n,) or (n, channels) into a WAV file of 32-bit floats."""
    header = wav_header(sampling_rate, frames.shape[1] if frames.ndim > 1 else 1, len(frames))
    with path.open("wb") as out:
        out.write(header)
        out.write(np.ascontiguousarray(frames, "<f4").data)


def wav_header(sampling_rate: float, channels: int, samples: int, names: Sequence[str] = ()) -> bytes:
    """Return the header of a WAV file of 32-bit floats of given length; names of its channels go into a chunk ``iXML``.

    Above 4 GiB it is an RF64 file (EBU Tech 3306), which has the lengths in a chunk ``ds64``.
    """
    rate, frame = as_number("sampling_rate", sampling_rate, at_least=1.0, below=2.0**31, unit="Hz"), 4 * channels
    if not rate.is_integer():
        raise InputError("sampling_rate", f"must be a whole number of Hz for a WAV file, but is {rate!r} Hz")
    if frame >= 2**16:
        raise InputError("channels", f"must be at most {2**14 - 1} in a WAV file, but are {channels}; use --store zarr")
    data = frame * samples
    more = _names_of_tracks(names)
    form = struct.pack(
        "<4sIHHIIHHH", b"fmt ", 18, _IEEE_FLOAT, channels, int(rate), min(int(rate) * frame, 2**32 - 1), frame, 32, 0
    )
    if 4 + len(form) + len(more) + 20 + data <= _LARGEST_WAV:
        fact = struct.pack("<4sII", b"fact", 4, samples)
        riff = struct.pack("<4sI4s", b"RIFF", 4 + len(form) + len(more) + len(fact) + 8 + data, b"WAVE")
        return riff + form + more + fact + struct.pack("<4sI", b"data", data)
    elsewhere = 2**32 - 1  # the lengths are in ds64
    fact = struct.pack("<4sII", b"fact", 4, elsewhere)
    whole = 4 + 36 + len(form) + len(more) + len(fact) + 8 + data
    lengths = struct.pack("<4sIQQQI", b"ds64", 28, whole, data, samples, 0)
    riff = struct.pack("<4sI4s", b"RF64", elsewhere, b"WAVE")
    return riff + lengths + form + more + fact + struct.pack("<4sI", b"data", elsewhere)


def _names_of_tracks(names: Sequence[str]) -> bytes:
    """Return a chunk with names of channels (iXML 2.0, TRACK_LIST), which recorders and workstations read."""
    if not any(names):
        return b""
    from xml.sax.saxutils import escape

    tracks = "".join(
        f"<TRACK><CHANNEL_INDEX>{i}</CHANNEL_INDEX><INTERLEAVE_INDEX>{i}</INTERLEAVE_INDEX><NAME>{escape(name)}</NAME>"
        "</TRACK>"
        for i, name in enumerate(names, 1)
    )
    listed = f"<TRACK_LIST><TRACK_COUNT>{len(names)}</TRACK_COUNT>{tracks}</TRACK_LIST>"
    text = f'<?xml version="1.0" encoding="UTF-8"?><BWFXML><IXML_VERSION>2.0</IXML_VERSION>{listed}</BWFXML>'
    content = text.encode()
    content += b"\n" * (len(content) % 2)  # libsndfile does not skip the padding of an odd chunk of RF64
    return struct.pack("<4sI", b"iXML", len(content)) + content


def as_frames(samples: NDArray[Any]) -> NDArray[np.float32]:
    """Return samples (rows, n) as frames (n, channels); complex ones become real and imaginary channels."""
    if np.iscomplexobj(samples):
        samples = np.stack([samples.real, samples.imag], axis=1).reshape(-1, samples.shape[1])
    return np.asarray(samples.T, dtype=np.float32)


class SoundFile:
    """Samples of one channel of a sound file, read on slicing."""

    def __init__(self, path: Path, channel: int = 0) -> None:
        import soundfile

        self._channel = channel

        self._path = os.fsencode(path)  # names need not be UTF-8
        info = soundfile.info(self._path)
        if missing_bytes(info.extra_info):
            raise ValueError(f"{path} ends {missing_bytes(info.extra_info)} bytes before its header says")
        self._count = int(info.frames)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, part: slice) -> Any:
        import soundfile

        frames: Any = soundfile.read(self._path, start=part.start, stop=part.stop, dtype="float32", always_2d=True)[0]
        return self._of(frames)

    def _of(self, frames: Any) -> Any:
        return frames[:, self._channel]


class EnvelopeFile(SoundFile):
    """Samples of one channel of a file of real and imaginary parts, complex64, read on slicing."""

    def _of(self, frames: Any) -> Any:
        return frames[:, 2 * self._channel] + np.complex64(1j) * frames[:, 2 * self._channel + 1]
