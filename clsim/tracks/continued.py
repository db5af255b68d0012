"""Tracks between ends that go on smoothly before their start and after their end, for impulse responses beyond a run.

Responses of nodes beyond the ends of a run, and of paths by which nothing sounds yet, need not be right, but must
change smoothly: what stands still at once would spread through the windows of nodes into what sounds.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from clsim.paths.path_set import PathSet
from clsim.scene.motion.curves import CONTINUATION, onward

if TYPE_CHECKING:
    from clsim.scene.ends import Receiver, Source
    from clsim.scene.motion.trajectory import Trajectory
    from clsim.tracks.tracks import SceneTracks

    End = TypeVar("End", Source, Receiver)


def continued(tracks: SceneTracks, seconds: float) -> SceneTracks:
    """Return the same tracks between ends that move on for so many seconds at either side.

    Ends are copied without their checks: where nothing sounds they may be outside of the room.
    """
    scene, families = copy(tracks.scene), {id(family): copy(family) for family in tracks.paths.families}
    object.__setattr__(scene, "sources", tuple(_end(end, seconds) for end in tracks.scene.sources))
    object.__setattr__(scene, "receivers", tuple(_end(end, seconds) for end in tracks.scene.receivers))
    for family in families.values():
        object.__setattr__(family, "scene", scene)
    pair_paths = tuple(replace(pair, family=families[id(pair.family)]) for pair in tracks.pair_paths)
    return replace(tracks, paths=PathSet(scene, tuple(families.values())), pair_paths=pair_paths)


def _end(end: End, seconds: float) -> End:
    made = copy(end)
    object.__setattr__(made, "trajectory", _motion(end.trajectory, seconds))
    return made


def _motion(motion: Trajectory, seconds: float) -> Trajectory:
    """Return a motion that goes on: lines and circles as they are, others straight beyond their continuation."""
    if motion.end == np.inf:
        return motion
    curve = onward(motion.curve, motion.start - CONTINUATION, motion.end + CONTINUATION)
    return replace(motion, curve=curve, start=motion.start - seconds, end=motion.end + seconds)
