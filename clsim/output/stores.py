"""Where the sound of a run goes: WAV files, a Zarr store or an HDF5 file, each written piece by piece.

All three can be gone on with after the process was killed: a piece that is written again changes nothing, and what
is not sound is on the disk before the first sample.
"""

from __future__ import annotations

import shutil
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, row_name, texts
from clsim.errors import InputError, check_packages
from clsim.files.atomic import to_disk, tree_to_disk, uninterrupted
from clsim.files.sound import EnvelopeFile, SoundFile, wav_header
from clsim.output import raw_files
from clsim.output.columns import Column, Columns, create_array, write_chunk, write_group
from clsim.plugins import STORES as STORE_PLUGINS
from clsim.plugins import with_plugins
from clsim.recording import sound_attributes, sound_coordinates

if TYPE_CHECKING:
    from clsim.pictures.plots import Readable

STORE_FORMAT = 1


@dataclass(frozen=True, slots=True, eq=False)
class StoredSound:
    """What a store says of the sound in it."""

    channels: tuple[tuple[str, str], ...]  # one per row: receiver and its channel, "" for the only one
    units: tuple[str, ...]  # likewise, Pa or V
    positions: Floats  # (rows, 3) of the receivers at 0 s, m
    sampling_rate: float  # hz
    samples: int  # of each row
    chunk: int  # samples that are written at a time
    scene: str  # the completed scene file
    version: str  # of clsim
    carrier: float | None = None  # of complex envelopes, Hz; None for sound as it is

    @property
    def sample_type(self) -> str:
        """NumPy's code of the samples."""
        return "<f4" if self.carrier is None else "<c8"

    @property
    def receiver_names(self) -> tuple[str, ...]:
        """Name of each row."""
        return tuple(map(row_name, self.channels))

    def attributes(self) -> dict[str, Any]:
        """Attributes at the root of a store."""
        root = {"clsim_store_format": STORE_FORMAT, "clsim_version": self.version, "scene": self.scene}
        rates = {"sampling_rate": self.sampling_rate, "carrier": self.carrier}
        return root | {name: rate for name, rate in rates.items() if rate is not None}

    def columns(self) -> Columns:
        """Return all but the sound as `coordinates` does, without its packages."""
        found = Columns(self.attributes())
        found.add("receiver", "receiver", texts(self.receiver_names))
        found.add("unit", "receiver", texts(self.units), coord=True)
        found.add("axis", "axis", texts("xyz"))
        about = {"units": "m", "long_name": "position at 0 s"}
        found.add("position", ("receiver", "axis"), self.positions, about, coord=True)
        if any(channel for _, channel in self.channels):
            found.add("channel", "receiver", texts(channel for _, channel in self.channels), coord=True)
        return found

    def coordinates(self) -> Any:
        """Return all but the sound as an xarray Dataset."""
        found = sound_coordinates(self.receiver_names, self.units, self.positions, self.channels)
        found.attrs = self.attributes()
        return found

    @property
    def sound_attributes(self) -> dict[str, Any]:
        """Attributes beside the samples."""
        return sound_attributes(self.units, self.carrier)


class SoundStore(ABC):
    """One kind of store, at `paths`, the files or folders that make it up; `store_kinds` lists them."""

    packages: ClassVar[tuple[str, ...]] = ()  # that it needs
    by_regions: ClassVar[bool] = False  # whether several processes, on several machines, may write chunks at a time

    def __init__(self, folder: Path, sound: StoredSound, receivers: Sequence[str]) -> None:
        self.paths = [folder / name for name in self.names(receivers)]
        self._sound = sound

    @staticmethod
    @abstractmethod
    def names(receivers: Sequence[str]) -> list[str]:
        """Names of its files or folders."""

    @staticmethod
    def problem_of(receiver: str) -> str:
        """Objection to a receiver's name, as users gave it, for this store; an empty text for none."""
        del receiver
        return ""

    @abstractmethod
    def create(self) -> None:
        """Make all that is not sound; it is on the disk itself afterwards."""

    def recover(self) -> None:  # noqa: B027  (most kinds have nothing to do)
        """Delete what a process that was killed wrote in part; nobody is writing."""

    @abstractmethod
    def open(self) -> None:
        """Make ready to write."""

    @abstractmethod
    def write(self, start: int, samples: NDArray[Any], first: int = 0) -> None:
        """Write samples (rows, n) from sample `start` and row `first` on; again they change nothing.

        They are of all channels of the receivers they begin with.
        """

    @abstractmethod
    def to_disk(self) -> None:
        """Wait until all that was written is on the disk itself."""

    @abstractmethod
    def close(self) -> None:
        """Write no more."""

    @abstractmethod
    def row(self, folder: Path, row: int) -> Readable:
        """Return the samples of a row in the store, which is in `folder` by now."""


