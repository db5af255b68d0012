"""A run that may be killed at any moment, and goes on from where it was."""

from __future__ import annotations

import hashlib
import math
import os
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.opencl.device import find_device
from clsim.render.render import render_chunks
from clsim.render.rendering import Rendering
from clsim.scene_file.scene import referenced_files
from clsim.version import __version__
from clsim.workflow.console import progress

if TYPE_CHECKING:
    from pathlib import Path

    from clsim.output.stores import SoundStore
    from clsim.render.plan import Plan
    from clsim.workflow.pipeline import PlannedScene
    from clsim.workflow.result_folder import ResultFolder

_PERIOD = 1.0  # s between notes in the journal, at least: what a killed run loses beside the chunk it was at


def render_sound(results: ResultFolder, plan: Plan, store: SoundStore, identity: dict[str, Any]) -> list[Path]:
    """Render into a store, from the beginning or from where the journal says; return what was moved to its place.

    Parameters
    ----------
    results : ResultFolder
        Held, and begun with this identity.
    plan : Plan
        What to render.
    store : SoundStore
        In the folder of what is not whole yet.
    identity : dict
        Of the run, for the journal.
    """
    names = [path.name for path in store.paths]
    if all(map(results.is_whole, names)):
        return []
    rendering, done = Rendering(plan), 0
    if results.journal.exists():
        _, done, state = results.journal.load()
        rendering.restore(state)
        lost = [path for path in store.paths if not (path.exists() or results.is_whole(path.name))]
        if lost:
            raise InputError("--resume", f"must find {lost[0]}, which is missing (--force begins anew)")
    else:
        store.create()
    if done < plan.samples:
        _render(results, plan, store, identity, done, rendering)
    return results.take(names)


def _render(
    results: ResultFolder,
    plan: Plan,
    store: SoundStore,
    identity: dict[str, Any],
    done: int,
    rendering: Rendering,
) -> None:
    store.open()
    try:
        with progress("rendering", plan.path_count * plan.samples) as advance:
            advance(plan.path_count * done)
            noted = -math.inf
            for start, samples in render_chunks(plan, first=done, rendering=rendering):
                store.write(start, samples)
                done = start + samples.shape[1]
                if done == plan.samples or time.monotonic() - noted > _PERIOD:
                    store.to_disk()
                    results.journal.save(identity, done, rendering.state())
                    noted = time.monotonic()
                advance(plan.path_count * samples.shape[1])
    finally:
        store.close()


def run_identity(planned: PlannedScene) -> dict[str, Any]:
    """Return all that the samples of a scene file depend on, in texts and numbers."""
    import scipy

    file, paths, plan = planned.file, planned.paths, planned.plan
    device = "none"
    if plan.options.engine == "opencl":
        info, _ = find_device(plan.options.device)
        device = f"{info.name} ({info.platform}, {info.version})"
    content = file.model.model_dump(mode="json", exclude_none=True, warnings=False)
    content["render"] |= {
        "engine": plan.options.engine, "duration": plan.duration, "samples": plan.samples, "chunk": plan.chunk,
    }  # fmt: skip
    content["render"].pop("device", None)
    return {
        "scene": content,
        "contents": {os.path.relpath(path, file.base): _digest(path) for path in referenced_files(file)},
        "device": device,
        "versions": {"clsim": __version__, "numpy": np.__version__, "scipy": scipy.__version__},
        "paths": paths.digest(),
        "contributions": {contribution.name: contribution.digest() for contribution in plan.contributions},
    }


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
