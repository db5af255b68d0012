"""Stores below their libraries: samples at fixed places of files, HDF5 with checksums, and what Zarr does not check."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_UNKNOWN_TO_SYSTEM = (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS)
CHECKSUM_BYTES = 4
LARGEST_CHUNK = 2**32 - 1 - CHECKSUM_BYTES  # bytes: its length is a number of 32 bits
_HEAP = struct.Struct("<4s4xQ")  # signature and version of a global heap, its bytes
_OBJECT = struct.Struct("<H6xQ")  # index of an object in it, 0 for free space, and its bytes


class RawRows:
    """Writes pieces of rows where they belong: written again they change nothing, and nothing else moves."""

    # sample_type: code of NumPy, ``"<f4"``, or ``"<c8"``, real before imaginary parts.
    def __init__(self, places: Sequence[tuple[Path, int]], sample_type: str = "<f4") -> None:
        self._places, self._type = places, np.dtype(sample_type)
        self._files: dict[Path, int] = {}

    def open(self) -> None:
        """Make ready to write."""
        try:
            for path, _ in self._places:
                if path not in self._files:
                    self._files[path] = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        except OSError:
            self.close()
            raise

    def reserve(self, sizes: Sequence[int]) -> None:
        """Take the disk space of the files, bytes, beforehand, so that a full disk shows before hours of work."""
        for (path, number), size in zip(self._files.items(), sizes, strict=True):
            try:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(number, 0, size)
            except OSError as error:
                if error.errno not in _UNKNOWN_TO_SYSTEM:
                    needed = f"{os.strerror(error.errno or 0)} ({size / 2**20:.3g} MiB are needed)"
                    raise OSError(error.errno, needed, str(path)) from error
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


class SampleFile(RawRows):
    """Samples of several receivers in a file that is read as an array, in bounded memory."""

    def __init__(self, path: Path, shape: tuple[int, int], sample_type: str) -> None:
        row = np.dtype(sample_type).itemsize * shape[1]
        super().__init__([(path, row * r) for r in range(shape[0])], sample_type)
        self._path, self._shape = path, shape
        path.touch()

    def samples(self) -> NDArray[Any]:
        """Return all samples (receivers, n); they are read where they are used."""
        return np.asarray(np.memmap(self._path, self._type, "r", shape=self._shape))


class _Image(io.RawIOBase):
    """A file in memory that holds all that is written but zeros."""

    def __init__(self) -> None:
        self._written: list[tuple[int, bytes]] = []  # first byte and content, later ones over earlier ones
        self._length = self._at = 0

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + (0, self._at, self._length)[whence]
        return self._at

    def truncate(self, size: int | None = None) -> int:
        self._length = self._at if size is None else size
        return self._length

    def readinto(self, buffer: Any) -> int:
        out = memoryview(buffer).cast("B")
        count = min(len(out), max(self._length - self._at, 0))
        out[:count] = bytes(count)
        for at, content in self._written:
            begin, end = max(at, self._at), min(at + len(content), self._at + count)
            if begin < end:
                out[begin - self._at : end - self._at] = content[begin - at : end - at]
        self._at += count
        return count

    def write(self, data: Any) -> int:
        end = self._at + len(data)
        over = any(at < end and self._at < at + len(old) for at, old in self._written)
        if over or np.frombuffer(data, np.uint8).any():
            self._written.append((self._at, bytes(data)))
        self._at, self._length = end, max(self._length, end)
        return len(data)

    def save(self, path: Path) -> None:
        """Write a file in which zeros take no space yet."""
        with path.open("wb") as out:
            for at, content in self._written:
                out.seek(at)
                out.write(content)
            out.truncate(self._length)


def create_file(
    path: Path, content: Any, shape: tuple[int, int], chunk: int, sample_type: str, attributes: dict[str, Any]
) -> None:
    """Write a netCDF-4 file of an xarray Dataset and of ``sound`` `shape`, zeros in chunks of one receiver."""
    # A process that dies within the HDF5 library can leave a file that no longer opens, and a full disk can end the
    # process within the library. Here the library writes into memory, and all chunks get their places at once.
    import h5netcdf
    import h5py
    from xarray.backends import H5NetCDFStore

    image = _Image()
    placed = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    placed.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    with h5netcdf.File(image, "w") as file:
        content.dump_to_store(H5NetCDFStore(file))
        file.dimensions["time"] = shape[1]
        variable = file.create_variable(
            "sound", ("receiver", "time"), np.dtype(sample_type), chunks=(1, chunk), fletcher32=True, dcpl=placed
        )
        variable.attrs.update(attributes)
    image.save(path)


def chunk_places(path: Path) -> list[int]:
    """List the bytes at which the chunks of ``sound`` begin, those of the first receiver first."""
    import h5py

    found: dict[tuple[int, ...], int] = {}
    with h5py.File(path, "r") as file:
        # One walk: looking up each chunk by its place takes 0.3 ms in long files.
        file["sound"].id.chunk_iter(lambda chunk: found.update({chunk.chunk_offset: chunk.byte_offset}))
    return [found[place] for place in sorted(found)]


def missing_chunks(path: Path) -> int:
    """Count the chunks of ``sound`` that the index of the file does not list; HDF5 reads zeros for them."""
    import h5py

    with h5py.File(path, "r") as file:
        sound = file["sound"]
        if sound.chunks is None:  # one block, without checksums, as clsim wrote it before
            return 0
        wanted = int(np.prod([-(-n // size) for n, size in zip(sound.shape, sound.chunks, strict=True)]))
        return wanted - int(sound.id.get_num_chunks())


def check_attributes(path: Path) -> None:
    """Read the attributes of a file: where they are damaged, h5netcdf fails to open it, and once more to close it."""
    import h5py

    with h5py.File(path, "r") as file:
        begin, end = _sound_span(file["sound"].id)
        with path.open("rb") as raw:
            _check_heaps(raw.read(begin))
            raw.seek(end)
            _check_heaps(raw.read())
        dict(file.attrs)


def _sound_span(sound: Any) -> tuple[int, int]:
    """First byte of the sound in a file, and the first one after it: what is outside is small."""
    places: list[tuple[int, int]] = []
    if sound.get_create_plist().get_layout() == 2:  # H5D_CHUNKED
        sound.chunk_iter(lambda chunk: places.append((chunk.byte_offset, chunk.size)))
    else:
        places.append((sound.get_offset() or 0, sound.get_storage_size()))
    return min((at for at, _ in places), default=0), max((at + size for at, size in places), default=0)


def _check_heaps(data: bytes) -> None:
    """Raise a ValueError where the list of a heap's strings does not end, in which the HDF5 library would not return.

    HDF5 File Format Specification Version 3.0, section III.E: signature, version, size; index, count, size of objects.
    """
    at = data.find(b"GCOL")
    while at >= 0 and at + _HEAP.size <= len(data):
        place, end = at + _HEAP.size, at + _HEAP.unpack_from(data, at)[1]
        while place + _OBJECT.size <= min(end, len(data)):
            index, size = _OBJECT.unpack_from(data, place)
            place += _OBJECT.size + -(-size // 8) * 8 if index else size
            if place > end or not (index or size):
                raise ValueError("the list of its strings is damaged")
        at = data.find(b"GCOL", max(place, at + 4))


ALL_CHUNKS = {"clsim_chunks": "all"}  # attribute of groups whose chunks of zeros are files, too
SEAL = "clsim_metadata_sha256"  # attribute of a group
_BLANK = "0" * 64  # stands in its place where the digest is computed


def arrays_with_missing_chunks(group: Path, metadata: dict[str, Any] | None = None) -> list[str]:
    """List the arrays of a group whose chunks are not all there; none of a group that left out zeros."""
    # Names of files are counted, no chunk is opened. `metadata` is the group's ``zarr.json``, with that of all arrays.
    found = json.loads((group / "zarr.json").read_bytes()) if metadata is None else metadata
    if not ALL_CHUNKS.items() <= found.get("attributes", {}).items():
        return []
    arrays = found["consolidated_metadata"]["metadata"]
    return [name for name, array in arrays.items() if _stored(group / name / "c") < _wanted(array)]


def _wanted(array: dict[str, Any]) -> int:
    sizes = array["chunk_grid"]["configuration"]["chunk_shape"]
    return math.prod(-(-n // size) for n, size in zip(array["shape"], sizes, strict=True))


def _stored(folder: Path) -> int:
    if folder.is_file():  # that of a single number
        return 1
    return sum(name.isdigit() for _, _, names in os.walk(folder) for name in names)


def seal(group: Path) -> None:
    """Store the digest of a group's ``zarr.json`` and of those of its arrays in the attributes of the group."""
    path = group / "zarr.json"
    metadata = json.loads(path.read_bytes())
    metadata.setdefault("attributes", {})[SEAL] = _BLANK
    text = json.dumps(metadata)
    path.write_text(text.replace(_BLANK, _digest(group, text.encode(), metadata)), "utf-8")


def is_sealed(group: Path) -> bool:
    """Test whether the metadata of a group and its arrays are what was sealed, to the byte."""
    try:
        content = (group / "zarr.json").read_bytes()
        metadata = json.loads(content)
        digest = metadata["attributes"][SEAL]
        blank = content.replace(digest.encode(), _BLANK.encode())
        return bool(digest != _BLANK and digest == _digest(group, blank, metadata))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return False


def _digest(group: Path, content: bytes, metadata: dict[str, Any]) -> str:
    """SHA-256 of a group's metadata, whose own digest is blank, and of the metadata of its arrays."""
    found = hashlib.sha256(content)
    for name in sorted(metadata.get("consolidated_metadata", {}).get("metadata", {})):
        found.update((group / name / "zarr.json").read_bytes())
    return found.hexdigest()
