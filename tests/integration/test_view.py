"""The interactive page of a scene: what it holds. What a browser draws of it, `test_view_page.py` tells."""

import re
from pathlib import Path

import numpy as np
import pytest
from made_pages import data_of

import clsim
from clsim.paths.view import view_scene, viewed
from clsim.pictures.view_page import ViewedEnd, ViewedPaths, ViewedWall, page_text

WALL = clsim.Material.from_reflection(0.9)
L = [(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)]


def walk() -> clsim.PathSet:
    """Return the paths of a walk round the corner of an L-shaped room."""
    floor = clsim.Material.from_absorption([10e3, 90e3], [0.5, 0.6], name="carpet </script>")
    room = clsim.MeshRoom.from_plan(L, 3.0, {"default": WALL, "floor": floor})
    way = clsim.Trajectory.line((2.0, 8.0, 1.4), (3.0, 2.0, 1.4), 2.0)
    tone = clsim.Signal.tone(40e3, 2.0, 192e3)
    ears = [clsim.Receiver(n, clsim.Trajectory.fixed(p)) for n, p in (("near", (7, 1, 2)), ("<far>", (1, 1, 2)))]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("robot", tone, way)], ears)
    return clsim.find_paths(scene, 2, engine="reference", resolution=1e-3)


@pytest.fixture(scope="module")
def paths() -> clsim.PathSet:
    return walk()


@pytest.fixture(scope="module")
def page(paths: clsim.PathSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "walk.html"
    view_scene(paths, path, duration=2.0, frames=21, title="a <b>walk</b>")
    return path


def test_the_page_needs_nothing_else(page: Path) -> None:
    text = page.read_text("utf-8")
    assert not re.search(r"<(script|link|img)[^>]*\s(src|href)\s*=", text)
    assert "<b>walk" not in text
    assert "&lt;b&gt;walk" in text
    # No text of the scene ends the script that holds it.
    data = text.split('<script id="data" type="application/json">')[1].split("</script>")[0]
    assert data.endswith("}")
    assert "carpet" in data


def test_frames_must_fit() -> None:
    wall = ViewedWall("w", "m", np.zeros((1, 3, 3)), np.zeros((1, 2, 3)))
    end = ViewedEnd("s", "source", np.zeros((1, 3)), np.zeros((1, 3)))
    none = ViewedPaths.none()
    with pytest.raises(clsim.InputError, match="frames: must be one per time, 2"):
        page_text(title="t", walls=[wall], ends=[end], times=np.array([0.0, 1.0]), frames=[none, none])
    pair = ViewedEnd("s", "source", np.zeros((2, 3)), np.zeros((1, 3)))
    with pytest.raises(clsim.InputError, match="times: must increase"):
        page_text(title="t", walls=[wall], ends=[pair], times=np.zeros(2), frames=[none, none])


def test_a_failure_leaves_the_old_page(paths: clsim.PathSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.html"
    path.write_text("old")

    def fail(self: Path, text: str, encoding: str) -> None:
        self.write_bytes(text[:9].encode(encoding))
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(OSError, match="disk full"):
        view_scene(paths, path, duration=0.5, frames=2)
    assert [p.name for p in tmp_path.iterdir()] == ["x.html"]
    assert path.read_bytes() == b"old"


def test_a_scene_at_rest_has_one_frame(tmp_path: Path) -> None:
    scene = clsim.Scene(
        clsim.Shoebox((8, 6, 3), WALL), clsim.Air(),
        [clsim.Source("s", clsim.Signal.tone(40e3, 1.0, 192e3), clsim.Trajectory.fixed((2, 2, 1)))],
        [clsim.Receiver("r", clsim.Trajectory.fixed((7, 3, 1.6)))],
    )  # fmt: skip
    view_scene(clsim.find_paths(scene, 1), tmp_path / "x.html", duration=1.0)
    assert '"times":[0.0]' in (tmp_path / "x.html").read_text("utf-8")


def heard(paths: clsim.PathSet, time: float) -> list[int]:
    """Return the number of active paths of each order."""
    now = (paths.start <= time) & (time < paths.end)
    return np.bincount(paths.order[now], minlength=3).tolist()


def test_the_page_is_that_of_what_is_viewed(paths: clsim.PathSet, page: Path) -> None:
    """Whose arrays `test_view_page.py` finds again in a browser."""
    view = viewed(paths, duration=2.0, frames=21)
    parts = {"walls": view.walls, "ends": view.ends, "times": view.times, "frames": view.frames, "notes": view.notes}
    text = page_text(title="a <b>walk</b>", **parts, edges=view.edges, bodies=view.bodies)
    assert page.read_text("utf-8") == text


def test_every_frame_has_what_is_heard_then(paths: clsim.PathSet, page: Path) -> None:
    data = data_of(page)
    np.testing.assert_allclose(data["times"], 0.1 * np.arange(21), atol=1e-9)
    assert data["marks"]["text"] == ["robot", "near", "<far>"]
    for time, frame, places in zip(data["times"], data["frames"], data["places"], strict=True):
        assert [len(part["labels"]) for part in frame] == heard(paths, time)
        np.testing.assert_allclose(places[0], [2.0 + 1.0 * time / 2, 8.0 - 6.0 * time / 2, 1.4], atol=0.501e-3)
        np.testing.assert_allclose(places[1:], [(7, 1, 2), (1, 1, 2)], atol=1e-9)
    assert heard(paths, 0.0) != heard(paths, 1.5)
    assert {"reflection 0.9", "carpet &lt;/script&gt;"} <= {trace["name"] for trace in data["fixed"]}
    assert [trace["name"] for trace in data["orders"]] == ["direct sound", "order 1", "order 2"]
