"""Rendering into stores, chunk by chunk: what a run and a member of a study have in common."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Protocol

from clsim.render.memory import within_memory
from clsim.render.render import render_chunks

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from clsim.render.plan import Plan
    from clsim.render.rendering import Rendering


class Sink(Protocol):
    """What takes samples, chunk by chunk."""

    def open(self) -> None:
        """Make ready to write."""

    def write(self, start: int, samples: NDArray[Any]) -> None:
        """Write samples (receivers, n) from sample `start` on."""

    def close(self) -> None:
        """Write no more."""


def render_into(sinks: Sequence[Sink], plan: Plan, rendering: Rendering, first: int = 0) -> Iterator[int]:
    """Render a plan into sinks, in bounded memory; yield how many samples are there behind each chunk."""
    with within_memory(plan.largest_field, "rendering", plan.memory_bytes), ExitStack() as stack:
        for sink in sinks:
            sink.open()
            stack.callback(sink.close)
        for start, samples in render_chunks(plan, first=first, rendering=rendering):
            for sink in sinks:
                sink.write(start, samples)
            yield start + samples.shape[1]
