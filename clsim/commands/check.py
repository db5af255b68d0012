"""`clsim check`: what a scene file holds, what is wrong with it, and what would be computed."""

from __future__ import annotations

import argparse
from itertools import groupby

import numpy as np

from clsim.commands.arguments import add_scene
from clsim.numerics.quaternions import rotate
from clsim.paths.path_set import PathSet
from clsim.paths.without_edges import largest_jump_db
from clsim.scene.directivity.patterns import Omni
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.scene import Scene, shaded_pairs
from clsim.scene_file import load_scene
from clsim.scene_file.scene import SceneFile
from clsim.tail.design import left_by_images
from clsim.workflow.console import progress
from clsim.workflow.pipeline import plan_scene

_INSTANTS = 10_001  # of a motion at which its speed is looked at


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)


def execute(options: argparse.Namespace) -> int:
    """Print the content of a scene file; return the exit status."""
    file = load_scene(options.scene)
    for line in file.scene.describe():  # before the search, which may take long or give up
        print(line, flush=True)
    if file.paths["diffraction"]:
        print(*file.scene.room.edges().describe(), *_thin(file), sep="\n", flush=True)
    print(*_facing(file.scene), sep="\n", flush=True)
    planned = plan_scene(file, progress)
    scene, plan = file.scene, planned.plan
    if not scene.room.is_convex or scene.bodies:
        print(*_comings_and_goings(planned.paths, file.paths["diffraction"]), sep="\n")
    left = left_by_images(planned.paths, plan.sampling_rate) if plan.options.tail == "off" else None
    # Rays replace the estimate of the plan's note.
    of_plan = [line for line in plan.describe() if left is None or not line.startswith("images leave")]
    if left is not None:
        remedy = ' (tail = "auto" adds it)' if left > -20.0 else ""
        of_plan.append(f"images leave {left:.0f} dB of the energy: higher orders, and what walls scatter{remedy}")
    for line in [*shaded_pairs(scene, plan.duration), *of_plan]:
        print(line)
    for field, item in [*scene.named_ends(), *scene.named_scatterers(), *scene.named_bodies()]:
        for note in [*_motion(item.trajectory), *item.trajectory.notes]:
            print(f"{field}.trajectory: {note}")
    print("the scene file is valid")
    return 0


def _motion(trajectory: Trajectory) -> list[str]:
    """Return duration and speed of a motion from a file, which reveal wrong units."""
    if not trajectory.notes:
        return []
    t = np.linspace(trajectory.start, trajectory.end, _INSTANTS)
    length = np.linalg.norm(np.diff(trajectory.position(t), axis=0), axis=1).sum()
    speed = np.linalg.norm(trajectory.velocity(t), axis=1).max()
    return [f"{length:.3g} m in {trajectory.end - trajectory.start:.4g} s, at most {speed:.3g} m/s"]


def _facing(scene: Scene) -> list[str]:
    """Return the directions in which sources and receivers face at 0 s, neighbours that face alike in one line."""
    rows = []
    for field, end in scene.named_ends():
        axis = rotate(end.orientation(np.zeros(1)), (1.0, 0.0, 0.0))[0].round(3) + 0.0
        kind = ", omnidirectional" if isinstance(end.directivity, Omni) else ""
        rows.append((field, f"faces ({', '.join(f'{x:g}' for x in axis)}) at 0 s{kind}"))
    lines = []
    for (_, direction), group in groupby(rows, lambda row: (row[0].partition("[")[0], row[1])):
        fields = [field for field, _ in group]
        lines.append(f"{' to '.join(dict.fromkeys((fields[0], fields[-1])))}: {direction}")
    return lines


def _thin(file: SceneFile) -> list[str]:
    """Return notes on panels with two edges within two wavelengths, where paths bend round one edge alone."""
    if file.paths["diffraction"] > 1:
        return []
    lowest = min(source.emitted.centre_frequency for source in file.scene.sources)
    wavelengths = 2.0 * file.scene.air.speed_of_sound / lowest
    return [
        f"{name} of {1e3 * thickness:.3g} mm: silent behind, as its edges are two (diffraction = 2), and thinner than "
        f"two wavelengths, {1e3 * wavelengths:.3g} mm: a sheet does as well (sheets_below = {wavelengths:.2g})"
        for name, thickness in file.scene.room.as_mesh().thin_panels(wavelengths)
    ]


def _comings_and_goings(paths: PathSet, diffraction: int) -> list[str]:
    """Report paths that begin and end, and without edges the largest jump of the pressure there."""
    always = np.isneginf(paths.start) & np.isposinf(paths.end)
    others = np.column_stack([paths.source, paths.receiver, paths.objects])[~always]
    count = len(np.unique(others, axis=0))
    lines = [
        f"paths: {always.sum() + count}, of which {always.sum()} are active all the time "
        f"and {count} in intervals ({len(others)} of them; the same walls in another order are another path)"
    ]
    jump = None if diffraction else largest_jump_db(paths)
    if jump is not None:
        jumps = f"paths begin and end at edges: the pressure jumps by up to {jump:.1f} dB of the strongest path"
        lines.append(f"{jumps}; paths over edges make it continuous (diffraction = 1)")
    return lines
