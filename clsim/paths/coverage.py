"""Check that materials and directivities cover the signal's band."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from clsim.scene.scene import Scene


def check_band_coverage(scene: Scene, sources: Iterable[int], low: float, high: float, what: str) -> None:
    """Check that materials and the directivities of receivers and some sources cover a band."""
    directivities = [(f"sources[{i}]", scene.sources[i].directivity) for i in sources]
    directivities += [(f"receivers[{i}]", receiver.directivity) for i, receiver in enumerate(scene.receivers)]
    for field, directivity in directivities:
        if not (directivity.band[0] <= low and high <= directivity.band[1]):
            raise InputError(
                f"{field}.directivity",
                f"must cover {what}, {low:.0f} to {high:.0f} Hz, but covers "
                f'{directivity.band[0]:.6g} to {directivity.band[1]:.6g} Hz; give more of it, or say outside="hold"',
            )
    for material in dict.fromkeys(scene.materials):
        try:
            material.check_coverage([low, high])
        except InputError as error:
            raise InputError("room", f"{error.field} {error.problem}") from error
