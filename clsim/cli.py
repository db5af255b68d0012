"""The command line."""

from __future__ import annotations

import argparse
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from clsim.errors import ClsimError, InputError
from clsim.output.stores import KINDS
from clsim.workflow.console import one_line_warnings


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 2 for an error, 130 when interrupted; 1 if members failed."""
    try:
        options = _parser().parse_args(arguments)
        with one_line_warnings():
            status: int = import_module(f"clsim.commands.{options.command}").execute(options)
            sys.stdout.flush()
            return status
    except BrokenPipeError:  # who reads has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ClsimError, OSError) as error:
        return _failed(f"clsim: error: {error}", error, 2)
    except MemoryError as error:
        return _failed(f"clsim: error: not enough memory: {error}", error, 2)
    except KeyboardInterrupt as error:
        nothing = "" if getattr(error, "__notes__", None) else "; nothing half-written was left"
        return _failed(f"clsim: interrupted{nothing}", error, 130)


def _failed(message: str, error: BaseException, status: int) -> int:
    """Print what went wrong and what is noted beside it on one line; return the exit status."""
    print(" ".join("; ".join([message, *getattr(error, "__notes__", [])]).split()), file=sys.stderr)
    return status


class _Parser(argparse.ArgumentParser):
    """Tells what is wrong as all else does."""

    def error(self, message: str) -> NoReturn:
        raise InputError("", message.removeprefix("argument "))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="clsim", description="Simulate what receivers hear in a room while sources and receivers move."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = _command(commands, "run", "render a scene file into a folder of sound files, tables and pictures")
    run.add_argument("-o", "--output", type=_path, required=True, metavar="FOLDER", help="where the results go")
    run.add_argument("--force", action="store_true", help="put others in the place of results that clsim wrote there")
    run.add_argument("--resume", action="store_true", help="go on with a run that was killed, if there is one")
    run.add_argument(
        "--store", choices=KINDS, default="wav", help="format of the sound: WAV files, Zarr or HDF5 (default: wav)"
    )
    run.add_argument(
        "--table",
        choices=("npz", "parquet", "none"),
        default="npz",
        help="format of the path table (default: npz)",
    )
    run.add_argument("--table-rate", type=float, default=100.0, metavar="HZ", help="rows per second (default: 100)")
    run.add_argument("--no-plots", action="store_true", help="draw no pictures")
    run.add_argument("--device", help="OpenCL device, by id or part of its name (see `clsim devices`)")
    run.add_argument("--engine", choices=("opencl", "reference"), help="instead of the scene file's")
    run.add_argument("--duration", type=float, metavar="SECONDS", help="instead of the scene file's")

    _command(commands, "check", "check a scene file and say what would be computed")

    paths = _command(commands, "paths", "list the paths of a scene file")
    paths.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of reception (default: 0)")
    paths.add_argument("--limit", type=_count, default=40, metavar="ROWS", help="paths listed at most (default: 40)")
    paths.add_argument(
        "-o", "--output", type=_path, metavar="FILE", help="write all of them to a .npz or .parquet file"
    )
    _add_force(paths)

    rir = _command(commands, "rir", "write the impulse responses of a scene file at one instant")
    rir.add_argument(
        "-o", "--output", type=_path, required=True, metavar="PATH",
        help="a folder for a WAV file per source and receiver, or a .npz or .sofa file",
    )  # fmt: skip
    _add_force(rir)
    rir.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of reception (default: 0)")
    rir.add_argument("--format", choices=("wav", "npz", "sofa"), help="default: by the ending of the output, else wav")
    rir.add_argument(
        "--band", type=float, nargs=2, metavar=("LOW", "HIGH"),
        help="where they are exact, Hz (default: 0 to 0.95 of half the sampling rate)",
    )  # fmt: skip
    rir.add_argument(
        "--lead", choices=("cut", "keep"), default="cut",
        help="what rings before time 0: cut, so that sample 0 is time 0 (default), or kept",
    )  # fmt: skip

    view = _command(commands, "view", "write an interactive page: room, motion, and the paths over time")
    view.add_argument("-o", "--output", type=_path, metavar="FILE", help="the page (default: beside the scene file)")
    _add_force(view)
    view.add_argument("--frames", type=_count, default=120, metavar="N", help="instants to choose from (default: 120)")
    view.add_argument("--limit", type=_count, default=300, metavar="N", help="strongest paths drawn (default: 300)")
    view.add_argument("--open", action="store_true", help="open it in a browser")

    plot = commands.add_parser("plot", help="draw beams, or what air absorbs").add_subparsers(
        required=True, metavar="PICTURE"
    )
    beam = plot.add_parser("beam", help="beams of a scene's sources and receivers, of a transducer or of a table")
    beam.add_argument("scene", type=Path, nargs="?", help="scene file (TOML)")
    beam.add_argument("--end", metavar="NAME", help="only this source or receiver")
    beam.add_argument("--name", help="a named directivity instead of a scene, for example T4010A1")
    beam.add_argument("--table", type=Path, metavar="FILE", help="a table instead of a scene (.csv, .npz, .mat, .sofa)")
    beam.add_argument("--rear", choices=("hold", "mirror", "zero"), help="beyond the last angle of --table")
    beam.add_argument("--scale", choices=("db", "linear"), help="what real values of --table are")
    beam.add_argument("--hold", action="store_true", help="at other frequencies than the table's, as at the nearest")
    beam.add_argument("--frequencies", type=float, nargs="+", metavar="HZ", help="a curve for each")
    air = plot.add_parser("air", help="absorption of air by frequency and by humidity")
    air.add_argument("--temperature", type=float, default=20.0, metavar="CELSIUS", help="default: 20")
    air.add_argument("--pressure", type=float, default=101_325.0, metavar="PA", help="default: 101325")
    air.add_argument(
        "--humidity", type=float, nargs="+", default=[0.1, 0.3, 0.5, 0.7, 0.9], metavar="H", help="relative, 0 to 1"
    )
    for picture, name in ((beam, "beam"), (air, "air")):
        picture.add_argument("-o", "--output", type=_path, required=True, metavar="FILE", help="the picture (.png)")
        _add_force(picture)
        picture.set_defaults(command="plot", picture=name)

    materials = commands.add_parser(
        "materials", help="list or draw the built-in materials, with sources and uncertainty",
        description="List the built-in materials, with sources and uncertainty, or draw what they send back.",
    )  # fmt: skip
    materials.add_argument("names", nargs="*", metavar="NAME", help="which (default: all)")
    materials.add_argument("-o", "--output", type=_path, metavar="FILE", help="draw them to this PNG instead")
    _add_force(materials)
    materials.add_argument(
        "--frequency", type=float, default=40e3, metavar="HZ", help="at which angles are shown (default: 40000)"
    )
    materials.set_defaults(command="materials")
    study = _command(commands, "study", "render a scene many times with other values of some of its fields", "study")
    study.add_argument("-o", "--output", type=_path, required=True, metavar="FOLDER", help="where the results go")
    study.add_argument("--resume", action="store_true", help="go on with a study that was stopped or killed")
    study.add_argument("--retry", action="store_true", help="the same, and run members that failed again")
    study.add_argument("--limit", type=_count, default=1000, metavar="N", help="members allowed (default: 1000)")
    study.add_argument(
        "--workers", type=_count, metavar="N", help="processes (default: one per GPU, else per two cores)"
    )
    study.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do the work instead")

    devices = commands.add_parser("devices", help="list the OpenCL devices of this machine")
    devices.set_defaults(command="devices")
    schema = commands.add_parser("schema", help="print the JSON schema of scene files, for editors")
    schema.set_defaults(command="schema")
    return parser


def _add_force(parser: Any) -> None:
    parser.add_argument("--force", action="store_true", help="write over a file that is already there")


def _path(text: str) -> Path:
    if not text:
        raise argparse.ArgumentTypeError("must name a file or a folder, but is empty")
    return Path(text)


def _count(text: str) -> int:
    try:
        number = float(text)
        if not number.is_integer():
            raise ValueError
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(f"must be a whole number, but is {text!r:.80}") from None
    return int(number)


def _command(commands: Any, name: str, text: str, file: str = "scene") -> Any:
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument(file, type=Path, help=f"{file} file (TOML)")
    parser.set_defaults(command=name)
    return parser


if __name__ == "__main__":
    sys.exit(main())
