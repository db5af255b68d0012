"""Rules of the language in docstrings and names: they name the thing, in the field's word."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sources import tree_of

import clsim

ROOT = Path(clsim.__file__).parents[1]
FOLDERS = ("clsim", "examples", "benchmarks", "tests", "docs/site")
EVASIVE = re.compile(r"Return (by )?(what|how|where|which|whether)\b|(Of|By how|For how|At most how)\b")
WORDS = 30  # of a sentence in the first paragraph
# Words that are none of the field, and those that are: the glossary and docs/architecture.md have these.
FOREIGN = {
    "way": "path, leg, length", "ways": "paths, legs, lengths", "told": "given", "tells": "states", "heard": "audible",
    "sounding": "emitting", "glint": "specular point", "look": "evaluation", "looks": "evaluations",
    "looked": "evaluated", "settled": "converged, decided", "asked": "requested", "worth": "cost-effective",
    "pays": "cost-effective", "lag": "delay offset", "partner": "adjacent", "partners": "adjacent",
    "unheld": "residual", "shortfall": "residual", "unshared": "without tables", "surroundings": "environment",
}  # fmt: skip
# Terms of the field or of Python's that hold such a word.
TERMS = {"two_way", "look_up"}
KINDS = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef


def files(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def documented(tree: ast.Module) -> Iterator[Any]:
    """Yield a module, its classes and functions, and those within them and within other statements."""
    left: list[Any] = [tree]
    while left:
        node = left.pop()
        if isinstance(node, KINDS):
            yield node
        for part in ("body", "orelse", "finalbody", "handlers"):
            left += getattr(node, part, [])


def faults(tree: ast.Module) -> list[str]:
    """Return the first paragraphs of docstrings that do not name the thing, or have long sentences."""
    docs = [ast.get_docstring(node) or "" for node in documented(tree)]
    heads = [" ".join(doc.split("\n\n")[0].split()) for doc in docs]
    return [head for head in heads if EVASIVE.match(head) or max(map(len, map(str.split, sentences(head)))) > WORDS]


def sentences(text: str) -> list[str]:
    return re.split(r"(?<=[.!?])\s", text)


def names(tree: ast.Module) -> Iterator[str]:
    """Yield the identifiers that a module makes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


def foreign(tree: ast.Module) -> set[str]:
    """Return the identifiers of a module that hold a foreign word."""
    made = set(names(tree)) - TERMS
    parts = {name: re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()) for name in made}
    return {name for name, words in parts.items() if FOREIGN.keys() & set(words)}


def test_docstrings_name_the_thing_in_short_sentences_and_the_package_is_in_the_fields_words() -> None:
    every, long, strange = files(*FOLDERS), [], []
    assert len(every) > 500
    for path in every:
        tree = tree_of(path) if path.is_relative_to(ROOT / "clsim") else ast.parse(path.read_text("utf-8"))
        long += [f"{path.name}: {head}" for head in faults(tree)]
        if path.is_relative_to(ROOT / "clsim"):
            strange += [f"{path.name}: {name}" for name in sorted(foreign(tree))]
    assert long == []
    assert strange == []


@pytest.mark.parametrize(
    "line",
    [
        "Return what is heard.", "Return by how much it grows.", "Return whether it is.", "Of a sphere, m.",
        f"A {'very ' * 30}.",
    ],
)  # fmt: skip
def test_what_does_not_name_it_is_seen(line: str) -> None:
    assert faults(ast.parse(f'class A:\n    def b(self):\n        """{line}\n\n        More.\n        """\n'))
    assert faults(ast.parse('class A:\n    """A thing.\n\n    Of which there are many.\n    """\n')) == []


@pytest.mark.parametrize(
    "text", ["asked_db = 3", "def name_way(): pass", "class MirrorLook: pass", "def f(told): pass", "a.heard = 1"]
)
def test_foreign_words_are_seen(text: str) -> None:
    assert len(foreign(ast.parse(text))) == 1
    assert foreign(ast.parse("two_way, always, task, lookup = 1, a.asked, 2, told")) == set()
