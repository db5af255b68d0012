"""The choice between sampled channels and the sum over paths: the default call against both, over a grid of scenes.

Usage: python choice.py [--repeat N] [--only TEXT ...]. Timed are whole calls in processor time, taken in turn, the least of
each. `ratio` is the default over the better of `channels=True` and `channels=False`; the aim is at most 1.15. `taken` is what
the default takes: where it takes the better one, a ratio beyond the aim is how much the figures of this run are worth.
"""

import argparse
import math
import time
import warnings
from dataclasses import dataclass

import numpy as np

import clsim

AIM = 1.15
SIZE = (6.0, 5.0, 3.0)
TABLE = clsim.Material.from_absorption([125, 500, 2e3, 8e3], [0.1, 0.15, 0.2, 0.3])


@dataclass(frozen=True)
class Case:
    """A source on a circle, and receivers at rest, in a box of 6 x 5 x 3 m."""

    rate: float
    order: int
    receivers: str = "1"  # a number of microphones, or "head" or "ambisonic"
    speed: float = 1.0
    by_frequency: bool = False
    seconds: float = 1.0

    @property
    def name(self) -> str:
        """The name of its row."""
        walls = "by frequency" if self.by_frequency else "one factor"
        return f"{self.rate / 1e3:g} kHz, order {self.order}, {walls}, {self.receivers}, {self.speed:g} m/s, {self.seconds:g} s"

    def paths(self) -> clsim.PathSet:
        """Return its paths."""
        way = clsim.Trajectory.circle((2.5, 2.5, 1.4), 1.0, 2.0 * np.pi / self.speed, self.seconds)
        band = (0.01 * self.rate, 0.4 * self.rate)
        source = clsim.Source("s", clsim.Signal.noise(self.seconds, self.rate, 1, band), way)
        walls = TABLE if self.by_frequency else clsim.Material.from_reflection(0.9)
        place = clsim.Trajectory.fixed((4.9, 0.8, 1.2))
        if self.receivers == "head":
            ears = [clsim.Receiver.binaural("r", place)]
        elif self.receivers == "ambisonic":
            ears = [clsim.Receiver.ambisonic("r", place, 1)]
        else:
            ears = clsim.receiver_array("r", [(4.9, 0.8 + 0.1 * i, 1.2) for i in range(int(self.receivers))])
        return clsim.find_paths(clsim.Scene(clsim.Shoebox(SIZE, walls), clsim.Air(), [source], ears), self.order)


CASES = [
    Case(16e3, 4), Case(16e3, 6), Case(16e3, 6, "6"), Case(16e3, 6, by_frequency=True), Case(16e3, 8, "6", 0.3),
    Case(16e3, 12), Case(16e3, 12, "6", by_frequency=True), Case(16e3, 12, speed=6.0), Case(16e3, 17),
    Case(48e3, 4, "6"), Case(48e3, 6), Case(48e3, 8, "6", 0.3, seconds=0.5), Case(48e3, 8, by_frequency=True),
    Case(48e3, 12, seconds=0.5), Case(48e3, 12, speed=6.0, seconds=0.5), Case(48e3, 17, seconds=0.25),
    Case(192e3, 4, "6", seconds=0.25), Case(192e3, 6, seconds=0.5), Case(192e3, 8, speed=0.3, seconds=0.5),
    Case(192e3, 10, seconds=0.25), Case(192e3, 10, by_frequency=True, seconds=0.25), Case(192e3, 12, seconds=0.25),
    Case(192e3, 12, speed=6.0, seconds=0.1), Case(192e3, 17, seconds=0.1),
    Case(16e3, 4, "ambisonic"), Case(16e3, 8, "ambisonic"), Case(48e3, 6, "ambisonic"), Case(48e3, 10, "ambisonic", seconds=0.5),
    Case(48e3, 2, "head", seconds=0.25), Case(48e3, 4, "head", seconds=0.25), Case(48e3, 7, "head", seconds=0.25),
    Case(16e3, 3, "head", 0.3, seconds=0.5), Case(16e3, 6, "head", seconds=0.5), Case(16e3, 8, "head", seconds=0.5),
]  # fmt: skip


def row(case: Case, repeat: int) -> tuple[str, float]:
    """Return a case's row of the table, and its ratio."""
    paths, choices = case.paths(), {"default": None, "channels": True, "sum": False}
    taken: dict[str, list[float]] = {name: [] for name in choices}
    for _ in range(repeat + 1):
        for name, channels in choices.items():
            begun = time.process_time()
            clsim.render(paths, case.rate, duration=case.seconds, channels=channels)
            taken[name].append(time.process_time() - begun)
    default, channels, plain = (min(times[1:]) for times in taken.values())
    ratio = default / min(channels, plain)
    plan = clsim.plan_render(paths, case.rate, duration=case.seconds)
    inner = [plan, *(part.plan for part in plan.allocation.ears)]
    chosen = "channels" if any(one.allocation.channels for one in inner) else "sum"
    return f"| {case.name} | {chosen} | {default:.2f} | {channels:.2f} | {plain:.2f} | {ratio:.2f} |", ratio


def main() -> None:
    """Measure and print a table, and the scenes beyond the aim."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=3, metavar="N", help="counted calls of each (default: 3)")
    parser.add_argument(
        "--only", nargs="+", default=[""], metavar="TEXT", help="scenes whose names contain any of these"
    )
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| scene | taken | default, s | sampled channels, s | sum, s | ratio |\n" + "|---" * 6 + "|")
    ratios = []
    for case in CASES:
        if any(text in case.name for text in options.only):
            text, ratio = row(case, options.repeat)
            ratios.append(ratio)
            print(text, flush=True)
    beyond = sum(ratio > AIM for ratio in ratios)
    print(
        f"\n{beyond} of {len(ratios)} beyond {AIM}; mean {math.exp(np.mean(np.log(ratios))):.2f}, largest {max(ratios):.2f}"
    )


if __name__ == "__main__":
    main()
