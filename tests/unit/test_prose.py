"""Rules of the language in docstrings: they name the thing, in short sentences."""

import ast
import re
from pathlib import Path

import pytest

import clsim

ROOT = Path(clsim.__file__).parents[1]
FOLDERS = ("clsim", "examples", "benchmarks", "tests", "docs/site")
EVASIVE = re.compile(r"Return (by )?(what|how|where|which|whether)\b|(Of|By how|For how|At most how)\b")
WORDS = 30  # of a sentence in the first paragraph
KINDS = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef


def files(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def faults(text: str) -> list[str]:
    """Return the first paragraphs of docstrings that do not name the thing, or have long sentences."""
    docs = [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(text)) if isinstance(node, KINDS)]
    heads = [" ".join(doc.split("\n\n")[0].split()) for doc in docs]
    return [head for head in heads if EVASIVE.match(head) or max(map(len, map(str.split, sentences(head)))) > WORDS]


def sentences(text: str) -> list[str]:
    return re.split(r"(?<=[.!?])\s", text)


def test_docstrings_name_the_thing_in_short_sentences() -> None:
    every = files(*FOLDERS)
    assert len(every) > 600
    assert [f"{path.name}: {head}" for path in every for head in faults(path.read_text("utf-8"))] == []


@pytest.mark.parametrize(
    "line",
    [
        "Return what is heard.",
        "Return by how much it grows.",
        "Return whether it is.",
        "Of a sphere, m.",
        f"A {'very ' * 30}.",
    ],
)
def test_what_does_not_name_it_is_seen(line: str) -> None:
    assert faults(f'class A:\n    def b(self):\n        """{line}\n\n        More.\n        """\n')
    assert faults('class A:\n    """A thing.\n\n    Of which there are many.\n    """\n') == []
