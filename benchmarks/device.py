"""All rates of one device with one command, and a roofline: what a card of given bandwidth and rates could reach.

Usage: device.py [DEVICE] [--bandwidth GB/s --float32 GFLOP/s --float64 GFLOP/s] [--order N] [--duration S]; writes device.md.
       device.py --count; writes device_counts.json, for which Oclgrind must be installed.
Measured are processor time and time on the wall of the stages; what is predicted is marked as such. Operations and bytes are
counted in the kernels as they run: Oclgrind, a simulator, tells how often every instruction was carried out.
"""

import argparse
import dataclasses
import json
import platform
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

import clsim
from clsim.opencl import device as device_module
from clsim.opencl.launch import Compiler
from clsim.render.opencl import engine as engine_module
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.plan import Plan
from clsim.render.planning import plan_render

HERE = Path(__file__).parent
RATE = 192e3
CARDS = {  # bandwidth in GB/s, float32 and float64 in GFLOP/s, as vendors state them
    "laptop, integrated": (60, 1_500, 0),
    "graphics card of the middle": (450, 20_000, 310),
    "data-centre card": (2_000, 19_500, 9_700),
}


def scene(duration: float, kind: str) -> clsim.Scene:
    """Return a box with a source at 6 m/s and a receiver at rest; walls by frequency, or not."""
    signal = clsim.Signal.tone(40e3, duration, RATE, fade=0.01)
    walls = clsim.Material.from_reflection(0.9)
    if kind == "functions":
        signal = clsim.Signal.chirp(36e3, 44e3, duration, RATE, window="tukey")
        walls = clsim.Material.from_absorption([20e3, 40e3, 60e3], [0.1, 0.4, 0.5])
    if kind == "pulses":
        signal = clsim.Signal.pulses(
            clsim.Signal.chirp(38e3, 42e3, 1e-3, RATE, window="hann"), 0.1, max(1, int(10 * duration))
        )
    way = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 1.047, duration + 0.2)
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))
    return clsim.Scene(clsim.Shoebox((8.0, 6.0, 3.0), walls), clsim.Air(), [clsim.Source("s", signal, way)], [ear])


class Stages:
    """Seconds of every kernel, and of the calls as a whole, on the wall and of the processor."""

    def __init__(self, plan: Plan) -> None:
        engine, self.kernels = OpenclEngine(plan), {}
        engine.render(0, plan.samples)  # builds
        self.wall, self.processor = self._timed(engine, plan)
        original = Compiler.kernel
        Compiler.kernel = lambda compiler, program, constants: self._one(
            program, original(compiler, program, constants)
        )
        try:
            OpenclEngine(plan).render(0, plan.samples)
        finally:
            Compiler.kernel = original

    def _timed(self, engine: OpenclEngine, plan: Plan) -> tuple[float, float]:
        spent = []
        for _ in range(3):
            begun = time.perf_counter(), time.process_time()
            engine.render(0, plan.samples)
            spent.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
        return tuple(statistics.median(column) for column in zip(*spent, strict=True))

    def _one(self, program: str, launch: object) -> object:
        def call(queue: object, items: tuple, **arguments: object) -> object:
            queue.finish()
            begun = time.process_time() if self.on_host else time.perf_counter()
            event = launch(queue, items, **arguments)
            queue.finish()
            now = time.process_time() if self.on_host else time.perf_counter()
            self.kernels[program] = self.kernels.get(program, 0.0) + now - begun
            return event

        return call

    on_host = False  # whether the device is the processor, whose time other work on the machine changes less


COUNTED = """
import sys, warnings
warnings.simplefilter("ignore")
sys.path.insert(0, {here!r})
import clsim, dataclasses
from device import RATE, scene
from clsim.opencl.launch import Compiler
from clsim.render.opencl.engine import GPU_LAYOUT, OpenclEngine
from clsim.render.planning import BUILDERS, plan_render
kind, samples = {kind!r}, {samples}
more = {{"responses": "centre"}} if kind == "tone" else {{}}
paths = clsim.find_paths(scene(0.3, kind), 3)
plan = plan_render(paths, RATE, device="Oclgrind", duration=(18432 + samples) / RATE, **more)
plan = dataclasses.replace(plan, blocks=(768,), builders=BUILDERS)
original, left_out = Compiler.kernel, {{"emit", "branches"}} | ({{"render"}} if samples == 18432 else set())

def kernel(compiler, program, constants):
    return (lambda *_, **__: None) if program in left_out else original(compiler, program, constants)

Compiler.kernel = kernel
OpenclEngine(plan, GPU_LAYOUT).render(18432, 18432 + samples)
"""


