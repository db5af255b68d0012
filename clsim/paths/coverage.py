"""Whether walls and beams are known where sound is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from clsim.scene.scene import Scene


def check_known(scene: Scene, sources: Iterable[int], low: float, high: float, what: str) -> None:
    """Refuse, or warn, where walls, receivers' beams or those of some sources are not known from `low` to `high` Hz.

    Parameters
    ----------
    scene : Scene
        Holds them.
    sources : iterable of int
        Indices.
    low, high : float
        Hz.
    what : str
        Stands in the message: "must cover ...".

    Raises
    ------
    InputError
        If they are not known there, and may not be continued.
    """
    beams = [(f"sources[{i}]", scene.sources[i].directivity) for i in sources]
    beams += [(f"receivers[{i}]", receiver.directivity) for i, receiver in enumerate(scene.receivers)]
    for field, beam in beams:
        if not (beam.band[0] <= low and high <= beam.band[1]):
            raise InputError(
                f"{field}.directivity",
                f"must cover {what}, {low:.0f} to {high:.0f} Hz, but is known from "
                f'{beam.band[0]:.6g} to {beam.band[1]:.6g} Hz; give more of it, or say outside="hold"',
            )
    for material in dict.fromkeys(scene.room.faces.materials):
        try:
            material.check_known([low, high])
        except InputError as error:
            raise InputError("room", f"{error.field} {error.problem}") from error
