"""Sound files as users have them."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray


def read_sound_file(path: str | PathLike[str], channel: int) -> tuple[NDArray[np.float32], float]:
    """Return one channel of a sound file, (n,), full scale being 1, and its sampling rate in Hz.

    Raises
    ------
    InputError
        If the file is missing, empty or no sound file, or has no such channel.
    """
    import soundfile

    if not isinstance(path, str | PathLike):
        raise InputError("path", f"must be a path, but is {path!r:.80}")
    if not Path(path).is_file():
        raise InputError("path", f"must be a sound file, but there is no file {str(path)!r}")
    try:
        with soundfile.SoundFile(path) as file:
            if channel >= file.channels:
                raise InputError("channel", f"must be below {file.channels}, the file's channels, but is {channel}")
            if not file.frames:
                raise InputError("path", f"must hold sound, but {path} is empty")
            samples, filled = np.empty(file.frames, dtype=np.float32), 0
            for block in file.blocks(65536, dtype="float32", always_2d=True):
                samples[filled : filled + len(block)] = block[:, channel]
                filled += len(block)
            return samples[:filled], float(file.samplerate)
    except (OSError, RuntimeError) as error:
        raise InputError("path", f"must be a sound file, but {error}") from error
