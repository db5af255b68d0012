"""What is allowed but hardly meant: rooms and signals in other units than metres and hertz."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from clsim.errors import warn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.scene.ends import Source
    from clsim.scene.room.protocol import Room

_LARGEST, _SMALLEST = 300.0, 0.2  # m, beyond which a room is likely to be in other units
_USUAL = 5.0  # m, size of a room
_LOWEST = 100.0  # Hz, below which paths are no picture of sound in a room


def warn_of_units(room: Room, sources: Sequence[Source]) -> None:
    """Warn of a room of a size that rooms do not have, and of signals too low to follow paths."""
    doubts = [_doubt_in_size(room)]
    doubts += [_doubt_in_frequency(i, s.signal.centre_frequency) for i, s in enumerate(sources)]
    for doubt in filter(None, doubts):
        warn(doubt)


def _doubt_in_size(room: Room) -> str:
    low, high = room.extent
    size = float((high - low).max())
    if _SMALLEST <= size <= _LARGEST:
        return ""
    steps = round(math.log(size / _USUAL, 1000.0)) or (1 if size > _USUAL else -1)
    factor = 1000.0**-steps
    scale = room.scale
    advice = f"{factor:g} times its lengths" if scale is None else f"scale = {scale * factor:g}"
    unit = {None: "for millimetres, ", 1.0: "for a file in millimetres, "}.get(scale, "") if steps == 1 else ""
    return f"room: {size:.4g} m is {'large' if steps > 0 else 'small'} for a room; {unit}try {advice}"


def _doubt_in_frequency(source: int, frequency: float) -> str:
    if frequency >= _LOWEST:
        return ""
    return (
        f"sources[{source}].signal: {frequency:.4g} Hz is low for paths in a room; "
        f"frequencies are in Hz: for {frequency:.4g} kHz, try {frequency:.4g}e3"
    )
