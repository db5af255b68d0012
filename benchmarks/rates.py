"""Rates of rendering, as ratios taken in one run. Needs a C compiler and `pip install -e '.[bench]'`.

Writes results.md and growth.png beside itself. See README.md for what is timed and what is not.
"""

import argparse
import ctypes
import math
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pyopencl as cl

import clsim
from clsim.opencl import compiler as compiler_module
from clsim.render.planning import plan_render
from clsim.render.render import render_chunks

HERE = Path(__file__).parent
RATE = 192e3
SIZE = (8.0, 6.0, 3.0)
CIRCLE = ((4.0, 3.0, 1.5), 1.0, 2 * math.pi / 6.0)  # 6 m/s
RECEIVER = (1.0, 1.0, 2.9)
REFLECTION = 0.9


def make_scene(
    duration: float, receivers: int = 1, sources: int = 1, signal: clsim.Signal | None = None
) -> clsim.Scene:
    """Return the scene of all figures: 40 kHz sources at 6 m/s, receivers at rest on a grid."""
    tone = signal or clsim.Signal.tone(40e3, duration, RATE, fade=0.01)
    way = clsim.Trajectory.circle(*CIRCLE, duration)
    room = clsim.Shoebox(SIZE, clsim.Material.from_reflection(REFLECTION))
    side = math.ceil(math.sqrt(receivers))
    places = (
        clsim.grid_positions((RECEIVER[0], 7.0, side), (RECEIVER[1], 5.0, side), RECEIVER[2])
        if side > 1
        else [RECEIVER]
    )
    ears = clsim.receiver_array("r", places[:receivers])
    return clsim.Scene(room, clsim.Air(), [clsim.Source(f"s{i}", tone, way) for i in range(sources)], ears)


