"""Direct sound that is in the shadow of scatterers, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.scene.ends import Receiver, Source
from clsim.scene.motion.motion import seen_by
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene

_INSTANTS = 1001  # of a run at which lines of sight are looked at
_PLACES = np.linspace(-1.0, 1.0, 33)[:, None]  # about the place nearest to a centre, in largest radii
_PAIRS = 8  # that are told of one by one
_EVALUATIONS = 301  # of a signal at which several scatterers may stand in the line of sight at once


def shaded_pairs(scene: Scene, duration: float) -> list[str]:
    """Lines that say by which scatterers direct sound is shaded, and when, in the first `duration` s of a scene."""
    # A line of sight is shaded where a scatterer is nearer than the radius of the first Fresnel zone there.
    casting = [scatterer for scatterer in scene.scatterers if scatterer.shape.shadows]
    pairs = [(s, r) for s in scene.sources for r in scene.receivers] if casting else []
    lines: list[str] = []
    for i, (source, receiver) in enumerate(pairs):
        if len(lines) == _PAIRS:
            return [*lines, f"shadows: {len(pairs) - i} more pairs are not looked at"]
        wavelength = scene.air.speed_of_sound / source.emitted.centre_frequency
        found = [(one.name, _spans(source, receiver, one, (wavelength, duration))) for one in casting]
        by = [f"{name} {', '.join(spans)}" for name, spans in found if spans]
        if by:
            lines.append(f"shadows: {source.name} to {receiver.name} by {'; '.join(by)}")
    return lines


def hidden_by_several(
    sources: Sequence[Source], receivers: Sequence[Receiver], scatterers: Sequence[Scatterer]
) -> str | None:
    """Words for the first line of sight in which a sphere by its series and another thing with a shadow stand at once.

    None for no such. Their shadows add up: the second takes the sound away that the first has taken already. Those of
    outlines multiply. The first eight pairs are looked at.
    """
    casting = [scatterer for scatterer in scatterers if scatterer.shape.shadows]
    series = np.array([not one.shape.outlined for one in casting])
    if len(casting) < 2 or not series.any():
        return None
    for source, receiver in [(s, r) for s in sources for r in receivers][:_PAIRS]:
        last = min(source.end, receiver.trajectory.end, *(one.trajectory.end for one in casting))
        times = np.linspace(max(source.start, 0.0), max(last, source.start, 0.0), _EVALUATIONS)
        cut = np.array([_cut(source, receiver, one, times) for one in casting])
        several = np.flatnonzero((cut.sum(axis=0) > 1) & cut[series].any(axis=0))
        if len(several):
            names = " and ".join(
                repr(one.name) for one, is_cut in zip(casting, cut[:, several[0]], strict=True) if is_cut
            )
            at = f"from {source.name!r} to {receiver.name!r} at {times[several[0]]:.3g} s"
            return f"{names} stand in the line of sight {at}"
    return None


def _cut(source: Source, receiver: Receiver, scatterer: Scatterer, times: Floats) -> NDArray[np.bool_]:
    """Mask (T,) of times at which a scatterer stands in a line of sight."""
    begin, end = (seen_by(scatterer.trajectory, each.trajectory).position(times) for each in (source, receiver))
    return _in_zone(scatterer, begin, end, 0.0)


def _spans(source: Source, receiver: Receiver, scatterer: Scatterer, numbers: tuple[float, float]) -> list[str]:
    """Spans in which a scatterer is in the first Fresnel zone of a line of sight, by wavelength, m, and duration, s."""
    seen = [seen_by(scatterer.trajectory, end.trajectory) for end in (source, receiver)]
    times = np.linspace(max(0.0, *(m.start for m in seen)), min(numbers[1], *(m.end for m in seen)), _INSTANTS)
    shaded = _in_zone(scatterer, seen[0].position(times), seen[1].position(times), numbers[0])
    if shaded.all():
        return ["all the time"]
    turns = np.flatnonzero(np.diff(np.concatenate([[0], shaded.astype(np.int8), [0]])))
    return [f"from {times[a]:.3g} to {times[b - 1]:.3g} s" for a, b in zip(turns[::2], turns[1::2], strict=True)]


def _in_zone(scatterer: Scatterer, source: Floats, receiver: Floats, wavelength: float) -> NDArray[np.bool_]:
    """Mask (n,) of lines of sight (n, 3), in the scatterer's frame, whose first Fresnel zone it reaches into."""
    sight = receiver - source
    length = np.maximum(np.linalg.norm(sight, axis=1), 1e-9)
    sight = sight / length[:, None]
    nearest = -np.sum(source * sight, axis=1)
    before = np.clip(nearest, 0.0, length)
    zone = np.sqrt(wavelength * before * (length - before) / length)
    met = (nearest > 0.0) & (nearest < length)
    rows = np.flatnonzero(met)
    # Most of a run it is nowhere near: its shape is asked of lines of sight within its largest radius.
    foot = np.linalg.norm(source + nearest[:, None] * sight, axis=1)
    rows = rows[foot[rows] < scatterer.shape.radius + zone[rows]]
    met[:] = False
    for row in rows:
        places = source[row] + (nearest[row] + scatterer.shape.radius * _PLACES) * sight[row]
        met[row] = bool(scatterer.shape.holds(places, float(zone[row])).any())
    return np.asarray(met)
