"""What paths over edges cost: their search among pillars, and rendering them against as many reflections.

Processor time of whole calls, least of some, for each second in which a path is received; ``python benchmarks/edges.py``, with
``PYTHONPATH`` for another checkout. Results stand in edges.md. "Alone" is a rendering of nothing else, "more" what edges add to a
rendering of the reflections.
"""

import argparse
import time
import warnings
from typing import Any

import numpy as np

import clsim
from clsim.paths.path_set import PathSet

RATE = 192e3
ABSORPTION = [0.1, 0.2, 0.4, 0.5, 0.5], [20e3, 30e3, 40e3, 50e3, 60e3]
PILLARS = [(2.0, 2.5), (3.5, 1.5), (4.2, 3.4)]
EARS = [(5.3, 4.2, 1.6), (1.0, 4.0, 1.1), (5.0, 0.7, 2.0), (0.6, 0.7, 1.7)]
BANDS = {"tone, 40 kHz": None, "39 to 41 kHz": (39e3, 41e3), "30 to 50 kHz": (30e3, 50e3), "0.1 to 8 kHz": (100.0, 8e3)}


def scene(band: tuple[float, float] | None, duration: float) -> clsim.Scene:
    """Return a room with three pillars, a source that moves at 0.5 m/s or less and four receivers."""
    wall = clsim.Material.from_absorption(ABSORPTION[1], ABSORPTION[0])
    pillars = [[(x, y), (x + 0.3, y), (x + 0.3, y + 0.3), (x, y + 0.3)] for x, y in PILLARS]
    room = clsim.MeshRoom.from_plan([(0, 0), (6, 0), (6, 5), (0, 5)], 3.0, wall, pillars=pillars)
    sound = clsim.Signal.tone(40e3, duration, RATE, fade=0.01)
    if band is not None:
        sound = clsim.Signal.chirp(*band, duration, RATE, window="tukey")
    way = clsim.Trajectory.line((2.5, 1.0, 1.2), (3.3, 1.8, 1.4), max(2.0, duration + 0.1))
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(place)) for i, place in enumerate(EARS)]
    return clsim.Scene(room, clsim.Air(), [clsim.Source("s", sound, way)], ears)


def measured(function: Any, *arguments: Any, repeat: int = 1, **options: Any) -> tuple[Any, float]:
    """Return the result of a function and its processor time, s: the least of several."""
    least = np.inf
    for _ in range(repeat):
        before = time.process_time()
        found = function(*arguments, **options)
        least = min(least, time.process_time() - before)
    return found, least


def rendered(paths: PathSet, duration: float, repeat: int) -> tuple[float, float, float]:
    """Return the time in which paths are received, summed, and processor times of planning and of rendering, s."""
    last = [np.minimum(family.end, duration) - np.maximum(family.start, 0.0) for family in paths.families]
    plan, planning = measured(clsim.plan_render, paths, RATE, repeat=repeat, duration=duration)
    _, seconds = measured(lambda: list(clsim.Rendering(plan).pieces()), repeat=repeat + 1)
    return float(sum(np.clip(each, 0.0, None).sum() for each in last)), planning, seconds


def main() -> None:
    """Print a line for each band."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--order", type=int, default=2)
    parser.add_argument("--duration", type=float, default=2.0, help="s")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    of_tone = scene(None, options.duration)
    clsim.find_paths(of_tone, options.order, diffraction=1)  # so that kernels are built
    _, without = measured(clsim.find_paths, of_tone, options.order)
    _, seconds = measured(clsim.find_paths, of_tone, options.order, diffraction=1)
    print(f"find_paths: {without:.2f} s, with edges {seconds:.2f} s\n")
    print(
        "| band | reflections, us | edges alone | edges more | planning, s: reflections | with edges |\n"
        + "|---" * 6
        + "|"
    )
    for name, band in BANDS.items():
        paths = clsim.find_paths(scene(band, options.duration), options.order, diffraction=1)
        specular, edge = paths.families
        # As many reflections as there are paths over edges: each of them so often.
        often = np.repeat(np.arange(len(specular)), max(1, round(len(edge) / len(specular))))
        sets = [PathSet(paths.scene, (family,)) for family in (specular.part(often), edge, specular)]
        many, alone, few, both = (rendered(some, options.duration, options.repeat) for some in (*sets, paths))
        one = many[2] / many[0]
        more = (both[2] - few[2]) / (both[0] - few[0])
        cells = [
            name,
            f"{1e6 * one:.0f}",
            f"{alone[2] / alone[0] / one:.2f}",
            f"{more / one:.2f}",
            f"{few[1]:.2f}",
            f"{both[1]:.2f}",
        ]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
