"""What the receivers heard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import NDArray

    from clsim.paths.path_set import PathSet


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What every receiver recorded, and what it came from.

    Attributes
    ----------
    samples : ndarray (receivers, samples) float32, or complex64 in baseband
        Sound pressure in Pa, or the voltage of a receiver with a transducer: see `units`. In baseband the complex
        envelope about `carrier`: 1 + 0j for a cosine of 1 Pa.
    sampling_rate : float
        Hz.
    receiver_names : tuple of str
        One per row.
    paths : PathSet or None
        The paths that were rendered, with their scene; None for tracks computed elsewhere.
    notes : tuple of str
        What was computed, a line each.
    units : tuple of str
        ``"Pa"`` or ``"V"``, one per row; all Pa when left out.
    clipped : tuple of int
        How many samples of each row a converter clipped; none when left out.
    carrier : float or None
        That of complex envelopes, Hz; None for sound as it is.
    """

    samples: NDArray[Any]
    sampling_rate: float
    receiver_names: tuple[str, ...]
    paths: PathSet | None
    notes: tuple[str, ...]
    units: tuple[str, ...] = ()
    clipped: tuple[int, ...] = ()
    carrier: float | None = None

    def __post_init__(self) -> None:
        count = len(self.receiver_names)
        object.__setattr__(self, "units", tuple(self.units) or ("Pa",) * count)
        object.__setattr__(self, "clipped", tuple(self.clipped) or (0,) * count)

    @property
    def pressure(self) -> NDArray[Any]:
        """Sound pressure (receivers, samples), Pa; in baseband its complex envelope.

        Raises
        ------
        InputError
            If a receiver has a transducer: its samples are no pressure.
        """
        return self._all_in("Pa", "pressure")

    @property
    def voltage(self) -> NDArray[Any]:
        """Voltage of the receivers' transducers (receivers, samples), V.

        Raises
        ------
        InputError
            If a receiver has none: its samples are sound pressure.
        """
        return self._all_in("V", "voltage")

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the samples, s, by the receivers' clocks."""
        return np.arange(self.samples.shape[1]) / self.sampling_rate

    def reception_times(self, receiver: int) -> NDArray[np.float64]:
        """Return the true times at which a receiver took its samples; see `Electronics`.

        Parameters
        ----------
        receiver : int
            Index.

        Returns
        -------
        ndarray (samples,)
            Times, s.
        """
        times = self.times
        return times if self.paths is None else times + self.paths.scene.receivers[receiver].clock_error(times)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a WAV file of 32-bit floats in Pa or V, one channel per receiver, whole or not at all.

        In baseband there are two channels per receiver, real part (I) before imaginary part (Q).

        Parameters
        ----------
        path : path-like
            Of the file.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        from clsim.files.sound import WavWriter, as_frames

        frames = as_frames(self.samples)
        with WavWriter(path, self.sampling_rate, frames.shape[1], len(frames)) as writer:
            writer.write(frames)

    def _all_in(self, unit: str, name: str) -> NDArray[Any]:
        for receiver, found in zip(self.receiver_names, self.units, strict=True):
            if found != unit:
                raise InputError(name, f"must be in {unit}, but {receiver!r} recorded {found}; take recording.samples")
        return self.samples
