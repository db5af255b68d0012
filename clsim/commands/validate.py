"""`clsim validate`: measured rooms, against what clsim finds for them."""

from __future__ import annotations

import argparse
from pathlib import Path

from clsim.commands.arguments import add_output, as_path, as_whole
from clsim.errors import InputError, check_pictures, not_one_of
from clsim.files.atomic import NewFile, atomic_path
from clsim.measured.page import Validated, draw, page_text, picture_names, summary
from clsim.measured.rooms import BUILT_IN, NAME, MeasuredRoom, bras_room, measured_room
from clsim.measured.simulated import simulate
from clsim.workflow.console import progress

_PAGE = "measured_rooms.md"
_MOST_SEEDS = 100


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "rooms", nargs="+", metavar="ROOM", help=f"{', '.join(BUILT_IN)}, {NAME}, or a TOML file of a measured room"
    )
    parser.add_argument("--bras", type=as_path, metavar="DIR", help=f"folder with the files of the BRAS, for {NAME}")
    parser.add_argument(
        "--seeds", type=as_whole, nargs="+", default=[0], metavar="N", help="seeds of rays and noise (default: 0)"
    )
    add_output(parser, f"for {_PAGE} and its pictures", "measured_rooms", metavar="FOLDER")


def execute(options: argparse.Namespace) -> int:
    """Simulate the rooms, print how far they are from what was measured, and write the page; return the exit status."""
    if len(options.seeds) > _MOST_SEEDS or min(options.seeds) < 0 or len(set(options.seeds)) < len(options.seeds):
        raise InputError("--seeds", f"must be 1 to {_MOST_SEEDS} different numbers from 0 on, but are {options.seeds}")
    check_pictures("--output")
    rooms = [_room(name, options.bras) for name in options.rooms]
    targets = [NewFile(options.output / _PAGE, [], options.force, new_folder=True)] + [
        NewFile(options.output / "pictures" / name, [], options.force, new_folder=True)
        for room in rooms
        for name in picture_names(room)
    ]
    found = []
    for room in rooms:
        one = Validated(room, tuple(simulate(room, state, options.seeds, progress) for state in room.states))
        print(*summary(one), sep="\n", flush=True)
        found.append(one)
    (options.output / "pictures").mkdir(parents=True, exist_ok=True)
    text = page_text(found, options.seeds)
    for target in targets:
        target.ready()
    for one in found:
        draw(one, options.output / "pictures")
    with atomic_path(options.output / _PAGE) as temporary:
        temporary.write_text(text, "utf-8")
    for target in targets:
        print(target.path)
    return 0


def _room(name: str, bras: Path | None) -> MeasuredRoom:
    """Read a room by its name, or from its file."""
    if name == NAME:
        if bras is None:
            raise InputError("--bras", f"must name the folder of the BRAS for {NAME}, but is missing")
        return bras_room(bras)
    if name not in BUILT_IN and not name.endswith(".toml"):
        raise InputError("ROOM", not_one_of(name, [*BUILT_IN, NAME]) + " (or a .toml file)")
    return measured_room(name)
