"""`clsim completion`: what makes a shell complete commands and options."""

from __future__ import annotations

import argparse
from importlib import import_module

from clsim.commands import COMMANDS

_SCRIPTS = {
    "bash": """\
_clsim() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}"
    if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W "{commands}" -- "$word"))
    elif [[ "$word" == -* ]]; then
        case "${{COMP_WORDS[1]}}" in
{cases}
        esac
    fi
}}
complete -o default -F _clsim clsim
""",
    "zsh": """\
#compdef clsim
autoload -U +X bashcompinit && bashcompinit
""",
    "fish": "complete -c clsim -n __fish_use_subcommand -f -a '{commands}'\n{cases}",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "shell", choices=tuple(_SCRIPTS), help='which; for bash: eval "$(clsim completion bash)" in ~/.bashrc'
    )


def execute(options: argparse.Namespace) -> int:
    """Print the script; return the exit status."""
    flags = {name: _flags(name) for name in COMMANDS}
    if options.shell == "fish":
        seen = "__fish_seen_subcommand_from"
        lines = [f"complete -c clsim -n '{seen} {name}' {_fish(flag)}" for name in flags for flag in flags[name]]
        print(_SCRIPTS["fish"].format(commands=" ".join(COMMANDS), cases="\n".join(lines)))
        return 0
    cases = [f'            {name}) COMPREPLY=($(compgen -W "{" ".join(flags[name])}" -- "$word")) ;;' for name in flags]
    script = _SCRIPTS["bash"].format(commands=" ".join(COMMANDS), cases="\n".join(cases))
    print(_SCRIPTS["zsh"] * (options.shell == "zsh") + script, end="")
    return 0


def _flags(command: str) -> list[str]:
    """Return the options of a command, those of its own commands, too."""
    parser = argparse.ArgumentParser()
    import_module(f"clsim.commands.{command.replace('-', '_')}").add_arguments(parser)
    return sorted(set(_options(parser)))


def _options(parser: argparse.ArgumentParser) -> list[str]:
    found = []
    for action in parser._actions:
        found += [flag for flag in action.option_strings if flag.startswith("--")]
        if isinstance(action, argparse._SubParsersAction):
            found += [flag for one in action.choices.values() for flag in _options(one)]
    return found


def _fish(flag: str) -> str:
    return f"-l {flag.removeprefix('--')}"
