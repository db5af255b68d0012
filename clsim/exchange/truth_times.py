"""At which times of a recording truth is written beside sound."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.recording import Recording
    from clsim.scene.scene import Scene


def truth_times(recording: Recording, scene: Scene, rate: float) -> Floats:
    """Return times (T,) from 0 on at a rate, Hz, as long as the sound and all trajectories last, s."""
    duration = recording.samples.shape[1] / recording.sampling_rate
    times = np.arange(int(duration * rate) + 1) / rate
    last = min(end.trajectory.end for _, end in scene.named_ends())
    return np.asarray(times[times <= last])
