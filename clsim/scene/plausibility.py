"""Warnings of what is allowed but hardly meant: other units than metres and hertz, swapped roles, missing aims."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from clsim.errors import warn
from clsim.scene.directivity.patterns import Omni
from clsim.scene.transducer.transducer import TRANSDUCER_NAMES, Transducer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.scene.ends import End, Receiver, Source
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


def warn_of_roles(sources: Sequence[Source], receivers: Sequence[Receiver]) -> None:
    """Warn of the first source that has a receiver's transducer, and of the first receiver that has a transmitter's."""
    sender, ear = TRANSDUCER_NAMES
    roles: tuple[tuple[str, Sequence[Source | Receiver], str, str], ...] = (
        ("sources", sources, ear, f"is a receiver, told in V/Pa; the transmitter is {sender}"),
        ("receivers", receivers, sender, f"is a transmitter, told in Pa/V; the receiver is {ear}"),
    )
    for field, ends, wrong, what in roles:
        known = Transducer.named(wrong)
        for i, end in enumerate(ends):
            given = end.transducer
            if given is not None and (given.name, given.sensitivity) == (wrong, known.sensitivity):
                warn(f"{field}[{i}].transducer: {wrong} {what}")
                break


def warn_of_facing(ends: Sequence[tuple[str, End]]) -> None:
    """Warn of the first directional end that moves but faces +x all the time because nothing says otherwise."""
    for field, end in ends:
        motion = end.trajectory
        if end.aim is None and not (motion.is_static or motion.has_orientation or isinstance(end.directivity, Omni)):
            warn(
                f"{field}: {end.name!r} moves and is directional, but faces +x all the time, as its trajectory has no "
                'orientations; give aim = "forward", aim_at = [x, y, z], or a direction such as aim = [1, 0, 0]'
            )
            break


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
