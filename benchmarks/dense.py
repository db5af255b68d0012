"""Scenes of thousands of paths: the default call against a C loop of the sum over paths, and against pyroomacoustics.

Processor time of whole calls, and of rendering with the plan at hand, each the least of some in one run. The loop
(`plain_loop.c`, which needs a C compiler) is given branch signals and polynomials of blocks, and sums one function of
frequency: `loop` is the time that it takes for all paths and samples once, `ratio` that over the rendering. With K
functions the same loop takes K times as long. pyroomacoustics, where it is installed, renders the first scene with its
source at rest. `apart` compares the default call with the sum over paths.
"""

import argparse
import importlib.util
import math
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from compare import Kernel

import clsim
from clsim.render.render import record

BANDS, ABSORPTION = (125, 250, 500, 1e3, 2e3, 4e3, 8e3), (0.1, 0.12, 0.15, 0.2, 0.25, 0.3, 0.35)
SIZE, FACTOR = (6.0, 5.0, 3.0), 0.9


@dataclass(frozen=True)
class Dense:
    """A source at 1 m/s and microphones at rest in a box of 6 x 5 x 3 m."""

    rate: float
    order: int
    microphones: int
    seconds: float
    band: tuple[float, float]
    by_frequency: bool = False

    def paths(self, seconds: float | None = None, microphones: int | None = None) -> clsim.PathSet:
        """Return its paths."""
        length = seconds or self.seconds
        wall = (
            clsim.Material.from_absorption(BANDS, ABSORPTION)
            if self.by_frequency
            else clsim.Material.from_reflection(FACTOR)
        )
        way = clsim.Trajectory.line((1.0, 2.0, 1.4), (1.0 + 0.9 * length, 2.0 + 0.435 * length, 1.4), length)
        source = clsim.Source("s", clsim.Signal.noise(length, self.rate, 1, self.band), way)
        places = [(4.9, 0.8 + 0.05 * i, 1.2) for i in range(microphones or self.microphones)]
        scene = clsim.Scene(clsim.Shoebox(SIZE, wall), clsim.Air(), [source], clsim.receiver_array("r", places))
        return clsim.find_paths(scene, self.order)


@dataclass(frozen=True)
class Corner(Dense):
    """The same at 0.5 m/s in an L-shaped room, whose paths begin and end."""

    def paths(self, seconds: float | None = None, microphones: int | None = None) -> clsim.PathSet:
        """Return its paths."""
        length = seconds or self.seconds
        plan = [(0, 0), (6, 0), (6, 2.6), (2.8, 2.6), (2.8, 5), (0, 5)]
        room = clsim.MeshRoom.from_plan(plan, SIZE[2], clsim.Material.from_reflection(FACTOR))
        way = clsim.Trajectory.line((0.8, 0.9, 1.4), (0.8 + 0.45 * length, 0.9 + 0.2 * length, 1.4), length)
        source = clsim.Source("s", clsim.Signal.noise(length, self.rate, 1, self.band), way)
        places = [(1.2, 4.1 - 0.05 * i, 1.2) for i in range(microphones or self.microphones)]
        return clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], clsim.receiver_array("r", places)), self.order)


SCENES = {
    "16 kHz, order 17, one factor": Dense(16e3, 17, 6, 4.0, (100.0, 6500.0)),
    "16 kHz, order 17, by frequency": Dense(16e3, 17, 6, 4.0, (100.0, 6500.0), by_frequency=True),
    "16 kHz, order 30, one factor": Dense(16e3, 30, 1, 4.0, (100.0, 6500.0)),
    "192 kHz, order 20, 82 kHz": Dense(192e3, 20, 1, 0.5, (1e3, 82e3)),
    "16 kHz, order 6, one factor": Dense(16e3, 6, 4, 4.0, (100.0, 6500.0)),
    "192 kHz, order 10, 82 kHz": Dense(192e3, 10, 1, 0.5, (1e3, 82e3)),
    "48 kHz, order 13, round a corner": Corner(48e3, 13, 1, 4.0, (100.0, 19e3)),
    "48 kHz, order 17, round a corner": Corner(48e3, 17, 1, 4.0, (100.0, 19e3)),
}


