"""`clsim devices --test`: parity and rates in one line, and a device that is wrong is told."""

import pytest

from clsim.cli import main
from clsim.opencl import launch as compiler_module
from clsim.workflow import device_test

pytestmark = pytest.mark.usefixtures("device")


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer paths and scenes: all of it is under a minute, but not much."""
    plans = device_test._plans
    some = ("pulses", "paths that come and go")
    monkeypatch.setattr(device_test, "_plans", lambda device: {k: v for k, v in plans(device).items() if k in some})
    monkeypatch.setattr(device_test, "_ORDER", 2)


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


def test_an_unknown_device_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices", "--test", "no such thing"]) == 2
    assert "part of the name of one of" in capsys.readouterr().err
