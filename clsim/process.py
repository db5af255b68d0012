"""The command line as a process of its own: its streams, and Ctrl-C from the first import on."""

from __future__ import annotations

import _thread
import atexit
import codecs
import io
import os
import signal
import sys
import time

TYPE_CHECKING = False  # of typing, which takes a while to import
if TYPE_CHECKING:
    from types import FrameType
    from typing import Any, NoReturn

INTERRUPTED = 130  # exit status
_MESSAGE = b"clsim: interrupted; nothing half-written was left\n"
_CONTROL = {code: f"\\x{code:02x}" for code in (*range(9), *range(11, 32), *range(127, 160))}
_AGAIN = 0.02  # s after which an interrupt is tried again that came during an import or in a callback
_SWALLOWED = 0.25  # s after which it is raised again, unless it is being handled: some libraries catch everything
_IMPORTS = "<frozen importlib._bootstrap>"  # file of the frames that import
_raised: list[bool] = []  # for each Ctrl-C that was raised


def is_command() -> bool:
    """Return True in the process of the command line: `clsim`, or `python -m clsim`."""
    name = os.path.basename((getattr(sys, "argv", None) or [""])[0])  # noqa: PTH119  (pathlib takes a while to import)
    as_module = name == "-m" and "clsim" in getattr(sys, "orig_argv", ())
    return as_module or name in ("clsim", "clsim.exe")


def end_on_interrupt() -> None:
    """Let Ctrl-C end this process at once: while it only imports, it leaves nothing behind."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else who started it wants it ignored
        signal.signal(signal.SIGINT, _end)


def raise_on_interrupt() -> None:
    """Let Ctrl-C raise `KeyboardInterrupt` from now on, so that open resources clean up."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, _raise)
        sys.unraisablehook = _raise_again


def ignore_interrupts() -> None:
    """Ignore Ctrl-C from now on: the exit status is known, and the process ends."""
    sys.unraisablehook = _drop_interrupt
    if hasattr(signal, "pthread_sigmask"):  # a handler that a library puts back is not called either
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def end(status: int) -> NoReturn:
    """End the process once its messages are printed: exit callbacks clean up, and report nothing."""
    # Zarr gives its threads 0.2 s to end, and fails where they take longer. Threads that still run are not waited for.
    try:
        sys.stderr = open(os.devnull, "w")  # noqa: PTH123, SIM115
        atexit._run_exitfuncs()
    finally:
        os._exit(status)


def _end(number: int, frame: FrameType | None) -> None:
    try:
        os.write(2, _MESSAGE)
    finally:
        os._exit(INTERRUPTED)


def _raise(number: int, frame: FrameType | None) -> None:
    """Raise `KeyboardInterrupt`, unless an earlier one is being handled: what cleans up is not interrupted."""
    # Until an import has ended it waits: some packages turn what is raised meanwhile into errors of their own.
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return
        error = error.__context__
    while frame is not None:
        if frame.f_code.co_filename == _IMPORTS:
            _raise_later()
            return
        frame = frame.f_back
    _raise_later(_SWALLOWED)
    _raised.append(True)
    raise KeyboardInterrupt


def was_interrupted() -> bool:
    """Tell whether Ctrl-C was raised in this process, whatever a library made of it."""
    return bool(_raised)


def _raise_later(seconds: float = _AGAIN) -> None:
    # Not threading.Timer: the interrupted code may hold a lock that starting a Timer takes.
    _thread.start_new_thread(_interrupt, (seconds,))


def _interrupt(seconds: float) -> None:
    time.sleep(seconds)
    os.kill(os.getpid(), signal.SIGINT)


def _raise_again(found: sys.UnraisableHookArgs) -> None:
    """Raise an interrupt again that arrived in a place that cannot raise, such as a callback."""
    if isinstance(found.exc_value, KeyboardInterrupt):
        _raise_later()
    elif not _is_half_made(found):
        sys.__unraisablehook__(found)


def _drop_interrupt(found: sys.UnraisableHookArgs) -> None:
    """Report an error that cannot be raised, unless it is an interrupt, which comes too late."""
    # Python reports with an OSError of no object that a signal came while its handler was replaced.
    late = isinstance(found.exc_value, OSError) and found.object is None
    if not (late or isinstance(found.exc_value, KeyboardInterrupt) or _is_half_made(found)):
        sys.__unraisablehook__(found)


def _is_half_made(found: sys.UnraisableHookArgs) -> bool:
    """Test whether an event loop is deleted that an interrupt left without its sockets."""
    where = getattr(found.object, "__qualname__", "")
    return isinstance(found.exc_value, AttributeError) and where == "BaseEventLoop.__del__"


def printable(text: str) -> str:
    r"""Return a text with escapes for control characters, which change the terminal's state; lines and tabs stay.

    Examples
    --------
    >>> print(printable("a\x1b[31mb"))
    a\x1b[31mb
    """
    return text.translate(_CONTROL)


class _Terminal(io.TextIOWrapper):
    """Standard output on a terminal; control characters in names are escaped."""

    def write(self, text: str, /) -> int:
        return super().write(printable(text))


class _UnfailingFile(io.FileIO):
    """File for messages; failed writes are dropped, so that no command fails because of them."""

    def write(self, data: Any, /) -> int:
        try:
            return super().write(data)
        except OSError:
            return len(memoryview(data))


def open_streams() -> None:
    """See that all three standard streams are there, take every text, and that messages never fail a command."""
    # A closed stream is replaced by one of the null device: else the next file that is opened takes its number, and
    # gets what drivers print. Names that are not UTF-8 are written as the bytes that they are, on terminals as escapes;
    # what else the encoding of the stream does not know, as an escape.
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    codecs.register_error("clsim-escape", _escaped)
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stdout.isatty():
        sys.stdout = _Terminal(sys.stdout.buffer, sys.stdout.encoding, "backslashreplace", line_buffering=True)
    elif isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="clsim-escape")
    encoding = getattr(sys.stderr, "encoding", None) or "utf-8"
    file = io.BufferedWriter(_UnfailingFile(2, "w", closefd=False))
    sys.stderr = io.TextIOWrapper(file, encoding, "clsim-escape", line_buffering=True)


def _escaped(error: UnicodeError) -> tuple[str | bytes, int]:
    """Return the bytes of a name that is not UTF-8, or an escape."""
    if isinstance(error, UnicodeEncodeError):
        code = ord(error.object[error.start])
        if 0xDC80 <= code <= 0xDCFF:
            return bytes([code - 0xDC00]), error.start + 1
    return codecs.backslashreplace_errors(error)


def flushed() -> bool:
    """Flush standard output; return False if it failed, and drop the rest."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return False
    return True
