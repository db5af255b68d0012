"""Samples of several receivers as rows of numbers at fixed places of files."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_UNKNOWN_TO_SYSTEM = (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS)


class RawRows:
    """Writes pieces of rows where they belong: written again they change nothing, and nothing else moves.

    Shapes: places (path, int).

    sample_type: numPy's code of the samples: ``"<f4"``, or ``"<c8"``, real before imaginary parts.
    """

    def __init__(self, places: Sequence[tuple[Path, int]], sample_type: str = "<f4") -> None:
        self._places, self._type = places, np.dtype(sample_type)
        self._files: dict[Path, int] = {}
        try:
            for path, _ in places:
                if path not in self._files:
                    self._files[path] = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        except OSError:
            self.close()
            raise

    def reserve(self, samples: Sequence[int]) -> None:
        """Take the disk space of rows of given lengths beforehand, so that a full disk shows before hours of work."""
        for path, number in self._files.items():
            rows = zip(self._places, samples, strict=True)
            size = max(begin + self._type.itemsize * count for (other, begin), count in rows if other == path)
            try:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(number, 0, size)
            except OSError as error:
                if error.errno not in _UNKNOWN_TO_SYSTEM:
                    raise OSError(
                        error.errno, f"{os.strerror(error.errno or 0)} ({size / 2**20:.3g} MiB are needed)", str(path)
                    ) from error
            os.truncate(number, max(size, os.fstat(number).st_size))

    def write(self, start: int, samples: NDArray[Any], first: int = 0) -> None:
        """Write samples (n_rows, n) of rows from `first` and from sample `start` on."""
        for (path, begin), row in zip(self._places[first : first + len(samples)], samples, strict=True):
            left = memoryview(np.ascontiguousarray(row, dtype=self._type).tobytes())
            at = begin + self._type.itemsize * start
            try:
                while left:
                    os.lseek(self._files[path], at, os.SEEK_SET)
                    count = os.write(self._files[path], left)
                    left, at = left[count:], at + count
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(path)) from error

    def to_disk(self) -> None:
        """Wait until all is on the disk itself."""
        for path, number in self._files.items():
            try:
                os.fsync(number)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(path)) from error

    def close(self) -> None:
        """Close the files."""
        for number in self._files.values():
            os.close(number)
        self._files = {}


class SampleFile:
    """Samples of several receivers in a file that is read as an array, in bounded memory."""

    def __init__(self, path: Path, shape: tuple[int, int], sample_type: str) -> None:
        self._path, self._shape, self._type = path, shape, np.dtype(sample_type)
        self._rows = RawRows([])

    def open(self) -> None:
        """Make ready to write."""
        row = self._type.itemsize * self._shape[1]
        self._path.touch()
        self._rows = RawRows([(self._path, row * r) for r in range(self._shape[0])], self._type.str)

    def write(self, start: int, samples: NDArray[Any]) -> None:
        """Write samples (receivers, n) from sample `start` on."""
        self._rows.write(start, samples)

    def close(self) -> None:
        """Write no more."""
        self._rows.close()

    def samples(self) -> NDArray[Any]:
        """Return all samples (receivers, n); they are read where they are used."""
        return np.asarray(np.memmap(self._path, self._type, "r", shape=self._shape))
