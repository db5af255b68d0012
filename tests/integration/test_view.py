"""The interactive page: what it holds, and what a browser draws of it."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.paths.view import view_scene
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


@pytest.fixture(scope="module")
def opened(browser: Any, page: Path) -> Iterator[Any]:
    """Open the page."""
    tab = browser.new_page(viewport={"width": 560, "height": 400})
    tab.set_default_timeout(120_000)  # of machines that do much else
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(page.as_uri())
    tab.wait_for_function("window.clsim && window.clsim.ready.then(() => true)")
    yield tab
    tab.close()
    assert errors == []


@pytest.fixture
def browser_page(opened: Any) -> Any:
    """Give the page at its first frame."""
    opened.evaluate("clsim.show(0)")
    return opened


def heard(paths: clsim.PathSet, time: float) -> list[int]:
    """Return how many paths of each order are heard."""
    now = (paths.start <= time) & (time < paths.end)
    return np.bincount(paths.order[now], minlength=3).tolist()


@pytest.mark.exhaustive
def test_the_slider_moves_what_is_drawn(browser_page, paths: clsim.PathSet) -> None:
    before = browser_page.evaluate("clsim.state()")
    assert before["paths"] == heard(paths, 0.0)
    picture = browser_page.screenshot()
    slider = browser_page.locator("#time")
    slider.focus()
    for _ in range(15):
        slider.press("ArrowRight")
    browser_page.wait_for_function("clsim.state().index === 15")
    after = browser_page.evaluate("clsim.state()")
    time = 15 * 0.1
    assert after["paths"] == heard(paths, time) != before["paths"]
    assert after["text"] == f"t = 1.500 s: {sum(heard(paths, time))} paths heard"
    np.testing.assert_allclose(after["places"][0], [2.0 + 1.0 * time / 2, 8.0 - 6.0 * time / 2, 1.4], atol=1e-4)
    np.testing.assert_allclose(after["places"][1], [7, 1, 2], atol=1e-4)
    browser_page.wait_for_timeout(500)
    assert browser_page.screenshot() != picture


@pytest.mark.exhaustive
def test_paths_of_an_order_can_be_hidden(browser_page) -> None:
    names = browser_page.evaluate("clsim.state().names")
    assert {"reflection 0.9", "carpet </script>", "direct sound", "order 1", "order 2"} <= set(names)
    shown = [n for n in names if n not in ("edges", "way of robot")]
    toggle = browser_page.locator(".legendtoggle").nth(shown.index("order 2"))
    for visible in ("false", "true"):
        toggle.click()
        browser_page.wait_for_function(f"clsim.state().visible[{names.index('order 2')}] === {visible}")
        browser_page.wait_for_timeout(500)  # two clicks in a row would be a double click


@pytest.mark.exhaustive
def test_play_goes_through_the_frames(browser_page) -> None:
    browser_page.locator("#play").click()
    browser_page.wait_for_function("clsim.state().index >= 3")
    browser_page.locator("#play").click()
    assert browser_page.locator("#play").inner_text() == "play"
