"""What paths bring when: delay, directions and length of each, in float64 at any time; its gain is asked for apart."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from clsim.arrays import Floats

Motion = Literal["retarded", "quasi-static"]
Amplitude = Literal["wave-equation", "static", "convective"]
MOTIONS: tuple[str, ...] = get_args(Motion)
AMPLITUDES: tuple[str, ...] = get_args(Amplitude)
MACH_EXPONENT = {"static": 0, "wave-equation": 1, "convective": 2}

_AT_A_TIME = 16384  # arrivals of paths at times that are computed at a time, where they are many


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """What P paths bring at T times, each array (P, T) or (P, T, 3).

    Attributes
    ----------
    departure, arrival : ndarray (P, T, 3)
        Unit vectors: from the real source along the path, and from the receiver back along it; in wind the normals
        of the wavefront.
    """

    delay: Floats  # (P, T) from emission to reception, s
    delay_rate: Floats  # (P, T) its derivative by the time of reception; the Doppler factor is ``1 - delay_rate``
    departure: Floats
    arrival: Floats
    length: Floats  # (P, T) of the path, over which pressure falls, m
    through: Floats  # (P, T) of the air that it passes, m: the same where the air rests
    means: Floats | None  # (P, T, terms) means of polynomials of the height along it, where the air depends on that
    emission_time: Floats  # (P, T) when it was emitted, s
    mach_factor: Floats  # (P, T) factor of the amplitude by the source's motion
    frequency_ratio: Floats  # (P, T) frequency on the way over that emitted: ``1 / (1 - M)``

    def part(self, rows: NDArray[np.int64], times: slice = slice(None)) -> Self:
        """Arrivals of some of the paths at some of the times."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        some: dict[str, Any] = {name: None if x is None else x[rows, times] for name, x in columns.items()}
        return replace(self, **some)


def slices_of(times: int, paths: int) -> list[slice]:
    """Return slices of so many times that the arrivals of so many paths take little memory."""
    step = max(1, _AT_A_TIME // max(paths, 1))
    return [slice(i, i + step) for i in range(0, times, step)]
