"""Measure the processor time of the rendering methods, and write `clsim/render/methods/costs.toml`.

Usage: python costs.py [--write]. Without --write the figures are printed beside those in use. Takes about two minutes.
"""

import argparse
import platform
import re
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import clsim
from clsim.render.channel_grid import work_at_nodes
from clsim.render.methods.costs import FILE, measured_costs
from clsim.render.opencl.channel_engine import TaperedEngine
from clsim.render.render import record

RATE, SECONDS = 192e3, 1.0
LOW, HIGH = 5, 9  # orders between which the cost of a path is taken
REPEATS = 5


def work_of(part: Any, filters: Any, until: float) -> tuple[float, ...]:
    """Return the counts of `work_at_nodes` of a part, until the end of a run, s."""
    tracks = part.plan.tracks
    pairs = [tracks.pairs[pair] for pair in part.pairs]
    counts = sum(map(len, pairs)), sum(len(p) * len(p.channels) for p in pairs), sum(len(p.channels) for p in pairs)
    return work_at_nodes(filters, counts, part.spacing, tracks.longest_delay(0.0, until, part.source), until)


def seconds(call: Callable[[], object]) -> float:
    """Return the median processor time of some calls, the first of which is not counted, s."""
    taken = []
    for _ in range(REPEATS + 1):
        begun = time.process_time()
        call()
        taken.append(time.process_time() - begun)
    return median(taken[1:])


def scene(signal: clsim.Signal, wall: clsim.Material) -> clsim.Scene:
    """Return a source at 6 m/s and a receiver in a room of 8 x 6 x 3 m."""
    circle = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 2.0 * np.pi / 6.0, SECONDS)
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((0.9, 0.7, 2.6)))
    return clsim.Scene(clsim.Shoebox((8.0, 6.0, 3.0), wall), clsim.Air(), [clsim.Source("s", signal, circle)], [ear])


def a_path(signal: clsim.Signal, wall: clsim.Material) -> float:
    """Return the processor time of one more path in a sample of the sum over paths, ns."""
    times, counts = [], []
    for order in (LOW, HIGH):
        paths = clsim.find_paths(scene(signal, wall), order)
        plan = clsim.plan_render(paths, RATE, narrowband=False)
        times.append(seconds(lambda plan=plan: record(plan)))
        counts.append(plan.path_count * plan.samples)
    return 1e9 * (times[1] - times[0]) / (counts[1] - counts[0])


def measured() -> dict[str, float]:
    """Return all figures, ns."""
    hard, soft = (
        clsim.Material.from_reflection(0.9),
        clsim.Material.from_absorption([10e3, 40e3, 80e3], [0.2, 0.5, 0.8]),
    )
    tone = clsim.Signal.tone(40e3, SECONDS, RATE)
    wide = clsim.Signal.chirp(20e3, 80e3, SECONDS, RATE, window="hann")
    plain, broad = a_path(tone, hard), a_path(wide, soft)
    return {
        "plain": plain,
        "wide": (broad - plain) / (60e3 / (0.5 * RATE)),
        **of_dense_scenes(),
        "stretch": a_stretch(),
    }


def a_stretch() -> float:
    """Return the processor time of a stretch of a path beside sampled channels, less that of its samples, ns."""
    room = clsim.MeshRoom.from_plan(
        [(0, 0), (6, 0), (6, 2.6), (2.8, 2.6), (2.8, 5), (0, 5)], 3.0, clsim.Material.from_reflection(0.9)
    )
    way = clsim.Trajectory.line((0.8, 0.9, 1.4), (2.6, 1.7, 1.4), 4.0)
    source = clsim.Source("s", clsim.Signal.noise(4.0, 16e3, 1, (100.0, 6500.0)), way)
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((1.2, 4.1, 1.2)))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [ear]), 10)
    plan = clsim.plan_render(paths, 16e3, channels=True, narrowband=False, duration=4.0)
    (part,) = plan.allocation.beside
    rows, filters = part.plan.tracks.pairs[0], plan.source_filters[0]
    samples = 16e3 * float(np.sum(np.clip(rows.end, 0.0, 4.0) - np.clip(rows.start, 0.0, 4.0)))
    taken = 1e9 * seconds(lambda: TaperedEngine(part.plan).render(0, plan.samples))
    return max(taken - filters.cost() * samples, 0.0) / len(rows)


