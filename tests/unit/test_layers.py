"""Structure: imports point down, there is no cycle, heavy packages come late, files and functions stay small."""

import ast
import importlib
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest
from sources import tree_of

import clsim

PACKAGE = Path(clsim.__file__).parent
ROOT = PACKAGE.parent
LAYERS = [
    ("errors", "arrays", "keywords", "plugins", "process", "version"),
    ("files", "numerics"),
    ("pictures",),
    ("acoustics",),
    ("scene",),
    ("opencl",),
    ("paths",),
    ("tracks",),
    ("tail",),
    ("recording", "impulse_responses"),
    ("room_measures",),
    ("render",),
    ("sensitivity",),
    ("score",),
    ("output",),
    ("exchange",),
    ("scene_file",),
    ("workflow",),
    ("study",),
    ("measured", "torch"),
    ("commands",),
    ("cli",),
    ("__main__",),
    ("__init__",),
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
FILES = sorted(PACKAGE.rglob("*.py"))
KERNELS = sorted(p for p in (ROOT / "kernels").rglob("*") if p.suffix in (".cl", ".h"))
FILE_LINES, FUNCTION_LINES, KERNEL_LINES = 300, 40, 150
# An import that points up, and why it must: at most five.
UPWARD: dict[tuple[str, str], str] = {}
# Who imports a module by a name that is made up as it runs, and which; all else is seen in the text.
BY_NAME = {
    "__init__.py": "public names, when they are first asked for",
    "cli.py": "the command that is called",
    "study/content.py": "the user's own metrics",
}
# Of whose classes nobody outside asks what a value is one of: what differs by kind is the package's own.
HOMES = ("scene/room", "tracks")


def place(path: Path, node: ast.AST | None = None) -> str:
    return f"{path.relative_to(ROOT)}" + (f":{node.lineno}" if node is not None else "")


def none(found: Iterable[str]) -> None:
    """Fail with a line for each thing found."""
    listed = sorted(found)
    assert not listed, "\n".join([f"{len(listed)} found", *listed])


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in FILES}


def rank(module: str) -> int:
    return RANK[module.split(".")[1] if "." in module else "__init__"]


def statements(tree: ast.Module) -> Iterable[ast.AST]:
    """Yield all statements, those within others too; none of their expressions, which are most of a tree."""
    left: list[ast.AST] = [tree]
    while left:
        node = left.pop()
        yield node
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            left += getattr(node, part, [])


