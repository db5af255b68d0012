"""`clsim check`: what a scene file holds, what is wrong with it, and what would be computed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.commands.arguments import add_scene
from clsim.render.tails import left_by_images
from clsim.scene_file import load_scene
from clsim.workflow.console import progress
from clsim.workflow.pipeline import plan_scene

if TYPE_CHECKING:
    import argparse

    from clsim.paths.path_set import PathSet


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_scene(parser)


def execute(options: argparse.Namespace) -> int:
    """Print what a scene file holds; return the exit status."""
    file = load_scene(options.scene)
    for line in file.scene.describe():  # before the search, which may take long or give up
        print(line, flush=True)
    if file.paths["diffraction"]:
        print(*file.scene.room.edges().describe(), sep="\n", flush=True)
    planned = plan_scene(file, progress)
    passing = [] if file.scene.room.is_convex else [_comings_and_goings(planned.paths)]
    options = planned.plan.options
    left = left_by_images(planned.paths, options.sampling_rate) if options.tail == "off" else None
    beyond = [] if left is None else [_left(left)]
    for line in [*passing, *planned.plan.describe(), *beyond]:
        print(line)
    for field, item in [*file.scene.named_ends(), *file.scene.named_scatterers()]:
        for note in item.trajectory.notes:
            print(f"{field}.trajectory: {note}")
    print("the scene file is valid")
    return 0


def _left(left_db: float) -> str:
    return (
        f"images leave {left_db:.0f} dB of the energy to higher orders and to what walls scatter (tail, below 40 kHz)"
    )


def _comings_and_goings(paths: PathSet) -> str:
    always = np.isneginf(paths.start) & np.isposinf(paths.end)
    others = np.column_stack([paths.source, paths.receiver, paths.objects])[~always]
    count = len(np.unique(others, axis=0))
    return (
        f"paths: {always.sum() + count}, of which {always.sum()} are heard all the time "
        f"and {count} come and go ({len(others)} intervals; the same walls in another order are another path)"
    )
