"""`clsim view`: an interactive page of a scene file."""

from __future__ import annotations

import webbrowser
from typing import TYPE_CHECKING

from clsim.errors import InputError
from clsim.files.ownership import NewFile
from clsim.output.view import view_scene
from clsim.scene_file import load_scene
from clsim.workflow.console import progress
from clsim.workflow.pipeline import planned, read_files

if TYPE_CHECKING:
    import argparse

_MOST_FRAMES = 10_000
_MOST_PATHS = 100_000  # drawn at a time


def execute(options: argparse.Namespace) -> int:
    """Write the page; return the exit status."""
    for name, most in (("frames", _MOST_FRAMES), ("limit", _MOST_PATHS)):
        if not 1 <= getattr(options, name) <= most:
            raise InputError(f"--{name}", f"must be 1 to {most}, but is {getattr(options, name)}")
    file = load_scene(options.scene)
    named = options.output or options.scene.with_suffix(".html")
    page = NewFile(named, read_files(options.scene, file), options.force)
    paths, plan = planned(file, {})
    with progress("drawing", options.frames) as advance:
        view_scene(
            paths, page.ready(), title=options.scene.stem, duration=plan.duration, frames=options.frames,
            limit=options.limit, progress=advance,
            motion=plan.tracks.motion, amplitude=plan.tracks.amplitude,
        )  # fmt: skip
    print(page.path)
    if options.open:
        webbrowser.open(page.path.resolve().as_uri())
    return 0