class _RowStore(SoundStore):
    """A store whose samples are rows at known places of files."""

    _row_type = ""  # of what is written, if that is not the samples themselves

    def __init__(self, folder: Path, sound: StoredSound, receivers: Sequence[str]) -> None:
        super().__init__(folder, sound, receivers)
        self._rows = raw_files.RawRows([])

    @abstractmethod
    def places(self) -> list[tuple[Path, int]]:
        """Return file and byte at which each row begins."""

    def open(self) -> None:
        self._rows = raw_files.RawRows(self.places(), self._row_type or self._sound.sample_type)
        self._rows.open()

    def reserve(self, sizes: Sequence[int]) -> None:
        """Take the disk space of all files, bytes."""
        self.open()
        try:
            self._rows.reserve(sizes)
            self._rows.to_disk()
        finally:
            self.close()
        to_disk(self.paths[0].parent)

    def write(self, start: int, samples: NDArray[Any], first: int = 0) -> None:
        self._rows.write(start, samples, first)

    def to_disk(self) -> None:
        self._rows.to_disk()

    def close(self) -> None:
        self._rows.close()


class _WavStore(_RowStore):
    """One file per receiver, of all its channels; its header comes first and says how long it will be."""

    # Envelopes have two channels, real part (I) and imaginary part (Q): the bytes of complex numbers.
    def __init__(self, folder: Path, sound: StoredSound, receivers: Sequence[str]) -> None:
        super().__init__(folder, sound, receivers)
        names: dict[str, list[str]] = {}  # of the channels of each receiver
        for receiver, channel in sound.channels:
            names.setdefault(receiver, []).append(channel)
        self._first = np.cumsum([0, *map(len, names.values())]).tolist()  # row of each receiver's first channel
        parts = 1 if sound.carrier is None else 2
        self._headers = [
            wav_header(sound.sampling_rate, parts * len(of_it), sound.samples, of_it if parts == 1 else ())
            for of_it in names.values()
        ]

    @staticmethod
    def names(receivers: Sequence[str]) -> list[str]:
        return [f"{name}.wav" for name in receivers]

    def create(self) -> None:
        """Write the headers and take the room of all samples, which are zeros."""
        for path, header in zip(self.paths, self._headers, strict=True):
            path.write_bytes(header)
        each = np.dtype(self._sound.sample_type).itemsize * self._sound.samples
        counts = np.diff(self._first).tolist()
        self.reserve([len(header) + each * count for header, count in zip(self._headers, counts, strict=True)])

    def places(self) -> list[tuple[Path, int]]:
        return [(path, len(header)) for path, header in zip(self.paths, self._headers, strict=True)]

    def write(self, start: int, samples: NDArray[Any], first: int = 0) -> None:
        receivers = range(self._first.index(first), self._first.index(first + len(samples)))
        for receiver in receivers:
            begin, end = self._first[receiver : receiver + 2]
            frames = samples[begin - first : end - first].T.reshape(1, -1)
            self._rows.write(start * (end - begin), frames, receiver)

    def row(self, folder: Path, row: int) -> Readable:
        """Return the samples of one row, read as asked for; with a carrier, complex ones of I and Q."""
        receiver = int(np.searchsorted(self._first, row, side="right")) - 1
        path, channel = folder / self.paths[receiver].name, row - self._first[receiver]
        return SoundFile(path, channel) if self._sound.carrier is None else EnvelopeFile(path, channel)


