"""Narrow part and rest against the plain way: processor time of whole calls, planning included, in turn, in one run.

Kernels are built by a first call of each that is not counted. `apart` compares both with a rendering at -110 dB, over the
first tenth of a second. Of signals for which the default call takes the plain way the ratio shows what looking costs.
At last the default call is compared with `plain_loop.c`, which needs a C compiler: how many paths times samples a second of
processor time either does. To the loop branch signals and polynomials of blocks are given, and it sums one function.
`--bands` compares chirps and noise of bands with the loop in this way, for two receivers, and `--hour` gives the time of an hour
of them at order 3, from a minute.
"""

import argparse
import math
import statistics
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from compare import Kernel

import clsim
from clsim.render.planning import plan_render
from clsim.render.render import record

RATE = 192e3


def beacons(duration: float, hop: float = math.inf) -> clsim.Signal:
    """Return tones of 25, 40 and 48 kHz with fades of 5 ms, together, or one after the other for `hop` s each."""
    length = min(hop, duration)
    tones = [clsim.Signal.tone(f, length, RATE, fade=0.005) for f in (25e3, 40e3, 48e3)]
    pieces = [tone.read(0, tone.count) for tone in tones]
    if hop > duration:
        return clsim.Signal.from_array(sum(pieces), RATE)
    return clsim.Signal.from_array(np.concatenate([pieces[i % 3] for i in range(round(duration / hop))]), RATE)


SIGNALS = {
    "40 kHz tone, abrupt ends": lambda d: clsim.Signal.tone(40e3, d, RATE),
    "40 kHz beacon, 10 ms fades": lambda d: clsim.Signal.tone(40e3, d, RATE, fade=0.01),
    "39 to 41 kHz chirp": lambda d: clsim.Signal.chirp(39e3, 41e3, d, RATE, window="tukey"),
    "beacons at 25, 40 and 48 kHz": beacons,
    "hops of 100 ms between these": lambda d: beacons(d, 0.1),
    "20 to 80 kHz chirp": lambda d: clsim.Signal.chirp(20e3, 80e3, d, RATE, window="tukey"),
    "noise, 30 to 50 kHz": lambda d: clsim.Signal.noise(d, RATE, 1, (30e3, 50e3)),
    "1 ms pulses, 10 a second": lambda d: clsim.Signal.pulses(
        clsim.Signal.tone(40e3, 1e-3, RATE, fade=2e-4), 0.1, round(10 * d)
    ),
}


BANDS = {
    f"{kind}, {low} to {high} kHz": (kind, 1e3 * low, 1e3 * high)
    for low, high in ((30, 50), (20, 45), (39, 41))
    for kind in ("chirp", "noise")
}


def of_band(name: str, duration: float) -> clsim.Signal:
    """Return a chirp or noise of a band."""
    kind, low, high = BANDS[name]
    if kind == "chirp":
        return clsim.Signal.chirp(low, high, duration, RATE, window="tukey")
    return clsim.Signal.noise(duration, RATE, 1, (low, high))


L_ROOM = "40 kHz beacon in an L-shaped room"


def found_round_a_corner(duration: float, order: int) -> clsim.PathSet:
    """Return the paths of a 40 kHz beacon that walks round the corner of a room, 8 by 9 by 3 m."""
    corners = [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]
    room = clsim.MeshRoom.from_plan(corners, 3.0, clsim.Material.from_reflection(0.9))
    places = [(2, 8, 1.4), (2.5, 6.5, 1.4), (2.2, 5, 1.6), (2.8, 3.5, 1.5), (3.0, 2.0, 1.4)]
    way = clsim.Trajectory.waypoints(np.linspace(0.0, duration, 5), places)
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((7.0, 3.0, 1.6)))]
    tone = clsim.Signal.tone(40e3, duration, RATE, fade=0.01)
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [clsim.Source("s", tone, way)], ears), order)


def found(signal: clsim.Signal, duration: float, order: int, receivers: int = 1) -> clsim.PathSet:
    """Return the paths of a source at 6.28 m/s on a circle of 1 m, in a box, to receivers 0.2 m apart."""
    way = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 1.0, duration)
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    ears = clsim.receiver_array("r", [(1.0 + 0.2 * i, 1.0, 2.9) for i in range(receivers)])
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", signal, way)], ears)
    return clsim.find_paths(scene, order)


def timed(paths: clsim.PathSet, duration: float, **options: object) -> tuple[float, np.ndarray, int]:
    """Return the processor time of a call, s, the samples (n,), and how many narrow parts there were."""
    begun = time.process_time()
    plan = plan_render(paths, RATE, duration=duration, **options)
    samples = record(plan).samples[0]
    return time.process_time() - begun, samples.astype(float), len(plan.allocation.narrow)


def apart_db(got: np.ndarray, wanted: np.ndarray) -> float:
    """Return the difference of samples, dB."""
    got = got[: len(wanted)]
    return 20.0 * math.log10(max(np.linalg.norm(got - wanted) / np.linalg.norm(wanted), 1e-15))


