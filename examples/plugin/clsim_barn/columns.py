"""A store: one NumPy file whose columns are receivers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clsim.output.stores import SoundStore


class Columns(SoundStore):
    """A NumPy file (samples, receivers)."""

    @staticmethod
    def names(receivers: Sequence[str]) -> list[str]:
        return ["sound.npy"]

    def create(self) -> None:
        shape = (self._sound.samples, len(self._sound.receiver_names))
        np.lib.format.open_memmap(self.paths[0], "w+", self._sound.sample_type, shape).flush()

    def open(self) -> None:
        self._array = np.lib.format.open_memmap(self.paths[0], "r+")

    def write(self, start: int, samples: NDArray[np.generic], first: int = 0) -> None:
        self._array[start : start + samples.shape[1], first : first + len(samples)] = samples.T

    def to_disk(self) -> None:
        self._array.flush()

    def close(self) -> None:
        del self._array

    def row(self, folder: Path, receiver: int) -> NDArray[np.generic]:
        return np.load(folder / "sound.npy", mmap_mode="r")[:, receiver]