class _Hdf5Store(_RowStore):
    """A netCDF-4 file whose sound is in chunks of one receiver with checksums, written past the HDF5 library."""

    # What the library wrote is on the disk before the first sample, and does not change any more.
    packages = ("h5netcdf", "h5py", "numcodecs", "xarray")
    _row_type = "|u1"

    @staticmethod
    def names(receivers: Sequence[str]) -> list[str]:
        del receivers  # one file holds all of them
        return ["recording.h5"]

    @staticmethod
    def problem_of(receiver: str) -> str:
        # Texts of HDF5 end at a NUL.
        return f"must have no NUL in its name for --store hdf5, but is {receiver!r:.80}" if "\0" in receiver else ""

    @property
    def _chunk(self) -> int:
        return min(self._sound.chunk, self._sound.samples)

    def create(self) -> None:
        """Write all but the samples, whose chunks, of zeros, have their places in the file."""
        sound = self._sound
        size = np.dtype(sound.sample_type).itemsize * self._chunk + raw_files.CHECKSUM_BYTES
        if size > raw_files.LARGEST_CHUNK:
            raise InputError(
                "chunk", f"must take less than 4 GiB of a receiver for --store hdf5, but takes {size} bytes"
            )
        shape = len(sound.receiver_names), sound.samples
        raw_files.create_file(
            self.paths[0], sound.coordinates(), shape, self._chunk, sound.sample_type, sound.sound_attributes
        )
        self.reserve([self.paths[0].stat().st_size])

    def places(self) -> list[tuple[Path, int]]:
        """Return the file and the byte at which each chunk begins, those of the first receiver first."""
        return [(self.paths[0], begin) for begin in raw_files.chunk_places(self.paths[0])]

    def write(self, start: int, samples: NDArray[Any], first: int = 0) -> None:
        """Write a whole chunk `(receivers, n)` from sample `start` on, of receiver `first` and those behind it."""
        from numcodecs.fletcher32 import Fletcher32  # the checksum of HDF5

        number, of_row = start // self._chunk, -(-self._sound.samples // self._chunk)
        for r, row in enumerate(samples, first):
            chunk = np.zeros(self._chunk, self._sound.sample_type)  # the last one is as long as all others
            chunk[: len(row)] = row
            content = np.frombuffer(Fletcher32().encode(chunk), np.uint8)
            self._rows.write(0, content[None], r * of_row + number)

    def row(self, folder: Path, row: int) -> Readable:
        import h5py

        return _ArrayRow(h5py.File(folder / self.paths[0].name, "r")["sound"], row)


