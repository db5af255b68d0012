"""Choice of the sources that have a diffuse tail, and the design of their tails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.tail.design import ULTRASOUND, NoTailError, SourceTail, TailOptions, find_tail, searched_order
from clsim.tail.diffuse_field import DiffuseField
from clsim.tail.zones import Zones

if TYPE_CHECKING:
    from collections.abc import Callable

    from clsim.paths.path_set import PathSet
    from clsim.render.options import RenderOptions

_MUCH_DB = -20.0  # of the reverberation, above which a note tells of it
_FAINT_DB = -60.0  # of all energy, below which a tail is not rendered


@dataclass(frozen=True, slots=True)
class FoundTails:
    """The tails of a scene's sources."""

    of_sources: tuple[SourceTail | None, ...] = ()  # by source; empty if none was asked for
    told: tuple[str, ...] = ()  # why some have none

    @property
    def duration(self) -> float:
        """The longest of them, s."""
        return max((tail.duration for tail in self.of_sources if tail is not None), default=0.0)


NO_TAILS = FoundTails()


def find_tails(paths: PathSet, options: RenderOptions, progress: Callable[[float], None] | None = None) -> FoundTails:
    """Return the tails that options ask for."""
    scene = paths.scene
    if options.tail == "off":
        return FoundTails(told=_without_tails(paths, options.sampling_rate))
    found: list[SourceTail | None] = []
    told: list[str] = []
    until = max(source.end for source in scene.sources) if options.duration is None else options.duration
    receivers = Zones.along(scene.receivers, scene.room, np.inf if options.duration is None else until, beams=False)
    asked = TailOptions(
        searched_order(paths), options.tail_directions, options.tail_error_db, options.tail_seed, device=options.device
    )
    for i, source in enumerate(scene.sources):
        low, high = source.emitted.band()
        if low >= ULTRASOUND:
            told.append(
                f"source {i}: no tail, for its band begins at {low:.0f} Hz and tails end at {ULTRASOUND:.0f} Hz"
            )
            found.append(None)
            continue
        own = Zones.along([source], scene.room, until, beams=True)
        tail = find_tail(scene, i, (low, min(high, 0.5 * options.sampling_rate)), (own, receivers), asked, progress)
        faint = tail.left_db < _FAINT_DB
        told += [f"source {i}: no tail, for images leave {tail.left_db:.0f} dB of the energy"] if faint else []
        found.append(None if faint else tail)
    if scene.bodies and any(tail is not None for tail in found):
        names = ", ".join(repr(body.name) for body in scene.bodies)
        told.append(f"tails are those of the room without its bodies ({names}), which take no sound out of them")
    return FoundTails(tuple(found), tuple(told))


def _without_tails(paths: PathSet, sampling_rate: float) -> tuple[str, ...]:
    """Note on the energy that images leave in a diffuse field, where that is much and tails are off."""
    highest = np.array([min(source.emitted.centre_frequency, 0.5 * sampling_rate) for source in paths.scene.sources])
    field = DiffuseField.of(paths.scene, highest[highest < ULTRASOUND])
    if field is None or not np.any(highest < ULTRASOUND):
        return ()
    left = float(field.left_db(searched_order(paths)).max())
    much = f"images leave some {left:.0f} dB of the reverberation: higher orders, and what walls scatter"
    return (f'{much} (tail="auto" adds it)',) if left > _MUCH_DB else ()


def left_by_images(paths: PathSet, sampling_rate: float) -> float | None:
    """Return the energy that images leave at 0 s, relative to all, of the source where it is most, dB, by a few rays.

    None in rooms from which most of the energy escapes.
    """
    scene, most = paths.scene, -np.inf
    receivers = Zones.frozen(scene.receivers, scene.room, 0.0, beams=False)
    asked = TailOptions(searched_order(paths), directions=1, error_db=np.inf)
    for i, source in enumerate(scene.sources):
        low, high = source.emitted.band()
        own = Zones.frozen([source], scene.room, 0.0, beams=True)
        try:
            found = find_tail(scene, i, (low, min(high, 0.5 * sampling_rate)), (own, receivers), asked)
        except NoTailError:
            return None
        most = max(most, found.left_db)
    return float(most)