def executed(kind: str, samples: int, kernel: str) -> dict[str, tuple[int, int]]:
    """Return the counts of a kernel's instructions for 64 paths, and the bytes that they moved."""
    program = COUNTED.format(here=str(HERE), kind=kind, samples=samples)
    command = ["oclgrind", "--inst-counts", "--build-options", "-O0", sys.executable, "-c", program]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    part = told.partition(f"kernel '{kernel}'")[2].partition("Instructions executed")[0]
    rows = re.findall(r"^\s*([\d,]+) - (.*?)(?: \(([\d,]+) bytes\))?$", part, re.MULTILINE)
    return {name: (int(n.replace(",", "")), int((size or "0").replace(",", ""))) for n, name, size in rows}


def count() -> None:
    """Count operations and bytes of a path-sample in the sum, and in tracks over a segment, and write them."""
    found = {}
    for kind in ("tone", "functions"):
        made = {}
        for stage, samples, kernel in (("render", 768, "render"), ("tracks", 18432, "tracks")):
            rows, work = executed(kind, samples, kernel), 64 * samples
            fused = dict.fromkeys(("32", "64"), 0)
            for name, (times, _) in rows.items():
                if is_fused := re.fullmatch(r"call llvm\.fmuladd\.(?:v(\d+))?f(32|64)\(\)", name):
                    fused[is_fused[2]] += 2 * times * int(is_fused[1] or 1)
            single = sum(rows.get(name, (0, 0))[0] for name in ("fadd", "fsub", "fmul", "fdiv", "fneg", "fcmp"))
            wide = stage == "tracks"  # whose sums and products outside of fused ones are nearly all in float64
            made[stage] = {
                "float32": (fused["32"] + (0 if wide else single)) / work,
                "float64": (fused["64"] + (single if wide else 0)) / work,
                "loaded": rows["load global"][1] / work, "stored": rows["store global"][1] / work,
            }  # fmt: skip
        found[kind] = made
        (HERE / "device_counts.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")


@dataclasses.dataclass
class Cost:
    """Bytes and operations of a path-sample in each stage, as counted."""

    render_operations: float
    render_loaded: float  # most of it from cache
    render_bytes: float
    tracks_float32: float
    tracks_float64: float
    tracks_bytes: float

    @classmethod
    def of(cls, plan: Plan, counts: dict[str, dict[str, float]]) -> "Cost":
        """Return those of a plan's first source, in blocks of 768 samples.

        Branch signals are shared by the paths of a tile and of other tiles, polynomials by the subblocks of a block: what comes
        from memory is each of them once, branch signals once for every tile of 128 paths.
        """
        filters, block = plan.source_filters[0], 768
        node_bytes = plan.bytes_per_node(0)
        render, tracks = counts["render"], counts["tracks"]
        memory = node_bytes / block + 4.0 * int(filters.rows[-1]) / 128.0
        return cls(
            render["float32"], render["loaded"], memory, tracks["float32"], tracks["float64"],
            tracks["loaded"] + tracks["stored"],
        )  # fmt: skip

    def predicted(self, bandwidth: float, float32: float, float64: float) -> tuple[float, float | None]:
        """Return path-samples a second of render and tracks by the roofline, for GB/s and GFLOP/s."""
        render = min(float32 * 1e9 / self.render_operations, bandwidth * 1e9 / self.render_bytes)
        if float64 == 0:
            return render, None
        seconds = self.tracks_float32 / (float32 * 1e9) + self.tracks_float64 / (float64 * 1e9)
        return render, min(1.0 / seconds, bandwidth * 1e9 / self.tracks_bytes)


def without_float64(plan: Plan, in_pairs: bool) -> float:
    """Return the processor seconds of a call without float64, with the tracks made of pairs of floats or by the host."""
    found, programs = device_module.find_device, engine_module.PAIR_PROGRAMS

    def hidden(wanted: str | None) -> tuple:
        info, handle = found(wanted)
        return dataclasses.replace(info, fp64=False), handle

    engine_module.find_device, engine_module.PAIR_PROGRAMS = hidden, programs if in_pairs else {}
    try:
        return Stages(plan).processor
    finally:
        engine_module.find_device, engine_module.PAIR_PROGRAMS = found, programs