class _ZarrStore(SoundStore):
    """A Zarr group with one file per receiver and chunk."""

    packages = ("zarr", "xarray")
    by_regions = True  # a chunk has a file of its own, which appears whole

    def __init__(self, folder: Path, sound: StoredSound, receivers: Sequence[str]) -> None:
        super().__init__(folder, sound, receivers)
        self._array: Any = None
        self._written: list[Path] = []

    @staticmethod
    def names(receivers: Sequence[str]) -> list[str]:
        del receivers  # one folder holds all of them
        return ["recording.zarr"]

    def create(self) -> None:
        """Write coordinates, and an array without chunks yet, of one receiver and one chunk of the run each."""
        import zarr

        path = self.paths[0]
        shutil.rmtree(path, ignore_errors=True)
        write_group(self._sound.columns(), path)
        self._create_array()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Zarr says that version 3 of its specification does not know this yet
            uninterrupted(zarr.consolidate_metadata, path)
        tree_to_disk(path)

    def _create_array(self) -> None:
        import zarr

        sound, group = self._sound, zarr.open_group(self.paths[0], mode="r+", zarr_format=3)
        uninterrupted(
            group.create_array, "sound", shape=(len(sound.receiver_names), sound.samples),
            chunks=(1, min(sound.chunk, sound.samples)), dtype=sound.sample_type, fill_value=np.nan,
            dimension_names=("receiver", "time"), attributes=sound.sound_attributes, compressors=_compressors(),
        )  # fmt: skip

    def recover(self) -> None:
        for half in self.paths[0].rglob("*.partial"):  # chunks
            half.unlink()

    def open(self) -> None:
        import zarr

        with zarr.config.set({"array.write_empty_chunks": True}):
            self._array = zarr.open_group(self.paths[0], mode="r+")["sound"]

    def write(self, start: int, samples: NDArray[Any], first: int = 0) -> None:
        """Write whole chunks `(receivers, n)` from sample `start` on, of receiver `first` and those behind it."""
        last = first + len(samples)
        part = slice(first, last), slice(start, start + samples.shape[1])
        uninterrupted(self._array.__setitem__, part, samples)
        for r in range(first, last):
            key = self._array.metadata.encode_chunk_key((r, start // self._sound.chunk))
            self._written.append(self.paths[0] / "sound" / key)

    def to_disk(self) -> None:
        for path in self._written:
            to_disk(path)
        for folder in {path.parent for path in self._written}:
            to_disk(folder)
        self._written = []

    def close(self) -> None:
        self._array = None

    def row(self, folder: Path, row: int) -> Readable:
        import zarr

        return _ArrayRow(zarr.open_group(folder / self.paths[0].name, mode="r")["sound"], row)


class MemberStore(_ZarrStore):
    """Sound of a member of a study in an empty folder, whose group gets all else when it is finished."""

    # Written past Zarr: its calls take longer than the samples of short scenes.
    def create(self) -> None:
        """Write an array without chunks yet, alone, of one receiver and one chunk of the run each."""
        sound = self._sound
        samples = np.broadcast_to(np.zeros((), sound.sample_type), (len(sound.receiver_names), sound.samples))
        column = Column(("receiver", "time"), samples, sound.sound_attributes)
        create_array(self.paths[0] / "sound", column, (1, self._chunk))

    @property
    def _chunk(self) -> int:
        return min(self._sound.chunk, self._sound.samples)

    def open(self) -> None:
        """Nothing is to be opened."""

    def write(self, start: int, samples: NDArray[Any], first: int = 0) -> None:
        """Write whole chunks `(receivers, n)` from sample `start` on, of receiver `first` and those behind it."""
        padded = np.zeros((len(samples), self._chunk), self._sound.sample_type)
        padded[:, : samples.shape[1]] = samples
        for r, row in enumerate(padded, first):
            self._written.append(write_chunk(self.paths[0] / "sound", (r, start // self._chunk), row))


class _ArrayRow:
    """Samples of one receiver of a Zarr array or an HDF5 dataset, read where they are cut."""

    def __init__(self, array: Any, receiver: int) -> None:
        self._array, self._receiver = array, receiver

    def __len__(self) -> int:
        return int(self._array.shape[1])

    def __getitem__(self, part: slice) -> NDArray[Any]:
        return np.asarray(self._array[self._receiver, part])


STORES: dict[str, type[SoundStore]] = {"wav": _WavStore, "zarr": _ZarrStore, "hdf5": _Hdf5Store}


def store_kinds() -> dict[str, type[SoundStore]]:
    """Join the classes of stores, by name; those of plugins are last."""
    return with_plugins(STORES, STORE_PLUGINS)


def check_store(kind: str, receiver_names: Sequence[str]) -> None:
    """See that a store of a kind can be written, before there is anything to write."""
    check_packages("--store", kind, "store", *store_kinds()[kind].packages)
    for i, name in enumerate(receiver_names):
        problem = store_kinds()[kind].problem_of(name)
        if problem:
            raise InputError(f"receivers[{i}]", problem)


def _compressors() -> list[Any]:
    """Return Zarr's usual codec, and one that refuses chunks that have changed since they were written."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return [ZstdCodec(level=0), Crc32cCodec()]
