"""Disks that are full at some moment: one line, nothing that looks whole is not, and it goes on where there is room.

Two at every change; `make attacks` does 30, of random sizes.
"""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from killing import content
from late import installed
from test_kills import RECEIVER, SCENE

from clsim.cli import main

DISKS = int(os.environ.get("CLSIM_DISKS", "15"))
KINDS = ("zarr", "wav", "hdf5", "rir", "view")
LINES = ("cannot write", "No space left on device", "are needed", "disk full", "File too large")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A place where a file system of its own can be mounted."""
    place = tmp_path / "disk"
    place.mkdir()
    if os.name == "nt" or os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root may mount a small disk")
    yield place
    subprocess.run(["umount", str(place)], check=False, capture_output=True)


def mount(place: Path, size: int, how: str = "") -> None:
    line = ["mount", "-t", "tmpfs", "-o", f"{how}size={size}", "tmpfs", str(place)]
    if subprocess.run(line, capture_output=True).returncode:
        pytest.skip("a small disk cannot be mounted here")


@pytest.mark.parametrize("number", few(range(DISKS), kept=(0, 1)))
def test_a_disk_that_is_full_loses_nothing(number: int, disk: Path, tmp_path: Path, capsys: Any) -> None:
    for package in ("zarr", "h5netcdf", "xarray"):
        installed(package)
    random, kind = np.random.default_rng([35, number]), KINDS[number % len(KINDS)]
    scene, whole = tmp_path / "scene.toml", tmp_path / "whole"
    scene.write_text(SCENE % (0.9, "".join(RECEIVER % n for n in ("left", "right"))), "utf-8")
    file = {"rir": "out.npz", "view": "out.html"}.get(kind, "out")

    def command(folder: Path, *more: str) -> list[str]:
        if kind in ("rir", "view"):
            return [kind, str(scene), "-o", str(folder / file), *(() if kind == "rir" else ("--frames", "20"))]
        return ["run", str(scene), "-o", str(folder / file), "--store", kind, "--no-plots", *more]

    whole.mkdir()
    assert main(command(whole)) == 0
    used = sum(len(data) for data in content(whole).values())
    capsys.readouterr()
    mount(disk, int(random.uniform(0.02, 0.9) * used))
    status, failed = main(command(disk)), capsys.readouterr().err
    assert status == 2, "the disk was too large"
    lines = [line for line in failed.splitlines() if not line.startswith("clsim: warning: ")]
    assert len(lines) == 1
    assert any(words in lines[0] for words in LINES), lines
    assert str(disk) in lines[0], "which file or folder"
    if kind in ("rir", "view"):
        assert not list(disk.iterdir())
    subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
    assert main(command(disk, "--resume")) == 0
    now, wanted = content(disk), content(whole)
    assert sorted(now) == sorted(wanted)
    assert kind == "view" or now == wanted


@pytest.mark.parametrize("ending", ["npz", "parquet"])
def test_a_table_of_paths_on_a_full_disk_is_not_there(ending: str, disk: Path, tmp_path: Path, capsys: Any) -> None:
    installed("pyarrow")
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % (0.9, RECEIVER % "left"), "utf-8")
    mount(disk, 4096)
    (disk / "other").write_bytes(bytes(4096))
    assert main(["paths", str(scene), "-o", str(disk / f"paths.{ending}")]) == 2
    (line,) = [one for one in capsys.readouterr().err.splitlines() if not one.startswith("clsim: warning: ")]
    assert "No space left on device" in line
    assert str(disk / f"paths.{ending}") in line
    assert [path.name for path in disk.iterdir()] == ["other"]
