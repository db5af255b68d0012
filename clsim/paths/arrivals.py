"""What paths bring when: delay, directions and length of each, in float64 at any time; its gain is asked for apart."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_choice

Motion = Literal["retarded", "quasi-static"]
Amplitude = Literal["wave-equation", "static", "convective"]
MOTIONS: tuple[str, ...] = get_args(Motion)
AMPLITUDES: tuple[str, ...] = get_args(Amplitude)
MACH_EXPONENT = {"static": 0, "wave-equation": 1, "convective": 2}

_AT_A_TIME = 16384  # arrivals of paths at times that are computed at a time, where they are many


@dataclass(frozen=True, slots=True)
class Kinematics:
    """Motion while sound is on its way, and how the source's motion changes the amplitude; as in `render`."""

    motion: str = "retarded"
    amplitude: str = "wave-equation"

    def __post_init__(self) -> None:
        as_choice("motion", self.motion, MOTIONS)
        as_choice("amplitude", self.amplitude, AMPLITUDES)

    @property
    def retarded(self) -> bool:
        """Whether everything is where it was when the sound passed, not where it is at reception."""
        return self.motion == "retarded"

    @property
    def exponent(self) -> int:
        """Exponent of the Doppler factor in the amplitude."""
        return MACH_EXPONENT[self.amplitude]


RETARDED = Kinematics()
QUASI_STATIC = Kinematics("quasi-static")


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """What P paths bring at T times, each array (P, T) or (P, T, 3)."""

    delay: Floats  # (P, T) from emission to reception, s
    delay_rate: Floats  # (P, T) its derivative by the time of reception; the Doppler factor is ``1 - delay_rate``
    # (P, T, 3) unit vectors: from the real source along the path, and from the receiver back along it; in wind
    # the normals of the wavefront.
    departure: Floats
    arrival: Floats  # likewise
    length: Floats  # (P, T) of the path, over which pressure falls, m
    through: Floats  # (P, T) of the air that it passes, m: the same where the air rests
    means: Floats | None  # (P, T, terms) means of polynomials of the height along it, where the air depends on that
    emission_time: Floats  # (P, T) when it was emitted, s
    mach_factor: Floats  # (P, T) factor of the amplitude by the source's motion
    frequency_ratio: Floats  # (P, T) frequency on the way over that emitted: ``1 / (1 - M)``
    # (P, T, ...) quantities that only responses of a kind of path need, by name.
    more: dict[str, Floats] = field(default_factory=dict)

    def part(self, rows: NDArray[np.int64], times: slice | NDArray[np.int64] = slice(None)) -> Self:
        """Arrivals of some of the paths at some of the times; of rows and times (n, 1) each path at its own."""
        columns = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "more"}
        some: dict[str, Any] = {name: None if x is None else x[rows, times] for name, x in columns.items()}
        return replace(self, **some, more={name: x[rows, times] for name, x in self.more.items()})


def slices_of(times: int, paths: int) -> list[slice]:
    """Return slices of so many times that the arrivals of so many paths take little memory."""
    step = max(1, _AT_A_TIME // max(paths, 1))
    return [slice(i, i + step) for i in range(0, times, step)]
