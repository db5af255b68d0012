"""Direct sound that is left out, or leaks past something, pair by pair: what a sonar hears of its own source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from clsim.arrays import as_number, read_only
from clsim.errors import InputError
from clsim.paths.arrivals import QUASI_STATIC
from clsim.paths.family import BODY, SPECULAR
from clsim.scene.placement import together

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.family import PathFamily
    from clsim.paths.options import DirectSound
    from clsim.scene.scene import Scene

_FLUSH = 5e-6  # m over a face, up to which an end sits in it


def direct_levels(scene: Scene, direct: DirectSound) -> Floats:
    """Return the pressure of the direct sound (sources, receivers) over that in the open, as it is wanted."""
    levels = np.ones((len(scene.sources), len(scene.receivers)))
    if not isinstance(direct, Mapping):
        levels[:] = _pressure("direct", direct)
        return _checked(scene, levels)
    names = [[end.name for end in ends] for ends in (scene.sources, scene.receivers)]
    for pair, value in direct.items():
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise InputError("direct", f"must have pairs (source, receiver) of names for keys, but has {pair!r:.80}")
        for kind, name, known in zip(("source", "receiver"), pair, names, strict=True):
            if name not in known:
                listed = ", ".join(map(repr, known[:8])) + (", ..." if len(known) > 8 else "")
                raise InputError("direct", f"must name a {kind} of the scene ({listed}), but names {name!r:.80}")
        place = names[0].index(pair[0]), names[1].index(pair[1])
        levels[place] = _pressure(f"direct[{pair[0]}, {pair[1]}]", value)
    return _checked(scene, levels)


def _checked(scene: Scene, levels: Floats) -> Floats:
    """Refuse direct sound from a source to a receiver at the same place, which would be infinite."""
    for s, r in np.argwhere(levels != 0.0).tolist():
        source, receiver = scene.sources[s], scene.receivers[r]
        if together(source, receiver):
            raise InputError(
                "direct",
                f"must be False for {source.name!r} and {receiver.name!r}, which are at the same place, "
                f"but is {True if levels[s, r] == 1.0 else 20.0 * np.log10(levels[s, r])!r:.20}",
            )
    return levels


def with_direct(families: tuple[PathFamily, ...], levels: Floats) -> tuple[PathFamily, ...]:
    """Return paths with direct ones scaled by levels (sources, receivers): 1 changes nothing, 0 leaves them out.

    Where both ends sit in one face, its reflection is the direct sound once more, and is scaled with it.
    """
    if np.all(levels == 1.0):
        return families
    each = [np.where(_is_direct(f, levels), levels[f.source, f.receiver], 1.0) for f in families]
    free = tuple(f.part(np.flatnonzero(level == 1.0)) for f, level in zip(families, each, strict=True))
    leaks = [
        _leaking(f, level) for f, level in zip(families, each, strict=True) if np.any((level != 0.0) & (level != 1.0))
    ]
    return (*free, *leaks)


def _is_direct(family: PathFamily, levels: Floats) -> NDArray[np.bool_]:
    """Return a mask of paths that meet nothing, or, between scaled pairs, only the face that both ends sit in.

    With heights h over a face its reflection has the length L, and ``4 h1 h2 = L^2 - d^2`` with the distance d.
    """
    direct: NDArray[np.bool_] = np.equal(family.order, 0)
    scene = family.scene
    for p in np.flatnonzero((family.order == 1) & (levels[family.source, family.receiver] != 1.0)).tolist():
        if family.interactions[p, 0] not in (SPECULAR, BODY):
            continue
        source, receiver = scene.sources[family.source[p]], scene.receivers[family.receiver[p]]
        now = np.array([np.clip(max(family.start[p], 0.0), source.trajectory.start, source.trajectory.end)])
        length = float(family.arrivals(np.array([p]), now, QUASI_STATIC).length[0, 0])
        apart = receiver.trajectory.position(now) - source.trajectory.position(now)
        direct[p] = length**2 - float(np.sum(apart**2)) < 4.0 * _FLUSH**2
    return direct


def _pressure(field: str, value: Any) -> float:
    """Return the pressure that a level, dB, stands for; True is 1 and False 0."""
    if isinstance(value, bool | np.bool_):
        return float(value)
    if not isinstance(value, int | float | np.integer | np.floating) or not value < 0.0:  # neither 1 nor 0 is a level
        raise InputError(field, f"must be True, False or a level below 0 dB, but is {value!r:.80}")
    return float(10.0 ** (as_number(field, value) / 20.0))


def _leaking(family: PathFamily, level: Floats) -> PathFamily:
    """Return the direct paths that leak."""
    rows = np.flatnonzero((level != 1.0) & (level != 0.0))
    made: PathFamily = replace(cast("Any", family.part(rows)), level=read_only(level[rows]))
    return made