def dense(order: int, rate: float, speed: float, *, by_frequency: bool) -> clsim.PathSet:
    """Return the paths of a wide band to four receivers, in a box of 6 x 5 x 3 m."""
    table = clsim.Material.from_absorption([125, 500, 2e3, 8e3], [0.1, 0.15, 0.2, 0.3])
    seconds = 32e3 / rate
    way = clsim.Trajectory.circle((2.5, 2.5, 1.4), 1.0, 2.0 * np.pi / speed, seconds)
    source = clsim.Source("s", clsim.Signal.noise(seconds, rate, 1, (0.01 * rate, 0.4 * rate)), way)
    walls = table if by_frequency else clsim.Material.from_reflection(0.9)
    ears = clsim.receiver_array("r", [(4.9, 0.8 + 0.1 * i, 1.2) for i in range(4)])
    return clsim.find_paths(clsim.Scene(clsim.Shoebox((6.0, 5.0, 3.0), walls), clsim.Air(), [source], ears), order)


def of_dense_scenes() -> dict[str, float]:
    """Return figures of the sum over paths by its filters, and of sampled channels, fitted to some scenes, ns."""
    sums, channels = [], []
    for order, rate, speed, by_frequency, responses in [
        (6, 16e3, 1.0, False, "centre"), (12, 16e3, 1.0, False, "centre"), (4, 16e3, 1.0, True, "band"),
        (12, 16e3, 1.0, True, "band"), (10, 16e3, 0.25, True, "band"), (6, 192e3, 1.0, False, "band"),
        (12, 192e3, 0.5, False, "centre"),
    ]:  # fmt: skip
        paths, options = (
            dense(order, rate, speed, by_frequency=by_frequency),
            {"responses": responses, "duration": 32e3 / rate},
        )
        plan = clsim.plan_render(paths, rate, channels=True, **options)
        plain = clsim.plan_render(paths, rate, channels=False, narrowband=False, **options)
        filters = plan.source_filters[0]
        (part,) = plan.allocation.channels
        channels.append((seconds(lambda plan=plan: record(plan)), *work_of(part, filters, plan.duration)))
        path_samples = plain.path_count * plain.samples
        sums.append(
            (
                seconds(lambda plain=plain: record(plain)),
                plain.path_count * plain.duration * (-(-len(filters.basis.nodes) // 8)) ** 2,
                path_samples * len(filters.basis),
            )
        )
    return dict(zip(("second", "function"), fitted(sums), strict=True)) | dict(
        zip(("channel_path", "channel_function", "channel_point", "channel_nodes"), fitted(channels), strict=True)
    )


def fitted(rows: list[tuple[float, ...]]) -> list[float]:
    """Return the costs, ns, that explain times, s, by counts and a cost of each call: least relative error, none below 0."""
    from scipy.optimize import nnls

    table = np.array(rows)
    counts = np.column_stack([table[:, 1:], np.ones(len(table))])
    return (1e9 * nnls(counts / table[:, :1], np.ones(len(table)))[0][:-1]).tolist()


def processor() -> str:
    """Return the name of the processor."""
    try:
        found = re.search(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text("utf-8"), re.MULTILINE)
    except OSError:
        found = None
    return found[1] if found else platform.processor()


def main() -> None:
    """Measure, print, and write if that is requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"write {FILE.name}")
    options = parser.parse_args()
    figures, text = measured(), FILE.read_text("utf-8")
    for name, value in figures.items():
        print(f"{name:10} {value:12.3g} ns, in use {getattr(measured_costs(), name):.3g}")
        text = re.sub(rf"(?m)^{name} = [^#]*", f"{name} = {value:.3g} ".ljust(25), text)
    text = re.sub(r"(?m)^date = .*$", f'date = "{datetime.now(UTC).date()}"', text)
    device = clsim.list_devices()[0].name
    text = re.sub(r"(?m)^processor = .*$", f'processor = "{processor()}, {device}"', text)
    if options.write:
        FILE.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
