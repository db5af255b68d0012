"""Runs examples as `python examples/NAME.py ...` does, each in a process forked from one that has loaded their imports.

That takes as long as many of them do. A line on stdin is an example: a name for its log, its file, and its arguments.
"""

import multiprocessing
import os
import runpy
import shlex
import sys
from importlib import import_module
from pathlib import Path

import clsim

# Examples import names, no packages, so none can do without an import of its own.
LOADED = [
    "clsim.pictures.plots", "clsim.render.opencl.engine", "clsim.study.run", "matplotlib.backends.backend_agg",
    "scipy.signal", "soundfile",
]  # fmt: skip


def run(arguments: list[str], log: Path) -> None:
    """Run a file by what a command line has after `python`; what it says goes to a log."""
    with log.open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    sys.argv, sys.path[0] = arguments, str(Path(arguments[0]).parent)
    runpy.run_path(arguments[0], run_name="__main__")


def main() -> None:
    """Run all; end with the first that fails, and what it said."""
    for module in LOADED:
        import_module(module)
    for name in clsim.__all__:
        getattr(clsim, name)  # loaded when asked for
    context = multiprocessing.get_context("fork")
    for line in sys.stdin:
        name, *arguments = shlex.split(line)
        log = Path("out/logs", name)
        process = context.Process(target=run, args=(arguments, log))
        process.start()
        process.join()
        if process.exitcode:
            sys.exit(f"== {name} failed\n{log.read_text('utf-8')}")
        print(f"== {name} passed", flush=True)


if __name__ == "__main__":
    main()
