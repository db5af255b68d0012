"""Intel's CPU runtime gives what PoCL gives."""

from collections.abc import Callable
from pathlib import Path

import pytest
from driver_scenes import SCENES
from drivers import EVERYTHING, FEW_ON_GPUS, INTEL, PARITY_DB, apart_db, render

FEW = ["phased", "doubled", "pulses", "mesh", "swinging", "sonar", "crowd", "baseband_pulses", "pairs"]
NAMES = [f"{name}.cpu" for name in (SCENES if EVERYTHING else FEW)] + [
    f"{name}.gpu" for name in (SCENES if EVERYTHING else FEW_ON_GPUS[:1])
]


@pytest.mark.exhaustive
@pytest.mark.slow
def test_parity(tmp_path: Path, by_pocl: Callable[..., Path]) -> None:
    intel = tmp_path / "intel"
    render(INTEL, intel, *NAMES)
    wanted = by_pocl()
    assert {name: db for name in NAMES if (db := apart_db(intel, wanted, name)) > PARITY_DB} == {}
