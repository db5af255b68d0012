"""Commands killed at random moments: what comes after ends like one that nobody killed, to the bit, and leaves no litter.

Two kills at every change, ten in the exhaustive tests; `make kills` does 200.
"""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from exhaustive import few
from killing import Killer, content

SCENE = """
format = 1
[room]
kind = "shoebox"
size = [4.0, 3.0, 2.5]
walls = { reflection = %s }
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 2e3, duration = 0.2, sampling_rate = 16e3, fade = 0.01 }
trajectory = { kind = "line", start = [1, 1, 1], end = [1.2, 1, 1], duration = 0.2 }
%s
[paths]
max_order = 1
[render]
sampling_rate = 16e3
interpolator = { kind = "lagrange", order = 4 }
engine = "reference"
chunk = 256
"""
RECEIVER = """
[[receivers]]
name = "%s"
trajectory = { kind = "fixed", position = [3.0, 1.0, 2.0] }
electronics = { ambient_noise_db = 10.0, seed = 3, low_cut = 1e3, high_cut = 4e3, gain_db = 40.0 }
"""
KINDS = ("wav", "zarr", "hdf5")
OPERATIONS = ("begin", "renew", "repair", "rir")
KILLS = int(os.environ.get("CLSIM_KILLS", "10"))


class Cases:
    """Operations on a folder, and what each leaves if nobody kills it."""

    def __init__(self, folder: Path, killer: Killer) -> None:
        self.folder, self.killer = folder, killer
        self._wanted: dict[tuple[str, str], tuple[Path, dict[str, bytes], int, float]] = {}
        (folder / "new.toml").write_text(SCENE % (0.9, "".join(RECEIVER % n for n in ("left", "right"))), "utf-8")
        (folder / "old.toml").write_text(SCENE % (0.7, "".join(RECEIVER % n for n in ("left", "other"))), "utf-8")

    def arguments(self, operation: str, kind: str, out: Path, scene: str = "new.toml") -> list[str]:
        if operation == "rir":
            return ["rir", str(self.folder / scene), "-o", str(out)]
        run = ["run", str(self.folder / scene), "-o", str(out), "--store", kind]
        return run if operation == "draw" else [*run, "--no-plots"]

    def flag(self, operation: str) -> str:
        """Return the commands that overwrite or continue a result."""
        return "--force" if operation in ("renew", "rir") else "--resume"

    def prepare(self, operation: str, kind: str, out: Path) -> None:
        """Put into a folder what is there before."""
        if operation in ("begin", "draw", "rir"):
            return
        scene = "old.toml" if operation == "renew" else "new.toml"
        before = self.folder / f"{kind}-{scene}"
        if not before.exists():
            assert self.killer.run(self.arguments("begin", kind, before, scene), before) == 0, self.killer.log
        shutil.copytree(before, out)
        if operation == "repair":
            for path in (out / "ground_truth.npz", out / "right.wav", out / "recording.h5"):
                path.unlink(missing_ok=True)
            shutil.rmtree(out / "recording.zarr", ignore_errors=True)

    def wanted(self, operation: str, kind: str) -> tuple[dict[str, bytes], int]:
        """Return the files at the end, and the number of changes of the folder until then."""
        if (operation, kind) not in self._wanted:
            out = self.folder / "work" / "out"
            self.prepare(operation, kind, out)
            arguments = [*self.arguments(operation, kind, out), self.flag(operation)]
            assert self.killer.run(arguments, out) == 0, self.killer.log
            self._wanted[operation, kind] = content(out), self.killer.events
            shutil.rmtree(out.parent)
        return self._wanted[operation, kind]


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory, killer: Killer) -> Cases:
    return Cases(tmp_path_factory.mktemp("kills"), killer)


@pytest.mark.parametrize("number", few(range(KILLS), kept=(0, 1)))
def test_a_killed_command_is_made_good(number: int, cases: Cases, rng: np.random.Generator) -> None:
    operation = "draw" if number % 24 == 23 else OPERATIONS[number % 4]
    kind = KINDS[number // 4 % 3]
    for package in {"wav": (), "zarr": ("zarr", "xarray"), "hdf5": ("h5netcdf", "xarray")}[kind]:
        pytest.importorskip(package)
    wanted, events = cases.wanted(operation, kind)
    out = cases.folder / "work" / "out"
    cases.prepare(operation, kind, out)
    arguments, first = cases.arguments(operation, kind, out), cases.flag(operation)
    flag, killed, longest = first, False, 0.3
    while not killed or rng.uniform() < 0.4:
        moment = {"event": int(rng.integers(1, events + 1))} if number % 2 else {"seconds": rng.uniform(1e-3, longest)}
        status = cases.killer.run([*arguments, flag], out, **moment)
        assert status in (-9, -14, 0), cases.killer.log
        if status == 0:  # it was done before
            longest /= 2.0
        killed = killed or status != 0
        # A run that is killed before it had anything of its own leaves the older results as they were.
        flag = first if operation == "rir" or not (out / ".partial" / "journal.npz").exists() else "--resume"
    assert cases.killer.run([*arguments, flag], out) == 0, cases.killer.log
    now = content(out)
    assert sorted(now) == sorted(wanted)
    if operation == "rir":  # libsndfile notes the time in the header
        now, wanted = ({name: data[data.index(b"data") :] for name, data in all_.items()} for all_ in (now, wanted))
    assert now == wanted
    shutil.rmtree(out.parent)
