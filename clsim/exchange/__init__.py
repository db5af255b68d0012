"""Recordings as other programs take them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.recording import Recording
    from clsim.scene.scene import Scene


def truth_times(recording: Recording, scene: Scene, rate: float) -> Floats:
    """Return the times (T,) of written truth, s: at `rate` (Hz) from 0 to the end of the sound or of a trajectory."""
    duration = recording.samples.shape[1] / recording.sampling_rate
    times = np.arange(int(duration * rate) + 1) / rate
    last = min(end.trajectory.end for _, end in scene.named_ends())
    return np.asarray(times[times <= last])