class Stages:
    """Times every kernel of the engine from outside, and keeps the arguments of the last render launch."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.launch: tuple = ()

    def __enter__(self) -> "Stages":
        self._original = compiler_module.Compiler.kernel
        original, stages = self._original, self

        def kernel(compiler: object, program: str, constants: dict) -> object:
            found = original(compiler, program, constants)

            def call(queue: object, items: tuple, **arguments: object) -> object:
                queue.finish()
                begun = time.perf_counter()
                event = found(queue, items, **arguments)
                queue.finish()
                stages.seconds[program] = stages.seconds.get(program, 0.0) + time.perf_counter() - begun
                if program == "render":
                    stages.launch = (found, queue, items, arguments)
                return event

            return call

        compiler_module.Compiler.kernel = kernel
        return self

    def __exit__(self, *_: object) -> None:
        compiler_module.Compiler.kernel = self._original


def render_rates(order: int, duration: float, error_db: float = -90.0, **more: object) -> tuple[float, float, Stages]:
    """Return path-samples per second of the render stage and of the whole call."""
    scene = make_scene(duration, **more)
    paths = clsim.find_paths(scene, order)
    options = {"interpolator": clsim.Bandlimited(error_db), "duration": duration, "responses": "centre"}
    clsim.render(paths, RATE, **options)  # builds the kernels
    spent = []
    for _ in range(3):
        begun = time.perf_counter()
        clsim.render(paths, RATE, **options)
        spent.append(time.perf_counter() - begun)
    whole = statistics.median(spent)
    with Stages() as stages:
        clsim.render(paths, RATE, **options)
    work = len(paths) * duration * RATE
    return work / stages.seconds["render"], work / whole, stages


class PlainLoop:
    """The C loop on the arguments of a render launch."""

    def __init__(self, launch: tuple, folder: Path) -> None:
        self._kernel, self._queue, self._items, self._arguments = launch
        given = self._arguments
        assert given["first_block"] == given["first_row"][0] == 0
        assert given["functions"] == 1
        self.samples = int(given["subblocks"]) * 32
        self._begin = int(given["first_sample"])
        kinds = {"branches": np.float32, "delay": np.int32, "polynomials": np.float32, "first_slot": np.int32}
        host = [np.empty(given[name].size // 4, dtype) for name, dtype in kinds.items()]
        for array, name in zip(host, kinds, strict=True):
            cl.enqueue_copy(self._queue, array, given[name])
        self._host, self._pressure = host, given["pressure"]
        library = folder / "plain_loop.so"
        flags = ["-O3", "-march=native", "-ffast-math", "-funroll-loops", "-shared", "-fPIC"]
        subprocess.run(["cc", *flags, "-o", library, HERE / "plain_loop.c"], check=True)
        self._render = ctypes.CDLL(str(library)).render
        self.slots, stride = int(given["slots"]), int(given["stride"])
        blocks = (int(given["block_subblocks"]), int(given["subblocks"]))
        self._numbers = (stride, len(host[0]) // stride, int(given["lead"]), *blocks)

    def run(self, threads: int) -> tuple[float, np.ndarray]:
        """Return seconds and pressure."""
        stride, rows, lead, block_subblocks, subblocks = self._numbers
        out = np.zeros(self.samples, np.float32)
        branches, delay, cubics, _ = (ctypes.c_void_p(a.ctypes.data) for a in self._host)

        def part(i: int) -> None:
            self._render(branches, ctypes.c_long(stride), rows, ctypes.c_long(lead), delay, cubics, self.slots, self.slots,
                         block_subblocks, subblocks * i // threads, subblocks * (i + 1) // threads,
                         ctypes.c_void_p(out.ctypes.data))  # fmt: skip

        workers = [threading.Thread(target=part, args=(i,)) for i in range(threads)]
        begun = time.perf_counter()
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        return time.perf_counter() - begun, out

    def kernel(self) -> tuple[float, np.ndarray]:
        """Return seconds and pressure of the OpenCL kernel on the same arguments."""
        zero = np.zeros(self._pressure.size // 4, np.float32)
        cl.enqueue_copy(self._queue, self._pressure, zero)
        self._queue.finish()
        begun = time.perf_counter()
        self._kernel(self._queue, self._items, **self._arguments)
        self._queue.finish()
        spent = time.perf_counter() - begun
        cl.enqueue_copy(self._queue, zero, self._pressure)
        return spent, zero[self._begin : self._begin + self.samples]


def numba_rate(order: int) -> float:
    """Return path-samples per second of a Numba loop: emission time solved, 13 Lagrange taps, per path and sample.

    Its source moves along a straight line, which spares it sines; taps are barycentric, which LLVM vectorises.
    """
    import numba

    scene = make_scene(1.0)
    paths = clsim.find_paths(scene, order)
    images = paths.families[0]
    matrix, offset = images.image_matrix.astype(np.float32), images.image_offset.astype(np.float32)
    gain = REFLECTION ** paths.order.astype(np.float32)
    margin = 200_000
    signal = scene.sources[0].signal.read(-margin, int(RATE) + margin).astype(np.float32)
    weight = np.array([1 / math.prod(k - j for j in range(13) if j != k) for k in range(13)], np.float32)
    c = np.float32(343.994)
    one, speed = np.float32(1.0), np.float32(6.0)

    @numba.njit(parallel=True, fastmath=True)
    def loop(first: int, count: int) -> np.ndarray:
        out = np.zeros(count, np.float32)
        for n in numba.prange(count):
            t = np.float32((first + n) / RATE)
            total = np.float32(0.0)
            for p in range(len(gain)):
                delay, distance = np.float32(0.03), np.float32(0.0)
                for _ in range(3):
                    x = np.float32(1.5) + speed * (t - delay)
                    dx = matrix[p, 0, 0] * x + offset[p, 0] - one
                    dy = matrix[p, 1, 1] * np.float32(3.0) + offset[p, 1] - one
                    dz = matrix[p, 2, 2] * np.float32(1.5) + offset[p, 2] - np.float32(2.9)
                    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
                    delay = distance / c
                late = delay * np.float32(RATE)
                whole = int(late + np.float32(0.5))
                f = late - np.float32(whole) + np.float32(6.000001)
                value, product = np.float32(0.0), one
                start = margin + first + n - whole + 6
                for k in range(13):
                    rest = f - np.float32(k)
                    product *= rest
                    value += signal[start - k] * weight[k] / rest
                value *= product
                total += gain[p] / distance * value
            out[n] = total
        return out

    loop(100_000, 64)
    count = max(256, int(4e6 / len(gain)))
    begun = time.perf_counter()
    loop(100_000, count)
    return len(gain) * count / (time.perf_counter() - begun)


def crossfade_error_db(responses: int) -> float:
    """Return the error of crossfading ideal impulse responses, `responses` a second, at order 2 and 6 m/s."""
    scene = make_scene(0.1)
    paths = clsim.find_paths(scene, 2)
    n = np.arange(int(0.09 * RATE), int(0.09 * RATE) + 2000)
    t = n / RATE
    keys = np.arange(math.floor(t[0] * responses), math.ceil(t[-1] * responses) + 2) / responses

    def tone(times: np.ndarray) -> np.ndarray:
        return np.sin(2 * np.pi * 40e3 * times)

    def at(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        table = paths.table(times, motion="quasi-static")
        return table.delay, table.gain

    delay, gain = at(t)
    exact = np.sum(gain * tone(t - delay), axis=0)
    delay, gain = at(keys)
    k = np.clip(np.searchsorted(keys, t, side="right") - 1, 0, len(keys) - 2)
    w = (t - keys[k]) * responses
    faded = np.sum(
        (1 - w) * gain[:, k] * tone(t - delay[:, k]) + w * gain[:, k + 1] * tone(t - delay[:, k + 1]), axis=0
    )
    return float(20 * np.log10(np.linalg.norm(faded - exact) / np.linalg.norm(exact)))


def crossfade_rate(order: int, responses: int) -> float:
    """Return path-samples per second of pyroomacoustics responses, computed and convolved `responses` times a second."""
    import pyroomacoustics as pra

    spent = []
    for i in range(5):
        begun = time.perf_counter()
        room = pra.ShoeBox(SIZE, fs=int(RATE), materials=pra.Material(1 - REFLECTION**2), max_order=order)
        room.add_source([4.0 + math.cos(i), 3.0 + math.sin(i), 1.5])
        room.add_microphone(RECEIVER)
        room.compute_rir()
        response = room.rir[0][0]
        size = 2 ** math.ceil(math.log2(len(response) + 2 * RATE / responses))
        np.fft.irfft(np.fft.rfft(response, size) * np.ones(size // 2 + 1, complex), size)
        spent.append(time.perf_counter() - begun)
    images = len(clsim.find_paths(make_scene(0.1), order))
    return images * RATE / (statistics.median(spent) * responses)


def broadband_rates() -> list[tuple[int, float, float, float]]:
    """Return, for asked errors from none to -100 dB, functions, branch signals, rate times functions, and seconds."""
    f = np.linspace(10e3, 90e3, 81)
    walls = [
        0.97 - 0.2 * (f / 80e3),
        0.8 + 0.1 * np.cos(2 * np.pi * f / 60e3),
        0.95 - 0.3 * np.exp(-(((f - 45e3) / 15e3) ** 2)),
    ]
    materials = [clsim.Material.from_absorption(f, 1.0 - wall**2) for wall in walls] * 2
    chirp = clsim.Signal.chirp(30e3, 50e3, 2.0, RATE, window="tukey")
    source = clsim.Source("s", chirp, clsim.Trajectory.circle(*CIRCLE, 2.0), clsim.Piston(0.0047), aim=(1, 0.4, 0.2))
    receivers = [clsim.Receiver("r", clsim.Trajectory.fixed(RECEIVER))]
    scene = clsim.Scene(clsim.Shoebox(SIZE, materials), clsim.Air(), [source], receivers)
    paths = clsim.find_paths(scene, 10)
    found = []
    for error_db in (None, -40.0, -48.0, -55.0, -62.0, -70.0, -80.0, -100.0):
        plan = plan_render(paths, RATE, duration=2.0, **held_within(error_db))
        list(render_chunks(plan))  # builds the kernels
        seconds = []
        for _ in range(3):
            with Stages() as stages:
                list(render_chunks(plan))
            seconds.append(stages.seconds["render"])
        filters, spent = plan.source_filters[0], statistics.median(seconds)
        functions = len(filters.basis)
        found.append((functions, int(filters.rows[-1]), len(paths) * 2.0 * RATE * functions / spent, spent))
    return found


def held_within(error_db: float | None) -> dict[str, object]:
    """Return the options that hold responses within an error, dB, or as at the centre of the band."""
    return {"responses": "centre"} if error_db is None else {"response_error_db": error_db}


def pulse_rows() -> list[tuple[str, ...]]:
    """Return how much faster 1 ms pulses ten times a second are than the same with nothing left out, a row each."""
    from clsim.render.opencl import activity

    pulse = clsim.Signal.chirp(39e3, 41e3, 1e-3, RATE, window="hann")
    rows = []
    for duration, error_db in ((10.0, -80.0), (60.0, -80.0), (60.0, None)):
        scene = make_scene(duration, signal=clsim.Signal.pulses(pulse, 0.1, round(10 * duration)))
        paths = clsim.find_paths(scene, 10)

        def timed(scene=scene, paths=paths, error_db=error_db, duration=duration) -> tuple[float, np.ndarray]:
            begun = time.perf_counter()
            made = clsim.render(paths, RATE, duration=duration, **held_within(error_db)).pressure
            return time.perf_counter() - begun, made

        timed()  # builds the kernels
        sparse = [timed() for _ in range(4)]
        usual, activity._SPARSE = activity._SPARSE, 0.0  # nothing is worth leaving out
        try:
            clsim.render(paths, RATE, duration=0.1, **held_within(error_db))  # builds the kernels
            dense, whole = timed()
        finally:
            activity._SPARSE = usual
        assert np.array_equal(sparse[0][1], whole)
        sparse += [timed() for _ in range(4)]  # before and after: the machine's own pace changes
        spent = statistics.median(seconds for seconds, _ in sparse)
        functions = len(plan_render(paths, RATE, duration=duration, **held_within(error_db)).source_filters[0].basis)
        rows.append((f"{duration:g} s", f"{functions}", f"{dense:.2f} s", f"{spent:.2f} s", f"{dense / spent:.1f}"))
    return rows


def growth() -> dict[str, list[tuple[float, float]]]:
    """Return how the whole call's rate grows with paths, duration, receivers, sources, branches and cores."""
    names = ("paths", "duration (s)", "receivers", "sources", "branches", "cores")
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for order in (2, 4, 6, 8, 10, 14):
        found["paths"].append((len(clsim.find_paths(make_scene(1.0), order)), render_rates(order, 1.0)[1]))
    for duration in (0.25, 1.0, 4.0, 10.0):
        found["duration (s)"].append((duration, render_rates(10, duration)[1]))
    for receivers in (1, 10, 100, 1000):
        found["receivers"].append((receivers, render_rates(3, 1.0, receivers=receivers)[1]))
    for sources in (1, 2, 4, 8):
        found["sources"].append((sources, render_rates(8, 1.0, sources=sources)[1]))
    for error_db in (-40.0, -60.0, -80.0, -90.0, -110.0):
        scene = make_scene(1.0)
        plan = plan_render(clsim.find_paths(scene, 1), RATE, interpolator=clsim.Bandlimited(error_db))
        found["branches"].append((len(plan.source_filters[0].bank.taps), render_rates(10, 1.0, error_db)[1]))
    for cores in range(1, (os.cpu_count() or 1) + 1):
        environment = os.environ | {"POCL_MAX_PTHREAD_COUNT": str(cores)}
        command = [sys.executable, __file__, "--one-rate"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        found["cores"].append((cores, float(done.stdout.split()[-1])))
    return found


def draw(found: dict[str, list[tuple[float, float]]], path: Path) -> None:
    """Draw the growth, a panel each."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 6), layout="constrained")
    for axes, (name, points) in zip(figure.subplots(2, 4).flat, found.items(), strict=False):
        axes.plot(*zip(*points, strict=True), "o-")
        axes.set(xlabel=name, ylim=(0, None), xscale="log" if name in ("receivers", "paths") else "linear")
        axes.grid(alpha=0.3)
    for row in (0, 4):
        figure.axes[row].set_ylabel("path-samples/s, whole call")
    figure.axes[-1].set_visible(False)
    figure.savefig(path, dpi=80)


def main() -> None:
    """Measure, print, and write results.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one-rate", action="store_true", help="print the whole call's rate at order 10 and end")
    if parser.parse_args().one_rate:
        print(render_rates(10, 2.0)[1])
        return
    runs = [render_rates(10, 10.0) for _ in range(2)]
    stage, whole = (statistics.median(run[i] for run in runs) for i in (0, 1))
    shares = [run[1] / run[0] for run in runs]
    with tempfile.TemporaryDirectory() as folder:
        loop = PlainLoop(runs[-1][2].launch, Path(folder))
        cores = os.cpu_count() or 1
        pairs = [(loop.kernel(), loop.run(cores)) for _ in range(9)]
    (_, by_kernel), (_, by_loop) = pairs[-1]
    apart_db = 20 * math.log10(np.linalg.norm(by_kernel - by_loop) / np.linalg.norm(by_loop))
    against_loop = statistics.median(b[0] / a[0] for a, b in pairs)
    numba = statistics.median(numba_rate(10) for _ in range(3))
    responses = 9600
    faded_db, faded = crossfade_error_db(responses), crossfade_rate(10, responses)
    coarse_db = crossfade_error_db(1000)
    rows = [
        ("render stage", f"{stage / 1e9:.2f}e9 path-samples/s", ""),
        ("whole call, 10 s of signal", f"{whole / 1e9:.2f}e9", f"{statistics.median(shares):.2f} of the render stage"),
        ("plain C loop, same nodes, all cores", f"{loop.samples * loop.slots / pairs[-1][1][0] / 1e9:.2f}e9",
         f"kernel is {against_loop:.2f} times as fast; outputs differ by {apart_db:.0f} dB"),
        ("Numba, emission time and 13 taps per path and sample", f"{numba / 1e9:.4f}e9", f"render stage {stage / numba:.0f} times as fast"),
        (f"crossfaded pyroomacoustics responses, {responses} a second", f"{faded / 1e9:.6f}e9",
         f"whole call {whole / faded:.0f} times as fast; their error is {faded_db:.0f} dB (1000 a second: {coarse_db:.0f} dB)"),
    ]  # fmt: skip
    text = "| | rate | ratio |\n|---|---|---|\n" + "".join(f"| {a} | {b} | {c} |\n" for a, b, c in rows)
    text += "\n| pulses of 1 ms every 0.1 s | functions | nothing left out | silence left out | ratio |\n|---|---|---|---|---|\n"
    text += "".join(f"| {' | '.join(row)} |\n" for row in pulse_rows())
    print(text)
    found, broadband = growth(), broadband_rates()
    draw(found | {"functions (rate x functions)": [(k, rate) for k, _, rate, _ in broadband]}, HERE / "growth.png")
    many, one = found["receivers"][-1][1], found["receivers"][0][1]
    text += f"\n1000 receivers, order 3, 1 s: {many / one:.2f} of the rate of one receiver\n"
    for name, points in found.items():
        text += f"\nWhole call by {name}: " + ", ".join(f"{x:g}: {y / 1e9:.2f}e9" for x, y in points) + "\n"
    text += "\n| functions of frequency | branch signals | rate x functions | of one function's | time, of one function's |\n|---|---|---|---|---|\n"
    for functions, rows_, rate, spent in broadband:
        share, slower = rate / broadband[0][2], spent / broadband[0][3]
        text += f"| {functions} | {rows_} | {rate / 1e9:.2f}e9 | {share:.2f} | {slower:.2f} |\n"
    (HERE / "results.md").write_text(text)
    print(HERE / "results.md")


if __name__ == "__main__":
    main()
