"""Trouble with devices: each kind that can be provoked gives a message that says what to do."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

import clsim
from clsim.opencl import launch as compiler_module
from clsim.opencl.device import find_device, list_devices
from clsim.opencl.launch import work

TONE = clsim.Signal.tone(40e3, 0.01, 192e3, fade=0.002)


def render(**options) -> np.ndarray:
    room = clsim.Shoebox((8, 6, 3), clsim.Material.from_reflection(0.9))
    source = clsim.Source("s", TONE, clsim.Trajectory.fixed((4, 3, 1)))
    scene = clsim.Scene(room, clsim.Air(), [source], [clsim.Receiver("r", clsim.Trajectory.fixed((1, 1, 2)))])
    return clsim.render(clsim.find_paths(scene, 1), 192e3, **options).pressure


def no_platform(*_: object) -> list:
    raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")


def test_no_platform_says_what_to_install(monkeypatch: pytest.MonkeyPatch, error_of) -> None:
    monkeypatch.setattr(cl, "get_platforms", no_platform)
    assert list_devices() == []
    with pytest.raises(clsim.DeviceError, match=r"pip install pocl-binary-distribution.*reference"):
        render()
    assert "install a driver" in error_of("devices")
    assert render(engine="reference").any()


def test_unknown_device_lists_those_there_are(device: None) -> None:
    with pytest.raises(clsim.DeviceError, match=r"one of 0:0 .*, but is '9:9'"):
        find_device("9:9")
    with pytest.raises(clsim.DeviceError, match="no such thing"):
        render(device="no such thing")
    assert find_device(list_devices()[0].name[:6])[0] == find_device("0:0")[0]


def test_build_failure_names_device_and_file(device: None, monkeypatch: pytest.MonkeyPatch) -> None:
    original = compiler_module.kernel_source
    monkeypatch.setattr(compiler_module, "kernel_source", lambda name: original(name) + "\nthis is no OpenCL C;")
    with pytest.raises(clsim.DeviceError, match=r"(?s)could not build \w+\.cl.*reference"):
        render(convolve_static=False)


@pytest.mark.exhaustive
def test_poisoned_cache_is_built_around(device: None, tmp_path: Path) -> None:
    """A process that dies while building can leave broken entries in the caches of PyOpenCL and of PoCL."""
    environment = os.environ | {
        "XDG_CACHE_HOME": str(tmp_path),
        "POCL_CACHE_DIR": str(tmp_path / "pocl"),
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    code = (
        "import clsim; t = clsim.Signal.tone(40e3, 0.01, 192e3, fade=0.002);"
        "room = clsim.Shoebox((8, 6, 3), clsim.Material.from_reflection(0.9));"
        "s = clsim.Source('s', t, clsim.Trajectory.fixed((4, 3, 1)));"
        "scene = clsim.Scene(room, clsim.Air(), [s], [clsim.Receiver('r', clsim.Trajectory.fixed((1, 1, 2)))]);"
        "p = clsim.render(clsim.find_paths(scene, 1), 192e3, convolve_static=False).pressure; print(float((p**2).sum()))"
    )

    def run(died: bool = False, warning: str = "") -> str:
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
        assert (done.returncode != 0) == died, done.stderr
        assert warning in done.stderr
        return done.stdout

    first = run()
    binaries = [p for p in tmp_path.rglob("*") if p.name in ("binary", "program.bc")]
    kernels = list(tmp_path.rglob("*.so"))
    if not binaries:
        pytest.skip("this device's driver keeps its cache elsewhere")
    for path in kernels:  # one cut short ends the process that loads it; the next one passes all of them over
        os.truncate(path, path.stat().st_size // 2)
    if kernels:
        run(died=True)
    for path in binaries:
        path.write_bytes(b"")
    assert run(warning=f"was deleted ({len(kernels)} files)" if kernels else "") == first


@pytest.mark.parametrize("count", [1, 31, 32, 33, 1000])
def test_work_is_whole_groups_of_one_size(count: int) -> None:
    size, group = work(count, 3)
    assert (group, size[1]) == ((32, 1), 3)
    assert size[0] % 32 == 0
    assert count <= size[0] < count + 32
