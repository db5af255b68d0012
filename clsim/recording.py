"""What the receivers heard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import NDArray

    from clsim.paths.path_set import PathSet


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Sound pressure at every receiver, and what it came from.

    Attributes
    ----------
    pressure : ndarray (receivers, samples) float32
        Sound pressure, Pa.
    sampling_rate : float
        Hz.
    receiver_names : tuple of str
        One per row.
    paths : PathSet or None
        The paths that were rendered, with their scene; None for tracks computed elsewhere.
    notes : tuple of str
        What was computed, a line each.
    """

    pressure: NDArray[np.float32]
    sampling_rate: float
    receiver_names: tuple[str, ...]
    paths: PathSet | None
    notes: tuple[str, ...]

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the samples, s."""
        return np.arange(self.pressure.shape[1]) / self.sampling_rate

    def save(self, path: str | PathLike[str]) -> None:
        """Write a WAV file of 32-bit floats in Pa, one channel per receiver, whole or not at all.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        from clsim.output.wav import WavWriter

        channels, samples = self.pressure.shape
        with WavWriter(path, self.sampling_rate, channels, samples) as writer:
            writer.write(self.pressure.T)
