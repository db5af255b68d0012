"""The command line: which commands there are, and how what goes wrong is said."""

from __future__ import annotations

import argparse
import os
import sys
from importlib import import_module
from typing import NoReturn

from clsim.errors import ClsimError, InputError
from clsim.workflow.console import built_programs, one_line_warnings

# Each is a module of `clsim.commands` (`warm_up` for warm-up) that has `add_arguments(parser)` and `execute(options)`,
# imported once it is called.
COMMANDS = {
    "run": "render a scene file into a folder of sound files, tables and pictures",
    "check": "check a scene file and say what would be computed",
    "paths": "list the paths of a scene file",
    "rir": "write the impulse responses of a scene file at one instant",
    "view": "write an interactive page: room, motion, and the paths over time",
    "plot": "draw directivities, or what air absorbs",
    "materials": "list or draw the built-in materials, with sources and uncertainty",
    "study": "render a scene many times with other values of some of its fields",
    "devices": "list the OpenCL devices of this machine",
    "warm-up": "build the kernels that common scenes need, so that first renders need not",
    "schema": "print the JSON schema of scene files, for editors",
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 2 for an error, 130 when interrupted; 1 if members failed."""
    try:
        options = _options(sys.argv[1:] if arguments is None else arguments)
        with one_line_warnings(), built_programs():
            status: int = options.execute(options)
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
    """Says what is wrong as all else does."""

    def error(self, message: str) -> NoReturn:
        raise InputError("", message.removeprefix("argument "))


def _options(arguments: list[str]) -> argparse.Namespace:
    """Return the options; only the command that is called is imported, and adds its arguments."""
    parser = _Parser(
        prog="clsim", description="Simulate what receivers hear in a room while sources and receivers move."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    called = next((argument for argument in arguments if not argument.startswith("-")), None)
    for name, text in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        if name == called:
            module = import_module(f"clsim.commands.{name.replace('-', '_')}")
            module.add_arguments(command)
            command.set_defaults(execute=module.execute)
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
