"""Arguments that several commands have, and how their texts are read."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

_UNITS = {"duration": "SECONDS"}  # shown where a value goes


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the scene file."""
    parser.add_argument("scene", type=Path, help="scene file (TOML)")


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add the option to overwrite a file."""
    parser.add_argument("--force", action="store_true", help="overwrite an existing file")


def add_output(parser: argparse.ArgumentParser, text: str, default: str | None = None, **more: Any) -> None:
    """Add the output, and the option to overwrite it."""
    if default is not None:
        more, text = (
            more | {"default": Path(default)},
            f"{text} (default: {default})" if text else f"default: {default}",
        )
    parser.add_argument("-o", "--output", type=as_path, **{"metavar": "FILE"} | more, help=text)
    add_force(parser)


def add_render_option(parser: argparse.ArgumentParser, name: str, text: str) -> None:
    """Add an option of `render`, of the type that `RenderOptions` gives it; left out it is None."""
    from clsim.render.options import RenderOptions  # late: others, as `clsim study`, begin sooner

    wanted = get_type_hints(RenderOptions)[name]
    kind = wanted if get_origin(wanted) is Literal else next(iter(get_args(wanted)), wanted)  # of `float | None`: float
    flag = f"--{name.replace('_', '-')}"
    if get_origin(kind) is Literal:
        parser.add_argument(flag, choices=get_args(kind), help=text)
    else:
        parser.add_argument(flag, type=kind, metavar=_UNITS.get(name), help=text)


def as_path(text: str) -> Path:
    """Return the path of what is written; an empty text is none."""
    if not text:
        raise argparse.ArgumentTypeError("must name a file or a folder, but is empty")
    return Path(text)


def as_whole(text: str) -> int:
    """Return a whole number, however it is written: 1000 or 1e3."""
    try:
        number = float(text)
        if not number.is_integer():
            raise ValueError
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(f"must be a whole number, but is {text!r:.80}") from None
    return int(number)
