"""What the scenes of `frozen.py` are made of, and the arrays that are compared of a rendering."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import either
import numpy as np
from frozen_files import Arrays

import clsim

RATE = 192e3
SCENES: dict[str, Callable[[Path], Arrays]] = {}
Fixed, Line, Circle = clsim.Trajectory.fixed, clsim.Trajectory.line, clsim.Trajectory.circle
WALL = clsim.Material.from_reflection(0.9)
BOX = clsim.Shoebox((5.0, 4.0, 3.0), WALL)


def scene(make: Callable) -> Callable:
    """Enter a function that returns arrays among the scenes, by its name."""
    SCENES[make.__name__] = (lambda _: make()) if make.__code__.co_argcount == 0 else make
    return make


def tone(duration: float, frequency: float = 40e3) -> clsim.Signal:
    """Return a faded tone."""
    return clsim.Signal.tone(frequency, duration, RATE, fade=0.002)


def chirp(duration: float, low: float = 30e3, high: float = 50e3) -> clsim.Signal:
    """Return a windowed sweep."""
    return clsim.Signal.chirp(low, high, duration, RATE, window="tukey")


def ring(duration: float) -> clsim.Trajectory:
    """Return 6 m/s on a circle in the box."""
    return Circle((2.4, 2.1, 1.5), 0.8, 0.8378, duration)


def ears(**more: Any) -> list[clsim.Receiver]:
    """Return a receiver at rest and one that moves."""
    places = (Fixed((0.9, 0.7, 2.6)), Line((4.0, 3.1, 0.9), (4.2, 2.2, 1.1), 1.0))
    return [clsim.Receiver(f"r{i}", place, **more) for i, place in enumerate(places)]


def one(room: Any, signal: clsim.Signal, way: clsim.Trajectory, receivers: list, **more: Any) -> clsim.Scene:
    """Return a scene with one source."""
    return clsim.Scene(room, clsim.Air(), [clsim.Source("s", signal, way, **more)], receivers)


def columns(paths: clsim.PathSet, until: float, motion: str = "retarded") -> Arrays:
    """Return a path set, its table at eleven instants, and the direct sound."""
    times = np.linspace(0.0, until, 11)
    table = paths.table(times, motion)
    arrays = {f"paths.{n}": getattr(paths, n) for n in ("source", "receiver", "order", "start", "end")}
    arrays |= {f"table.{n}": getattr(table, n) for n in ("delay", "doppler_factor", "gain", "departure", "arrival")}
    arrays |= {"paths.walls": either.walls(paths), "table.walls": either.walls(table)}
    truth = either.found("direct_truth")(paths, times, motion)
    return arrays | {f"truth.{n}": getattr(truth, n) for n in ("delay", "doppler_factor", "line_of_sight")}


def heard(of: clsim.Scene, order: int, search: dict[str, Any] | None = None, **options: Any) -> Arrays:
    """Return the samples that a scene is rendered to, and its paths; `search` are options of `find_paths`."""
    paths = clsim.find_paths(of, order, **(search or {}))
    recording = either.render(paths, RATE, **options)
    arrays = {f"samples.{n}": x for n, x in zip(recording.receiver_names, recording.samples, strict=True)}
    arrays["clipped"] = np.array(recording.clipped)
    until = recording.samples.shape[1] / recording.sampling_rate
    return arrays | columns(paths, until, options.get("motion", "retarded"))


def prefixed(**parts: Arrays) -> Arrays:
    """Return the arrays of several renderings in one."""
    return {f"{part}.{name}": x for part, arrays in parts.items() for name, x in arrays.items()}
