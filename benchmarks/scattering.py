"""What a moving person costs: 14 ellipsoids in a shoebox, one image on either leg, two receivers.

Processor time of planning and of rendering, and wall time of both: of the room alone, with the person, and with the
person and nodes that the host makes; ``python benchmarks/scattering.py [seconds]``. Each runs twice, and the second
run counts: the first one builds kernels.

Then a person of twelve capsules who crosses the line between a source and a receiver, with and without shadows, among 129
paths: least processor time of three runs, of the search for paths, planning and rendering.
"""

import sys
import time
import warnings

import numpy as np

import clsim
from clsim.render.opencl.path_columns import COLUMNS

RATE = 192e3
PARTS = [  # name, semi-axes, m, height, m, swing along the way, m, and its phase, rad
    ("head", (0.10, 0.08, 0.12), 1.65, 0.01, 0.0), ("torso", (0.12, 0.18, 0.28), 1.25, 0.02, 0.0),
    ("hips", (0.11, 0.17, 0.10), 0.95, 0.02, 0.0), ("neck", (0.05, 0.05, 0.06), 1.50, 0.01, 0.0),
    *((f"{side} {name}", axes, height, swing, phase + turn)
      for side, turn in (("left", 0.0), ("right", np.pi))
      for name, axes, height, swing, phase in (
          ("thigh", (0.08, 0.08, 0.22), 0.72, 0.12, 0.0), ("shank", (0.05, 0.05, 0.21), 0.32, 0.26, 0.4),
          ("foot", (0.12, 0.05, 0.04), 0.06, 0.32, 0.5), ("upper arm", (0.05, 0.05, 0.16), 1.25, 0.08, np.pi),
          ("forearm", (0.04, 0.04, 0.14), 0.98, 0.18, np.pi))),
]  # fmt: skip


def walker(duration: float) -> list[clsim.Scatterer]:
    """Return a trajectory to and fro, 3 m in 5 s."""

    def way(height: float, swing: float, phase: float, aside: float) -> clsim.Trajectory:
        def place(t: np.ndarray) -> np.ndarray:
            along = 4.0 + 1.5 * np.sin(2.0 * np.pi * t / 10.0) + swing * np.sin(2.0 * np.pi * 0.9 * t + phase)
            return np.stack([along, 2.5 + aside + 0.2 * np.sin(t), height + 0.02 * np.cos(3.6 * np.pi * t)], axis=1)

        return clsim.Trajectory.sampled(place, duration, 200.0)

    return [
        clsim.Scatterer.ellipsoid(name, axes, way(height, swing, phase, 0.1 * name.startswith("left")))
        for name, axes, height, swing, phase in PARTS
    ]


def scene(duration: float, scatterers: list[clsim.Scatterer]) -> clsim.Scene:
    """Return a room with a sonar in it."""
    room = clsim.Shoebox((8.0, 5.0, 3.0), clsim.Material.from_reflection(0.8))
    sound = clsim.Signal.pulses(
        clsim.Signal.chirp(38e3, 42e3, 0.01, RATE, window="tukey"), 0.05, round(duration / 0.05)
    )
    source = clsim.Source("speaker", sound, clsim.Trajectory.fixed((1.0, 2.5, 1.2)))
    ears = [clsim.Receiver(f"ear {i}", clsim.Trajectory.fixed((1.0, 2.4 + 0.2 * i, 1.2))) for i in range(2)]
    return clsim.Scene(room, clsim.Air(), [source], ears, scatterers=scatterers)


def measured(duration: float, scatterers: list[clsim.Scatterer]) -> tuple[int, float, float, float]:
    """Return the number of paths, processor times of planning and of rendering, and the wall time of both, s."""
    begun, wall = time.process_time(), time.perf_counter()
    paths = clsim.find_paths(scene(duration, scatterers), 1, scattering_order=1)
    rendering = clsim.Rendering(clsim.plan_render(paths, RATE, duration=duration))
    planned = time.process_time()
    for _ in rendering.pieces():
        pass
    return len(paths), planned - begun, time.process_time() - planned, time.perf_counter() - wall


