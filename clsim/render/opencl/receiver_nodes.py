"""Receivers at nodes, as the device takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.numerics.quaternions import rotate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.ends import Receiver

# A receiver at a node, as in nodes/image.h.
RECEIVER_NODE = np.dtype(
    [("position", "f8", 3), ("velocity", "f8", 3), ("axes", "f8", (2, 3)), ("clock_error", "f8"), ("clock_rate", "f8")]
)


def receiver_at(receiver: Receiver, times: Floats) -> NDArray[Any]:
    """Return position, velocity, axes and clock of a receiver, (times,)."""
    out = np.empty(len(times), dtype=RECEIVER_NODE)
    out["clock_error"] = receiver.clock_error(times)
    out["clock_rate"] = receiver.clock_rate
    true = times + out["clock_error"]
    out["position"], out["velocity"] = receiver.trajectory.position(true), receiver.trajectory.velocity(true)
    for i, axis in enumerate(np.eye(3)[:2]):
        out["axes"][:, i] = rotate(receiver.orientation(true), axis)
    return out
