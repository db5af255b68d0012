"""Files of motion, written row by row."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clsim.errors import ClsimWarning, InputError
from clsim.scene.motion.trajectory import Trajectory


def motion(count=60, step=0.1):
    t = step * np.arange(count)
    x = np.stack([np.sin(t), np.cos(t), 0.1 * t], axis=1)
    q = Rotation.from_rotvec(np.outer(t, [0.3, -0.2, 0.5])).as_quat()
    return t, x, q


def write(path, rows, head="t,x,y,z,qx,qy,qz,qw", separator=","):
    lines = [head, *(separator.join(str(cell) for cell in row) for row in rows)]
    path.write_text("\n".join(line for line in lines if line) + "\n", encoding="utf-8")
    return path


def by_points(path, form, **more):
    """Load without smoothing and without its warning."""
    with pytest.warns(ClsimWarning, match="Doppler noise"):
        return Trajectory.from_file(path, form, smooth=False, **more)


def refused(path, form="csv", **more):
    with pytest.raises(InputError) as caught:
        Trajectory.from_file(path, form, **more)
    return caught.value
