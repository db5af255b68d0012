"""Examples in docstrings give what they say."""

import doctest
import importlib
from pathlib import Path

import pytest

import clsim

PACKAGE = Path(clsim.__file__).parent
WITH_EXAMPLES = [path for path in sorted(PACKAGE.rglob("*.py")) if ">>> " in path.read_text("utf-8")]


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=module_name)
def test_examples_give_what_they_say(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module = importlib.import_module(module_name(path))
    failed, tried = doctest.testmod(module)
    assert tried > 0, "none is found"
    assert failed == 0, capsys.readouterr().out


def test_a_wrong_example_fails(capsys: pytest.CaptureFixture[str]) -> None:
    example = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "wrong", None, 0)
    assert doctest.DocTestRunner().run(example).failed == 1
    assert "Expected:\n    3\nGot:\n    2" in capsys.readouterr().out
