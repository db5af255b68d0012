"""Published studies done again: the figures of the examples against those of the papers."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import clsim

pytestmark = pytest.mark.usefixtures("device")


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(clsim.__file__).parents[1] / "examples" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_speeds_at_which_codes_are_lost() -> None:
    """Paredes et al. 2011: nulls at 2.72, 0.67 and 0.17 m/s within 3 %; and no null elsewhere."""
    codes = example("moving_codes")
    for bits, published in zip(codes.BITS, codes.PUBLISHED, strict=True):
        assert codes.null(bits) == pytest.approx(published, rel=0.03)
    at_rest, half, gone = codes.peaks(6, np.array([0.0, 0.5, 1.0]) * codes.PUBLISHED[0])
    assert half / at_rest == pytest.approx(2.0 / np.pi, rel=0.03)  # sin(x) / x of half a turn
    assert gone / at_rest < 0.05
    # Matched to whole chips, the stretched code's ends count less, and cannot cancel the middle yet.
    assert codes.peaks(8, np.array([codes.PUBLISHED[1]]), 1.0)[0] > 0.05


def test_pistons_whose_nulls_split_a_chirp() -> None:
    """Carotenuto et al. 2020: the peak is off the true time for the four largest pistons of six, and there alone.

    Nulls are where ka sin(angle) = 3.832: at 50 kHz from a diameter of 8.4 mm on. That of 8.5 mm has its at 80 degrees
    and 50 kHz, the chirp's faded end.
    """
    pistons = example("piston_pulses")
    for diameter in pistons.DIAMETERS:
        error = np.abs(pistons.errors(diameter))
        assert error[0] < 1e-5
        assert (error.max() > 5e-3) == (diameter > 10.0)
        if diameter < 10.0:
            assert error.max() < 1e-4
