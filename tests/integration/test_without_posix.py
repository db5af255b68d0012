"""Rendering where Python has only what it has on every system: without locks of files, fork, and numbers of users."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exhaustive import few
from made_studies import SCENE

import clsim

# What Python for Windows lacks, of what clsim or a package that it imports could ask for.
WITHOUT = """
import os, sys

import platformdirs  # which takes this system for POSIX, as it is

for name in ("fcntl", "resource", "grp", "pwd", "termios"):
    sys.modules[name] = None
for name in (
    "statvfs", "fstatvfs", "sysconf", "sysconf_names", "fork", "forkpty", "register_at_fork", "geteuid", "getuid", "getgid", "killpg",
    "getpgid", "sched_getaffinity", "O_NOFOLLOW", "ST_NOEXEC", "posix_fallocate", "chown", "mkfifo",
):
    if hasattr(os, name):
        delattr(os, name)
import signal
del signal.pthread_sigmask, signal.setitimer
from clsim.cli import main
sys.exit(main(sys.argv[1:]))
"""


# Some of it alone, each of which code could ask for by another name.
SOME = """
import os, sys

sys.modules["fcntl"] = sys.modules["resource"] = None
del os.statvfs, os.sysconf, os.fork
from clsim.cli import main
sys.exit(main(sys.argv[1:]))
"""


def without(*arguments: object, program: str = WITHOUT) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "MPLBACKEND": "agg"}
    line = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(line, env=environment, capture_output=True, text=True)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    return path


@pytest.mark.skipif(sys.platform != "linux", reason="what is hidden is there on Linux")
@pytest.mark.parametrize("program", few([WITHOUT, SOME]))
def test_a_run_needs_nothing_of_posix(program: str, scene: Path, device: None) -> None:
    out = scene.parent / "out"
    done = without("run", scene, "-o", out, "--no-plots", program=program)
    assert (done.returncode, done.stderr) == (0, "")
    here = clsim.load_scene(scene)
    wanted = clsim.render(clsim.find_paths(here.scene, 1), sampling_rate=192e3)
    sound = clsim.load_recording(out)
    assert np.array_equal(sound.samples, wanted.samples)


@pytest.mark.exhaustive
@pytest.mark.skipif(sys.platform != "linux", reason="what is hidden is there on Linux")
@pytest.mark.parametrize(
    "arguments", [["check"], ["paths"], ["rir", "-o", "out.npz"], ["view", "-o", "out.html"], ["run", "-o", "out"], ["run", "-o", "out", "--store", "zarr"]]
)  # fmt: skip
def test_no_command_needs_posix(scene: Path, arguments: list[str], device: None) -> None:
    command, *more = (str(scene.parent / a) if a.startswith("out") else a for a in arguments)
    done = without(command, scene, *more)
    assert (done.returncode, done.stderr) == (0, "")
    if command == "run":
        done = without(command, scene, *more, "--resume")
        assert done.returncode == 0
        assert "already finished" in done.stderr
