"""Renders scenes by one driver, in a process of its own.

Usage: driver_runs.py DEVICE FOLDER NAME.LAYOUT[.MUTANT]... writes FOLDER/NAME.LAYOUT[.MUTANT].npz for each: `heard`, `launched`,
lines of JSON with program and compile-time constants, and `reported`, what Oclgrind had to say of it.
"""

import dataclasses
import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
from driver_scenes import BATCHES, FEWEST, LAYOUTS, SCENES

from clsim.opencl import device as device_module
from clsim.opencl import launch as compiler_module
from clsim.opencl.launch import work
from clsim.render import plan as plan_module
from clsim.render.opencl import baseband_engine as envelope_module
from clsim.render.opencl import batches as layout_module
from clsim.render.opencl import branch_signals as limits_module
from clsim.render.opencl import channel_engine as channel_module
from clsim.render.opencl import engine as engine_module
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.plan import Plan


def without_float64(wanted: str | None) -> tuple[device_module.DeviceInfo, Any]:
    """Find a device that says that it has no float64."""
    info, handle = device_module.find_device(wanted)
    return dataclasses.replace(info, fp64=False), handle


# Where signals pause, eight gains of neighbouring functions are read at once, whether or not there are as many.
EIGHT_GAINS = "g[i] = *(__global const loose_gains*)(c + DELAY_TERMS + i * functions + first + first_beside);"
EACH_GAIN = """{
    g[i] = 0.0f;
    for (int k = 0; k < beside && first + first_beside + k < functions; k++) {
        ((float*)(g + i))[k] = c[DELAY_TERMS + i * functions + first + first_beside + k];
    }
}"""


def without_false_reports() -> None:
    """Do without what Oclgrind falsely takes for uninitialised: `test_oclgrind.py` has a kernel of its own for each."""
    make, kept = cl.Buffer, []

    def fill(queue: Any, buffer: Any, pattern: np.ndarray, offset: int, size: int) -> Any:
        return cl.enqueue_copy(queue, buffer, np.full(size // pattern.nbytes, pattern[0]), dst_offset=offset)

    def buffer(*arguments: Any, **options: Any) -> Any:
        kept.append(make(*arguments, **options))  # another one in its place would be taken for what was there
        return kept[-1]

    cl.enqueue_fill_buffer, cl.Buffer = fill, buffer
    replace_text("render", EIGHT_GAINS, EACH_GAIN)


def replace_text(program: str, old: str, new: str) -> None:
    """Build a program with another text in the place of one that it has once."""
    source = compiler_module.kernel_source
    assert source(program).count(old) == 1, f"{program} has not once {old}"
    compiler_module.kernel_source = lambda name: source(name).replace(old, new) if name == program else source(name)


# Program, text, and what stands there instead; without a program it is the host, whose buffers are then not cleared.
MUTANTS = {
    "": None,
    "off_by_one": ("branches", "k < tap_count; k++, at++", "k <= tap_count; k++, at++"),
    "no_barrier": ("render", "                }\n#endif\n                SYNCHRONISE;", "                }\n#endif"),
    "not_cleared": (),
}


@contextmanager
def mutated(mutant: str) -> Iterator[None]:
    """Have one thing wrong."""
    source, fill = compiler_module.kernel_source, cl.enqueue_fill_buffer
    wrong = MUTANTS[mutant]
    if wrong:
        replace_text(*wrong)
    elif wrong is not None:
        cl.enqueue_fill_buffer = lambda *_: None
    try:
        yield
    finally:
        compiler_module.kernel_source, cl.enqueue_fill_buffer = source, fill


@contextmanager
def filled_up_to(paths: int) -> Iterator[None]:
    """Have paths filled up to batches of so many, and work-groups of no more: what fills them up sounds of nothing."""
    modules, defaults = (
        (plan_module, limits_module, layout_module, engine_module, channel_module, envelope_module),
        work.__kwdefaults__,
    )
    before, group = plan_module.BATCH, defaults["group"]
    for module in modules:
        module.BATCH = paths
    defaults["group"] = min(paths, group)
    try:
        yield
    finally:
        for module in modules:
            module.BATCH = before
        defaults["group"] = group


def rendered(device: str, name: str) -> np.ndarray:
    """Return the samples of a scene."""
    scene_name, layout, mutant = f"{name}.".split(".")[:3]
    with mutated(mutant), filled_up_to(max(FEWEST, BATCHES.get(name, 0))), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # boxes of a few centimetres are unusual
        made = SCENES[scene_name](device)
        if not isinstance(made, Plan):
            return made.heard(LAYOUTS[layout].lanes)
        engine = OpenclEngine if made.baseband is None else BasebandEngine
        return engine(made, LAYOUTS[layout]).render(0, made.samples)


def noting(compile_kernel: Callable) -> tuple[Callable, list[str]]:
    """Return a `Compiler.kernel` that notes what it is asked for, and its notes."""
    notes: list[str] = []

    def kernel(compiler: object, program: str, constants: dict) -> object:
        notes.append(json.dumps([program, {k: str(v) for k, v in sorted(constants.items())}]))
        return compile_kernel(compiler, program, constants)

    return kernel, notes


def main(device: str, folder: str, *names: str) -> None:
    """Render scenes."""
    if device == "Oclgrind":
        without_false_reports()
    compiler_module.Compiler.kernel, notes = noting(compiler_module.Compiler.kernel)
    log, said = Path(os.environ["OCLGRIND_LOG"]), ""
    for name in names:
        notes.clear()
        engine_module.find_device = without_float64 if name.startswith("pairs") else device_module.find_device
        heard = rendered(device, name)
        before, said = said, log.read_text() if log.exists() else ""
        reported = said.removeprefix(before)
        np.savez(Path(folder, f"{name}.npz"), launched=sorted(set(notes)), heard=heard, reported=reported)


if __name__ == "__main__":
    main(*sys.argv[1:])
