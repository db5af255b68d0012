"""`clsim new` and `schema`: a scene file to begin with, and what editors need to know of such files."""

from __future__ import annotations

import argparse
import json
import os
import tomllib
from pathlib import Path

import numpy as np

from clsim.arrays import Floats, as_number
from clsim.commands.arguments import add_force
from clsim.errors import InputError
from clsim.files.atomic import NewFile, atomic_path
from clsim.files.input_files import LARGEST_TEXT, read_file, shown
from clsim.scene.material.material import Material
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.room.mesh import MeshRoom
from clsim.scene_file.scene import build_scene, scene_schema

_SIZE = (8.0, 6.0, 3.0)  # m, of a room of which nothing is known
_MARGIN = 1.0  # m, about a trajectory
_LONGEST = 2.0  # s of sound
_NANOSECONDS = 10**15  # from which on a first number is one of EuRoC's stamps


def new_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, help="scene file (TOML) that is written")
    add_force(parser)
    parser.add_argument("--mesh", type=Path, metavar="FILE", help="the room: OBJ, STL, PLY, GLB or OFF")
    parser.add_argument("--scale", type=float, default=1.0, metavar="M", help="metres in the mesh's unit (default: 1)")
    parser.add_argument("--up", choices=("x", "y", "z"), default="z", help="the mesh axis that points up")
    parser.add_argument(
        "--trajectory", type=Path, metavar="FILE", help="the source's motion: TUM, EuRoC or CSV with a header"
    )
    parser.add_argument(
        "--max-gap", type=float, metavar="S", help="largest time step that is no gap (default: five median steps)"
    )


def new(options: argparse.Namespace) -> int:
    """Write the scene file; return the exit status."""
    inputs = [path for path in (options.mesh, options.trajectory) if path is not None]
    target = NewFile(options.scene, inputs, options.force)
    base = options.scene.parent
    as_number("--scale", options.scale, at_least=1e-9, at_most=1e9)
    motion = None if options.trajectory is None else _motion(options.trajectory, options.max_gap)
    if options.mesh is None:
        low, high, room = _box(motion)
        inside = None
    else:
        inside = MeshRoom.from_file(options.mesh, options.scale, options.up, Material.from_reflection(0.9))
        low, high = inside.extent
        walls = "materials = { reflection = 0.9 }   # or by group: { default = { … }, curtain = { … } }"
        named = f'path = {_relative(options.mesh, base)}\nscale = {options.scale:g}\nup = "{options.up}"'
        room = f'[room]\nkind = "mesh"\n{named}\n{walls}; `clsim materials`'
    moved = np.zeros(3) if options.mesh is not None or motion is None else _MARGIN - motion[1].min(axis=0)
    duration = _LONGEST if motion is None else min(_LONGEST, 0.9 * motion[2])
    places = _places(low, high, inside)
    trajectory = f'trajectory = {{ kind = "fixed", position = {_text(places[0])} }}'
    if motion is not None:
        named = _relative(options.trajectory, base)
        gap = "" if options.max_gap is None else f", max_gap = {options.max_gap:g}"
        file = f'kind = "file", path = {named}, format = "{motion[0]}"{gap}'
        trajectory = f"trajectory = {{ {file}, translate = {_text(moved)} }}"
    text = Path(__file__).with_suffix(".toml").read_text("utf-8").format(
        name=shown(options.scene.name), room=room, duration=duration, fade=min(0.005, 0.1 * duration),
        trajectory=trajectory, receiver=_text(places[1]), order=3 if options.mesh is None else 2,
    )  # fmt: skip
    build_scene(tomllib.loads(text), base)  # what is written works
    with atomic_path(target.ready()) as temporary:
        temporary.write_text(text, "utf-8")
    print(options.scene)
    return 0


def _motion(path: Path, max_gap: float | None) -> tuple[str, Floats, float]:
    """Return the format of a trajectory's file, positions in it (n, 3), m, and how long it lasts, s."""
    form = _format(path)
    try:
        found = Trajectory.from_file(path, form, max_gap=max_gap)
    except InputError as error:
        problem = error.problem.replace("max_gap=", "--max-gap").replace(" or repair=('gaps',)", "")
        raise InputError("--trajectory", f"{error.field}: {problem}") from error
    return form, np.atleast_2d(found.position(np.linspace(found.start, found.end, 1000))), found.end - found.start


def _format(path: Path) -> str:
    """Return the format of a trajectory's file, by its first lines."""
    try:
        lines = read_file(path, LARGEST_TEXT).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("--trajectory", f"cannot be read: {path}: {error}") from error
    first = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    if "," not in first:
        return "tum"
    word = first.split(",")[0].strip()
    return "euroc" if word.isdigit() and int(word) >= _NANOSECONDS else "csv"


def _box(motion: tuple[str, Floats, float] | None) -> tuple[Floats, Floats, str]:
    """Return the ends of a box, m, and what the file says of it."""
    size = np.array(_SIZE)
    if motion is not None:
        size = np.ceil(10.0 * (np.ptp(motion[1], axis=0) + 2.0 * _MARGIN)) / 10.0
    walls = "walls = { reflection = 0.9 }     # or by wall: { default = { … }, z_min = { … } }; `clsim materials`"
    kind = 'kind = "shoebox"                 # or "plan", or "mesh"'
    return np.zeros(3), size, f"[room]\n{kind}\nsize = {_text(size)}\n{walls}"


def _places(low: Floats, high: Floats, room: MeshRoom | None) -> tuple[Floats, Floats]:
    """Return a place for the source in the middle of a room, and one for the receiver high up, m."""
    wanted = low + (high - low) * np.array([[0.5, 0.5, 0.5], [0.15, 0.2, 0.9]])
    if room is None or not room.is_closed:
        return wanted[0], wanted[1]
    shares = (np.arange(9) + 0.5) / 9
    grid = low + (high - low) * np.stack(np.meshgrid(shares, shares, shares), axis=-1).reshape(-1, 3)
    grid = grid[room.contains(grid)]
    if not len(grid):
        return wanted[0], wanted[1]
    near = [grid[np.argmin(np.linalg.norm(grid - place, axis=1))] for place in wanted]
    return near[0], near[1]


def _relative(path: Path, base: Path) -> str:
    """Return a path as a scene file in a folder names it."""
    named = Path(os.path.relpath(path, base)).as_posix()
    if any("\udc80" <= letter <= "\udcff" for letter in named):
        raise InputError("path", f"must be UTF-8, as scene files are, but is {shown(named)}; rename it")
    return json.dumps(named, ensure_ascii=False).replace("\x7f", "\\u007f")


def _text(place: Floats) -> str:
    return "[" + ", ".join(f"{x + 0.0:.3f}" for x in place) + "]"


def schema_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command, which has none."""


def schema(options: argparse.Namespace) -> int:
    """Print it; return the exit status."""
    print(json.dumps(scene_schema(), indent=1))
    return 0
