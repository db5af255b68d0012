"""Origin of warnings, former names, kinds that are refused, short reprs, one version."""

import re
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.errors import counted
from clsim.version import __version__


def never() -> Any:
    raise AssertionError("made again")


@pytest.mark.parametrize("turn", [0, 1])
def test_what_was_made_is_not_made_again(turn: int, once) -> None:
    name = f"a list of {turn}"
    assert once(name, lambda: [turn]) == once(name, never) == [turn]
    with pytest.raises(AssertionError, match="made again"):
        once(f"{name}, not made yet", never)


def test_reprs_are_short() -> None:
    times = np.linspace(0.0, 1.0, 200)
    way = clsim.Trajectory.waypoints(times, np.column_stack([1.0 + times, 1.0 + 0.0 * times, 1.0 + 0.0 * times]))
    source = clsim.Source("robot", clsim.Signal.from_array(np.sin(np.arange(9600.0)), 96e3), way)
    ears = clsim.receiver_array("ceiling", clsim.grid_positions((0.5, 5.5, 20), (0.5, 3.5, 10), 2.3))
    box = clsim.Shoebox((6.0, 4.0, 2.5), clsim.Material.from_reflection(0.8))
    scene = clsim.Scene(box, clsim.Air(), [source], ears)
    paths = clsim.find_paths(scene, 1)
    values = [
        scene, box, box.as_mesh(), source, source.signal, ears[0], paths, paths.table([0.0, 0.5]), clsim.track(paths),
    ]  # fmt: skip
    for value in values:
        shown = repr(value)
        assert shown.startswith(f"{type(value).__name__}("), shown
        assert len(shown) < 600, shown
        assert "\n" not in shown
    assert repr(scene).startswith("Scene(room=Shoebox(")
    assert "<200 Receiver>" in repr(scene)


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


def test_warnings_name_the_line_outside_that_called() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        clsim.Air(temperature_celsius=35.0)
        tone = clsim.Signal.tone(40.0, 0.5, 8e3)  # looks like kHz
        source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
        receiver = clsim.Receiver("r", clsim.Trajectory.fixed((2.0, 2.0, 2.0)))
        room = clsim.Shoebox((4000.0, 3000.0, 2500.0), clsim.Material.from_reflection(0.9))
        scene = clsim.Scene(room, clsim.Air(), [source], [receiver])
        clsim.render(clsim.find_paths(scene, 0), 8e3, duration=0.1, engine="reference")
    assert len(caught) >= 2
    assert {w.filename for w in caught} == {__file__}
    assert all(issubclass(w.category, clsim.ClsimWarning) for w in caught)
    with pytest.raises(clsim.ClsimWarning, match="Cramer"):
        clsim.Air(temperature_celsius=35.0)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("direct_truth", "direct_path"),
        ("SphericalTable", "SphericalDirectivity"),
        ("DirectivityTable", "AxialDirectivity"),
    ],
)
def test_a_name_of_an_earlier_version_is_the_new_one_and_warns(old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"clsim.{old} is called clsim.{new} since version 0.2") as caught:
        assert getattr(clsim, old) is getattr(clsim, new)
    assert caught[0].filename == __file__
    assert old not in dir(clsim)
    with pytest.warns(DeprecationWarning, match=old) as caught:
        exec(compile(f"from clsim import {old}", "mine.py", "exec"), {"__name__": "mine"})
    assert {w.filename for w in caught} == {"mine.py"}


def test_former_names_of_attributes_warn_and_give_the_new_ones() -> None:
    source = clsim.Source("s", clsim.Signal.tone(1e3, 0.5, 8e3), clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((2.0, 2.0, 2.0)))
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [receiver]), 1)
    table = paths.table(np.array([0.1]))
    with pytest.warns(
        DeprecationWarning, match=r"clsim.PathTable.heard is called clsim.PathTable.audible since"
    ) as caught:
        np.testing.assert_array_equal(table.heard, table.audible)
    assert caught[0].filename == __file__
    with pytest.warns(DeprecationWarning, match="name_objects"):
        assert table.name_way(1) == table.name_objects(1)
    with pytest.warns(DeprecationWarning, match="at_receiver"):
        assert len(paths.heard_by(0)) == len(paths.at_receiver(0)) == 7
    with pytest.raises(AttributeError, match="'PathTable' object has no attribute 'nothing'"):
        table.nothing  # noqa: B018


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: clsim.write_flac(3, "out"), "recording: must be a Recording, but is 3"),
        (lambda: clsim.write_mat(3, "a.mat"), "recording: must be a Recording, but is 3"),
        (lambda: clsim.direct_path(3, [0.0]), "paths: must be a PathSet, but is 3"),
        (lambda: clsim.score.ranging(3, None), "recording: must be a Recording, but is 3"),
        (lambda: clsim.track(3), "paths: must be a PathSet, but is 3"),
        (lambda: clsim.render(3, 48e3), "paths: must be a PathSet, but is 3"),
        (
            lambda: clsim.RenderOptions(48e3, engine=np.zeros(2)),
            r'engine: must be one of "opencl", "reference", but is array\(.*',
        ),
        (lambda: clsim.find_paths(3, 0), "scene: must be a Scene, but is 3"),
        (lambda: clsim.MeshRoom.joined(3), "parts: must be a list of at least one room, but is 3"),
        (lambda: clsim.MeshRoom.joined([]), r"parts: must be a list of at least one room, but is \[\]"),
        (lambda: clsim.render_tracks([], 3, 48e3), "tracks: must be Tracks, but is 3"),
    ],
)
def test_what_is_of_another_kind_is_told_so(call: Callable[[], object], message: str) -> None:
    with pytest.raises(clsim.InputError, match=f"^{message}$"):
        call()


def test_one_thing_is_not_things() -> None:
    assert [counted(n, "path") for n in (0, 1, 2)] == ["0 paths", "1 path", "2 paths"]
