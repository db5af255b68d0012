"""How long a rendering takes against paths, receivers and duration, and against other programs: one page in one run.

Usage: compare.py [--busy]; draws compare.png and writes the table into README.md beside itself, some three minutes. Needs a C
compiler and `pip install -e '.[bench]'`; what is not installed is said in the table. `--busy` says that other work ran.
"""

import argparse
import ctypes
import importlib.util
import math
import os
import platform
import statistics
import subprocess
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyopencl as cl

import clsim
from clsim.opencl.device import find_device
from clsim.opencl.launch import Compiler

HERE = Path(__file__).parent
RATE = 192e3
SIZE = (8.0, 6.0, 3.0)
CIRCLE = ((4.0, 3.0, 1.5), 1.0, 2 * math.pi / 6.0)  # 6 m/s
EAR = (1.0, 1.0, 2.9)
REFLECTION = 0.9
RESPONSES = 9600  # room impulse responses a second
ORDERS, EARS, DURATIONS = (1, 2, 4, 6, 8, 10), (1, 4, 16, 64), (0.25, 1.0, 4.0, 10.0)
UP = 16  # times the sampling rate at which Acoular reads the signal
BEGIN, END = "<!-- written by compare.py -->", "<!-- end -->"
BY_PATHS, BY_EARS, BY_TIME = "paths (1 s, one receiver)", "receivers (order 3, 1 s)", "duration, s (order 6)"

Row = tuple[str, ...]
Panels = dict[str, dict[str, list[tuple[float, float]]]]  # lines of the plots: seconds against something


def make_scene(duration: float, receivers: int = 1, room: bool = True) -> clsim.Scene:
    """Return the scene of all figures: a 40 kHz source at 6 m/s, receivers at rest on a grid."""
    tone = clsim.Signal.tone(40e3, duration, RATE, fade=0.01)
    walls = clsim.Material.from_reflection(REFLECTION)
    side = math.ceil(math.sqrt(receivers))
    places = clsim.grid_positions((1.0, 7.0, side), (1.0, 5.0, side), EAR[2])[:receivers] if side > 1 else [EAR]
    source = clsim.Source("s", tone, clsim.Trajectory.circle(*CIRCLE, duration))
    return clsim.Scene(clsim.Shoebox(SIZE, walls), clsim.Air(), [source], clsim.receiver_array("r", places))


def timed(call: Callable[[], object], repeats: int = 3) -> float:
    """Return the median of the seconds that a call takes, after one that is not counted."""
    call()
    spent = []
    for _ in range(repeats):
        begun = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begun)
    return statistics.median(spent)


def ours(order: int, duration: float = 1.0, receivers: int = 1) -> tuple[int, float]:
    """Return paths of a receiver and seconds of `clsim.render`, plan and transfers included."""
    paths = clsim.find_paths(make_scene(duration, receivers), order)
    return len(paths) // receivers, timed(lambda: clsim.render(paths, RATE, duration=duration, responses="centre"))


