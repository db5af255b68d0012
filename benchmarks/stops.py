"""Follow the scene through `find_paths` and the paths through `render`, as data, and count what a reader has to open.

A function is on the route when the value is an argument of it, or an object of clsim that was built from it: returned
by a function that was given it, or initialized there. What an object is asked by its own methods is no stop, but their
results count as built from it. Functions count once, in the order of their first calls.

- stop: functions of one file that are entered one after the other;
- files: those with a stop;
- return: a stop in a file that had one before.

    python benchmarks/stops.py            # the three figures of both routes
    python benchmarks/stops.py --route    # every stop, with its functions
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Any

import clsim

PACKAGE = Path(clsim.__file__).parent
WALL = clsim.Material.from_reflection(0.9)
# Stops, files, returns: the goal, and today's figures, which are to be lowered with the code.
GOALS = {"find_paths, all kinds": (20, 12, 5), "find_paths": (20, 12, 5), "render": (25, 14, 6)}
BOUNDS = {"find_paths, all kinds": (24, 21, 3), "find_paths": (4, 4, 0), "render": (26, 22, 4)}


class Route:
    """Functions on the route of a value, as (file, name), in the order of their first calls."""

    def __init__(self, value: object) -> None:
        self.functions: dict[tuple[str, str], None] = {}
        self._carriers = {id(value): value}  # kept, so that no other object gets their ids
        self._on_route: list[FrameType] = []

    def follow(self, frame: FrameType, event: str, result: Any) -> None:
        """Take note of a call or a return; for `sys.setprofile`."""
        if event == "call" and str(frame.f_globals.get("__name__", "")).startswith("clsim"):
            carriers = {name for name, value in _arguments(frame) if self._carries(value)}
            if carriers:
                self._enter(frame, is_stop=carriers != {"self"})
        elif event == "return" and self._on_route and self._on_route[-1] is frame:
            self._on_route.pop()
            self._carry(result)

    def stops(self) -> list[tuple[str, list[str]]]:
        """List the stops: a file, and the functions that are entered there."""
        return [
            (file, [name for _, name in calls]) for file, calls in groupby(self.functions, key=lambda call: call[0])
        ]

    def figures(self) -> tuple[int, int, int]:
        """Count stops, files and returns."""
        stops = [file for file, _ in self.stops()]
        return len(stops), len(set(stops)), len(stops) - len(set(stops))

    def _enter(self, frame: FrameType, *, is_stop: bool) -> None:
        code = frame.f_code
        if code.co_name in ("__init__", "__post_init__"):
            self._carry(frame.f_locals["self"])
            # What a dataclass initializes with was given to what dataclasses make.
            is_stop |= (
                bool(self._on_route)
                and self._on_route[-1] is frame.f_back
                and frame.f_back.f_code.co_name == "__init__"
            )
        self._on_route.append(frame)
        if is_stop and code.co_filename.startswith(str(PACKAGE)):  # what dataclasses make is in no file
            self.functions.setdefault((str(Path(code.co_filename).relative_to(PACKAGE)), code.co_qualname))

    def _carries(self, value: object) -> bool:
        return any(id(part) in self._carriers for part in _parts(value))

    def _carry(self, value: object) -> None:
        for part in _parts(value):
            if type(part).__module__.startswith("clsim"):
                self._carriers[id(part)] = part


def _arguments(frame: FrameType) -> list[tuple[str, object]]:
    code = frame.f_code
    if code.co_name.startswith("<"):  # part of the function it stands in
        return []
    count = code.co_argcount + code.co_kwonlyargcount + bool(code.co_flags & 4) + bool(code.co_flags & 8)
    return [(name, frame.f_locals.get(name)) for name in code.co_varnames[:count]]


def _parts(value: object) -> Iterator[object]:
    """Yield a value, or the elements of a tuple, a list or a dict."""
    if isinstance(value, dict):
        yield from value.values()
    elif isinstance(value, tuple | list):
        yield from value
    else:
        yield value


def followed(call: Callable[[Any], Any], value: object) -> tuple[Route, Any]:
    """Call a function with a value; give the value's route and the result."""
    route = Route(value)
    sys.setprofile(route.follow)
    try:
        result = call(value)
    finally:
        sys.setprofile(None)
    return route, result


def simple_scene() -> clsim.Scene:
    """Make a robot that drives through a room and beeps, and two microphones."""
    return clsim.Scene(clsim.Shoebox((8.0, 6.0, 3.0), WALL), clsim.Air(), [robot()], microphones())


def full_scene() -> clsim.Scene:
    """Make an L-shaped room with an edge, a body that moves and a sphere."""
    outline = [(0.0, 0.0), (8.0, 0.0), (8.0, 3.0), (6.0, 3.0), (6.0, 6.0), (0.0, 6.0)]
    room = clsim.MeshRoom.from_plan(outline, 3.0, WALL)
    crate = clsim.Body.box("crate", (0.4, 0.4, 0.4), WALL, clsim.Trajectory.line((2.0, 2.0, 1.0), (2.1, 2.0, 1.0), 0.1))
    ball = clsim.Scatterer.sphere("ball", 0.05, clsim.Trajectory.fixed((3.0, 4.0, 1.0)))
    return clsim.Scene(room, clsim.Air(), [robot()], microphones(), scatterers=[ball], bodies=[crate])


def robot() -> clsim.Source:
    """Make a source that moves."""
    tone = clsim.Signal.tone(40e3, duration=0.02, sampling_rate=192e3, fade=0.002)
    return clsim.Source("robot", tone, clsim.Trajectory.line((4.0, 3.0, 1.5), (4.1, 3.0, 1.5), 0.1))


def microphones() -> list[clsim.Receiver]:
    """Make a receiver at rest and one that moves."""
    places = clsim.Trajectory.fixed((1.0, 1.0, 2.9)), clsim.Trajectory.line((5.0, 1.0, 1.0), (5.0, 1.1, 1.0), 0.1)
    return [clsim.Receiver(f"r{i}", place) for i, place in enumerate(places)]


def routes() -> dict[str, Route]:
    """Follow a scene that needs every search, the first scene of a user, and the paths of that."""
    everything, _ = followed(
        lambda scene: clsim.find_paths(scene, 1, diffraction=1, scattering_order=1, path_limit=10**5), full_scene()
    )
    searched, paths = followed(lambda scene: clsim.find_paths(scene, 2), simple_scene())
    rendered, _ = followed(lambda paths: clsim.render(paths, 192e3), paths)
    return {"find_paths, all kinds": everything, "find_paths": searched, "render": rendered}


def main() -> int:
    """Print the figures; fail where they are above today's."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--route", action="store_true", help="print every stop")
    shown = parser.parse_args().route
    above = False
    for name, route in routes().items():
        figures = route.figures()
        print(f"{name}: {figures} stops, files, returns; at most {BOUNDS[name]}, goal {GOALS[name]}")
        above |= any(a > b for a, b in zip(figures, BOUNDS[name], strict=True))
        for file, functions in route.stops() if shown else ():
            print(f"  {file}: {', '.join(functions)}")
    return int(above)


if __name__ == "__main__":
    sys.exit(main())
