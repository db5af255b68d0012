"""Rules of the language in docstrings: they name the thing that a function gives."""

import ast
import re
from pathlib import Path

import pytest

import clsim

EVASIVE = re.compile(r"Return (by )?(what|how|where|which|whether)\b")


def evasive(text: str) -> list[str]:
    """Return the first lines of docstrings that describe a thing in place of naming it."""
    kinds = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
    found = [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(text)) if isinstance(node, kinds)]
    return [doc.splitlines()[0] for doc in found if EVASIVE.match(doc)]


def test_docstrings_name_the_thing() -> None:
    files = list(Path(clsim.__file__).parent.rglob("*.py"))
    assert len(files) > 100
    assert [f"{path.name}: {line}" for path in files for line in evasive(path.read_text("utf-8"))] == []


@pytest.mark.parametrize("line", ["Return what is heard.", "Return by how much it grows.", "Return whether it is."])
def test_what_does_not_name_it_is_seen(line: str) -> None:
    assert evasive(f'class A:\n    def b(self):\n        """{line}\n\n        More.\n        """\n') == [line]
