"""An hour of a beacon that drives through a hall: order 20, bounded memory, killed and resumed.

Some 11 500 paths lead to each of two microphones. Their responses are sampled as fast as Doppler changes them, and the
sound is written piece by piece. The run is killed once, without warning, as soon as some of it is on the disk, and goes
on with `--resume`. Ranges by a matched filter are then read piece by piece, too, and drawn against the true ones.

`--seconds 3600` is the hour; the default is its first minute. It prints what the part costs, and the hour at that rate.
"""

import argparse
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import soundfile
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim
from clsim.score.ranging import MatchedFilter

RATE, PERIOD, ORDER = 16e3, 1.0, 20  # Hz, s between pulses, reflections
PULSE = {"start": 800.0, "stop": 6000.0, "duration": 0.05}  # Hz, Hz, s
CHUNK = 4 * 18432  # samples that are rendered at a time
SCENE = """
format = 1
[room]
kind = "shoebox"
size = [30.0, 20.0, 8.0]
walls = {{ reflection = 0.85 }}
[[sources]]
name = "beacon"
trajectory = {{ kind = "circle", center = [15.0, 10.0, 1.0], radius = 6.0, period = 38.0, duration = {seconds} }}
[sources.signal]
kind = "pulses"
pulse = {{ kind = "chirp", start = 800.0, stop = 6000.0, duration = 0.05, sampling_rate = 16e3, window = "hann" }}
period = 1.0
count = {pulses}
[[receivers]]
name = "east"
trajectory = {{ kind = "fixed", position = [28.0, 17.0, 6.0] }}
[[receivers]]
name = "west"
trajectory = {{ kind = "fixed", position = [2.0, 3.0, 6.0] }}
[paths]
max_order = {order}
[render]
sampling_rate = 16e3
duration = {seconds}
chunk = {chunk}
"""


def main() -> None:
    """Render, kill, resume, find ranges and draw them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--order", type=int, default=ORDER)
    arguments = parser.parse_args()
    folder, seconds = arguments.output / "long_hall", arguments.seconds
    begun = spent()
    print("killed, and resumed" if rendered(folder, seconds, arguments.order) else "finished before it could be killed")
    used = spent() - begun
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    hour = used * 60.0 / seconds
    print(f"{seconds:g} s of sound: {used:.0f} s of processor time (an hour: {hour:.0f} min), at most {memory:.0f} MiB")
    found, true = ranges(folder)
    draw(found, true, arguments.output / "long_hall.png")
    error = np.abs(found - true)
    print(
        f"ranges: off by {1e3 * np.median(error):.1f} mm in the median, {np.mean(error > 0.1):.1%} by more than 0.1 m"
    )
    print(arguments.output / "long_hall.png")


def spent() -> float:
    """Return the processor time of all processes that this one waited for, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def rendered(folder: Path, seconds: float, order: int = ORDER) -> bool:
    """Render into a folder; return whether the run could be killed between."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = folder / "scene.toml"
    pulses = int(seconds / PERIOD)
    scene.write_text(SCENE.format(seconds=seconds, pulses=pulses, order=order, chunk=CHUNK), "utf-8")
    line = [sys.executable, "-m", "clsim", "run", scene, "-o", folder / "run", "--no-plots", "--table", "none"]
    run = subprocess.Popen([*line, "--force"], stdout=subprocess.DEVNULL)
    while run.poll() is None and not (folder / "run" / ".partial" / "journal.npz").exists():
        time.sleep(0.01)
    run.kill()
    killed = run.wait() == -signal.SIGKILL
    subprocess.run([*line, "--resume"], check=True, stdout=subprocess.DEVNULL)
    return killed


def ranges(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the ranges (receivers, pulses) at which each pulse is loudest behind its filter, and the true ones, m."""
    scene = clsim.load_scene(folder / "scene.toml").scene
    matched = MatchedFilter.of(clsim.Signal.chirp(**PULSE, sampling_rate=RATE, window="hann"), RATE)
    found = []
    for receiver in scene.receivers:
        with soundfile.SoundFile(folder / "run" / f"{receiver.name}.wav") as file:
            pieces = file.blocks(round(PERIOD * RATE), fill_value=0.0)
            found.append([np.abs(matched.outputs(piece[None])[0]).argmax() / RATE for piece in pieces])
    delays = np.array(found)
    paths, emitted = clsim.find_paths(scene, 0), PERIOD * np.arange(delays.shape[1])
    # A chirp tells the place at which its middle was emitted.
    heard = emitted + 0.5 * PULSE["duration"] + delays
    true = np.array([clsim.direct_path(paths, times).delay[0, i] for i, times in enumerate(heard)])
    return delays * scene.air.speed_of_sound, true * scene.air.speed_of_sound


def draw(found: np.ndarray, true: np.ndarray, path: Path) -> None:
    """Draw ranges and their errors over time."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    minutes = PERIOD * np.arange(found.shape[1]) / 60.0
    for name, mine, exact in zip(("east", "west"), found, true, strict=True):
        left.plot(minutes, mine, ".", label=name)
        left.plot(minutes, exact, color="0.6", linewidth=0.8)
        right.semilogy(minutes, np.maximum(1e3 * np.abs(mine - exact), 0.1), ".", label=name)
    left.set(xlabel="time (min)", ylabel="range (m)", title="found, and the true one as a line")
    right.set(xlabel="time (min)", ylabel="error (mm)", title="error of the loudest arrival")
    left.legend()
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
