"""What a wall sends back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clsim.arrays import Floats


def reflection_from_absorption(alpha: ArrayLike) -> Floats:
    """Return the reflection factor of sound pressure of a wall that absorbs a share of the energy.

    Parameters
    ----------
    alpha : array_like (...)
        Absorption coefficients, 0 to 1.

    Returns
    -------
    ndarray (...)
        Factors, 0 to 1: the phase is unknown, and taken as that of a rigid wall.

    Notes
    -----
    ``R = sqrt(1 - α)``: H. Kuttruff, "Room Acoustics", 5th ed. 2009, section 2.1.

    Examples
    --------
    >>> reflection_from_absorption([0.0, 0.36, 1.0]).tolist()
    [1.0, 0.8, 0.0]
    """
    factor: Floats = np.sqrt(1.0 - np.asarray(alpha, dtype=np.float64))
    return factor
