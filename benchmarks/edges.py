"""What paths over edges cost: their search in a furnished room, and rendering them against as many reflections.

Needs the meshes and motions of ../shared/data. Times are of the processor, not of the clock.
"""

import argparse
import time
from typing import Any

import numpy as np
from paths import make_scene

import clsim
from clsim.paths.path_set import PathSet


def measured(function: Any, *arguments: Any, **options: Any) -> tuple[Any, float]:
    """Return what a function gives, and the processor's seconds."""
    before = time.process_time()
    found = function(*arguments, **options)
    return found, time.process_time() - before


def main() -> None:
    """Print a line for each figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--order", type=int, default=2)
    parser.add_argument("--share", type=float, default=1.0, help="of the 30 s motion")
    parser.add_argument("--render", type=float, default=1.0, help="s that are rendered")
    options = parser.parse_args()
    scene = make_scene("bedroom", "tum", options.share)
    edges = scene.room.edges()
    _, without = measured(clsim.find_paths, scene, options.order)
    paths, seconds = measured(clsim.find_paths, scene, options.order, diffraction=1)
    specular, edge = paths.families
    print(f"{len(scene.room.walls)} walls, {len(edges)} edges, order {options.order}, {len(scene.receivers)} receivers")
    print(f"find_paths: {without:.1f} s for {len(specular)} rows, with edges {seconds:.1f} s for {len(edge)} more")
    count = min(len(specular), len(edge))
    rng = np.random.default_rng(0)
    for name, family in (("reflections", specular), ("edges", edge), ("edges", edge), ("reflections", specular)):
        some = np.sort(rng.choice(len(family), count, replace=False))
        alone = PathSet(scene, (family.part(some),))
        _, seconds = measured(clsim.render, alone, 192e3, duration=options.render)
        print(f"rendering {options.render:g} s of {count} rows of {name}: {seconds:.1f} s")


if __name__ == "__main__":
    main()
