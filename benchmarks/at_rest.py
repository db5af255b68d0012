"""Pairs at rest: one impulse response and a convolution, against rendering path by path. Writes at_rest.md."""

import time
from pathlib import Path

import clsim
from clsim.render.methods import static
from clsim.render.planning import plan_render

RATE = 192e3
SIZE = (8.0, 6.0, 3.0)


def seconds(scene: clsim.Scene, paths: clsim.PathSet, convolved: bool) -> float:
    """Return the time of a whole call."""
    begun = time.perf_counter()
    clsim.render(paths, RATE, convolve_static=convolved)
    return time.perf_counter() - begun


def response_seconds(scene: clsim.Scene, paths: clsim.PathSet) -> float:
    """Return the time of making the impulse response."""
    import numpy as np

    plan = plan_render(paths, RATE)
    begun = time.perf_counter()
    static.StaticConvolution(plan).begin().add(np.zeros((1, 1), dtype=np.float32), 0)
    return time.perf_counter() - begun


def main() -> None:
    """Measure and write."""
    rows = []
    for duration in (1.0, 60.0):
        signal = clsim.Signal.noise(duration, RATE, seed=1, band=(38e3, 42e3))
        source = clsim.Source("s", signal, clsim.Trajectory.fixed((4.0, 3.0, 1.5)))
        room = clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.9))
        receivers = [clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))]
        scene = clsim.Scene(room, clsim.Air(), [source], receivers)
        for order in (3, 6, 10):
            paths = clsim.find_paths(scene, order)
            if not rows:
                seconds(scene, paths, True), seconds(scene, paths, False)  # builds the kernels
            made = response_seconds(scene, paths)
            convolved = min(seconds(scene, paths, True) for _ in range(3 if duration < 10 else 1))
            by_path = min(seconds(scene, paths, False) for _ in range(3 if duration < 10 else 1))
            rows.append((duration, order, len(paths), made, convolved, by_path))
            print(rows[-1], flush=True)
    lines = [
        "| signal | order | paths | response | convolved, whole call | path by path, whole call | ratio |",
        "|---|---|---|---|---|---|---|",
        *(f"| {d:g} s | {o} | {p} | {m:.2f} s | {a:.2f} s | {b:.2f} s | {b / a:.1f} |" for d, o, p, m, a, b in rows),
    ]
    (Path(__file__).parent / "at_rest.md").write_text("\n".join(lines) + "\n", "utf-8")


if __name__ == "__main__":
    main()
