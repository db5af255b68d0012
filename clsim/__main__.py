"""`clsim` and `python -m clsim`: the command line as a process of its own."""

import sys
import warnings
from typing import NoReturn

from clsim import process


def run() -> NoReturn:
    """Run the command line, and end the process with its status."""
    process.end_on_interrupt()
    process.open_streams()
    # An interrupt may come while Zarr has made a coroutine and not begun it; nobody can do anything about that.
    warnings.filterwarnings("ignore", r"coroutine '.*' was never awaited", RuntimeWarning)
    from clsim.cli import main

    status = None
    try:
        process.raise_on_interrupt()
        status = main()
        process.ignore_interrupts()
    except BaseException:
        if not process.was_interrupted():  # else a library may have made another error of it
            raise
        process.ignore_interrupts()
        if status is None:
            print("clsim: interrupted; nothing half-written was left", file=sys.stderr)
            status = process.INTERRUPTED
    if not process.flushed() and not status:
        print("clsim: error: standard output cannot be written", file=sys.stderr)
        status = 2
    process.end(status)


if __name__ == "__main__":
    run()
