"""Pages of scenes: what they hold, and what a browser makes of them."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from made_pages import data_of

import clsim
from clsim.paths.path_table import view_scene, viewed
from clsim.pictures.view_page import ViewedBody, ViewedEnd, ViewedPaths, ViewedWall, page_text

WALL = clsim.Material.from_reflection(0.9)
VIEW_L = [(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)]


def walk() -> clsim.PathSet:
    """Return the paths of a walk round the corner of an L-shaped room."""
    floor = clsim.Material.from_absorption([10e3, 90e3], [0.5, 0.6], name="carpet </script>")
    room = clsim.MeshRoom.from_plan(VIEW_L, 3.0, {"default": WALL, "floor": floor})
    way = clsim.Trajectory.line((2.0, 8.0, 1.4), (3.0, 2.0, 1.4), 2.0)
    tone = clsim.Signal.tone(40e3, 2.0, 192e3)
    ears = [clsim.Receiver(n, clsim.Trajectory.fixed(p)) for n, p in (("near", (7, 1, 2)), ("<far>", (1, 1, 2)))]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("robot", tone, way)], ears)
    return clsim.find_paths(scene, 2, engine="reference", resolution=1e-3)


@pytest.fixture(scope="module")
def paths() -> clsim.PathSet:
    return walk()


@pytest.fixture(scope="module")
def page_of_view(paths: clsim.PathSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "walk.html"
    view_scene(paths, path, duration=2.0, frames=21, title="a <b>walk</b>")
    return path


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


def test_the_page_is_that_of_what_is_viewed(paths: clsim.PathSet, page_of_view: Path) -> None:
    """Whose arrays `test_view_page.py` finds again in a browser."""
    text = page_text(title="a <b>walk</b>", **viewed(paths, duration=2.0, frames=21))
    assert page_of_view.read_text("utf-8") == text


def test_every_frame_has_what_is_heard_then(paths: clsim.PathSet, page_of_view: Path) -> None:
    data = data_of(page_of_view)
    np.testing.assert_allclose(data["times"], 0.1 * np.arange(21), atol=1e-9)
    assert data["marks"]["text"] == ["robot", "near", "<far>"]
    for time, frame, places in zip(data["times"], data["frames"], data["places"], strict=True):
        assert [len(part["labels"]) for part in frame] == heard(paths, time)
        np.testing.assert_allclose(places[0], [2.0 + 1.0 * time / 2, 8.0 - 6.0 * time / 2, 1.4], atol=0.501e-3)
        np.testing.assert_allclose(places[1:], [(7, 1, 2), (1, 1, 2)], atol=1e-9)
    assert heard(paths, 0.0) != heard(paths, 1.5)
    assert {"reflection 0.9", "carpet &lt;/script&gt;"} <= {trace["name"] for trace in data["fixed"]}
    assert [trace["name"] for trace in data["orders"]] == ["direct sound", "order 1", "order 2"]


L = np.array([(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)], dtype=float)
FAN = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
TIMES = np.linspace(0.0, 2.0, 11)
WAY = np.linspace((2.0, 8.0, 1.4), (3.0, 2.0, 1.4), len(TIMES))
EARS = {"near": (7.0, 1.0, 2.0), "<far> & {{data}}": (1.0, 1.0, 2.0)}
PLASTER, CARPET = "plaster {{plotly}}", "carpet </script><b>"
NO_PATHS = ViewedPaths.none()


def l_room() -> list[ViewedWall]:
    walls = []
    for w, (a, b) in enumerate(zip(L, np.roll(L, -1, axis=0), strict=True)):
        corners = np.array([(*a, 0), (*b, 0), (*b, 3), (*a, 3)])
        outline = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        walls.append(ViewedWall(f"wall {w}", PLASTER, corners[[(0, 1, 2), (0, 2, 3)]], outline))
    for name, height, material in (("floor", 0.0, CARPET), ("ceiling", 3.0, PLASTER)):
        corners = np.column_stack([L, np.full(len(L), height)])
        outline = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        walls.append(ViewedWall(name, material, corners[FAN], outline))
    return walls


def frame(index: int) -> ViewedPaths:
    """Return 2 direct paths, and a number of bent ones that differs from frame to frame."""
    rng = np.random.default_rng(index)
    corners, orders, labels, pairs = [], [], [], []
    for name, ear in EARS.items():
        for p in range(12 + index):
            order = 0 if p == 0 else 1 + p % 3
            bends = rng.uniform((0, 0, 0), (4, 9, 3), (order, 3))
            corners.append(np.vstack([WAY[index], bends, ear]))
            orders.append(order)
            labels.append(f"robot to {name}, path {p}: 12.31 ms")
            pairs.append(("robot", name))
    levels = -60.0 * rng.random(len(orders))
    return ViewedPaths(tuple(corners), np.array(orders, dtype=np.int32), tuple(labels), tuple(pairs), levels)


FRAMES = [frame(i) for i in range(len(TIMES))]


def ends() -> list[ViewedEnd]:
    seen = np.where(TIMES < 1.0, 1.0, np.nan)[:, None] * (5.0, 3.0, 1.0)
    fixed = [ViewedEnd(n, "receiver", np.tile(p, (len(TIMES), 1)), np.array([p])) for n, p in EARS.items()]
    ahead = np.tile((0.0, 1.0, 0.0), (len(TIMES), 1))
    return [
        ViewedEnd("robot", "source", WAY, WAY, ahead),
        *fixed,
        ViewedEnd("lost </script><script>", "receiver", seen, seen),
    ]


def bodies() -> list[ViewedBody]:
    """Return a tetrahedron that comes along and turns about an axis of no wall, and a sheet that rests."""
    c, s = np.cos(TIMES), np.sin(TIMES)
    zero, one = np.zeros_like(c), np.ones_like(c)
    about_z = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.0, -0.8, 0.6]])
    corners = np.array([(0, 0, 0), (0.5, 0, 0), (0, 0.6, 0), (0, 0, 0.7)])
    faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    sheet = np.array([(0, 0, 0), (0.8, 0, 0), (0, 0, 1.5)])
    still = np.tile((1.0, 6.0, 0.2), (len(TIMES), 1)), np.tile(np.eye(3), (len(TIMES), 1, 1))
    return [
        ViewedBody("cart <i>{{data}}", corners, faces, WAY - (0.3, 0.2, 1.0), tilt @ about_z),
        ViewedBody("door", sheet, np.array([(0, 1, 2)]), *still),
    ]


def write(path: Path, **changed: Any) -> Path:
    given = {
        "title": "a <b>walk</b> {{data}}", "walls": l_room(), "ends": ends(), "times": TIMES, "frames": FRAMES,
        "bodies": bodies(),
    }  # fmt: skip
    path.write_text(page_text(**(given | {"notes": ["air of 20 °C", "</script><i>note"]} | changed)), "utf-8")
    return path


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("page") / "walk.html")


def test_the_page_loads_nothing_and_texts_stay_texts(page: Path) -> None:
    text = page.read_text("utf-8")
    assert not re.search(r"<(script|link|img|iframe)[^>]*\s(src|href)\s*=", text)
    assert text.count("</script>") == text.count("<script") - text.count('"<script') == 3
    assert "<h1>a &lt;b&gt;walk&lt;/b&gt; {{data}}</h1>" in text
    assert "<p>&lt;/script&gt;&lt;i&gt;note</p>" in text
    assert [t["name"] for t in data_of(page)["fixed"] if t["type"] == "mesh3d"] == [
        "plaster {{plotly}}", "carpet &lt;/script&gt;&lt;b&gt;",
    ]  # fmt: skip


def test_the_page_holds_the_arrays_to_a_millimetre(page: Path) -> None:
    data = data_of(page)
    np.testing.assert_allclose(data["times"], TIMES, rtol=1e-8)
    for given, held in zip(FRAMES, data["frames"], strict=True):
        for order, part in enumerate(held):
            mine = np.concatenate([c for c, n in zip(given.vertices, given.order, strict=True) if n == order])
            np.testing.assert_allclose(np.reshape(part["mm"], (-1, 3)) / 1e3, mine, rtol=0.0, atol=0.501e-3)
    assert data["places"][0][3] == [5.0, 3.0, 1.0]
    assert data["places"][-1][3] == [None, None, None]


def test_materials_have_colours_of_their_own(tmp_path: Path) -> None:
    walls = [ViewedWall(f"w{i}", f"m{i}", np.zeros((1, 3, 3)), np.zeros((1, 2, 3))) for i in range(12)]
    fixed = data_of(write(tmp_path / "x.html", walls=walls))["fixed"]
    assert len({t["color"] for t in fixed if t["type"] == "mesh3d"}) == 12


def test_a_page_of_nothing_can_be_written(tmp_path: Path) -> None:
    data = data_of(write(tmp_path / "x.html", walls=[], ends=[], times=np.zeros(1), frames=[NO_PATHS], bodies=[]))
    assert data["fixed"] == []
    assert data["frames"] == [[{"mm": [], "labels": [], "source": [], "receiver": [], "level": []}]]


@pytest.fixture(scope="module")
def loaded(browser: Any, page: Path) -> Iterator[Any]:
    tab = browser.new_page(viewport={"width": 560, "height": 400})
    tab.set_default_timeout(120_000)  # of machines that do much else
    wrong: list[str] = []
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    tab.on("request", lambda request: wrong.append(request.url) if not request.url.startswith("file:") else None)
    tab.goto(page.as_uri())
    tab.wait_for_function("window.clsim && clsim.ready.then(() => true)")
    yield tab
    tab.close()  # else it goes on drawing
    assert [w for w in wrong if not w.startswith(("data:", "blob:"))] == []


@pytest.fixture
def tab(loaded: Any) -> Any:
    """Give the page at its first frame."""
    loaded.evaluate("clsim.show(0)")
    return loaded


def assert_drawn(tab: Any, index: int) -> None:
    """Compare plotly's own arrays with the frame that was given, bodies too."""
    state = tab.evaluate("clsim.state()")
    given = FRAMES[index]
    assert state["index"] == index
    assert state["paths"] == np.bincount(given.order, minlength=4).tolist()
    assert state["text"] == f"t = {TIMES[index]:.3f} s: {len(given.order)} active paths"
    np.testing.assert_allclose(state["places"][0], WAY[index], rtol=0.0, atol=0.501e-3)
    assert state["places"][3] == ([5, 3, 1] if TIMES[index] < 1.0 else [None] * 3)
    for seen, body in zip(state["bodies"], bodies(), strict=True):
        np.testing.assert_allclose(seen, body.corners(index), rtol=0.0, atol=1e-3)
    drawn = tab.evaluate("document.getElementById('drawing').data.slice(-4).map(t => [t.x, t.y, t.z])")
    for order, columns in enumerate(drawn):
        points = np.array(columns, dtype=float).T
        mine = [c for c, n in zip(given.vertices, given.order, strict=True) if n == order]
        gap = np.full((1, 3), np.nan)
        want = np.concatenate([part for c in mine for part in (c, gap)])
        np.testing.assert_allclose(points, want, rtol=0.0, atol=0.501e-3)