def imported(path: Path) -> set[str]:
    """Return the modules of clsim that a file imports anywhere: inside functions and for types alone, too."""
    found = set()
    for node in statements(tree_of(path)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{place(path, node)} imports relatively"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in MODULES else str(node.module) for name in names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name in MODULES and name != module_name(path)}


@cache
def graph() -> dict[str, set[str]]:
    """Return the imports of each module; made when a test asks, since every process collects this file."""
    return {name: imported(path) for name, path in MODULES.items()}


def test_every_module_has_a_layer() -> None:
    assert {(name.split(".")[1] if "." in name else "__init__") for name in MODULES} == set(RANK)


def test_imports_point_down() -> None:
    upward = {(name, other) for name, others in graph().items() for other in others if rank(other) > rank(name)}
    assert len(UPWARD) <= 5
    none(f"{a} imports {b}" for a, b in upward - set(UPWARD))
    assert set(UPWARD) <= upward, "what is allowed and not needed"


def test_what_is_imported_by_name_is_listed() -> None:
    found = {
        str(path.relative_to(PACKAGE))
        for path in FILES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__")
    }
    assert found == BY_NAME.keys()


def reaches(module: str) -> set[str]:
    """Return all that a module imports, and what that imports."""
    found, left = set(), [module]
    while left:
        new = graph()[left.pop()] - found
        found |= new
        left += new
    return found


def test_no_module_imports_itself_by_others() -> None:
    every = {name: reaches(name) for name in graph()}
    cycles = {tuple(sorted(m for m in every[name] if name in every[m])) for name in graph() if name in every[name]}
    none(" <-> ".join(cycle) for cycle in cycles)


def test_no_package_imports_itself_by_others() -> None:
    def package(module: str) -> str:
        return ".".join(module.split(".")[:2])

    above = {package(name): set() for name in MODULES}
    for name, others in graph().items():
        above[package(name)] |= {package(other) for other in others} - {package(name)}
    while free := [name for name, others in above.items() if not others]:
        above = {name: others - set(free) for name, others in above.items() if name not in free}
    none(f"{name} <-> {', '.join(sorted(others))}" for name, others in above.items())


def loaded_by(code: str) -> set[str]:
    """Return the modules that a process holds which has run a code and does not come with Python."""
    shown = f"{code}\nimport sys; print(*sys.modules, file=sys.stderr)"
    out = subprocess.run(
        [sys.executable, "-I", "-c", f"import sys; sys.path[:0] = {sys.path!r}\n{shown}"],
        capture_output=True,
        text=True,
        check=True,
    )
    return {name for name in out.stderr.split() if name.partition(".")[0] not in sys.stdlib_module_names}


def test_import_loads_nothing_but_itself() -> None:
    before = loaded_by("")  # what the environment imports into every process
    assert loaded_by("import clsim") - before == {"clsim", "clsim.process", "clsim.version"}


def test_help_loads_no_command() -> None:
    loaded = loaded_by("from clsim.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass") - loaded_by("")
    assert loaded == {
        "clsim",
        "clsim.process",
        "clsim.version",
        "clsim.errors",
        "clsim.cli",
        "clsim.files",
        "clsim.files.input_files",
        "clsim.workflow",
        "clsim.workflow.console",
        "clsim.commands",
        "clsim.scene_file",
    }


def test_a_run_without_pictures_loads_nothing_that_draws(tmp_path: Path) -> None:
    arguments = [
        "run", str(ROOT / "examples/circle.toml"), "-o", str(tmp_path / "out"), "--duration", "0.01", "--no-plots",
    ]  # fmt: skip
    loaded = loaded_by(f"from clsim.cli import main\nassert main({[*arguments, '--engine', 'reference']!r}) == 0")
    late = {"matplotlib", "trimesh", "xarray", "zarr", "h5py", "dask", "scipy.signal", "scipy.interpolate", "pyopencl"}
    assert "clsim.render.methods.per_sample" in loaded
    none(f"{name} is loaded" for name in late & loaded)


def test_public_names_are_those_of_the_stub() -> None:
    stub = next(n for n in ast.parse((PACKAGE / "__init__.pyi").read_text("utf-8")).body if isinstance(n, ast.Assign))
    assert clsim.__all__ == ast.literal_eval(stub.value)
    importlib.import_module("clsim.render.options")  # of a package that a public function is called as
    assert all(not isinstance(getattr(clsim, name), ModuleType) for name in clsim.__all__)
    assert set(clsim.__all__) <= set(dir(clsim))
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        clsim.nothing  # noqa: B018


@cache
def code_lines(path: Path) -> frozenset[int]:
    """Return the lines that hold code: no comments, no docstrings, nothing empty."""
    text = path.read_text("utf-8")
    told = {
        line
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    silent = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    tokens = (t for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type not in silent)
    return frozenset({line for t in tokens for line in range(t.start[0], t.end[0] + 1)} - told)


def kernel_code(text: str) -> int:
    """Return the number of lines of code in a kernel file."""
    bare = re.sub(r"/\*.*?\*/", lambda comment: "\n" * comment[0].count("\n"), text, flags=re.DOTALL)
    return sum(bool(line.split("//")[0].strip()) for line in bare.splitlines())


def test_lines_of_code_are_counted() -> None:
    assert kernel_code("/* a\n b */ int x; // c\n\n// d\nint y;\n") == 2


def test_files_are_small() -> None:
    long = (path for path in FILES if len(path.read_text("utf-8").splitlines()) > FILE_LINES)  # others cannot be
    sizes = [(path, len(code_lines(path)), FILE_LINES) for path in long]
    sizes += [(path, kernel_code(path.read_text("utf-8")), KERNEL_LINES) for path in KERNELS]
    none(f"{place(path)} has {size} lines of code" for path, size, most in sizes if size > most)


def test_functions_are_small() -> None:
    long = []
    for path in FILES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                if (node.end_lineno or 0) - node.body[0].lineno < FUNCTION_LINES:
                    continue
                size = sum(node.body[0].lineno <= line <= (node.end_lineno or 0) for line in code_lines(path))
                long += [f"{place(path, node)} {node.name} has {size} lines of code"] if size > FUNCTION_LINES else []
    none(long)


def asked_kinds(tree: ast.Module) -> list[tuple[ast.AST, set[str]]]:
    """Return the places where a file tests the class of a value, and the names of those classes."""
    asked: list[tuple[ast.AST, ast.AST]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.MatchClass):
            asked.append((node, node.cls))
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) == 2:
            asked += [(node, node.args[1])] if node.func.id in ("isinstance", "issubclass") else []
        elif isinstance(node, ast.Compare) and any(isinstance(o, ast.Is | ast.IsNot | ast.Eq) for o in node.ops):
            asked += [(node, other) for other in node.comparators] if "type(" in ast.unparse(node.left) else []
    return [(at, {n.id for n in ast.walk(of) if isinstance(n, ast.Name)} | {n.attr for n in ast.walk(of) if isinstance(n, ast.Attribute)}) for at, of in asked]  # fmt: skip


@cache
def classes_of(home: str) -> frozenset[str]:
    """Return the names of all classes of a package that others may know."""
    nodes = (node for path in FILES if path.is_relative_to(PACKAGE / home) for node in ast.walk(tree_of(path)))
    return frozenset(n.name for n in nodes if isinstance(n, ast.ClassDef) and not n.name.startswith("_"))


def test_kinds_are_asked_for_at_home_alone() -> None:
    assert classes_of("scene/room") > {"Room", "Shoebox", "MeshRoom"}
    assert classes_of("tracks") > {"Tracks", "SceneTracks", "SampledTracks"}
    none(
        f"{place(path, node)} asks for {', '.join(sorted(names & classes_of(home)))}"
        for path in FILES
        for node, names in asked_kinds(tree_of(path))
        for home in HOMES
        if names & classes_of(home) and not path.is_relative_to(PACKAGE / home)
    )


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("isinstance(room, Shoebox | MeshRoom)", True), ("isinstance(x, (a.Shoebox, int))", True), ("type(x) is Shoebox", True),
        ("match x:\n    case Shoebox(): pass", True), ("isinstance(x, int)", False), ("Shoebox(3)", False),
    ],
)  # fmt: skip
def test_every_way_to_ask_is_seen(text: str, seen: bool) -> None:
    assert any(names & classes_of("scene/room") for _, names in asked_kinds(ast.parse(text))) == seen


def test_no_type_is_ignored() -> None:
    none(
        f"{place(path)}:{number} {line.strip()}"
        for path in FILES
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        if "type: ignore" in line
    )


def test_heads_of_kernel_files_say_what_they_hold() -> None:
    for path in KERNELS:
        assert path.read_text("utf-8").lstrip().startswith(("//", "/*")), place(path)
