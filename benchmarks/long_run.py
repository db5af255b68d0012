"""A long run from the command line: peak memory, rate, and its tail against the same tail rendered alone.

Writes two WAV files of 2.8 GB an hour into a temporary folder, and prints one line.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import soundfile

from clsim.render.render import render_chunks
from clsim.scene_file import load_scene
from clsim.workflow.pipeline import plan_scene

SCENE = """
format = 1
[room]
kind = "shoebox"
size = [8.0, 6.0, 3.0]
walls = {{ reflection = 0.9 }}
[[sources]]
name = "beacon"
signal = {{ kind = "tone", frequency = 40e3, duration = {0}, sampling_rate = 192e3, fade = 0.01 }}
trajectory = {{ kind = "circle", center = [4.0, 3.0, 1.5], radius = 1.0, period = 6.0, duration = {0} }}
[[receivers]]
name = "left"
trajectory = {{ kind = "fixed", position = [1.0, 1.0, 2.9] }}
[[receivers]]
name = "right"
trajectory = {{ kind = "fixed", position = [7.0, 5.0, 2.9] }}
[paths]
max_order = 3
[render]
sampling_rate = 192e3
duration = {0}
"""


def main() -> None:
    """Run, measure, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--folder", type=Path, help="where the files go for a while (default: a temporary one)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        (folder / "long.toml").write_text(SCENE.format(options.seconds))
        command = [sys.executable, "-m", "clsim", "run", folder / "long.toml", "-o", folder / "out"]
        begun = time.perf_counter()
        subprocess.run([*command, "--no-plots", "--table", "none"], check=True, stdout=subprocess.DEVNULL)
        spent = time.perf_counter() - begun
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        plan = plan_scene(load_scene(folder / "long.toml")).plan
        first = (plan.samples - 1) // plan.chunk * plan.chunk
        _, alone = next(iter(render_chunks(plan, first=first)))
        heard = [
            soundfile.read(folder / "out" / f"{ear}.wav", start=first, dtype="float32")[0] for ear in ("left", "right")
        ]
        rate = plan.path_count * plan.samples / spent
        print(
            f"{options.seconds:g} s of signal in {spent:.0f} s ({rate / 1e9:.2f}e9 path-samples/s), at most {peak:.0f} MiB, "
            f"on {os.cpu_count()} cores; the last {alone.shape[1]} samples alone are "
            f"{'the same to the last bit' if np.array_equal(heard, alone) else 'not the same'}"
        )


if __name__ == "__main__":
    main()
