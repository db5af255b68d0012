"""Caches of built kernels: a writable folder for drivers, and detection of entries that ended a process."""

from __future__ import annotations

import atexit
import errno
import hashlib
import os
import shutil
import stat
import struct
import sys
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from clsim.errors import warn

_TOO_LARGE = "this process may not write files as large as kernels are"
_SHARED = Path("/tmp/pocl/kcache")  # PoCL's choice where no variable names a folder
_ROOM = 2**20  # bytes: about what the kernels of one scene take


@cache
def prepare() -> str:
    """See that PoCL and PyOpenCL can keep what they build, once per process and before either of them looks.

    PoCL has no device where it cannot make its cache, and ends the process where it cannot write into it: then it is
    given a folder of this process, which is deleted at its end. PyOpenCL can do without. Both run what they find in
    their caches, so a cache that other users could have written is not used either.
    """
    if os.name == "nt":  # PoCL does not come with pip there, and other drivers look after themselves
        return ""
    import platformdirs  # comes with PyOpenCL, which asks it too

    if _trouble(Path(platformdirs.user_cache_dir("pytools", "pytools"))) or not _pyopencl_cache_opens():
        os.environ["PYOPENCL_NO_CACHE"] = "1"
        if "pyopencl" in sys.modules:
            vars(sys.modules["pyopencl"])["_PYOPENCL_NO_CACHE"] = True
    folder = pocl_folder()
    # Any user can make the shared folder first, and whoever made it can replace what is in it.
    trouble = "HOME is not set, and all users share it" if folder == _SHARED else _trouble(folder)
    if not trouble:
        return ""
    trouble = f"the cache of built kernels, {folder}, cannot be used: {trouble}"
    if trouble.endswith(_TOO_LARGE):  # which no other folder would change
        return f"{trouble}; raise the limit to {_ROOM} bytes or more (`ulimit -f`)"
    private = _private_folder()
    if private is None:
        return f"{trouble}; no temporary folder can either: free some space, or set POCL_CACHE_DIR to one that can"
    os.environ["POCL_CACHE_DIR"] = str(private)
    warn(f"{trouble}; kernels are built anew by every process (set POCL_CACHE_DIR to a folder that lasts)")
    return ""


def pocl_folder() -> Path:
    """Return the folder in which PoCL keeps kernels, found as PoCL finds it."""
    for name, below in (("POCL_CACHE_DIR", ""), ("XDG_CACHE_HOME", "pocl/kcache"), ("HOME", ".cache/pocl/kcache")):
        if os.environ.get(name):
            return Path(os.environ[name], below)
    return _SHARED


def _pyopencl_cache_opens() -> bool:
    """Test whether PyOpenCL's database of calls can be opened; its module opens it at import."""
    try:
        import pyopencl.invoker  # noqa: F401
    except ImportError:
        raise
    except Exception:  # of sqlite3, for example: the file is no database
        return False
    return True


def _trouble(folder: Path) -> str:
    """Return the reason against a folder as a cache, or an empty text."""
    if not folder.is_absolute():
        return "it is relative to the working folder"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        others = _open_to_others(folder)
        if others:
            return others
        if hasattr(os, "statvfs") and os.statvfs(folder).f_flag & getattr(os, "ST_NOEXEC", 0):
            return "it is mounted noexec"
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_ROOM))
            file.flush()
    except OSError as error:
        return _TOO_LARGE if error.errno == errno.EFBIG else error.strerror or str(error)
    return ""


def _open_to_others(folder: Path) -> str:
    """Return the reason for which other users could write into a folder, or an empty text."""
    if not hasattr(os, "geteuid"):
        return ""
    mine = (0, os.geteuid())
    resolved = folder.resolve()
    for path in dict.fromkeys((resolved, *resolved.parents, folder, *folder.parents)):
        status = path.lstat()
        if status.st_uid not in mine or (path == resolved and status.st_uid != mine[1]):
            return f"{path} belongs to user {status.st_uid}, not to user {mine[1]}"
        sticky = status.st_mode & stat.S_ISVTX and path != resolved  # others delete and rename nothing there
        if stat.S_ISLNK(status.st_mode) or sticky:
            continue
        if status.st_mode & stat.S_IWOTH:
            return f"all users can write to {path}"
        if status.st_mode & stat.S_IWGRP and not _is_own_group(status.st_gid):
            return f"group {status.st_gid} can write to {path}"
    return ""


def _is_own_group(group: int) -> bool:
    """Test whether a group is the superuser's or the user's own group of the same name."""
    import grp
    import pwd

    try:
        return group == 0 or grp.getgrgid(group).gr_name == pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return False