def spent(call: Callable[[], object]) -> float:
    """Return the processor time of a call, s."""
    begun = time.process_time()
    call()
    return time.process_time() - begun


def row(dense: Dense, repeat: int) -> str:
    """Return a scene's row of the table."""
    paths, options = dense.paths(), {"duration": dense.seconds}
    calls: dict[str, list[float]] = {"plan": [], "default": [], "sum": []}
    plans = {
        name: clsim.plan_render(paths, dense.rate, **options, **more)
        for name, more in (("default", {}), ("sum", {"channels": False}))
    }
    made = {name: record(plan).samples.astype(np.float64) for name, plan in plans.items()}
    loops = []
    with tempfile.TemporaryDirectory() as folder:
        loop = Kernel(Path(folder), dense.paths(min(dense.seconds, 2.0), 1), min(dense.seconds, 2.0), dense.rate)
        for _ in range(repeat):
            calls["plan"].append(spent(lambda: clsim.plan_render(paths, dense.rate, **options)))
            for name, plan in plans.items():
                calls[name].append(spent(lambda plan=plan: record(plan)))
            loops.append(spent(loop.plain) / (loop.slots * loop.samples))
    plan, functions = plans["default"], len(plans["default"].source_filters[0].basis)
    loop_seconds = min(loops) * plan.path_count * plan.samples
    apart = 20.0 * math.log10(
        max(float(np.linalg.norm(made["default"] - made["sum"]) / np.linalg.norm(made["sum"])), 1e-15)
    )
    taken = "channels" if plan.allocation.channels else "narrow" if plan.allocation.narrow else "sum"
    least = {name: min(values) for name, values in calls.items()}
    return (
        f"{plan.path_count // dense.microphones} x {dense.microphones} | {taken} | {functions} | {least['plan']:.2f} | {least['default']:.2f} | "
        f"{least['sum']:.2f} | {loop_seconds:.2f} | {loop_seconds / least['default']:.1f} | "
        f"{functions * loop_seconds / least['default']:.1f} | {apart:.0f} dB |"
    )


def standing_still(dense: Dense, repeat: int) -> float:
    """Return the processor time of pyroomacoustics with the source at rest, s."""
    import pyroomacoustics as pra

    signal = clsim.Signal.noise(dense.seconds, dense.rate, 1, dense.band).read(0, round(dense.seconds * dense.rate))
    taken = []
    for _ in range(repeat + 1):
        begun = time.process_time()
        material = (
            pra.Material({"coeffs": list(ABSORPTION), "center_freqs": list(BANDS)}) if dense.by_frequency
            else pra.Material(1.0 - FACTOR**2)
        )  # fmt: skip
        room = pra.ShoeBox(SIZE, fs=int(dense.rate), materials=material, max_order=dense.order, air_absorption=True)
        room.add_source([1.0, 2.0, 1.4], signal=signal)
        for i in range(dense.microphones):
            room.add_microphone([4.9, 0.8 + 0.05 * i, 1.2])
        room.simulate()
        taken.append(time.process_time() - begun)
    return min(taken[1:])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=3, metavar="N", help="counted calls of each (default: 3)")
    parser.add_argument("--only", nargs="+", choices=SCENES, default=[*SCENES], metavar="NAME", help="some scenes")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(
        "| scene | paths | taken | K | plan, s | default, s | sum, s | loop, s | ratio | ratio, K | apart |\n"
        + "|---" * 11
        + "|"
    )
    for name in options.only:
        print(f"| {name} | {row(SCENES[name], options.repeat)}", flush=True)
    if importlib.util.find_spec("pyroomacoustics") is not None:
        for name in list(SCENES)[:2]:
            if name in options.only:
                print(
                    f"\n{name}: pyroomacoustics, standing still: {standing_still(SCENES[name], options.repeat):.2f} s"
                )


if __name__ == "__main__":
    main()