def row(name: str, duration: float, order: int, repeat: int) -> str:
    """Return a signal's row of the table."""
    paths = found_round_a_corner(duration, order) if name == L_ROOM else found(SIGNALS[name](duration), duration, order)
    ways: tuple[dict[str, object], ...] = ({"narrowband": False}, {})
    first = [timed(paths, duration, **way) for way in ways]
    spent: list[list[float]] = [[], []]
    for i in range(repeat):
        for k in (i % 2, 1 - i % 2):
            spent[k].append(timed(paths, duration, **ways[k])[0])
    fine = {"interpolator": clsim.Bandlimited(-110.0), "response_error_db": -110.0, "narrowband": False}
    wanted = timed(paths, min(0.1, duration), **fine)[1]
    ratios = [f(spent[0]) / f(spent[1]) for f in (min, statistics.median)]
    errors = [apart_db(made, wanted) for _, made, _ in first]
    return (
        f"| {name} | {'narrow and rest' if first[1][2] else 'plain'} | {min(spent[0]):.2f} s | {min(spent[1]):.2f} s | "
        f"{ratios[0]:.2f} | {ratios[1]:.2f} | {errors[0]:.0f} dB | {errors[1]:.0f} dB |"
    )


def against_the_loop(duration: float, order: int, repeat: int) -> str:
    """Return the times of the default call of an abrupt tone and of the C loop."""
    signal = SIGNALS["40 kHz tone, abrupt ends"]
    short, paths = (found(signal(d), d, order) for d in (1.0, duration))
    plan = plan_render(short, RATE, duration=1.0, responses="centre", narrowband=False)
    timed(paths, duration)
    calls, loops = [], []
    with tempfile.TemporaryDirectory() as folder:
        loop = Kernel(Path(folder), short, 1.0)
        for _ in range(repeat):
            calls.append(len(paths) * duration * RATE / timed(paths, duration)[0])
            begun = time.process_time()
            loop.plain()
            loops.append(loop.slots * loop.samples / (time.process_time() - begun))
    branches, ratio = len(plan.source_filters[0].bank.taps), max(calls) / max(loops)
    return (
        f"abrupt tone of {duration:g} s, {len(paths)} paths: default call {max(calls):.3g}, C loop of one function and "
        f"{branches} branches {max(loops):.3g} path-samples a second of processor time: {ratio:.2f} (median "
        f"{statistics.median(calls) / statistics.median(loops):.2f})"
    )


def bands_against_the_loop(duration: float, order: int, repeat: int) -> None:
    """Print how default calls of bands compare with the C loop of one function, two receivers."""
    print("| signal | order | taken | default call | C loop | ratio |\n" + "|---" * 6 + "|")
    with tempfile.TemporaryDirectory() as folder:
        loop = Kernel(Path(folder), found(SIGNALS["40 kHz tone, abrupt ends"](1.0), 1.0, order), 1.0)
        for name in BANDS:
            paths, calls, loops = found(of_band(name, duration), duration, order, 2), [], []
            taken = timed(paths, duration)[2]
            for _ in range(repeat):
                calls.append(len(paths) * duration * RATE / timed(paths, duration)[0])
                begun = time.process_time()
                loop.plain()
                loops.append(loop.slots * loop.samples / (time.process_time() - begun))
            print(
                f"| {name} | {order} | {'envelope' if taken else 'plain'} | {max(calls):.3g} | {max(loops):.3g} | "
                f"{max(calls) / max(loops):.2f} |",
                flush=True,
            )


def hour_of(signal: clsim.Signal) -> float:
    """Return the processor time of an hour of a signal at order 3 with two receivers, s, from that of a minute."""
    paths = found(signal, 60.0, 3, 2)
    record(plan_render(paths, RATE, duration=1.0))
    begun = time.process_time()
    plan = plan_render(paths, RATE, duration=60.0)
    planned = time.process_time()
    record(plan)
    return planned - begun + 60.0 * (time.process_time() - planned)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration", type=float, default=10.0, metavar="SECONDS", help="of each signal (default: 10)")
    parser.add_argument("--order", type=int, default=10, help="of reflections (default: 10)")
    parser.add_argument("--repeat", type=int, default=3, metavar="N", help="counted calls of each (default: 3)")
    parser.add_argument(
        "--only", nargs="+", choices=[*SIGNALS, L_ROOM], default=[*SIGNALS, L_ROOM], metavar="NAME", help="some signals"
    )
    parser.add_argument("--bands", action="store_true", help="chirps and noise against the C loop")
    parser.add_argument("--hour", action="store_true", help="an hour at order 3")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.bands:
        bands_against_the_loop(options.duration, options.order, options.repeat)
    if options.hour:
        hours = {"a tone": clsim.Signal.tone(40e3, 60.0, RATE, fade=0.01)} | {n: of_band(n, 60.0) for n in BANDS}
        for name, signal in hours.items():
            print(f"an hour of {name}, order 3, two receivers: {hour_of(signal):.0f} s", flush=True)
    if options.bands or options.hour:
        return
    print("| signal | taken | plain | default | ratio: least | median | plain: apart | default |\n" + "|---" * 8 + "|")
    for name in options.only:
        print(row(name, options.duration, options.order, options.repeat), flush=True)
    print("\n" + against_the_loop(options.duration, options.order, options.repeat))


if __name__ == "__main__":
    main()
