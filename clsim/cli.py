"""The command line: the list of commands, and one-line reports of errors."""

from __future__ import annotations

import argparse
import os
import re
import sys
import traceback
from importlib import import_module
from itertools import takewhile
from textwrap import wrap
from typing import Any, NoReturn

from clsim.commands import COMMANDS, GROUPS
from clsim.errors import ClsimError, InputError, meant, not_one_of
from clsim.files.input_files import shown
from clsim.scene_file import as_toml
from clsim.version import __version__
from clsim.workflow.console import built_programs, one_line_warnings

_WIDTH = 79
_STATUS = (
    "exit status: 0 done; 1 members of a study, or scenes of a device's test, failed, or results have changed; "
    "2 an error, in one line; 130 interrupted"
)
_VERBOSE = {"-v", "--verbose"}
_CHOICE = re.compile(r"(?:argument )?(.+?): invalid choice: '(.*)' \(choose from (.*)\)", re.DOTALL)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 2 for an error, 130 when interrupted; 1 if members failed."""
    given = sys.argv[1:] if arguments is None else arguments
    try:
        if not given:
            given = ["--help"]
        options = _options(given)
        with one_line_warnings(), built_programs():
            status: int = options.execute(options)
            if sys.stdout is not None:
                sys.stdout.flush()
            return status
    except BrokenPipeError:  # who reads has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ClsimError, OSError) as error:
        before_command: list[str] = list(takewhile(lambda argument: argument.startswith("-"), given))
        if _VERBOSE & set(before_command):
            traceback.print_exc()
        return _failed(f"clsim: error: {error}", error, 2)
    except MemoryError as error:
        return _failed(f"clsim: error: not enough memory: {error}", error, 2)
    except KeyboardInterrupt as error:
        nothing = "" if getattr(error, "__notes__", None) else "; nothing half-written was left"
        return _failed(f"clsim: interrupted{nothing}", error, 130)


def _failed(message: str, error: BaseException, status: int) -> int:
    """Print an error and its notes on one line; return the exit status."""
    text = as_toml(" ".join("; ".join([message, *getattr(error, "__notes__", [])]).split()))
    print(shown(text), file=sys.stderr)
    return status


class _Parser(argparse.ArgumentParser):
    """Parser that reports errors in clsim's form and suggests the nearest option."""

    def error(self, message: str) -> NoReturn:
        """Raise argparse's message as an InputError."""
        choice = _CHOICE.fullmatch(message)
        if choice:
            raise InputError(choice[1], not_one_of(choice[2], re.findall(r"[\w-]+", choice[3])))
        raise InputError("", message.removeprefix("argument "))

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help or the version; argparse's own method hides that it failed."""
        print(message, end="", file=file, flush=True)


def _listed() -> str:
    """All commands in their groups, each group with an example, and what the exit status says."""
    lines = []
    for name, (_, text) in COMMANDS.items():
        if name in GROUPS:
            title, example = GROUPS[name]
            lines += ["", f"{title}, such as `{example}`:"]
        lines += wrap(text, _WIDTH, initial_indent=f"  {name:<12}", subsequent_indent=14 * " ")
    return "\n".join([*lines[1:], "", *wrap(_STATUS, _WIDTH)])


def _options(arguments: list[str]) -> argparse.Namespace:
    """Return the options; only the command that is called is imported, and adds its arguments."""
    parser = _Parser(
        prog="clsim",
        description="Simulate the sound that microphones receive in a room while sources and receivers move.",
        epilog=_listed(), formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--version", action="version", version=f"clsim {__version__}")
    parser.add_argument("-v", "--verbose", action="store_true", help="also report where in the program an error arose")
    commands = parser.add_subparsers(metavar="COMMAND", help="one of those below; `clsim COMMAND --help` explains it")
    completed = os.environ.get("COMP_LINE") if "_ARGCOMPLETE" in os.environ else None  # by a shell, before Enter
    words = arguments if completed is None else completed.split()[1:]
    called = next((word for word in words if not word.startswith("-")), None)
    if called is not None and called not in COMMANDS and completed is None:
        raise InputError(
            "COMMAND", f"must be one that `clsim --help` lists, but is {called!r:.80}{meant(called, COMMANDS)}"
        )
    parser_called = parser
    for name, (home, text) in COMMANDS.items():
        command = commands.add_parser(name, description=f"{text[0].upper()}{text[1:]}.")
        if name == called:
            module, word = import_module(f"clsim.commands.{home}"), name.replace("-", "_")
            getattr(module, f"{word}_arguments")(command)
            command.set_defaults(execute=getattr(module, word))
            parser_called = command
    if completed is not None:
        import argcomplete

        argcomplete.autocomplete(parser)  # ends the process
    options, beyond = parser.parse_known_args(arguments)
    if beyond:
        known = re.findall(r"--[\w-]+", parser_called.format_help())
        raise InputError("", f"unrecognized arguments: {' '.join(beyond)}{meant(beyond[0].partition('=')[0], known)}")
    if called is None:
        raise InputError("COMMAND", "must be given; `clsim --help` lists them")
    return options
