"""Work that is done side by side by threads: NumPy lets others go on in all that takes long."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Item = TypeVar("Item")
    Result = TypeVar("Result")


def thread_count() -> int:
    """Return how many threads of this process can run at the same time, as the operating system tells."""
    affinity = getattr(os, "sched_getaffinity", None)  # not told by every operating system
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def side_by_side(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    meanwhile: Callable[[], None] | None = None,
    threads: int | None = None,
) -> list[Result]:
    """Return what a function makes of each item, in their order."""
    count = min(thread_count() if threads is None else threads, len(items))
    if count <= 1:
        if meanwhile is not None:
            meanwhile()
        return [function(item) for item in items]
    with ThreadPoolExecutor(count) as pool:
        made = pool.map(function, items)
        if meanwhile is not None:
            meanwhile()
        return list(made)
