"""What paths over edges cost: their search in a furnished room, and rendering them against as many reflections.

Both are told for each second in which a path is heard.

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
    """Return the result of a function and its processor time, s."""
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
    # As many reflections as there are paths over edges: each of them so often.
    often = np.tile(np.arange(len(specular)), max(1, round(len(edge) / len(specular))))
    kinds = {"reflections": specular.part(np.sort(often)), "edges": edge}
    for family in kinds.values():  # so that kernels are built
        rendered(family, options.render)
    for name in ("reflections", "edges", "edges", "reflections"):
        heard, planning, seconds = rendered(kinds[name], options.render)
        print(
            f"rendering {heard:.0f} s of paths heard, {name}: {1e3 * seconds / heard:.2f} ms each; planning {planning:.1f} s"
        )


def rendered(family: Any, duration: float) -> tuple[float, float, float]:
    """Return for how long paths are heard, all together, and the processor's seconds of planning and of rendering."""
    scene = family.scene
    paths = PathSet(scene, (family,))
    heard = np.clip(np.minimum(family.end, duration) - np.maximum(family.start, 0.0), 0.0, None).sum()
    plan, planning = measured(clsim.plan_render, paths, 192e3, duration=duration)
    rendering = clsim.Rendering(plan)
    _, seconds = measured(lambda: [None for _ in rendering.pieces()])
    return float(heard), planning, seconds


if __name__ == "__main__":
    main()
