"""When the pulses of a source are received: what a range is measured against."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import as_index
from clsim.errors import InputError
from clsim.paths.specular.family import SpecularPaths
from clsim.recording import as_recording

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.path_set import PathSet
    from clsim.recording import Recording

_STEPS = 12  # of Newton's method
_EXACT = 1e-13  # s


def heard_scene(recording: Recording, what: str) -> PathSet:
    """Return the paths of a recording that a score of some kind is made of.

    Raises
    ------
    InputError
        If it is no recording, has none, or is a complex envelope.
    """
    recording = as_recording(recording)
    if recording.carrier is not None:
        raise InputError("recording", f"must be sound for {what}, but is the envelope about {recording.carrier:g} Hz")
    if recording.paths is None:
        raise InputError("recording", f"must have its paths for {what}, but has none: load_recording(…, paths=True)")
    return recording.paths


def source_index(paths: PathSet, source: int | str) -> int:
    """Return the index of a source, by index or name.

    Raises
    ------
    InputError
        If there is none.
    """
    return as_index("source", source, [one.name for one in paths.scene.sources])


def direct_delays(paths: PathSet, source: int, emitted: Floats, motion: str) -> tuple[Floats, NDArray[np.bool_]]:
    """Return delays (receivers, K) of the direct sound emitted at times (K,), s, and whether it is heard.

    Delays are known where a wall is in the way, too. What is received at r was emitted at ``r - delay(r)``, which grows
    with r: Newton's method.
    """
    receivers = len(paths.scene.receivers)
    delay, seen = np.empty((receivers, len(emitted))), np.zeros((receivers, len(emitted)), dtype=bool)
    for pair in SpecularPaths.direct(paths.scene).pairs():
        if pair.source != source:
            continue
        last = paths.scene.receivers[pair.receiver].trajectory.end
        received = np.minimum(emitted, last)
        for _ in range(_STEPS):
            found = pair.arrivals(received, motion)
            error = received - found.delay[0] - emitted
            received = np.minimum(received - error / (1.0 - found.delay_rate[0]), last)
            if np.abs(error).max(initial=0.0) < _EXACT:
                break
        delay[pair.receiver] = np.where(np.abs(error) < 1e3 * _EXACT, received - emitted, np.nan)
        for row in np.flatnonzero((paths.order == 0) & (paths.source == source) & (paths.receiver == pair.receiver)):
            seen[pair.receiver] |= (received >= paths.start[row]) & (received < paths.end[row])
    return delay, seen
