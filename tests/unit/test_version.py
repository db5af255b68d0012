"""One version, everywhere."""

import re
import tomllib
from pathlib import Path

import clsim
from clsim.version import __version__

ROOT = Path(__file__).parents[2]


def test_the_version_is_one() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    assert project["project"]["dynamic"] == ["version"]
    assert "version" not in project["project"]
    # What hatch reads, by the pattern that it looks for.
    path = ROOT / project["tool"]["hatch"]["version"]["path"]
    assert re.findall(r'(?m)^__version__ = "(.*)"$', path.read_text("utf-8")) == [__version__]
    assert re.findall(r"(?m)^version: (.*)$", (ROOT / "CITATION.cff").read_text("utf-8")) == [__version__]
    assert clsim.__version__ == __version__
    assert f"\n## {__version__}" in (ROOT / "CHANGELOG.md").read_text("utf-8")
