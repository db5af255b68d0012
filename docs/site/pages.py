"""Pages that are made: the reference of all public names, and what tests measured."""

import inspect
from collections.abc import Iterator
from pathlib import Path

import figures

import clsim

GROUPS = {
    "Scenes": "clsim.scene",
    "Paths": "clsim.paths",
    "Rendering": "clsim.render",
    "Other": "clsim",
}


def public_names() -> Iterator[tuple[str, str]]:
    """Yield the group and the full name of all that is public, scores included."""
    for name in clsim.__all__:
        home = getattr(clsim, name).__module__
        yield next(group for group, prefix in GROUPS.items() if home.startswith(prefix)), f"clsim.{name}"
    for name in clsim.score.__all__:
        yield "Scores", f"clsim.score.{name}"


def write_reference(folder: Path) -> None:
    """Write a page for each public name, and one that lists them."""
    folder.mkdir(exist_ok=True)
    listed: dict[str, list[str]] = {}
    for group, name in public_names():
        listed.setdefault(group, []).append(name)
        short = name.removeprefix("clsim.")
        module, _, last = name.rpartition(".")
        is_class = inspect.isclass(getattr(clsim.score if ".score." in name else clsim, last))
        kind = "autoclass" if is_class else "autofunction"
        text = f"{short}\n{'=' * len(short)}\n\n.. currentmodule:: {module}\n\n.. {kind}:: {last}\n"
        _write(folder / f"{short}.rst", text)
    parts = ["Reference", "=========", "", "All that is public.", ""]
    for group, names in listed.items():
        parts += [group, "-" * len(group), "", ".. toctree::", "   :maxdepth: 1", ""]
        parts += [*(f"   {name.removeprefix('clsim.')}" for name in sorted(names)), ""]
    _write(folder / "index.rst", "\n".join(parts))


# Pages that stand elsewhere in the repository, and their names on the site.
COPIES = {"CHANGELOG.md": "changes", "CONTRIBUTING.md": "contributing", "tests/README.md": "tests"}


def write_copies(docs: Path) -> None:
    """Write the pages that stand elsewhere, with links from where they are then."""
    root = Path(clsim.__file__).parents[1]
    for source, name in COPIES.items():
        text = (root / source).read_text("utf-8").replace("](benchmarks/", "](../benchmarks/")
        for other, page in COPIES.items():
            text = text.replace(f"]({other})", f"]({page}.md)")
        _write(docs / f"{name}.md", text.replace("](docs/", "](").replace("](../docs/", "]("))


def _write(path: Path, text: str) -> None:
    """Write a file whose text differs from what is there: what is the same need not be read again."""
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")


def write_validation(docs: Path, measured: str | None) -> None:
    """Write the page of the figures of the last run of the tests, as the fixture ``measured`` noted them."""
    lines = [
        "# Measured in this run", "",
        "The figures of the run of the tests that this site was built from; [validation](validation.md) names the oracles.", "",
    ]  # fmt: skip
    found = figures.noted(Path(measured)) if measured else {}
    lines += figures.table(found) if found else ["This site was built without a run of the tests."]
    _write(docs / "validation_run.md", "\n".join(lines) + "\n")
