"""Progress and warnings on the command line."""

from __future__ import annotations

import logging
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from clsim.errors import ClsimWarning
from clsim.files.input_files import shown
from clsim.scene_file import as_toml

Progress = Callable[[str, float], AbstractContextManager[Callable[[float], None]]]

_PREFIXES = ("", "k", "M", "G", "T")
_PATIENCE = 2.0  # s after which progress is shown
_MOMENT = 0.3  # s of building before a message: cached programs take less


@contextmanager
def progress(what: str, total: float) -> Iterator[Callable[[float], None]]:
    """Yield a function that advances a bar on a terminal, shown once the work has taken two seconds."""
    if not sys.stderr.isatty():
        yield lambda amount: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"),
        TextColumn("{task.fields[rate]}"), TimeRemainingColumn(), console=Console(stderr=True), transient=True,
    )  # fmt: skip
    task = bar.add_task(what, total=total, rate="")
    begun = time.monotonic()
    shown = False

    def advance(amount: float) -> None:
        """Move the bar on, and show it once the work has taken a while."""
        nonlocal shown
        bar.advance(task, amount)
        spent = time.monotonic() - begun
        done = bar.tasks[0].completed
        rate = done / max(spent, 1e-3)
        power = min(max(int(math.log10(max(rate, 1.0)) // 3), 0), len(_PREFIXES) - 1)
        text = f"{rate / 1000.0**power:.3g} {_PREFIXES[power]}path-samples/s"
        bar.update(task, rate=text if total > 1e6 else "")
        if spent > _PATIENCE and not shown:
            bar.start()
            shown = True

    try:
        yield advance
    finally:
        if shown:
            bar.stop()


@contextmanager
def no_progress(what: str, total: float) -> Iterator[Callable[[float], None]]:
    """Yield a function that shows nothing."""
    yield lambda amount: None


class BuiltPrograms(logging.Handler):
    """Counts the programs that are built for a device, and says so on a terminal if that takes more than a moment."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.count, self._seconds, self._shown = 0, 0.0, not sys.stderr.isatty()

    def emit(self, record: logging.LogRecord) -> None:
        """Count a program from the compiler's log record: its name, and seconds."""
        _, seconds = record.args if isinstance(record.args, tuple) else ("", 0.0)
        self.count, self._seconds = self.count + 1, self._seconds + float(str(seconds))
        if self._seconds > _MOMENT and not self._shown:
            self._shown = True
            print("clsim: building kernels (once)", file=sys.stderr)


@contextmanager
def built_programs() -> Iterator[BuiltPrograms]:
    """Yield a counter of the programs that are built in this block."""
    log, handler = logging.getLogger("clsim.opencl.launch"), BuiltPrograms()
    level, spreads = log.level, log.propagate
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    log.propagate = False  # else a root that shows all would show each program on the console
    try:
        yield handler
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
        log.propagate = spreads


@contextmanager
def one_line_warnings() -> Iterator[None]:
    """Print each of clsim's warnings once, on one line."""
    seen: set[str] = set()

    def show(message: Any, *_: Any, **__: Any) -> None:
        """Print a warning as one line, each text once."""
        text = shown(as_toml(" ".join(str(message).split())))
        if text not in seen:
            seen.add(text)
            print(f"clsim: warning: {text}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ClsimWarning)
        warnings.showwarning = show
        yield