def picture(tab: Any) -> bytes:
    """Return the drawn state once plotly has finished: it draws changes in the next frame."""
    tab.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return bytes(tab.locator("#drawing").screenshot())


def test_the_slider_moves_what_is_drawn(tab: Any) -> None:
    assert_drawn(tab, 0)
    before = picture(tab)
    slider = tab.locator("#time")
    slider.focus()
    for _ in range(7):
        slider.press("ArrowRight")
    tab.wait_for_function("clsim.state().index === 7")
    assert_drawn(tab, 7)
    assert tab.locator("#caption").inner_text() == f"t = 1.400 s: {len(FRAMES[7].order)} active paths"
    moved = picture(tab)
    assert moved != before
    box = slider.bounding_box()
    tab.mouse.click(box["x"] + box["width"] - 3, box["y"] + box["height"] / 2)
    tab.wait_for_function("clsim.state().index === 10")
    assert_drawn(tab, 10)
    assert picture(tab) not in (before, moved)


@pytest.mark.parametrize("entry", few(["order 2", CARPET]))
def test_a_legend_entry_toggles_what_it_names(entry: str, tab: Any) -> None:
    names = tab.evaluate("clsim.state().names")
    mine = [names.index(entry)] + ([names.index(entry) + 1] if entry == CARPET else [])  # a material and its outlines
    toggle = tab.locator(".legend .traces").filter(has_text=entry).locator(".legendtoggle")
    before = picture(tab)
    for visible in (False, True):
        toggle.click()  # what follows is seen only when a second click would not be one of two in a row any more
        tab.wait_for_function(f"clsim.state().visible[{mine[0]}] === {str(visible).lower()}")
        state = tab.evaluate("clsim.state().visible")
        assert [i for i, shown in enumerate(state) if not shown] == ([] if visible else mine)
        assert visible or picture(tab) != before


