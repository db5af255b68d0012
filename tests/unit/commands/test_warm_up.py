"""Kernels built ahead, and told of: `clsim warm-up`, and one line on a terminal."""

import io
import re
import sys

import pytest

import clsim
from clsim.cli import main
from clsim.opencl.device import find_device
from clsim.opencl.kernels import kernel_source
from clsim.opencl.launch import compiler_of
from clsim.workflow.console import built_programs

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


def test_what_is_warmed_up_is_there_when_it_is_needed(device: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warm-up"]) == 0
    name = re.escape(find_device(None)[0].name)
    assert re.fullmatch(rf"\d+ programs are ready on {name}, in \d+\.\d s\n", capsys.readouterr().out)
    before = built()
    heard(clsim.Signal.tone(40e3, 0.1, RATE, fade=0.01))  # another room, other paths, another speed
    of_nodes = kernel_source("tracks")  # which knows how many functions of frequency there are
    assert {key for key in built() - before if key[0] != of_nodes} == set()
    assert main(["warm-up", "--device", "no such device"]) == 2
    assert "part of the name of one of" in capsys.readouterr().err


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
def test_building_is_told_once_and_on_a_terminal_only(
    device: None, monkeypatch: pytest.MonkeyPatch, stream: type
) -> None:
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
