"""Intel's CPU runtime gives what PoCL gives."""

from pathlib import Path

from driver_scenes import SCENES
from drivers import EVERYTHING, INTEL, PARITY_DB, POCL, apart_db, render

FEW = ["plain", "phased", "doubled", "pulses", "mesh", "baseband_pulses"]
NAMES = [f"{name}.cpu" for name in (SCENES if EVERYTHING else FEW)] + [f"{n}.gpu" for n in SCENES if EVERYTHING]


def test_parity(tmp_path: Path) -> None:
    intel, pocl = tmp_path / "intel", tmp_path / "pocl"
    render(INTEL, intel, *NAMES)
    render(POCL, pocl, *NAMES)
    assert {name: db for name in NAMES if (db := apart_db(intel, pocl, name)) > PARITY_DB} == {}
