"""`clsim view`: an interactive page of a scene file."""

from __future__ import annotations

import webbrowser
from typing import TYPE_CHECKING

from clsim.commands.console import progress
from clsim.commands.planning import planned
from clsim.errors import InputError
from clsim.output.view import view_scene
from clsim.scene_file import load_scene

if TYPE_CHECKING:
    import argparse
    from pathlib import Path


def execute(options: argparse.Namespace) -> int:
    """Write the page; return the exit status."""
    for name in ("frames", "limit"):
        if getattr(options, name) < 1:
            raise InputError(f"--{name}", f"must be at least 1, but is {getattr(options, name)}")
    paths, plan = planned(load_scene(options.scene), {})
    page: Path = options.output or options.scene.with_suffix(".html")
    with progress("drawing", options.frames) as advance:
        view_scene(
            paths, page, duration=plan.duration, frames=options.frames, limit=options.limit, title=options.scene.stem,
            motion=plan.tracks.motion, amplitude=plan.tracks.amplitude, progress=advance,  # type: ignore[attr-defined]
        )  # fmt: skip
    print(page)
    if options.open:
        webbrowser.open(page.resolve().as_uri())
    return 0
