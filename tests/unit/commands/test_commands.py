"""Commands declare their own arguments; the command line only lists them. Devices, and programs built in advance."""

import io
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest

import clsim
import clsim.commands
from clsim import cli
from clsim.cli import main
from clsim.commands import devices
from clsim.opencl import launch as compiler_module
from clsim.opencl.device import find_device
from clsim.opencl.launch import compiler_of, kernel_source
from clsim.workflow.console import built_programs

pytestmark = pytest.mark.usefixtures("device")


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer paths and scenes: all of it is under a minute, but not much."""
    plans = devices._plans
    some = ("pulses", "paths that come and go")
    monkeypatch.setattr(devices, "_plans", lambda device: {k: v for k, v in plans(device).items() if k in some})
    monkeypatch.setattr(devices, "_ORDER", 2)


def test_a_device_passes_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--test", "0:0"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("pulses: -1")
    assert " | passed: -1" in lines[-1]
    assert all(word in lines[-1] for word in ("clsim 0", "driver", "render ", "tracks ", "float64"))


def test_a_device_that_is_wrong_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    original = compiler_module.kernel_source

    def wrong(program: str) -> str:
        return (
            original(program).replace("at - whole", "(at - whole) * 0.999f")
            if program == "render"
            else original(program)
        )

    assert wrong("render") != original("render")
    monkeypatch.setattr(compiler_module, "kernel_source", wrong)
    assert main(["devices", "--test"]) == 1
    told = capsys.readouterr().out
    assert " | FAILED: " in told
    assert "report the line above" in told


def test_an_unknown_device_is_refused(error_of) -> None:
    assert "part of the name of one of" in error_of("devices", "--test", "no such thing")


RATE = 192e3
ROOM = clsim.Shoebox((6.0, 5.0, 2.5), clsim.Material.from_reflection(0.8))


def built() -> set[tuple[str, tuple[str, ...]]]:
    return set(compiler_of(find_device(None)[1])._built)


def paths_of(signal: clsim.Signal) -> clsim.PathSet:
    way = clsim.Trajectory.line((2.0, 2.0, 1.0), (2.0, 2.0 + 3.0 * signal.duration, 1.0), signal.duration)
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 1.0, 2.0)))
    scene = clsim.Scene(ROOM, clsim.Air(), [clsim.Source("s", signal, way)], [receiver])
    return clsim.find_paths(scene, 2)


def heard(signal: clsim.Signal, **options: object) -> clsim.Recording:
    return clsim.render(paths_of(signal), RATE, **options)


def test_what_is_warmed_up_is_there_when_it_is_needed(device, capsys, error_of) -> None:
    assert main(["warm-up"]) == 0
    name = re.escape(find_device(None)[0].name)
    assert re.fullmatch(rf"\d+ programs are ready on {name}, in \d+\.\d s\n", capsys.readouterr().out)
    before = built()
    heard(clsim.Signal.tone(40e3, 0.1, RATE, fade=0.01))  # another room, other paths, another speed
    of_nodes = kernel_source("tracks")  # which knows how many functions of frequency there are
    assert {key for key in built() - before if key[0] != of_nodes} == set()
    assert "part of the name of one of" in error_of("warm-up", "--device", "no such device")


CHIRP = clsim.Signal.chirp(30e3, 50e3, 0.002, RATE, window="tukey")
SIGNALS = {
    "with pauses": clsim.Signal.pulses(CHIRP, 0.03, 3),
    "without": clsim.Signal.chirp(20e3, 80e3, 0.1, RATE, window="tukey"),
}


@pytest.mark.parametrize("signal", SIGNALS.values(), ids=SIGNALS)
def test_other_numbers_of_functions_and_branches_need_no_other_sum(device: None, signal: clsim.Signal) -> None:
    def of_sum() -> set[tuple[str, tuple[str, ...]]]:
        texts = {kernel_source("render"), kernel_source("branches")}
        return {key for key in built() if key[0] in texts}

    known, functions, branches = [], [], []
    for error_db in (-60.0, -80.0):
        heard(signal, response_error_db=error_db)
        known.append(of_sum())
        plan = clsim.plan_render(paths_of(signal), RATE, response_error_db=error_db)
        functions.append(len(plan.source_filters[0].banks))
        branches.append({len(bank.taps) for bank in plan.source_filters[0].banks})
    assert functions[1] > functions[0] > 1
    assert branches[1] > branches[0]
    assert known[0] == known[1]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_building_is_told_once_and_on_a_terminal_only(device, monkeypatch, stream: type) -> None:
    compiler, shown = compiler_of(find_device(None)[1]), stream()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr("clsim.workflow.console._MOMENT", 0.0)
    anew = [f"-DOF_{stream.__name__}={i}" for i in range(2)]
    for i, option in enumerate(anew):
        assert ("emit", option) not in compiler._built
        with built_programs() as built:
            assert built.count == 0
            compiler._launch("emit", (option,))
            compiler._launch("emit", (option,))  # found
            assert built.count == 1
        assert shown.getvalue().count("building kernels (once)") == (i + 1) * (stream is Terminal)


TOY = """
def toy_arguments(parser):
    parser.add_argument("--number", type=int, required=True, help="what is doubled")


def toy(options):
    print(2 * options.number)
    return 0
"""


def test_a_command_is_one_file_and_its_line_in_the_list(tmp_path, monkeypatch, capsys, error_of) -> None:
    (tmp_path / "doubling.py").write_text(TOY, "utf-8")
    monkeypatch.setattr(clsim.commands, "__path__", [*clsim.commands.__path__, str(tmp_path)])
    monkeypatch.setitem(cli.COMMANDS, "toy", ("doubling", "double a number"))
    assert cli.main(["toy", "--number", "21"]) == 0
    assert capsys.readouterr().out == "42\n"
    assert error_of("toy", "--number", "x") == "--number: invalid int value: 'x'"
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
    module = import_module(f"clsim.commands.{cli.COMMANDS[name][0]}")
    assert getattr(module, name.replace("-", "_")).__doc__


def test_commands_are_those_that_are_listed() -> None:
    folder = Path(clsim.commands.__file__).parent
    found = [re.findall(r"^def (\w+)\(options", path.read_text("utf-8"), re.MULTILINE) for path in folder.glob("*.py")]
    assert {name.replace("_", "-") for names in found for name in names} >= set(cli.COMMANDS)
    added = [
        re.findall(r"^def (\w+)_arguments\(", path.read_text("utf-8"), re.MULTILINE) for path in folder.glob("*.py")
    ]
    assert {name.replace("_", "-") for names in added for name in names} == set(cli.COMMANDS)


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
def test_what_is_misspelt_is_asked_for(arguments: list[str], told: str, error_of) -> None:
    assert error_of(*arguments) == told


@pytest.mark.parametrize("arguments", [["--help"], [], ["nothing"]], ids=str)
def test_only_the_command_that_is_called_is_imported(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "import_module", lambda name: pytest.fail(f"{name} was imported"))
    if arguments != ["nothing"]:
        with pytest.raises(SystemExit, match="0"):
            cli.main(arguments)
    else:
        assert cli.main(arguments) == 2