class Kernel:
    """The last launch of the kernel that sums paths, and the same sum by a plain loop in C, on all cores."""

    def __init__(self, folder: Path, paths: clsim.PathSet, duration: float, rate: float = RATE) -> None:
        original, kept = Compiler.kernel, []

        def kernel(compiler: Compiler, program: str, constants: dict) -> object:
            launch = original(compiler, program, constants)

            def call(queue: object, items: tuple, **arguments: object) -> object:
                if program == "render":
                    kept[:] = [launch, queue, items, arguments]
                return launch(queue, items, **arguments)

            return call

        Compiler.kernel = kernel
        try:
            clsim.render(paths, rate, duration=duration, responses="centre", narrowband=False, channels=False)
        finally:
            Compiler.kernel = original
        self._launch, self._queue, self._items, given = kept
        self._given = given
        kinds = {"branches": np.float32, "delay": np.int32, "polynomials": np.float32}
        self._host = [np.empty(given[name].size // 4, kind) for name, kind in kinds.items()]
        for array, name in zip(self._host, kinds, strict=True):
            cl.enqueue_copy(self._queue, array, given[name])
        # One function: eight numbers a block and path, of eight neighbouring paths side by side; the loop has all paths so.
        slots, first = int(given["slots"]), int(given["first_block"])
        cubics = self._host[2][: len(self._host[2]) // (8 * slots) * 8 * slots].reshape(-1, slots // 8, 8, 8)[first:]
        self._host[1:] = [self._host[1][first * slots :], np.ascontiguousarray(cubics.swapaxes(1, 2))]
        library = folder / "plain_loop.so"
        flags = ["-O3", "-march=native", "-ffast-math", "-funroll-loops", "-shared", "-fPIC"]
        subprocess.run(["cc", *flags, "-o", library, HERE / "plain_loop.c"], check=True)
        self._loop = ctypes.CDLL(str(library)).render
        self.samples, self.slots = int(given["subblocks"]) * 32, slots

    def plain(self) -> np.ndarray:
        """Return the pressure of the loop in C."""
        given, threads = self._given, os.cpu_count() or 1
        stride, blocks = int(given["stride"]), int(given["subblocks"])
        out = np.zeros(self.samples, np.float32)
        branches, delay, cubics = (ctypes.c_void_p(a.ctypes.data) for a in self._host)
        slots = int(given["slots"])

        def part(i: int) -> None:
            self._loop(
                branches, ctypes.c_long(stride), int(given["first_row"][-1]), ctypes.c_long(int(given["lead"])), delay,
                cubics, slots, slots, int(given["block_subblocks"]), blocks * i // threads,
                blocks * (i + 1) // threads, ctypes.c_void_p(out.ctypes.data),
            )  # fmt: skip

        workers = [threading.Thread(target=part, args=(i,)) for i in range(threads)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        return out

    def opencl(self) -> np.ndarray:
        """Return the pressure of the kernel."""
        pressure = self._given["pressure"]
        out = np.zeros(pressure.size // 4, np.float32)
        cl.enqueue_copy(self._queue, pressure, out)
        self._launch(self._queue, self._items, **self._given)
        self._queue.finish()
        cl.enqueue_copy(self._queue, out, pressure)
        return out[int(self._given["first_sample"]) :][: self.samples]


def numba_loop(margin: int) -> Callable[..., np.ndarray]:
    """Return a function from images (P, 3, 3) and (P, 3) with gains (P,) to samples.

    In float32, on all cores: the time of emission by three iterations, and 13 barycentric Lagrange taps, for every path and
    sample. Its source moves along a straight line, which spares it sines; its signal begins so many samples late.
    """
    import numba

    weight = np.array([1 / math.prod(k - j for j in range(13) if j != k) for k in range(13)], np.float32)
    c, one, speed = np.float32(343.994), np.float32(1.0), np.float32(6.0)
    signal = make_scene(1.0).sources[0].signal.read(-margin, int(RATE) + margin).astype(np.float32)

    @numba.njit(parallel=True, fastmath=True)
    def loop(matrix: np.ndarray, offset: np.ndarray, gain: np.ndarray, first: int, count: int) -> np.ndarray:
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
                total += gain[p] / distance * value * product
            out[n] = total
        return out

    return loop


def numba_seconds() -> Callable[[int], float]:
    """Return a function that extrapolates the seconds of a Numba loop for an order, 1 s and one receiver from some samples."""
    loop = numba_loop(200_000)

    def seconds(order: int) -> float:
        images = clsim.find_paths(make_scene(1.0), order).families[0]
        matrix, offset = images.legs[0].matrix.astype(np.float32), images.legs[0].offset.astype(np.float32)
        gain = REFLECTION ** images.order.astype(np.float32)
        count = min(max(256, int(4e6 / len(gain))), int(RATE))  # the signal is there for a second
        return timed(lambda: loop(matrix, offset, gain, 100_000, count)) * RATE / count

    return seconds


def crossfade_seconds(order: int) -> float:
    """Return the seconds of pyroomacoustics responses, computed and convolved `RESPONSES` times for 1 s, from five of them."""
    import pyroomacoustics as pra

    spent = []
    for i in range(6):
        begun = time.perf_counter()
        room = pra.ShoeBox(SIZE, fs=int(RATE), materials=pra.Material(1 - REFLECTION**2), max_order=order)
        room.add_source([4.0 + math.cos(i), 3.0 + math.sin(i), 1.5])
        room.add_microphone(EAR)
        room.compute_rir()
        response = room.rir[0][0]
        size = 2 ** math.ceil(math.log2(len(response) + 2 * RATE / RESPONSES))
        np.fft.irfft(np.fft.rfft(response, size) * np.ones(size // 2 + 1, complex), size)
        spent.append(time.perf_counter() - begun)
    return statistics.median(spent[1:]) * RESPONSES  # the first one loads what it needs


def crossfade_error_db() -> float:
    """Return the error of crossfading *ideal* responses at that rate (order 2), dB."""
    paths = clsim.find_paths(make_scene(0.1), 2)
    t = np.arange(int(0.09 * RATE), int(0.09 * RATE) + 2000) / RATE
    keys = np.arange(math.floor(t[0] * RESPONSES), math.ceil(t[-1] * RESPONSES) + 2) / RESPONSES
    here, there = (paths.table(times, motion="quasi-static") for times in (t, keys))
    exact = np.sum(here.gain * np.sin(2 * np.pi * 40e3 * (t - here.delay)), axis=0)
    k = np.clip(np.searchsorted(keys, t, side="right") - 1, 0, len(keys) - 2)
    w = (t - keys[k]) * RESPONSES
    faded = sum(
        share * there.gain[:, i] * np.sin(2 * np.pi * 40e3 * (t - there.delay[:, i]))
        for share, i in ((1 - w, k), (w, k + 1))
    ).sum(axis=0)
    return float(20 * np.log10(np.linalg.norm(faded - exact) / np.linalg.norm(exact)))


def acoular_seconds(duration: float, receivers: int) -> float:
    """Return the seconds of Acoular for the direct sound, which is all that it computes of a moving source."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import acoular
    scene = make_scene(duration, receivers)
    told = np.linspace(0.0, duration, round(1000 * duration) + 1)
    points = {
        float(t): tuple(map(float, p)) for t, p in zip(told, scene.sources[0].trajectory.position(told), strict=True)
    }
    data = scene.sources[0].signal.read(0, round(duration * RATE))[:, None]
    ears = np.array([r.trajectory.position(0.0) for r in scene.receivers]).reshape(-1, 3).T

    def call() -> None:
        signal = acoular.GenericSignalGenerator(source=acoular.TimeSamples(data=data, sample_freq=RATE))
        source = acoular.MovingPointSource(
            signal=signal, mics=acoular.MicGeom(pos_total=ears), env=acoular.Environment(c=343.994), up=UP,
            trajectory=acoular.Trajectory(points=points), conv_amp=True,
        )  # fmt: skip
        for _ in source.result(4096):
            pass

    return timed(call, 1)


def draw(panels: Panels) -> None:
    """Draw seconds against paths, receivers and duration."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.2), layout="constrained")
    marks = {"clsim": "o-", "Numba": "s--", "pyroomacoustics": "^--", "Acoular": "d--", "clsim, direct sound": "o:"}
    for axes, (name, lines) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        for label, points in lines.items():
            colour = "C0" if label.startswith("clsim") else f"C{1 + list(PEERS).index(label.split(',')[0])}"
            axes.loglog(*zip(*points, strict=True), marks.get(label, "s--"), color=colour, label=label)
        axes.set(xlabel=name, ylabel="seconds")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=8)
    figure.savefig(HERE / "compare.png", dpi=90)


def c_loop_row() -> Row:
    """Return the table's row of the plain loop in C."""
    with tempfile.TemporaryDirectory() as folder:
        kernel = Kernel(Path(folder), clsim.find_paths(make_scene(2.0), 10), 2.0)
        ratios, apart = [], kernel.opencl() - kernel.plain()
        for _ in range(7):
            ratios.append(timed(kernel.plain, 1) / timed(kernel.opencl, 1))
        apart_db = 20 * math.log10(np.linalg.norm(apart) / np.linalg.norm(kernel.plain()))
    return (
        "plain C loop (`-O3 -march=native -ffast-math`, all cores)", "the inner sum alone, of the same numbers",
        f"{apart_db:.0f} dB apart", f"{statistics.median(ratios):.2f}, of the inner sum",
    )  # fmt: skip


def numba_row(panels: Panels) -> Row:
    """Return the table's row of the loop in Numba, and add its line to the plot against paths."""
    lines, seconds = panels[BY_PATHS], numba_seconds()
    lines["Numba"] = [(paths, seconds(order)) for (paths, _), order in zip(lines["clsim"], ORDERS, strict=True)]
    return (
        "Numba, float32, all cores", "all of it: emission time and 13 taps for every path and sample", "not measured",
        f"{lines['Numba'][-1][1] / lines['clsim'][-1][1]:.0f}",
    )  # fmt: skip


def crossfade_row(panels: Panels) -> Row:
    """Return the table's row of pyroomacoustics, and add its line to the plot against paths."""
    lines = panels[BY_PATHS]
    spent = [(paths, crossfade_seconds(order)) for (paths, _), order in zip(lines["clsim"], ORDERS, strict=True)]
    lines["pyroomacoustics"] = spent
    return (
        "pyroomacoustics", f"{RESPONSES} room impulse responses a second, convolved and crossfaded",
        f"{crossfade_error_db():.0f} dB at best", f"{spent[-1][1] / lines['clsim'][-1][1]:.0f}",
    )  # fmt: skip


def acoular_row(panels: Panels) -> Row:
    """Return the table's row of Acoular, and add its lines, and ours of the direct sound, to the plots."""
    theirs, mine = [
        [(n, f(n)) for n in EARS[:3]] for f in (lambda n: acoular_seconds(1.0, n), lambda n: ours(0, 1.0, n)[1])
    ]
    panels[BY_EARS] |= {"Acoular, direct sound alone": theirs, "clsim, direct sound": mine}
    panels[BY_TIME]["Acoular, direct sound alone"] = [(d, acoular_seconds(d, 1)) for d in DURATIONS[:2]]
    jitter = 20 * math.log10(2 * math.pi * 40e3 / (RATE * UP * math.sqrt(12.0)))
    return (
        "Acoular", f"the direct sound alone, {EARS[:3][-1]} receivers; nearest of {UP} samples in one",
        f"{jitter:.0f} dB", f"{theirs[-1][1] / mine[-1][1]:.0f}, of the direct sound",
    )  # fmt: skip


PEERS = {
    "Numba": ("numba", numba_row),
    "pyroomacoustics": ("pyroomacoustics", crossfade_row),
    "Acoular": ("acoular", acoular_row),
}


def measured() -> tuple[Panels, list[Row]]:
    """Return the lines of the three plots, and the rows of the table."""
    panels: Panels = {
        BY_PATHS: {"clsim": [ours(order) for order in ORDERS]},
        BY_EARS: {"clsim": [(n, ours(3, 1.0, n)[1]) for n in EARS]},
        BY_TIME: {"clsim": [(d, ours(6, d)[1]) for d in DURATIONS]},
    }
    count, whole = panels[BY_PATHS]["clsim"][-1]
    told = f"{count} paths, 1 s at 192 kHz, one receiver: {whole:.2f} s"
    rows: list[Row] = [("**clsim**", told, "below -85 dB", "1"), c_loop_row()]
    there = {name: importlib.util.find_spec(module) is not None for name, (module, _) in PEERS.items()}
    rows += [row(panels) for name, (_, row) in PEERS.items() if there[name]]
    rows += [(name, "not installed", "", "") for name in PEERS if not there[name]]
    return panels, rows


def main() -> None:
    """Measure, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--busy", action="store_true", help="say that other work ran on the machine")
    busy = parser.parse_args().busy
    panels, rows = measured()
    draw(panels)
    device, _ = find_device(None)
    where = f"{device.name}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}"
    if busy:
        where += "; **a busy machine: these times are no measure**"
    table = f"{where}\n\n| program | what it does | error | clsim is so many times as fast |\n|---|---|---|---|\n"
    table += "".join(f"| {' | '.join(row)} |\n" for row in rows)
    page = (HERE / "README.md").read_text("utf-8")
    before, rest = page.split(BEGIN)
    (HERE / "README.md").write_text(f"{before}{BEGIN}\n\n{table}\n{END}{rest.split(END)[1]}", "utf-8")
    print(table)


if __name__ == "__main__":
    main()
