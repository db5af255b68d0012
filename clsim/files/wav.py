"""WAV files of 32-bit floats, written piece by piece."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_number
from clsim.errors import InputError
from clsim.files.atomic import temporary_path

if TYPE_CHECKING:
    import os
    from types import TracebackType

    from numpy.typing import NDArray

_LARGEST_WAV = 2**32 - 2**16  # bytes; beyond that RF64
_IEEE_FLOAT = 3  # WAVE_FORMAT_IEEE_FLOAT


class WavWriter:
    """Writes a WAV file of 32-bit floats; it gets its name when the block ends well, and is deleted otherwise.

    Parameters
    ----------
    path : path-like
        Where the file is to be.
    sampling_rate : float
        A whole number of Hz, since the format holds nothing else.
    channels : int
        Number of channels.
    samples : int, optional
        How many will be written, if given: above 4 GiB the file becomes an RF64.

    Raises
    ------
    InputError
        If the sampling rate is no whole number.
    OSError
        If the file cannot be written; nothing is left of it then.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "a.wav"
    >>> with WavWriter(path, 500e3) as writer:
    ...     writer.write(np.zeros(10, dtype=np.float32))
    >>> path.exists()
    True
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        sampling_rate: float,
        channels: int = 1,
        samples: int | None = None,
    ) -> None:
        import soundfile

        rate = _whole_rate(sampling_rate)
        self._path = Path(path)
        self._temporary = temporary_path(self._path)
        self._frame_bytes = 4 * channels
        self._large = samples is not None and self._frame_bytes * samples > _LARGEST_WAV
        try:
            self._file = soundfile.SoundFile(
                self._temporary, "w", samplerate=rate, channels=channels, subtype="FLOAT",
                format="RF64" if self._large else "WAV",
            )  # fmt: skip
        except soundfile.LibsndfileError as error:
            raise OSError(f"cannot write {self._path}: {error}") from error

    def write(self, samples: NDArray[Any]) -> None:
        """Append samples (n,) or (n, channels).

        Raises
        ------
        OSError
            If they do not fit on the disk, or not into a WAV file whose length was not announced.
        """
        before = self._file.frames
        if not self._large and self._frame_bytes * (before + len(samples)) > _LARGEST_WAV:
            raise OSError(f"cannot write {self._path}: above 4 GiB, the number of samples must be given beforehand")
        try:
            self._file.write(np.ascontiguousarray(samples, dtype=np.float32))
        except (RuntimeError, AssertionError) as error:  # libsndfile reports a full disk as a short write
            raise OSError(f"cannot write {self._path}: {error or 'disk full'}") from error
        if self._file.frames - before != len(samples):
            raise OSError(f"cannot write {self._path}: disk full")

    def __enter__(self) -> WavWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._file.close()
            if kind is None:
                self._temporary.replace(self._path)
        finally:
            self._temporary.unlink(missing_ok=True)


def wav_header(sampling_rate: float, channels: int, samples: int) -> bytes:
    """Return what stands before the samples of a WAV file of 32-bit floats whose length is given.

    Above 4 GiB it is an RF64 file (EBU Tech 3306), which has the lengths in a chunk ``ds64``.

    Raises
    ------
    InputError
        If the sampling rate is no whole number.
    """
    rate, frame = _whole_rate(sampling_rate), 4 * channels
    data = frame * samples
    form = struct.pack("<4sIHHIIHHH", b"fmt ", 18, _IEEE_FLOAT, channels, rate, rate * frame, frame, 32, 0)
    if 4 + len(form) + 20 + data <= _LARGEST_WAV:
        fact = struct.pack("<4sII", b"fact", 4, samples)
        riff = struct.pack("<4sI4s", b"RIFF", 4 + len(form) + len(fact) + 8 + data, b"WAVE")
        return riff + form + fact + struct.pack("<4sI", b"data", data)
    elsewhere = 2**32 - 1  # the lengths are in ds64
    fact = struct.pack("<4sII", b"fact", 4, elsewhere)
    whole = 4 + 36 + len(form) + len(fact) + 8 + data
    lengths = struct.pack("<4sIQQQI", b"ds64", 28, whole, data, samples, 0)
    riff = struct.pack("<4sI4s", b"RF64", elsewhere, b"WAVE")
    return riff + lengths + form + fact + struct.pack("<4sI", b"data", elsewhere)


def _whole_rate(sampling_rate: float) -> int:
    rate = as_number("sampling_rate", sampling_rate, at_least=1.0, below=2.0**31, unit="Hz")
    if not rate.is_integer():
        raise InputError("sampling_rate", f"must be a whole number of Hz for a WAV file, but is {rate!r} Hz")
    return int(rate)


def as_frames(samples: NDArray[Any]) -> NDArray[np.float32]:
    """Return samples (rows, n) as a file holds them, (n, channels): complex ones as real and imaginary channels."""
    if np.iscomplexobj(samples):
        samples = np.stack([samples.real, samples.imag], axis=1).reshape(-1, samples.shape[1])
    return np.asarray(samples.T, dtype=np.float32)


class SoundFile:
    """Samples of a mono sound file, read where they are cut."""

    def __init__(self, path: Path) -> None:
        import soundfile

        self._path = path
        self._count = int(soundfile.info(path).frames)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, part: slice) -> Any:
        import soundfile

        return soundfile.read(self._path, start=part.start, stop=part.stop, dtype="float32")[0]


class EnvelopeFile(SoundFile):
    """Samples of a file of real and imaginary parts, read where they are cut, complex64."""

    def __getitem__(self, part: slice) -> Any:
        import soundfile

        frames = soundfile.read(self._path, start=part.start, stop=part.stop, dtype="float32", always_2d=True)[0]
        return frames[:, 0] + np.complex64(1j) * frames[:, 1]