def _private_folder() -> Path | None:
    """Make a folder of this process, deleted when it ends; None if there is no room anywhere."""
    with suppress(OSError):  # no temporary folder at all
        tempfile.gettempdir()
    for parent in dict.fromkeys((tempfile.tempdir, "/tmp", "/dev/shm")):
        if parent is None:
            continue
        try:
            folder = Path(tempfile.mkdtemp(prefix="clsim-kernels-", dir=parent))
        except OSError:
            continue
        if not _trouble(folder):
            atexit.register(_remove, folder, os.getpid())
            return folder
        shutil.rmtree(folder, ignore_errors=True)
    return None


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:  # and not a copy of it by fork
        shutil.rmtree(folder, ignore_errors=True)


class Trial:
    """Building a program and running it for the first time, with a mark beside the cache meanwhile.

    A process that dies while building can leave an entry in PoCL's cache that ends every later process which uses it.
    Such a process leaves its mark too, a file that nobody locks. From then on the program is built as another one, with
    one more of the compiler's `options`.
    """

    def __init__(self, program: str, text: str, options: list[str]) -> None:
        self._folder = pocl_folder() / "clsim"
        for more in range(100):
            self.options = [*options, *([f"-DANEW={more}"] if more else [])]
            self._name = hashlib.sha256("\n".join([text, *self.options]).encode()).hexdigest()[:32]
            died = self._died()
            if not died:
                return
            if died == "now":
                cut_short = f"what is cut short in {pocl_folder()} was deleted ({_swept(pocl_folder())} files)"
                anew = f"a process died while it built or first ran {program}.cl: the program is built anew"
                warn(f"{anew}, and {cut_short}")

    def _died(self) -> str:
        """Return "now" if a process is found to have died, "before" if that is known, or an empty text."""
        known = self._folder / f"{self._name}.died"
        with suppress(OSError, ImportError):  # no locks, and then no marks either
            for mark in self._folder.glob(f"{self._name}-*"):
                with mark.open() as file:
                    if _locked(file):  # and by no living process
                        mark.replace(known)
                        return "now"
        return "before" if known.exists() else ""

    @contextmanager
    def marked(self) -> Iterator[None]:
        """Leave a mark if the process dies in this block; where none can be made or locked, do without."""
        if find_spec("fcntl") is None:  # as on Windows
            yield
            return
        mark = self._folder / f"{self._name}-{uuid.uuid4().hex}"
        hidden = mark.with_name(f".{mark.name}")
        file = None
        with suppress(OSError):
            self._folder.mkdir(exist_ok=True)
            file = hidden.open("w")
            if _locked(file):
                hidden.replace(mark)  # nobody sees one that is not locked yet
        try:
            yield
        finally:
            if file is not None:
                for path in (hidden, mark):  # while it is locked
                    with suppress(OSError):
                        path.unlink()
                file.close()


def _locked(file: Any) -> bool:
    """Lock a file, unless somebody else has; the system takes the lock back when the process dies."""
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _swept(folder: Path) -> int:
    """Delete the kernels of PoCL that are cut short, which end a process that loads them; return how many."""
    count = 0
    for path in folder.glob("*/*/*/*/*.so"):
        with suppress(OSError):
            if not _is_whole(path):
                path.unlink()
                count += 1
    return count


def _is_whole(path: Path) -> bool:
    """Test whether a shared object (ELF, 64 bit) has its whole section table, which stands at its end."""
    with path.open("rb") as file:
        head = file.read(64)
    if sys.platform != "linux" or head[4:6] == b"\1\1":  # 32 bit
        return True
    at, (length, count) = int.from_bytes(head[40:48], "little"), struct.unpack("<HH", head[58:62].ljust(4, b"\0"))
    return head[:4] == b"\x7fELF" and path.stat().st_size >= at + length * count


class TriedKernel:
    """A kernel whose first runs are marked: its driver loads or makes it only then, for each size of launches."""

    def __init__(self, kernel: Any, trial: Trial) -> None:
        self._kernel, self._trial = kernel, trial
        self._tried: set[tuple[Any, ...]] = set()

    def __call__(self, queue: Any, size: tuple[int, ...], group: tuple[int, ...], *arguments: Any) -> Any:
        """Launch it as PyOpenCL does; return the event."""
        kind = group, tuple(int(count).bit_length() for count in size)
        if kind in self._tried:
            return self._kernel(queue, size, group, *arguments)
        with self._trial.marked():
            event = self._kernel(queue, size, group, *arguments)
            event.wait()
        self._tried.add(kind)
        return event