def page(info: device_module.DeviceInfo, order: int, duration: float, rows: list[str], costs: dict, cards: dict) -> str:
    """Return the page: rows that were measured, and what the roofline predicts for cards."""
    clock = "processor time" if info.kind == "CPU" else "time on the wall"
    lines = [
        f"# {info.name}", "",
        f"{info.platform}, {info.version}, driver {info.driver}; {info.compute_units} units, {info.memory_bytes / 2**30:.1f} GiB; "
        f"{platform.system()} {platform.machine()}. Order {order}, {duration:g} s, {RATE / 1e3:g} kHz. Path-samples/s in {clock}.",
        "", "| signal | functions | whole call | render | tracks | branch signals, s | without float64: in pairs, by the host |",
        "|---|---|---|---|---|---|---|", *rows,
        "", "## Roofline: predictions, not measured", "",
        "Operations and loads are counted: Oclgrind carried the kernels out, in the layout for GPUs, for 64 paths, and told how often",
        "every instruction ran (a fused product and sum is two; other instructions on vectors count once). Of what render loads",
        "most comes from caches; what must come from memory is reckoned: polynomials once, branch signals once for 128 paths.",
        "",
        "| signal | render: operations, bytes loaded, bytes from memory of a path-sample | tracks: float32, float64 operations, bytes |",
        "|---|---|---|",
    ]  # fmt: skip
    for kind, c in costs.items():
        lines.append(
            f"| {kind} | {c.render_operations:.0f}, {c.render_loaded:.0f}, {c.render_bytes:.2f} | "
            f"{c.tracks_float32:.2g}, {c.tracks_float64:.2g}, {c.tracks_bytes:.2g} |"
        )
    lines += [
        "",
        "| card (GB/s, GFLOP/s in float32 and float64) | signal | render, at most | tracks, at most |",
        "|---|---|---|---|",
    ]
    for name, card in cards.items():
        for kind, cost in costs.items():
            render, tracks = cost.predicted(*card)
            told = "in pairs of floats" if tracks is None else f"{tracks:.2g} (predicted)"
            lines.append(
                f"| {name} ({card[0]:g}, {card[1]:g}, {card[2]:g}) | {kind} | {render:.2g} (predicted) | {told} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Count; or measure, predict and write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("device", nargs="?")
    parser.add_argument("--bandwidth", type=float)
    parser.add_argument("--float32", type=float)
    parser.add_argument("--float64", type=float, default=0.0)
    parser.add_argument("--order", type=int, default=6)
    parser.add_argument("--duration", type=float, default=1.0)
    parser.add_argument("--count", action="store_true")
    options = parser.parse_args()
    if options.count:
        return count()
    file = HERE / "device_counts.json"
    counts = json.loads(file.read_text("utf-8")) if file.exists() else {}
    info, _ = device_module.find_device(options.device)
    Stages.on_host = info.kind == "CPU"
    rows, costs = [], {}
    for kind in ("tone", "functions", "pulses"):
        paths = clsim.find_paths(scene(options.duration, kind), options.order)
        more = {"responses": "centre"} if kind == "tone" else {}
        plan = plan_render(paths, RATE, duration=options.duration, device=info.id, **more)
        stages, work = Stages(plan), plan.path_count * plan.samples
        whole = stages.processor if Stages.on_host else stages.wall
        tracks = stages.kernels["tracks"] + stages.kernels["coarse_delays"]
        pairs, host = (without_float64(plan, way) / stages.processor for way in (True, False))
        if kind in counts:  # not of pulses, of which the cost depends on how much is silent
            costs[kind] = Cost.of(plan, counts[kind])
        rows.append(
            f"| {kind} | {len(plan.source_filters[0].basis)} | {work / whole:.2g} | {work / stages.kernels['render']:.2g} | "
            f"{work / tracks:.2g} | {stages.kernels['branches']:.3f} | {pairs:.2f}, {host:.0f} times the processor time |"
        )
        print(rows[-1], flush=True)
    cards = dict(CARDS)
    if options.bandwidth and options.float32:
        cards["as asked"] = (options.bandwidth, options.float32, options.float64)
    (HERE / "device.md").write_text(page(info, options.order, options.duration, rows, costs, cards), "utf-8")


if __name__ == "__main__":
    main()
