"""The files that a value passes through on its way do not become more: figures of `benchmarks/stops.py`."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "stops.py"


@pytest.mark.exhaustive
def test_scene_and_paths_pass_through_no_more_files_than_they_did(device: None) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", SCRIPT, "--route"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_stops_files_and_returns_are_counted() -> None:
    """A stack made by hand: the first call is in one file, the second in another, the third in the first again."""
    spec = importlib.util.spec_from_file_location("stops", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    stops = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(stops)
    package = str(stops.PACKAGE)
    space = [{"__name__": "clsim.a"}, {"__name__": "clsim.b"}]
    first = (
        "class Built:\n    def __init__(self, of): self.of = of\n    def asked(self): return 1\n"
        "def third(it): return it[0].asked()\ndef unrelated(it): return it\n"
        "def first(value):\n    unrelated(7)\n    return second(Built(value))\n"
    )
    exec(compile(first, f"{package}/a.py", "exec"), space[0])
    exec(compile("def second(built): return third([built])\n", f"{package}/b.py", "exec"), space[1])
    space[0]["second"], space[1]["third"] = space[1]["second"], space[0]["third"]
    route, result = stops.followed(space[0]["first"], object())
    assert result == 1
    assert route.stops() == [("a.py", ["first", "Built.__init__"]), ("b.py", ["second"]), ("a.py", ["third"])]
    assert route.figures() == (3, 2, 1)
