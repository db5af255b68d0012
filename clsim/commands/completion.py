"""`clsim completion`: a script with which a shell completes commands, options and choices."""

from __future__ import annotations

import argparse

from clsim.errors import check_packages


def completion_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "shell", choices=("bash", "zsh", "fish"), help='for bash: eval "$(clsim completion bash)" in ~/.bashrc'
    )


def completion(options: argparse.Namespace) -> int:
    """Print the script; return the exit status."""
    check_packages("completion", "completion", "completion", "argcomplete")
    from argcomplete.shell_integration import shellcode

    print(shellcode(["clsim"], shell=options.shell))
    return 0
