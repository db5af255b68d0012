"""Pairs of source and receiver that never move: which they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from clsim.render.interpolator import Bandlimited
from clsim.scene.directivity.patterns import Omni

if TYPE_CHECKING:
    from clsim.render.options import RenderOptions
    from clsim.scene.ends import Receiver, Source
    from clsim.tracks.tracks import Tracks


@dataclass(frozen=True, slots=True)
class StaticPairs:
    """Which pairs are convolved.

    Attributes
    ----------
    indices : frozenset of int
        Indices among the tracks' pairs.
    """

    indices: frozenset[int] = frozenset()

    def holds(self, tracks: Tracks, source: int) -> bool:
        """Return whether all paths of a source are convolved, and there are some."""
        mine = {i for i, pair in enumerate(tracks.pairs) if pair.source == source}
        return bool(mine) and mine <= self.indices


def find_static_pairs(tracks: Tracks, options: RenderOptions) -> StaticPairs:
    """Return the pairs that never change, where they are to be convolved.

    Neither end moves, no clock drifts, no path begins or ends, and no directivity turns. A delay filter that is asked
    for by name (Lagrange) is used for all paths, and the reference engine renders all of them one by one.
    """
    of_scene = tracks.of_scene
    wanted = options.convolve_static and options.engine == "opencl" and isinstance(options.interpolator, Bandlimited)
    if of_scene is None or not wanted:
        return StaticPairs()
    scene, found = of_scene.scene, []
    for i, pair in enumerate(tracks.pairs):
        source, receiver = scene.sources[pair.source], scene.receivers[pair.receiver]
        static = _is_static(source) and _is_static(receiver) and not of_scene.pair_paths[i].family.moves
        if static and receiver.clock_rate == 1.0 and pair.always_heard:
            found.append(i)
    return StaticPairs(frozenset(found))


def _is_static(end: Source | Receiver) -> bool:
    return end.trajectory.is_static and (isinstance(end.directivity, Omni) or not end.trajectory.turns)
