"""Structure: imports point up, heavy packages are imported late, files stay small, kernels say what they are."""

import ast
import io
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

import clsim

PACKAGE = Path(clsim.__file__).parent
LAYERS = [
    ("errors", "arrays", "version"),
    ("files", "numerics"),
    ("acoustics",),
    ("scene",),
    ("opencl",),
    ("paths",),
    ("tracks",),
    ("recording", "impulse_responses"),
    ("render",),
    ("output",),
    ("scene_file",),
    ("workflow",),
    ("study",),
    ("commands",),
    ("cli",),
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
FILES = sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")


def top_name(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_up(path: Path) -> None:
    rank = RANK[top_name(path)]
    tree = ast.parse(path.read_text("utf-8"))
    late = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        or (isinstance(function, ast.If) and "TYPE_CHECKING" in ast.dump(function.test))
        for node in ast.walk(function)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("clsim.") and id(node) not in late:
            assert RANK[node.module.split(".")[1]] <= rank, f"{path.name} imports {node.module}"


def test_import_loads_nothing_heavy() -> None:
    code = "import sys, clsim; print([m for m in ('pyopencl', 'matplotlib', 'pydantic', 'soundfile', 'xarray', 'distributed') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def code_lines(text: str) -> int:
    """Return the lines that hold code: no comments, no docstrings, nothing empty."""
    told = {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    silent = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    tokens = (t for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type not in silent)
    return len({line for t in tokens for line in range(t.start[0], t.end[0] + 1)} - told)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_files_are_small(path: Path) -> None:
    assert code_lines(path.read_text("utf-8")) <= 300


def test_public_names_are_documented_and_exist() -> None:
    for name in clsim.__all__:
        assert getattr(clsim, name).__doc__, name
