"""Other OpenCL implementations than PoCL: where they are, and scenes rendered by one of them in a process of its own."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from clsim.opencl.device import list_devices

HERE = Path(__file__).parent
PARITY_DB = -120.0  # compilers may fuse products and sums otherwise: measured -142 dB and better, of envelopes -137 dB
# Where `pip install clsim[drivers]` and the Debian package oclgrind put them; the first of CLSIM_DRIVERS, if it is a folder.
PREFIXES = [Path(os.environ.get("CLSIM_DRIVERS", "")), Path(sys.prefix), Path("/usr"), Path("/usr/local")]
EVERYTHING = bool(os.environ.get("CLSIM_ALL_DRIVERS"))
FEW_ON_GPUS = ("plain", "pulses", "baseband", "waves", "moments")
# Constants by which code is chosen, and their values.
OPTIONS = {
    "LANES": {"1", "8"}, "SPARSE": {"0", "1"}, "FINE": {"0", "1"}, "OVERSAMPLING": {"1", "2"}, "PARTS": {"1", "2"},
    "RETARDED": {"0", "1"}, "STATIC_RECEIVERS": {"0", "1"}, "MACH_EXPONENT": {"0", "1", "2"}, "DELAY_TERMS": {"4", "8"},
    "SOURCE_DIRECTIVITY": {"0", "1", "2"}, "RECEIVER_DIRECTIVITY": {"0", "1", "2"}, "NODES_AT_ONCE": {"1", "4"},
    "WIND": {"0", "1"}, "AIR_TERMS": {"0", "2"}, "AT_EDGE": {"0", "1"}, "GAP": {"0", "1"}, "GROUPED": {"0", "1"}, "ORDER": {"0", "1"},
    "LEG": {"0", "1"}, "VERTEX": {"0", "1", "2", "3"}, "MIRRORS": {"0", "2"},
    "FREQUENCIES": {"1", "8"}, "WORKERS": {"1", "32"}, "APART": {"0", "1"}, "CONVEX": {"0", "1"}, "SIZED": {"0", "1"},
    "PAIRED": {"0", "1"}, "TILTED": {"0", "1"}, "TAPERED": {"0", "1"}, "TRIMMED": {"0", "1"},
}  # fmt: skip


@dataclass(frozen=True)
class Driver:
    """An OpenCL driver.

    Attributes
    ----------
    platform : str
        Its name for itself.
    library : str
        Below a prefix.
    install : str
        How to get it.
    settings : dict
        Environment of its process.
    """

    platform: str
    library: str
    install: str
    settings: dict[str, str]

    def found(self) -> Path:
        """Return its library; skip visibly without it."""
        for prefix in PREFIXES:
            if (prefix / self.library).is_file():
                return prefix / self.library
        pytest.skip(f"no {self.platform} on this machine: {self.install}")


# Without optimisation, which gives the same bits and takes half as long to compile.
POCL = Driver(
    "Portable Computing Language", "", "pip install pocl-binary-distribution",
    {"PYOPENCL_BUILD_OPTIONS": "-cl-opt-disable"},
)  # fmt: skip
INTEL = Driver("Intel(R) OpenCL", "lib/libintelocl.so", "pip install 'clsim[drivers]' (Linux x86-64)", {})
# Its compiler makes an intrinsic that its interpreter lacks, but not with -O0.
OCLGRIND = Driver(
    "Oclgrind", "lib/oclgrind/liboclgrind-rt-icd.so", "apt install oclgrind (Debian, Ubuntu)",
    {
        "OCLGRIND_BUILD_OPTIONS": "-O0", "OCLGRIND_DATA_RACES": "1", "OCLGRIND_UNINITIALIZED": "1",
        "OCLGRIND_NUM_THREADS": "1", "OCLGRIND_GLOBAL_MEM_SIZE": str(2**30), "OCLGRIND_MAX_ERRORS": "2000",
        "OCLGRIND_MAX_WGSIZE": "64", "OCLGRIND_LOCAL_MEM_SIZE": str(2**15),  # as small as of real GPUs
    },
)  # fmt: skip


def environment(driver: Driver, folder: Path, **more: str) -> dict[str, str]:
    """Return the environment in which a process has a driver, and writes what it reports to FOLDER/log."""
    paths = [str(HERE.parents[1]), str(HERE), *(str(HERE.parent / name) for name in ("physics", "parity")), *sys.path]
    found = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "PYOPENCL_NO_CACHE": "1"} | driver.settings | more
    if driver is not POCL:
        library = driver.found()
        (folder / "vendors").mkdir(exist_ok=True)
        (folder / "vendors" / "driver.icd").write_text(f"{library}\n")
        found["OCL_ICD_VENDORS"] = str(folder / "vendors")
        found["LD_LIBRARY_PATH"] = os.pathsep.join([str(library.parent), found.get("LD_LIBRARY_PATH", "")])
    found["OCLGRIND_LOG"] = str(folder / "log")
    return found


def run(driver: Driver, folder: Path, *arguments: str, **more: str) -> str:
    """Run Python with a driver; return what the driver reported."""
    if driver is POCL:
        need_pocl()
    folder.mkdir(exist_ok=True)
    done = subprocess.run(
        [sys.executable, *arguments], env=environment(driver, folder, **more), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    log = folder / "log"
    return log.read_text() if log.exists() else ""


def need_pocl() -> None:
    """Skip visibly without PoCL."""
    if not any(info.platform == POCL.platform for info in list_devices()):
        pytest.skip("no PoCL on this machine")


def render(driver: Driver, folder: Path, *names: str) -> str:
    """Render scenes, each a name, a layout and perhaps a mutant, into a folder; return what the driver reported."""
    return run(driver, folder, str(HERE / "driver_runs.py"), driver.platform, str(folder), *names)


def apart_db(folder: Path, other: Path, name: str) -> float:
    """Return the difference of two drivers."""
    one, two = (np.load(f / f"{name}.npz")["heard"] for f in (folder, other))
    return difference_db(one, two)


def difference_db(one: np.ndarray, two: np.ndarray) -> float:
    """Return the difference of two non-zero results."""
    for heard in (one, two):
        assert np.all(np.isfinite(heard))
        assert np.any(heard)
    return float(20 * np.log10(np.linalg.norm(one - two) / np.linalg.norm(two) + 1e-20))


def launched(folder: Path, *names: str) -> list[tuple[str, dict[str, str]]]:
    """Return programs and constants that ran in scenes."""
    return [tuple(json.loads(line)) for name in names for line in np.load(folder / f"{name}.npz")["launched"]]
