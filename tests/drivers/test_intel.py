"""Intel's CPU runtime gives what PoCL gives.

Its compiler makes of a kernel one for several work-items at a time, which takes most of its time: every kernel is compiled so
once, as users have it, and in the other scenes, which are there for their options, optimised as well but for one at a time.
"""

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from driver_scenes import SCENES
from drivers import EVERYTHING, INTEL, OPTIONS, PARITY_DB, Driver, apart_db, launched, render

from clsim.opencl.launch import PROGRAMS

AS_USERS = [
    "crowd.cpu", "waves.cpu", "rays.cpu", "channels.cpu", "tapered.cpu", "ear_channels.cpu", "moments.cpu", "heads.cpu", "doubled.cpu",
    "baseband_pulses.cpu", "baseband_bend.cpu", "pairs.cpu", "plain.gpu",
]  # fmt: skip
SCALAR = [
    "functions.cpu", "harmonics.cpu", "phased.cpu", "fine.cpu", "pulses.cpu", "mesh.cpu", "bend.cpu", "swinging.cpu", "sonar.cpu",
    "shadows.cpu",    "pairs_pulses.cpu", "lopsided.cpu", "baseband_tilted.cpu", "baseband.gpu", "waves.gpu", "moments.gpu",
]  # fmt: skip
ALL = [f"{name}.{layout}" for name in SCENES for layout in ("cpu", "gpu")]
INTEL_SCALAR = dataclasses.replace(INTEL, settings={"CL_CONFIG_CPU_VECTORIZER_MODE": "1"})


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize(
    ("driver", "names"),
    [(INTEL, ALL if EVERYTHING else AS_USERS), (INTEL_SCALAR, SCALAR)],
    ids=["as users have it", "one work-item at a time"],
)
def test_parity(driver: Driver, names: list[str], tmp_path: Path, by_pocl: Callable[..., Path]) -> None:
    render(driver, tmp_path, *names)
    wanted = by_pocl()
    assert {name: db for name in names if (db := apart_db(tmp_path, wanted, name)) > PARITY_DB} == {}


@pytest.mark.exhaustive
def test_scenes_run_every_kernel_with_every_option(by_pocl: Callable[..., Path]) -> None:
    by = by_pocl()
    ran = {name: launched(by, name) for name in [*AS_USERS, *SCALAR]}
    assert branches(ran.values()) == branches(launched(by, file.stem) for file in by.glob("*.npz"))
    as_users = {program for name in AS_USERS for program, _ in ran[name]}
    assert as_users == set(PROGRAMS)


def branches(scenes: Iterable[list[tuple[str, dict[str, str]]]]) -> set[tuple[str, str, str]]:
    """Return programs, options by which code is chosen, and their values."""
    return {
        (program, o, value) for ran in scenes for program, given in ran for o, value in given.items() if o in OPTIONS
    }