def assert_hovered(tab: Any, point: Any, text: str) -> None:
    """Wait until the page tells a text where a point of the room, m, lies on the screen."""
    x, y = tab.evaluate(
        """point => {
          const sub = document.getElementById("drawing")._fullLayout.scene._scene, plot = sub.glplot;
          const {model, view, projection} = plot.cameraParams;
          let v = [...point.map((p, i) => p * sub.dataScale[i]), 1];
          for (const m of [model, view, projection]) v = [0, 1, 2, 3].map(
            r => [0, 1, 2, 3].reduce((sum, c) => sum + m[4 * c + r] * v[c], 0));
          const box = plot.canvas.getBoundingClientRect();
          return [box.x + box.width * (1 + v[0] / v[3]) / 2, box.y + box.height * (1 - v[1] / v[3]) / 2];
        }""",
        list(point),
    )
    tab.mouse.move(x - 40, y - 40)
    tab.mouse.move(x, y, steps=4)
    tab.locator("#drawing .hovertext").filter(has_text=text).wait_for(timeout=20_000)


@pytest.mark.exhaustive
def test_the_mouse_finds_paths_behind_walls_and_walls(tab: Any) -> None:
    near = FRAMES[0].vertices[0]
    assert_hovered(tab, 0.4 * near[0] + 0.6 * near[1], "robot to near, path")
    assert_hovered(tab, EARS["<far> & {{data}}"], "<far> & {{data}}")
    assert_hovered(tab, (7.7, 0.0, 0.3), f": {PLASTER}")