def crossing(duration: float, shadow: bool) -> list[clsim.Scatterer]:
    """Return twelve capsules that walk to and fro across the middle of the room at up to 1.2 m/s."""

    def way(height: float, swing: float, phase: float) -> clsim.Trajectory:
        def place(t: np.ndarray) -> np.ndarray:
            across = 2.5 + 1.2 * np.sin(t - 0.5 * duration) + swing * np.sin(2.0 * np.pi * 0.9 * t + phase)
            return np.stack(
                [4.0 + 0.1 * np.cos(phase) + 0.0 * t, across, height + 0.02 * np.cos(3.6 * np.pi * t)], axis=1
            )

        return clsim.Trajectory.sampled(place, duration + 0.1, 200.0)

    return [
        clsim.Scatterer.capsule(
            name, min(axes), 2.0 * (max(axes) - min(axes)), way(height, swing, phase), shadow=shadow
        )
        for name, axes, height, swing, phase in PARTS[2:]
    ]


def in_room(kind: str, sound: clsim.Signal, duration: float, way: clsim.Trajectory) -> clsim.Scene:
    """Return a room of 129 paths, alone or with twelve capsules, with shadows or without."""
    bodies = [] if kind == "room alone" else crossing(duration, kind == "with shadows")
    room = clsim.Shoebox((8.0, 5.0, 3.0), clsim.Material.from_reflection(0.8))
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((7.0, 2.4, 1.1)))
    return clsim.Scene(room, clsim.Air(), [clsim.Source("s", sound, way)], [ear], scatterers=bodies)


def tell_capsules() -> None:
    """Print search, planning, rendering, and all over those of the room alone, measured in turns: the least of three."""
    kinds = ("room alone", "capsules", "with shadows")
    for name, duration, rests in (
        ("tone", 1.0, False), ("tone", 2.0, False), ("tone", 10.0, False), ("39 to 41 kHz", 2.0, False),
        ("30 to 50 kHz", 1.0, False), ("30 to 50 kHz", 2.0, False), ("tone", 2.0, True), ("tone", 10.0, True),
    ):  # fmt: skip
        sound = clsim.Signal.tone(40e3, duration, RATE, fade=0.01)
        if name != "tone":
            low, _, high, _ = name.split()
            sound = clsim.Signal.chirp(1e3 * float(low), 1e3 * float(high), duration, RATE, window="hann")
        way = clsim.Trajectory.line((1.0, 2.3, 1.2), (1.2, 2.8, 1.3), duration)
        scenes = {
            k: in_room(k, sound, duration, clsim.Trajectory.fixed((1.0, 2.5, 1.2)) if rests else way) for k in kinds
        }
        spent: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in kinds}
        for _ in range(4):
            for kind, made in scenes.items():
                times = [time.process_time()]
                paths = clsim.find_paths(made, 4)
                times.append(time.process_time())
                rendering = clsim.Rendering(clsim.plan_render(paths, RATE, duration=duration))
                times.append(time.process_time())
                for _ in rendering.pieces():
                    pass
                times.append(time.process_time())
                spent[kind].append(tuple(np.diff(times).tolist()))
        alone = np.min(spent["room alone"][1:], axis=0)
        for kind in kinds:
            parts = np.min(spent[kind][1:], axis=0)
            searched, planned, rendered = parts.tolist()
            print(
                f"{name:12} {duration:4.0f} s, source {'at rest' if rests else 'moving ':7} {kind:13}{searched:6.2f} s of search, "
                f"{planned:5.2f} s of planning, {rendered:5.2f} s of rendering, {parts[1:].sum() / alone[1:].sum():5.1f} times the "
                f"room alone, {parts.sum() / alone.sum():5.1f} times with the search",
                flush=True,
            )


def main() -> None:
    """Print tables."""
    warnings.simplefilter("ignore", clsim.ClsimWarning)  # shadows fall on the direct sound alone
    tell_capsules()
    duration = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    spent = []
    for name, scatterers in (("room alone", []), ("a person", walker(duration)), ("nodes by host", walker(duration))):
        if name == "nodes by host":
            del COLUMNS["scatterers"]
        measured(duration, scatterers)
        count, planning, rendering, wall = measured(duration, scatterers)
        spent.append(rendering)
        print(
            f"{name:14}{count:6} paths{planning:8.1f} s of planning{rendering:8.1f} s of rendering (processor){wall:8.1f} s"
        )
    print(f"person over room alone {spent[1] / spent[0]:.1f}, nodes by host over device {spent[2] / spent[1]:.1f}")


if __name__ == "__main__":
    main()
