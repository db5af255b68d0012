"""What moving bodies cost: the search over steps, and nodes of paths by a door against those of paths by walls.

Processor time, least of some runs in turn: ``python benchmarks/bodies.py``, with a number of seconds that somebody walks (2 where
left out). A node is a path's delay and gains at the end of a
block. Timed is all that makes nodes: what is uploaded for a chunk, `coarse_delays` and `tracks`; both kinds in one rendering, on
the device, and, for comparison, those by the door on the host.
"""

import resource
import sys
import time
import warnings
from typing import Any

import numpy as np

import clsim
from clsim.paths.path_set import PathSet
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.opencl.path_columns import COLUMNS

RATE = 192e3
ROUNDS = 7
PADDED = 64  # paths of a batch: what fills it up is computed, too


def scene(door: bool, swift: bool = False) -> clsim.Scene:
    """Return a room with a door, and a source that moves: on a line, or in circles at 2 m/s."""
    wood = clsim.Material.from_reflection(0.9)
    tone = clsim.Signal.tone(40e3, duration=1.0, sampling_rate=RATE, fade=0.01)
    way = clsim.Trajectory.line((1.0, 0.7, 1.2), (1.4, 0.8, 1.2), 1.0)
    if swift:
        way = clsim.Trajectory.circle((1.0, 0.8, 1.2), 0.3, 0.95, 1.0)
    source, ear = clsim.Source("s", tone, way), clsim.Receiver("r", clsim.Trajectory.fixed((3.0, 0.6, 1.3)))
    hinge = clsim.Trajectory.swing((1.5, 2.0, 0.0), (0, 0, 1), [0.0, 0.2, 0.5], [0.0, 0.5, 1.0])
    body = clsim.Body.box("door", (0.9, 0.0, 2.0), wood, hinge, centre=(0.5, 0.0, 1.1))
    return clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), wood), clsim.Air(), [source], [ear], bodies=[body] if door else []
    )


def walk(duration: float) -> clsim.Scene:
    """Return a room with 64 receivers, in which a box of the size of a person goes slowly."""
    wood = clsim.Material.from_reflection(0.9)
    tone = clsim.Signal.tone(40e3, duration, RATE)
    way = clsim.Trajectory.line((1.0, 2.2, 0.0), (1.0 + 0.07 * duration, 2.4, 0.0), duration)
    body = clsim.Body.box("walker", (0.4, 0.5, 1.7), wood, way, centre=(0.0, 0.0, 0.9))
    places = [(0.3 + 0.7 * (i % 8), 0.3 + 0.6 * (i // 8), 1.8) for i in range(64)]
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(place)) for i, place in enumerate(places)]
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((5.5, 2.5, 1.2)))
    return clsim.Scene(clsim.Shoebox((6.0, 5.0, 3.0), wood), clsim.Air(), [source], ears, bodies=[body])


def tell_walk(duration: float) -> None:
    """Print what the search costs while somebody walks."""
    made, begun = walk(duration), time.process_time()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rows = len(clsim.find_paths(made, 1, engine="reference").families[-1])
    spent, after = time.process_time() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(
        f"a walk of {duration:g} s, 64 receivers, order 1: search {spent:.2f} s of processor time, "
        f"{(after - before) / 1024:.0f} MiB more; {rows} rows by the walker"
    )


class Timed:
    """A maker of nodes that takes the processor time of what it does, and counts the nodes."""

    def __init__(self, maker: Any) -> None:
        self.maker, self.spent, self.nodes_made = maker, 0.0, 0

    def prepare(self, source: int, batch: Any, *rest: Any) -> Any:
        """Return the prepared case of a maker, and the number of paths."""
        begun = time.process_time()
        state = self.maker.prepare(source, batch, *rest)
        self.spent += time.process_time() - begun
        return batch.count, state

    def nodes(self, state: Any, start: int, block: int, blocks: int, meanwhile: Any = None) -> Any:
        """Return the maker's nodes; nothing else is done meanwhile."""
        count, chunk = state
        begun = time.process_time()
        made = self.maker.nodes(chunk, start, block, blocks)
        self.spent += time.process_time() - begun
        self.nodes_made += count * blocks
        return made


def nodes_of(paths: PathSet) -> list[float]:
    """Return the processor times of a node of paths by walls and by the door, s."""
    made = clsim.plan_render(paths, RATE, convolve_static=False)
    engine, timed = OpenclEngine(made), []
    for pair in range(len(made.tracks.pairs)):
        engine.maker(pair)
    for family in engine._makers:
        timed.append(Timed(engine._makers[family]))
        engine._makers[family] = timed[-1]
    engine.render(0, made.samples)
    return [each.spent / each.nodes_made for each in timed]


def filled(paths: PathSet) -> PathSet:
    """Return paths by walls and by the door, rows of each again and again, so that batches are whole."""
    families = [paths.families[0], paths.families[-1]]
    return PathSet(paths.scene, tuple(f.part(np.resize(np.arange(len(f)), PADDED)) for f in families))


def main() -> None:
    """Print all figures."""
    warnings.simplefilter("ignore")
    tell_walk(float(sys.argv[1]) if len(sys.argv) > 1 else 2.0)
    for order in (1, 2, 3):
        begun = time.process_time()
        clsim.find_paths(scene(door=False), order)
        plain, begun = time.process_time() - begun, time.process_time()
        both = clsim.find_paths(scene(door=True), order)
        search = time.process_time() - begun
        print(
            f"order {order}: search {search:.2f} s of processor time, without the door {plain:.2f} s; "
            f"{len(both.families[-1])} rows by the door"
        )
        for swift in (False, True):
            paths = filled(both if not swift else clsim.find_paths(scene(door=True, swift=True), order))
            nodes_of(paths)  # builds programs
            walls, moving = np.min([nodes_of(paths) for _ in range(ROUNDS)], axis=0)
            program = COLUMNS.pop("bodies")
            by_host = min(nodes_of(paths)[1] for _ in range(2))
            COLUMNS["bodies"] = program
            print(
                f"  source {'in circles' if swift else 'on a line'}: a node {1e9 * walls:.0f} ns by walls, by the door "
                f"{moving / walls:.2f} times that; by the door on the host {by_host / walls:.1f} times"
            )


if __name__ == "__main__":
    main()
