"""One run on one worker and on two: seconds on the wall, processor time of each worker, and whether the bits are the same.

Starts a Dask scheduler and workers on loopback, each worker with one thread for its OpenCL device, and runs
`clsim run --store zarr --scheduler` on them; a first short run builds the kernels. Where each worker has a core, the wall
tells; where cores are shared with others, the largest processor time of any worker does.
"""

import argparse
import filecmp
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

SCENE = """
format = 1
[room]
kind = "shoebox"
size = [8.0, 6.0, 3.0]
walls = {{ reflection = 0.9 }}
[[sources]]
name = "beacon"
signal = {{ kind = "tone", frequency = 40e3, duration = {seconds}, sampling_rate = 192e3, fade = 0.01 }}
trajectory = {{ kind = "circle", center = [4.0, 3.0, 1.5], radius = 1.0, period = 6.0, duration = {seconds} }}
[[receivers]]
name = "ceiling"
positions = {{ kind = "grid", x = [1.0, 7.0, 8], y = [1.0, 5.0, {columns}], z = 2.9 }}
{ends}
[paths]
max_order = {order}
[render]
sampling_rate = 192e3
duration = {seconds}
"""
ENDS = """
transducer = { kind = "named", name = "MA40S4R" }
electronics = { self_noise_db = 20.0, low_cut = 20e3, high_cut = 80e3, order = 4, adc_bits = 16, adc_full_scale = 10.0 }
"""
ONE_THREAD = {"POCL_MAX_PTHREAD_COUNT": "1", "POCL_CPU_MAX_CU_COUNT": "1"}


def started(folder: Path, count: int) -> tuple[str, list[psutil.Popen]]:
    """Start a scheduler and workers; return its address and all processes, the scheduler last."""
    note = folder / f"scheduler-{count}.json"
    base, quiet = [sys.executable, "-m"], {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    line = [*base, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    scheduler = psutil.Popen([*line, "--scheduler-file", str(note)], **quiet)
    line = [*base, "distributed.cli.dask_worker", "--scheduler-file", str(note), "--nthreads", "1", "--no-nanny"]
    line += ["--no-dashboard", "--host", "127.0.0.1", "--local-directory", str(folder / "space")]
    workers = [psutil.Popen(line, env=os.environ | ONE_THREAD, **quiet) for _ in range(count)]
    while not (note.exists() and note.stat().st_size):
        time.sleep(0.1)
    return json.loads(note.read_text("utf-8"))["address"], [*workers, scheduler]


def used(process: psutil.Process) -> float:
    """Return the processor time of a process so far, s."""
    times = process.cpu_times()
    return times.user + times.system


def run(scene: Path, out: Path, address: str) -> None:
    """Run a scene on workers."""
    line = [sys.executable, "-m", "clsim", "run", str(scene), "-o", str(out), "--store", "zarr"]
    line += ["--no-plots", "--table", "none", "--scheduler", address]
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL, env=os.environ | ONE_THREAD)


def same(one: Path, other: Path) -> bool:
    """Compare the files of two folders."""
    names = [sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file()) for folder in (one, other)]
    return names[0] == names[1] and not filecmp.cmpfiles(one, other, names[0], shallow=False)[1]


def main() -> None:
    """Run, measure, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=300.0, help="of signal (default: 300)")
    parser.add_argument("--receivers", type=int, default=64, help="a multiple of 8 (default: 64)")
    parser.add_argument("--order", type=int, default=3, help="(default: 3)")
    parser.add_argument("--ends", action="store_true", help="receivers with transducers and electronics")
    options = parser.parse_args()
    values = {"columns": options.receivers // 8, "order": options.order, "ends": ENDS if options.ends else ""}
    wall, most = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "short.toml").write_text(SCENE.format(seconds=1.0, **values))
        (folder / "long.toml").write_text(SCENE.format(seconds=options.seconds, **values))
        for count in (1, 2):
            address, processes = started(folder, count)
            run(folder / "short.toml", folder / f"short-{count}", address)
            before = [used(process) for process in processes]
            begun = time.perf_counter()
            run(folder / "long.toml", folder / f"long-{count}", address)
            wall.append(time.perf_counter() - begun)
            spent = [used(process) - old for process, old in zip(processes, before, strict=True)]
            most.append(max(spent[:-1]))
            told = " and ".join(f"{seconds:.1f} s" for seconds in spent[:-1])
            print(
                f"{count} worker(s): {wall[-1]:.1f} s on the wall; processor time {told}; scheduler {spent[-1]:.1f} s"
            )
            for process in processes:
                process.kill()
                process.wait()
        print(
            f"two against one: {wall[1] / wall[0]:.2f} on the wall, {most[1] / most[0]:.2f} of the busiest worker's "
            f"processor time; {'the same' if same(folder / 'long-1', folder / 'long-2') else 'NOT the same'} to the last bit"
        )


if __name__ == "__main__":
    main()
