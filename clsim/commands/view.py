"""`clsim view`: an interactive page of a scene file."""

from __future__ import annotations

import argparse
import webbrowser

from clsim.commands.arguments import add_output, add_scene, as_whole
from clsim.errors import InputError
from clsim.files.atomic import NewFile
from clsim.files.input_files import shown
from clsim.paths.path_table import view_scene
from clsim.scene_file import load_scene
from clsim.workflow.console import progress
from clsim.workflow.pipeline import input_files, plan_scene

_MOST_FRAMES = 10_000
_MOST_PATHS = 100_000  # drawn at a time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser, "the page (default: beside the scene file)")
    parser.add_argument(
        "--frames", type=as_whole, default=120, metavar="N", help="instants to choose from (default: 120)"
    )
    parser.add_argument("--limit", type=as_whole, default=300, metavar="N", help="strongest paths drawn (default: 300)")
    parser.add_argument("--open", action="store_true", help="open it in a browser")


def execute(options: argparse.Namespace) -> int:
    """Write the page; return the exit status."""
    for name, most in (("frames", _MOST_FRAMES), ("limit", _MOST_PATHS)):
        if not 1 <= getattr(options, name) <= most:
            raise InputError(f"--{name}", f"must be 1 to {most}, but is {getattr(options, name)}")
    file = load_scene(options.scene)
    named = options.output or options.scene.with_suffix(".html")
    page = NewFile(named, input_files(options.scene, file), options.force)
    planned = plan_scene(file, progress)
    with progress("drawing", options.frames) as advance:
        view_scene(
            planned.paths, page.ready(), title=shown(options.scene.stem), duration=planned.plan.duration,
            frames=options.frames, limit=options.limit, progress=advance,
            motion=planned.plan.options.motion, amplitude=planned.plan.options.amplitude,
        )  # fmt: skip
    print(page.path)
    if options.open:
        webbrowser.open(page.path.resolve().as_uri())
    return 0
