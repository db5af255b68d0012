"""Runs examples as `python examples/NAME.py --output out/examples` does, each in a process forked from one that has loaded all.

What they import takes as long as many of them take. A line on stdin is an example: a name for its log, its file, and its arguments.
"""

import multiprocessing
import os
import runpy
import shlex
import sys
import time
from pathlib import Path

import matplotlib.backends.backend_agg
import matplotlib.figure
import scipy.signal  # noqa: F401
import soundfile  # noqa: F401

import clsim
import clsim.commands.warm_up
import clsim.pictures.plots
import clsim.render.opencl.engine  # noqa: F401


def run(arguments: list[str], log: str) -> None:
    """Run a file by what a command line has after `python`; what it says goes to a log."""
    with open(log, "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    sys.argv, sys.path[0] = arguments, str(Path(arguments[0]).parent)
    runpy.run_path(arguments[0], run_name="__main__")


def main() -> None:
    """Run all; end with the first that fails, and what it said."""
    for name in clsim.__all__:
        getattr(clsim, name)  # loaded when asked for
    context = multiprocessing.get_context("fork")
    for line in sys.stdin:
        name, *arguments = shlex.split(line)
        log, begun = f"out/logs/{name}", time.perf_counter()
        process = context.Process(target=run, args=(arguments, log))
        process.start()
        process.join()
        if process.exitcode:
            sys.exit(f"== {name} failed\n{Path(log).read_text('utf-8')}")
        print(f"== {name} passed in {time.perf_counter() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
