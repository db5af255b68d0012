"""The processor that PoCL compiles for: named where PoCL does not know the one it runs on."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clsim.opencl.device import able_processor, list_devices

AVX2 = "sse2 sse4_2 abm avx avx2 bmi1 bmi2 f16c fma movbe"

# In a process of its own, for the name is that of all the process: first as PoCL would have it by itself.
UNKNOWN = """
import numpy as np
import pyopencl as cl
from clsim.opencl.device import find_device
from clsim.opencl.device import UNKNOWN, processor, set_processor

def build():
    program = cl.Program(context, "__kernel void root(__global double *a) { a[get_global_id(0)] = sqrt(a[get_global_id(0)]); }")
    values = np.arange(16.0) ** 2
    buffer = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=values)
    queue = cl.CommandQueue(context)
    program.build(cache_dir=False).root(queue, (16,), None, buffer)
    cl.enqueue_copy(queue, values, buffer)
    return values.tolist()

pocl = [platform for platform in cl.get_platforms() if platform.name == "Portable Computing Language"]
found = [device for platform in pocl for device in platform.get_devices() if processor(device)]
if not found:
    raise SystemExit  # another release of PoCL
device = found[0]
context = cl.Context([device])
set_processor(device, UNKNOWN)
try:
    build()
except cl.RuntimeError as error:
    print("unknown target CPU" in str(error))
find_device("Portable Computing Language")
print(processor(device) not in {UNKNOWN, None})
print(build())
"""


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        (f"{AVX2} avx512f avx512bw avx512cd avx512dq avx512vl avx512_bf16", "skylake-avx512"),
        (f"{AVX2} avx512f avx512cd", "haswell"),
        (AVX2, "haswell"),
        ("sse2 sse4_2 avx", "x86-64"),
    ],
)
def test_a_processor_is_one_whose_instructions_are_all_there(flags: str, name: str) -> None:
    assert able_processor(flags.split()) == name


@pytest.mark.skipif(sys.platform != "linux" or os.uname().machine != "x86_64", reason="PoCL's name for it is good here")
def test_pocl_builds_where_it_does_not_know_the_processor(tmp_path: Path) -> None:
    if not any(device.platform == "Portable Computing Language" for device in list_devices()):
        pytest.skip("no PoCL on this machine")
    done = subprocess.run(
        [sys.executable, "-c", UNKNOWN],
        env=os.environ | {"POCL_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    if not done.stdout:
        pytest.skip("PoCL's description of its device does not tell the processor")
    refused, named, roots = done.stdout.splitlines()
    assert (refused, named) == ("True", "True")
    assert roots == str([float(i) for i in range(16)])
