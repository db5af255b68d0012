"""When the pulses of a source are received: what a range is measured against."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import as_index
from clsim.errors import InputError
from clsim.paths.ground_truth import in_sight, reception_times
from clsim.paths.specular.family import SpecularPaths
from clsim.recording import as_recording

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.path_set import PathSet
    from clsim.recording import Recording

_LATE = 1e-10  # s, of rounding, by which a receiver's trajectory may be exceeded


def heard_scene(recording: Recording, what: str) -> PathSet:
    """Return the paths of a recording that a score of some kind is made of."""
    recording = as_recording(recording)
    if recording.carrier is not None:
        raise InputError("recording", f"must be sound for {what}, but is the envelope about {recording.carrier:g} Hz")
    if recording.paths is None:
        raise InputError("recording", f"must have its paths for {what}, but has none: load_recording(…, paths=True)")
    return recording.paths


def source_index(paths: PathSet, source: int | str) -> int:
    """Return the index of a source, by index or name."""
    return as_index("source", source, [one.name for one in paths.scene.sources])


def direct_delays(paths: PathSet, source: int, emitted: Floats, motion: str) -> tuple[Floats, NDArray[np.bool_]]:
    """Return delays (receivers, K) of the direct sound emitted at times (K,), s, and a mask of those in sight.

    Delays are known where a wall is in the way, too; they are NaN beyond the end of a receiver's trajectory.
    """
    receivers = paths.scene.receivers
    received = np.empty((len(receivers), len(emitted)))
    for pair in SpecularPaths.direct(paths.scene).pairs():
        if pair.source == source:
            received[pair.receiver] = reception_times(pair, emitted, motion)
    last = np.array([receiver.trajectory.end for receiver in receivers])[:, None]
    return np.where(received <= last + _LATE, received - emitted, np.nan), in_sight(paths, source, received)
