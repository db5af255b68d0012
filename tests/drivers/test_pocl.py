"""PoCL without optimisation, which other drivers are held against, gives the bits of PoCL as users have it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from driver_runs import rendered
from drivers import POCL, need_pocl


@pytest.mark.exhaustive
def test_optimisation_changes_no_bit(by_pocl: Callable[..., Path]) -> None:
    need_pocl()
    plain = by_pocl()
    for name in ("phased.cpu", "doubled.cpu", "pulses.cpu", "baseband_pulses.cpu"):
        heard = rendered(POCL.platform, name)
        assert np.any(heard)
        assert np.array_equal(heard, np.load(plain / f"{name}.npz")["heard"]), name
