"""Scripts of benchmarks and examples: all that they ask of clsim and of each other is there, though no test runs them."""

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path

import clsim

ROOT = Path(clsim.__file__).parents[1]
TWO_VERSIONS = "either.py"  # asks what an older version has, too
SCRIPTS = sorted([*(ROOT / "benchmarks").glob("*.py"), *(ROOT / "examples").glob("*.py")])


def has(module: str, name: str) -> bool:
    """Test that a module of clsim has a name, or that a module of that name exists."""
    try:
        found = importlib.import_module(module)
        return hasattr(found, name) or importlib.import_module(f"{module}.{name}") is not None
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("clsim"):
            raise
        return False


def defined(path: Path) -> set[str]:
    """Return the names that a script defines or imports itself."""
    found = set()
    for node in ast.parse(path.read_text("utf-8")).body:
        for name in ast.walk(node) if isinstance(node, ast.Assign | ast.AnnAssign) else [node]:
            if isinstance(name, ast.FunctionDef | ast.ClassDef):
                found.add(name.name)
            elif isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store):
                found.add(name.id)
    return found


def lost(path: Path) -> Iterator[str]:
    """Yield what a script asks for that there is not: of clsim, and of scripts beside it."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "clsim":
            if not has("clsim", node.attr):
                yield f"{path.name}:{node.lineno}: clsim.{node.attr}"
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names, beside = [alias.name for alias in node.names], path.with_name(f"{node.module}.py")
            if node.module.split(".")[0] == "clsim":
                missing = [name for name in names if not has(node.module, name)]
            else:
                missing = sorted(set(names) - defined(beside)) if beside.exists() else []
            yield from (f"{path.name}:{node.lineno}: {node.module}.{name}" for name in missing)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                package, _, module = alias.name.rpartition(".")
                if package.startswith("clsim") and not has(package, module):
                    yield f"{path.name}:{node.lineno}: {alias.name}"


def test_scripts_ask_for_nothing_that_is_gone() -> None:
    assert len(SCRIPTS) > 20
    assert [line for path in SCRIPTS if path.name != TWO_VERSIONS for line in lost(path)] == []


def test_what_is_gone_is_found(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("KEPT = 1\n\ndef call():\n    inner = 2\n", "utf-8")
    script = tmp_path / "script.py"
    script.write_text(
        "import clsim\nimport clsim.opencl.device\nimport clsim.nowhere\nfrom clsim.opencl import device, gone\n"
        "from clsim.nowhere import anything\nfrom beside import KEPT, call, inner\nclsim.Scene, clsim.NoScene\n",
        "utf-8",
    )
    assert sorted(line.split(": ")[1] for line in lost(script)) == [
        "beside.inner", "clsim.NoScene", "clsim.nowhere", "clsim.nowhere.anything", "clsim.opencl.gone",
    ]  # fmt: skip


def loose(path: Path) -> Iterator[str]:
    """Yield what a script does when it is imported, but for finding modules."""
    for node in ast.parse(path.read_text("utf-8")).body:
        calls = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
        if isinstance(node, ast.For | ast.While | ast.With) or calls:
            text = ast.unparse(node).splitlines()[0]
            if not text.startswith("sys.path."):
                yield f"{path.name}:{node.lineno}: {text:.80}"


def test_a_script_that_is_imported_does_nothing() -> None:
    """What it measures stands in functions, called where it is run as a script: others may import it."""
    assert [line for path in SCRIPTS for line in loose(path)] == []


def test_what_a_script_does_is_found(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(
        "import sys\nsys.path.insert(0, 'x')\nprint(1)\nfor x in ():\n    pass\n", "utf-8"
    )
    assert [line.split(": ")[1] for line in loose(tmp_path / "script.py")] == ["print(1)", "for x in ():"]