def test_filters_leave_the_paths_that_were_asked_for(tab: Any) -> None:
    given = FRAMES[0]
    order, to = given.order, np.array([receiver for _, receiver in given.pairs])
    tab.select_option("#receiver", label="near")
    state = tab.evaluate("clsim.state()")
    assert state["paths"] == np.bincount(order[to == "near"], minlength=4).tolist()
    tab.select_option("#order", label="up to 1")
    assert tab.evaluate("clsim.state().paths") == [1, np.sum((to == "near") & (order == 1)), 0, 0]
    tab.select_option("#receiver", label="all")
    tab.select_option("#order", label="all")
    tab.wait_for_function(f"clsim.state().text.includes(': {len(order)} active paths')")
    assert not tab.locator("#source").is_visible()  # of one source


def test_paths_are_coloured_by_their_levels(tab: Any) -> None:
    plain = picture(tab)
    tab.select_option("#colour", label="level")
    tab.wait_for_function("Array.isArray(document.getElementById('drawing').data.at(-1).line.color)")
    given = FRAMES[0]
    drawn = tab.evaluate("document.getElementById('drawing').data.at(-1).line.color")
    want = [
        v for level, n in zip(given.levels, given.order, strict=True) if n == 3 for v in (*[round(level, 1)] * 5, -60)
    ]
    np.testing.assert_allclose(drawn, want, atol=0.051)
    assert picture(tab) != plain
    tab.select_option("#colour", label="order")
    tab.wait_for_function("!Array.isArray(document.getElementById('drawing').data.at(-1).line.color)")


def test_aims_are_drawn_where_they_point(tab: Any) -> None:
    columns = tab.evaluate(
        "(t => [t.x, t.y, t.z])(document.getElementById('drawing').data.find(t => t.name === 'aims'))"
    )
    points = np.array(columns, dtype=float).T
    np.testing.assert_allclose(points[0], WAY[0], atol=0.501e-3)
    np.testing.assert_allclose(points[1] - points[0], [0.0, 0.06 * 9.0, 0.0], atol=1.1e-3)


def test_the_room_follows_the_window(tab: Any) -> None:
    for width in (420, 1000):
        tab.set_viewport_size({"width": width, "height": 400})
        tab.wait_for_function(
            f"Math.abs(document.querySelector('#drawing canvas').getBoundingClientRect().width - {width}) < 2"
        )
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
    tab.set_viewport_size({"width": 560, "height": 400})
    tab.wait_for_function("Math.abs(document.querySelector('#drawing canvas').getBoundingClientRect().width - 560) < 2")


def test_the_page_is_small(page: Path) -> None:
    assert page.stat().st_size < 2.1e6


@pytest.mark.exhaustive
def test_play_goes_on_until_pause(tab: Any) -> None:
    play = tab.locator("#play")
    play.click()
    assert play.inner_text() == "pause"
    tab.wait_for_function("clsim.state().index >= 3")
    play.click()
    assert play.inner_text() == "play"
    tab.wait_for_timeout(400)
    rests = tab.evaluate("clsim.state().index")
    tab.wait_for_timeout(400)
    assert tab.evaluate("clsim.state().index") == rests
    assert_drawn(tab, rests)


@pytest.mark.exhaustive
def test_a_scene_at_rest_has_no_slider_and_what_cannot_be_drawn_is_told(browser: Any, tmp_path: Path) -> None:
    """In a tab without WebGL, which is all that takes long: of the page all is there but the picture."""
    path = write(tmp_path / "x.html", ends=[], bodies=[], times=TIMES[:1], frames=FRAMES[:1])
    still = browser.new_page(viewport={"width": 400, "height": 300})
    still.set_default_timeout(120_000)
    wrong: list[str] = []
    still.on("pageerror", lambda error: wrong.append(str(error)))
    still.add_init_script(
        "const get = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
        "  return kind.includes('webgl') ? null : get.call(this, kind, ...more); };"
    )
    still.goto(path.as_uri())
    still.wait_for_function("window.clsim && clsim.ready.then(() => true)")
    assert not still.locator("#time").is_visible()
    assert not still.locator("#play").is_visible()
    assert still.evaluate("clsim.state().paths") == np.bincount(FRAMES[0].order, minlength=4).tolist()
    assert "WebGL is not supported" in still.locator("#drawing").inner_text()
    still.close()
    assert wrong == []
