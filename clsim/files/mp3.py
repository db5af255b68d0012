"""MP3 files that were cut: what their frames and the header of encoders say."""

from __future__ import annotations

import mmap
import struct
from os import PathLike
from pathlib import Path

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
    """Look for a cut at the end of an MP3 file: its description, "" for none, and whether the file declares a length.

    Without a declaration a file that was cut between two frames looks whole.

    References
    ----------
    ISO/IEC 11172-3, 2.4.2.3, header of a frame; the Xing header as LAME writes it: flags, frames, bytes.
    """
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
