"""What a sonar should find out of the things that sound comes back from, of whatever kind they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from clsim.arrays import read_only, short_repr

if TYPE_CHECKING:
    from typing import Any

    from clsim.arrays import Floats
    from clsim.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class EchoTruth:
    """A way by each of some things between every source and receiver, (things, sources, receivers, T).

    Attributes
    ----------
    times : ndarray (T,)
        Times of reception, s.
    delay : ndarray (things, sources, receivers, T)
        From emission to reception, s, also where something is in the way; group delays in air that disperses.
    doppler_factor : ndarray (things, sources, receivers, T)
        Received over emitted frequency.
    range : ndarray (things, sources, receivers, T)
        From where it comes back to the receiver, m.
    radial_speed : ndarray (things, sources, receivers, T)
        Speed of sound times the change of the delay by time of reception, over 2, m/s: for a source and a receiver at
        one place at rest how fast the thing goes away.
    bearing : ndarray (things, sources, receivers, T, 3)
        Unit vectors from the receiver to where it comes back, in the room; in wind normals of the wavefront.
    source_names, receiver_names : tuple of str
        Along two of the axes.
    KIND, MEASURES : str, tuple of str
        What the things are, and names of the fields that have them along the first axis.
    """

    times: Floats
    delay: Floats
    doppler_factor: Floats
    range: Floats
    radial_speed: Floats
    bearing: Floats
    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]

    KIND: ClassVar[str]
    MEASURES: ClassVar[tuple[str, ...]] = ("delay", "doppler_factor", "range", "radial_speed", "bearing")

    __repr__ = short_repr

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the things, along the first axis."""
        named: tuple[str, ...] = getattr(self, f"{self.KIND}_names")
        return named


def echo_fields(scene: Scene, times: Floats, delay: Floats, rate: Floats, away: Floats, bearing: Floats) -> Any:
    """Return the fields of `EchoTruth` by their names.

    Shapes: times (T,) s; delay, rate, away (things, sources, receivers, T) s; bearing (things, sources, receivers, T,
    3).

    delay, rate, away: delay, s, its change by time of reception, s/s, and the way from the thing to the receiver, m.
    """
    speed = np.array([scene.air.speed_at(source.emitted.centre_frequency) for source in scene.sources])
    return {
        "times": times,
        "delay": read_only(delay),
        "doppler_factor": read_only(1.0 - rate),
        "range": read_only(away),
        "radial_speed": read_only(0.5 * speed[:, None, None] * rate),
        "bearing": read_only(bearing),
        "source_names": tuple(source.name for source in scene.sources),
        "receiver_names": tuple(receiver.name for receiver in scene.receivers),
    }
