"""The way through the files of the package from a call to the first kernel: short, never back, and as it is told."""

import re
import traceback
from itertools import groupby
from pathlib import Path

import pytest
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.opencl.launch import Launch

PACKAGE = Path(clsim.__file__).parent
SCENE = scene_text(
    source_at("robot", tone_of(40e3, 0.01, fade=0.001), along((1, 1, 1), (1.1, 1, 1), 0.1)),
    receiver_at("ceiling", (2, 2, 2)),
)


class Launched(BaseException):
    """What is raised in place of the first launch."""


@pytest.fixture(autouse=True)
def stop_at_the_first_kernel(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise Launched

    monkeypatch.setattr(Launch, "__call__", stop)


def passed(caught: BaseException) -> list[str]:
    """Return the files of the package on the stack, in the order in which they were entered."""
    frames = traceback.extract_tb(caught.__traceback__)
    files = [Path(frame.filename) for frame in frames]
    inside = [str(file.relative_to(PACKAGE)) for file in files if file.is_relative_to(PACKAGE)]
    return [file for file, _ in groupby(inside)] + ["opencl/launch.py"]


def told(call: str) -> list[str]:
    """Return the walk of a call that docs/architecture.md tells of, "as above" told in full."""
    document = (PACKAGE.parent / "docs" / "architecture.md").read_text("utf-8")
    section = document.partition("## A walk")[2].partition("\n## ")[0]
    text = next(part for part in section.split("\n- ") if part.startswith(f"`{call}")).partition(". ")[0]
    files = re.findall(r"`([\w/]+\.py)", text)
    if "as above" in text:
        above = told("clsim.render(")
        files += above[above.index(files[-1]) + 1 :]
    return files


def check(walk: list[str], call: str) -> None:
    assert len(walk) < 12, walk
    assert len(set(walk)) == len(walk), walk
    assert walk == told(call)


def test_from_render(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    file = clsim.load_scene(tmp_path / "scene.toml")
    with pytest.raises(Launched) as caught:
        clsim.render(clsim.find_paths(file.scene, 1), 192e3)
    check(passed(caught.value), "clsim.render(")


def test_from_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    with pytest.raises(Launched) as caught:
        main(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), "--no-plots"])
    check(passed(caught.value), "clsim run scene.toml`")
