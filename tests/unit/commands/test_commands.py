"""Commands declare their own arguments; the command line only lists them."""

from importlib import import_module
from pathlib import Path

import pytest

import clsim.commands
from clsim import cli

TOY = """
def add_arguments(parser):
    parser.add_argument("--number", type=int, required=True, help="what is doubled")


def execute(options):
    print(2 * options.number)
    return 0
"""


def test_a_command_is_one_file_and_its_line_in_the_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    (tmp_path / "toy.py").write_text(TOY, "utf-8")
    monkeypatch.setattr(clsim.commands, "__path__", [*clsim.commands.__path__, str(tmp_path)])
    monkeypatch.setitem(cli.COMMANDS, "toy", "double a number")
    assert cli.main(["toy", "--number", "21"]) == 0
    assert capsys.readouterr().out == "42\n"
    assert cli.main(["toy", "--number", "x"]) == 2
    assert capsys.readouterr().err == "clsim: error: --number: invalid int value: 'x'\n"
    for arguments, texts in (
        (["--help"], ["toy", "double a number"]),
        (["toy", "-h"], ["Double a number.", "what is"]),
    ):
        with pytest.raises(SystemExit):
            cli.main(arguments)
        printed = capsys.readouterr().out
        assert all(text in printed for text in texts)


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_each_command_has_its_help(name: str, capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main([name, "--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: clsim {name} [-h]")
    assert import_module(f"clsim.commands.{name.replace('-', '_')}").execute.__doc__


def test_commands_are_those_that_are_listed() -> None:
    folder = Path(clsim.commands.__file__).parent
    there = {path.stem.replace("_", "-") for path in folder.glob("*.py") if "def execute(" in path.read_text("utf-8")}
    assert there == set(cli.COMMANDS)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["rnu", "scene.toml"],
            """COMMAND: must be one that `clsim --help` lists, but is 'rnu'; did you mean "run"?""",
        ),
        (["studdy"], """COMMAND: must be one that `clsim --help` lists, but is 'studdy'; did you mean "study"?"""),
        (["nothing"], "COMMAND: must be one that `clsim --help` lists, but is 'nothing'"),
        (["--verion"], 'unrecognized arguments: --verion; did you mean "--version"?'),
        (["devices", "--tset"], 'unrecognized arguments: --tset; did you mean "--test"?'),
    ],
    ids=str,
)
def test_what_is_misspelt_is_asked_for(arguments: list[str], told: str, capsys) -> None:
    assert cli.main(arguments) == 2
    assert capsys.readouterr().err == f"clsim: error: {told}\n"


@pytest.mark.parametrize("arguments", [["--help"], [], ["nothing"]], ids=str)
def test_only_the_command_that_is_called_is_imported(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "import_module", lambda name: pytest.fail(f"{name} was imported"))
    if arguments != ["nothing"]:
        with pytest.raises(SystemExit, match="0"):
            cli.main(arguments)
    else:
        assert cli.main(arguments) == 2
