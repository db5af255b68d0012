"""`clsim` and `python -m clsim`: the command line as a process of its own."""

import sys
import warnings
from typing import NoReturn

from clsim.process import (
    INTERRUPTED,
    end,
    end_on_interrupt,
    flushed,
    ignore_interrupts,
    open_streams,
    raise_on_interrupt,
    was_interrupted,
)


def run() -> NoReturn:
    """Run the command line, and end the process with its status."""
    end_on_interrupt()
    open_streams()
    # An interrupt may come while Zarr has made a coroutine and not begun it; nobody can do anything about that.
    warnings.filterwarnings("ignore", r"coroutine '.*' was never awaited", RuntimeWarning)
    from clsim.cli import main

    status = None
    try:
        raise_on_interrupt()
        status = main()
        ignore_interrupts()
    except BaseException:
        if not was_interrupted():  # else a library may have made another error of it
            raise
        ignore_interrupts()
        if status is None:
            print("clsim: interrupted; nothing half-written was left", file=sys.stderr)
            status = INTERRUPTED
    if not flushed() and not status:
        print("clsim: error: standard output cannot be written", file=sys.stderr)
        status = 2
    end(status)


if __name__ == "__main__":
    run()
