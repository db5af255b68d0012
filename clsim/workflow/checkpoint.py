"""A run that may be killed at any moment, and goes on from where it was."""

from __future__ import annotations

import hashlib
import math
import os
import time
from typing import TYPE_CHECKING, Any

from clsim.errors import InputError
from clsim.render.rendering import Rendering
from clsim.scene_file.scene import referenced_files
from clsim.workflow.console import progress
from clsim.workflow.on_workers import render_on_workers
from clsim.workflow.pieces import device_of, versions
from clsim.workflow.streaming import render_into

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from clsim.cluster.workers import Workers
    from clsim.output.stores import SoundStore
    from clsim.render.contributions import State
    from clsim.render.plan import Plan
    from clsim.workflow.pipeline import PlannedScene
    from clsim.workflow.result_folder import ResultFolder

_PERIOD = 1.0  # s between notes in the journal, at least: what a killed run loses beside the chunk it was at


def render_sound(
    results: ResultFolder, plan: Plan, store: SoundStore, identity: dict[str, Any], workers: Workers | None = None
) -> list[Path]:
    """Render into a store, from the beginning or from where the journal says; return what was moved to its place."""
    names = [path.name for path in store.paths]
    if all(map(results.is_whole, names)):
        return []
    begun: tuple[int, State] = 0, {}
    if results.journal.exists():
        begun = results.journal.load()[1:]
        lost = [path for path in store.paths if not (path.exists() or results.is_whole(path.name))]
        if lost:
            raise InputError("--resume", f"must find {lost[0]}, which is missing (--force begins anew)")
        store.recover()
    else:
        store.create()
    if begun[0] < plan.samples:
        notes = _Notes(results, identity, plan.samples, begun[0])
        with progress("rendering", plan.path_count * plan.samples) as advance:
            advance(plan.path_count * begun[0])
            if workers is None:
                _render(plan, store, begun, notes, lambda samples: advance(plan.path_count * samples))
            else:
                render_on_workers(
                    workers, results.work, plan, store, begun, notes, lambda samples: advance(plan.path_count * samples)
                )
    return results.take(names)


class _Notes:
    """What is noted in the journal of a run, not too often."""

    def __init__(self, results: ResultFolder, identity: dict[str, Any], samples: int, done: int) -> None:
        self._results, self._identity, self._samples = results, identity, samples
        self._done, self._noted = done, -math.inf

    def due(self, done: int) -> bool:
        """Return whether it is time to note that so many samples are there."""
        finished = done == self._samples
        return done > self._done and (finished or time.monotonic() - self._noted > _PERIOD)

    def __call__(self, done: int, state: State) -> None:
        """Note what is there, on the disk itself, and what is remembered behind it, if it is time."""
        if self.due(done):
            self._results.journal.save(self._identity, done, state)
            self._done, self._noted = done, time.monotonic()


def _render(
    plan: Plan, store: SoundStore, begun: tuple[int, State], notes: _Notes, advance: Callable[[float], None]
) -> None:
    """Render in this process."""
    rendering = Rendering(plan)
    if begun[0]:
        rendering.restore(begun[1])
    before = begun[0]
    for done in render_into([store], plan, rendering, before):
        if notes.due(done):
            store.to_disk()
            notes(done, rendering.state())
        advance(done - before)
        before = done


def run_identity(planned: PlannedScene) -> dict[str, Any]:
    """Return all that the samples of a scene file depend on, in texts and numbers."""
    file, paths, plan = planned.file, planned.paths, planned.plan
    content = file.model.model_dump(mode="json", exclude_none=True, warnings=False)
    content["render"] |= {
        "engine": plan.options.engine, "duration": plan.duration, "samples": plan.samples, "chunk": plan.chunk,
    }  # fmt: skip
    content["render"].pop("device", None)
    return {
        "scene": content,
        "contents": {os.path.relpath(path, file.base): _digest(path) for path in referenced_files(file)},
        "device": device_of(plan),
        "versions": versions(),
        "paths": paths.digest(),
        "contributions": {contribution.name: contribution.digest() for contribution in plan.contributions},
    }


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
