"""Sound files as users have them."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import LOUDEST, as_number
from clsim.errors import InputError
from clsim.files.input_files import check_file

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LARGEST = 2**35  # bytes of a file, whatever its channels
_LONGEST = 2**28  # samples of a channel, 1 GiB: 23 minutes at 192 kHz
_MOST_PER_BYTE, _MPEG_PER_BYTE = 5000, 25  # samples: silence in FLAC, and 24 kHz at 8 kbit/s
_BLOCK = 2**20  # samples of all channels read at a time
_PADDING = 5000  # samples by which compressed sound can be shorter than its file says


def as_scale(value: Any) -> float:
    """Return what full scale of a file means, or raise an InputError for the field ``scale``."""
    return as_number("scale", value, at_least=-LOUDEST, at_most=LOUDEST)


def read_sound_file(path: str | PathLike[str], channel: int) -> tuple[NDArray[np.float32], float]:
    """Return one channel of a sound file, (n,), full scale being 1, and its sampling rate in Hz.

    Raises
    ------
    InputError
        If the file is missing, empty, too long or no sound file, has no such channel, ends before it says, or holds
        what is no finite sound.
    """
    import soundfile

    if not isinstance(path, str | PathLike):
        raise InputError("path", f"must be a path, but is {path!r:.80}")
    try:
        check_file(path, _LARGEST)
        with soundfile.SoundFile(path) as file:
            if channel >= file.channels:
                raise InputError("channel", f"must be below {file.channels}, the file's channels, but is {channel}")
            densest = _MPEG_PER_BYTE if file.format == "MP3" else _MOST_PER_BYTE
            most = min(_LONGEST, densest * Path(path).stat().st_size)
            if not 0 < file.frames <= most:
                claim = f"{path} says that it holds {file.frames} samples" if file.frames else f"{path} is empty"
                raise InputError("path", f"must hold sound, and its bytes hold {most} samples at most, but {claim}")
            return _channel(file, channel, path), float(file.samplerate)
    except FileNotFoundError as error:
        raise InputError("path", f"must be a sound file, but there is no file {str(path)!r}") from error
    except (OSError, RuntimeError) as error:
        raise InputError("path", f"must be a sound file, but {getattr(error, 'strerror', None) or error}") from error


def _channel(file: Any, channel: int, path: str | PathLike[str]) -> NDArray[np.float32]:
    """Return the samples of a channel; memory is taken as they come, not as the file says."""
    parts, count = [np.empty(0, np.float32)], 0
    for block in file.blocks(max(1, _BLOCK // file.channels), dtype="float32", always_2d=True):
        part = block[:, channel].copy()
        bad = np.flatnonzero(~(np.abs(part) <= LOUDEST))
        if len(bad):
            raise InputError("path", f"must hold finite samples, but [{count + bad[0]}] of {path} is {part[bad[0]]:g}")
        parts.append(part)
        count += len(part)
    if not count or count < file.frames - _PADDING:
        raise InputError("path", f"must be whole, but {path} says that it holds {file.frames} samples and has {count}")
    return np.concatenate(parts)
