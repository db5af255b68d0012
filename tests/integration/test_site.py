"""The documentation site: what it is made of is whole, and, where it was built, a browser opens it."""

import importlib.util
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import pytest
from pydantic import TypeAdapter

import clsim
from clsim.scene_file.model import kinds

ROOT = Path(clsim.__file__).parents[1]
SITE = ROOT / "out" / "site"
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.py"))


def loaded(name: str) -> ModuleType:
    folder = ROOT / "docs" / "site"
    if str(folder) not in sys.path:  # these files import each other
        sys.path.insert(0, str(folder))
    spec = importlib.util.spec_from_file_location(f"site_{name}", folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_page_of_scene_files_is_current() -> None:
    """Mend by ``python docs/site/scene_file.py``; a new key's text comes from the docstring of what it is given to."""
    made = loaded("scene_file")
    assert made.PAGE.read_text("utf-8") == made.page()


def test_every_key_is_told_and_its_example_is_what_the_key_takes() -> None:
    made = loaded("scene_file")
    for model in made.all_tables():
        told = made.meanings(model)
        for name, field in model.model_fields.items():
            assert told.get(name, "").strip(), f"{model.__name__}.{name} has no text"
            example = made.example_of(model, name)
            if "…" not in example and not example.startswith("[["):
                held = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
                assert TypeAdapter(held).validate_python(tomllib.loads(example)[name]) is not None, example
            assert example.startswith("[[") == (made.type_of(field.annotation) == "list of tables"), example
    rows = dict(
        re.findall(r"^\| `(\w+)` \|.*\| ([^|]*) \| [^|]* \| [^|]* \|$", made.PAGE.read_text("utf-8"), re.MULTILINE)
    )
    wanted = {"sampling_rate": "Hz", "duration": "s", "low_cut": "Hz", "self_noise_db": "dB", "translate": "m"}
    assert {name: rows[name] for name in wanted} == wanted
    assert {"tum", "euroc", "csv"} <= set(re.findall(r'"(\w+)"', made.PAGE.read_text("utf-8")))
    assert len({kind for model in made.all_tables() for kind in kinds(model)}) > 20


def test_the_reference_has_every_public_name(tmp_path: Path) -> None:
    loaded("pages").write_reference(tmp_path)
    index = (tmp_path / "index.rst").read_text("utf-8")
    for name in [*clsim.__all__, *(f"score.{name}" for name in clsim.score.__all__)]:
        assert f"   {name}\n" in index
        assert f":: {name.rpartition('.')[2]}\n" in (tmp_path / f"{name}.rst").read_text("utf-8")


def test_tutorials_draw_and_check_themselves() -> None:
    assert len(TUTORIALS) == 8
    for path in TUTORIALS:
        text = path.read_text("utf-8")
        assert re.search(r"^(    )?assert |^np.testing.assert", text, re.MULTILINE), f"{path.name} checks nothing"
        assert "pyplot" in text or ".spectrogram(" in text or ".plot()" in text, f"{path.name} draws nothing"


@pytest.fixture
def tab(browser: Any) -> Iterator[Any]:
    if not (SITE / "index.html").exists():
        pytest.skip("the site is not built: make docs")
    page = browser.new_page()
    page.set_default_timeout(120_000)
    yield page
    page.close()


@pytest.mark.parametrize("width", [1280, 400])
def test_pages_of_the_site_fit_the_window_and_load_nothing_from_elsewhere(tab: Any, width: int) -> None:
    wrong: list[str] = []
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.on("requestfailed", lambda request: wrong.append(request.url))
    tab.on(
        "request", lambda request: wrong.append(request.url) if not request.url.startswith(("file:", "data:")) else None
    )
    tab.set_viewport_size({"width": width, "height": 800})
    for page in [
        *sorted(SITE.glob("*.html")),
        SITE / "gallery" / "1_circle_and_doppler.html",
        SITE / "api" / "Scene.html",
    ]:
        if page.stem not in ("genindex", "search"):
            tab.goto(page.as_uri())
            assert tab.locator("h1").first.inner_text()
            tab.evaluate("window.MathJax ? MathJax.startup.promise : null")
            if tab.evaluate("document.documentElement.scrollWidth") > width:
                wrong.append(f"{page.name} is wider than {width} pixels")
            if tab.locator("mjx-merror").count():
                wrong.append(f"{page.name} has a formula that MathJax cannot read")
    tab.goto((SITE / "gallery" / "1_circle_and_doppler.html").as_uri())
    picture = tab.locator("article img").first
    assert picture.evaluate("image => image.complete && image.naturalWidth > 300")
    assert wrong == []


def test_viewers_and_sounds_stand_in_pages_and_are_made() -> None:
    made = loaded("media")
    named = [found for page in (ROOT / "docs").glob("*.md") for found in made.COMMENT.findall(page.read_text("utf-8"))]
    assert {name for kind, name in named if kind == "viewer"} == {*made.VIEWERS, "listener"}
    assert {name for kind, name in named if kind == "sound"} == {*made.SOUNDS}
    text = made.embedded("A door:\n\n<!-- viewer: door -->\n\n<!-- sound: chirp -->\n")
    assert text.count("```{raw} html") == 2
    assert 'src="media/door.html"' in text
    assert 'src="media/chirp.flac"' in text


def test_the_site_is_small_and_holds_its_media() -> None:
    if not (SITE / "index.html").exists():
        pytest.skip("the site is not built: make docs")
    assert sum(path.stat().st_size for path in SITE.rglob("*") if path.is_file()) < 40e6
    for page in SITE.glob("*.html"):
        for source in re.findall(r'src="(media/[^"]*)"', page.read_text("utf-8")):
            assert (SITE / source).stat().st_size > 1000, f"{page.name}: {source}"


def test_no_page_of_the_site_names_an_address_elsewhere() -> None:
    if not (SITE / "index.html").exists():
        pytest.skip("the site is not built: make docs")
    for page in SITE.rglob("*.html"):
        found = re.findall(r"<(?:a|script|link|img)\b[^>]*(?:href|src)=\"(https?://[^\"]*)", page.read_text("utf-8"))
        assert found == [], page
