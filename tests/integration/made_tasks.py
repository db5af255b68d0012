"""Tasks for workers that cost nothing, and what listens in a tree of processes, as the system tells it."""

import os
import time
from pathlib import Path
from typing import Any

LISTENS = "0A"  # of /proc/net/tcp


class MadeTasks:
    """Tasks that tell by which process they were done.

    `waits` is how many seconds each takes, `kills` are numbers whose process dies, as long as a file is not there.
    """

    kind, several = "made", False
    loads: tuple[str, ...] = ()

    def __init__(self, note: str = "", waits: float = 0.0, kills: tuple[int, ...] = ()) -> None:
        self.note, self.waits, self.kills = note, waits, kills
        self.asked_over = 0

    def check(self) -> Any:
        return ready, ()

    def call(self, number: int) -> Any:
        return do, (number, self.note, self.waits, number in self.kills)

    def found(self, number: int) -> None:
        return None

    def failed(self, number: int, error: BaseException) -> Any:
        return {"status": "failed", "error": repr(error)}

    def over(self) -> None:
        self.asked_over += 1


def ready() -> tuple[str, bool]:
    return "", False


def do(number: int, note: str, waits: float, kills: bool, device: str | None) -> dict[str, Any]:
    if kills and not Path(note).exists():
        Path(note).touch()
        os.kill(os.getpid(), 9)
    try:
        Path(f"{note}.begun").touch()
        time.sleep(waits)
        if number < 0:
            raise UnreadableError("a", "b")
        return {"status": "finished", "process": os.getpid(), "device": device}
    except KeyboardInterrupt:
        Path(note).touch()  # what cleans up is done
        raise


class UnreadableError(Exception):
    """An error that can be pickled and not be read again, as some of libraries."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(one)


def tree(process: int) -> set[int]:
    """Return a process and all that descend from it."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(path.read_text("utf-8").rpartition(")")[2].split()[1])
        except OSError:
            continue
    found = {process}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found


def listening(processes: set[int]) -> tuple[set[int], set[str]]:
    """Return the TCP ports, and the names of Unix sockets, on which processes listen; '@' begins an abstract name."""
    held = set()
    for process in processes:
        try:
            links = list(Path(f"/proc/{process}/fd").iterdir())
        except OSError:
            continue
        for link in links:
            try:
                held.add(str(link.readlink()).removeprefix("socket:[").rstrip("]"))
            except OSError:
                continue
    ports, names = set(), set()
    for table in ("tcp", "tcp6"):
        for line in Path("/proc/net", table).read_text("utf-8").splitlines()[1:]:
            words = line.split()
            if words[3] == LISTENS and words[9] in held:
                ports.add(int(words[1].rpartition(":")[2], 16))
    for line in Path("/proc/net/unix").read_text("utf-8").splitlines()[1:]:
        words = line.split()
        if len(words) > 7 and words[6] in held and words[3] == "00010000":  # it accepts connections
            names.add(words[7])
    return ports, names
