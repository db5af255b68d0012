"""What is written is whole: public docstrings, sources of formulae, and the figures and files that pages name."""

import ast
import importlib.util
import inspect
import pkgutil
import re
import sys
import textwrap
import types
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

import clsim
import clsim.acoustics
import clsim.numerics

ROOT = Path(clsim.__file__).parents[1]
# A unit, or that there is none.
UNIT = re.compile(
    r"(?<![\w^])(m|mm|s|Hz|kHz|dB|dB/m|Pa|kPa|V|V/Pa|Pa/V|rad|rad/s|m/s|m/s²|m²|m³|°|°C|K|kg|kg/m³|kg/m²|%|ppm|MiB|GiB|bytes|N s/m⁴|Pa s/m²)(?![\w/])"
    r"|degrees|per cent|samples?\b|frames|octaves?|[Uu]nit vectors?|quaternions?|rows|1\.|[0-9] to [0-9]|[Ff]rom 0|from -1|[Ww]ithout (a )?unit|ratio|share|fraction|factors?|[Gg]ains?|direction|units of"
)
SHAPE = re.compile(r"\([^()]*\w*[^()]*,?[^()]*\)|scalar|sequence|one per|as many|broadcast|same shape|any shape")
NUMBERS = re.compile(r"float|array|complex|Floats")
EQUATION = re.compile(
    r"(?:[Ee]qs?\.|[Ee]quations?|[Ss]ections?|[Tt]ables?|[Aa]nnex|[Aa]ppendix|[Cc]hapter|[Cc]h\.|pp?\.) ?\(?[A-Z]?\d"
    r"|\bno\. ?\d|[Aa]nnex [A-Z]|§ ?\d|algorithm \d|his appendix"
)
SOURCE = re.compile(r"\[\w+\]_|\b(?:1[89]|20)\d\d\b|ISO \d+|IEC \d+|AES\d+")
# Functions that no publication holds, and why; what is derived is derived in their Notes.
OWN = {
    "advanced": "a delay of transforms",
    "turns": "a periodic exponential",
    "most_points": "a bound of cost",
    "outline_fields": "`outline_field`, some lines of sight at a time",
    "steps_of_points": "rounding",
    "blas_threads": "no formula",
    "with_blas_threads": "likewise",
    "harmonic_norm": "a factor of `real_harmonics`",
    "harmonic_norms": "likewise",
    "sphere_aspects": "derived: angle and distances of the ends",
    "sphere_bound": "a maximum",
    "band_filters": "derived: least squares of a filter's real and imaginary part",
    "band_taper": "a product of two functions of scipy",
    "bank_error": "a maximum",
    "double_transition": "derived: a double integral as four single ones",
    "gap_transition": "derived: a quarter plane of a quadratic phase",
    "double_tie": "derived: the coupling of two phases that are quadratic in both angles",
    "angle_polynomials": "a recurrence of Chebyshev polynomials",
    "end_coefficients": "derived: a quadrature of end_transition at Chebyshev nodes",
    "end_detour": "derived: differences of lengths without cancellation",
    "fit_delay": "derived: least squares of phases of neighbours' products",
    "is_clipped": "what the name says",
    "level_fall": "derived: a mean over a mean",
    "largest_hole": "a maximum",
    "lit_share": "the choice that ellipsoid_strength tells of",
    "merged": "a mean",
    "neighbours_on_sphere": "a hull of scipy",
    "normalised": "what the name says",
    "off_line": "cylindrical coordinates, and their limit on the line",
    "adjacent_reflections": "derived: images of the source by both faces in turn",
    "quaternion_from_direction": "derived: a product of two turns",
    "resonance_response": "derived: the quality from the width at -6 dB",
    "resonance_taps": "derived: poles of the resonance, zeros by what is asked at two frequencies",
    "ringing": "measured",
    "same_hemisphere": "what the name says",
    "capsule_field": "derived: lobes along the capsule, and the field about its outline",
    "silhouette_field": "derived: a sum of both approximations by their shares",
    "pole": "derived: a function that falls like the pole and has none",
    "known_at": "measured",
    "forward_share": "our choice: where one approximation goes over into the other",
    "silhouette_aspects": "derived: lengths and directions of both ends",
    "table_directions": "even angles",
    "shade": "derived: screens in a row, of which each meets what the last one lets pass",
    "faded": "what the name says",
    "eased": "what the name says",
    "chebyshev_points": "what the name says",
    "interpolation": "the discrete orthogonality of Chebyshev polynomials",
    "inverse": "what the name says",
    "quaternion_product": "likewise",
    "silhouette_bound": "derived: Kirchhoff's field of a disc",
}


OVERRIDDEN = re.compile(r"see `(\w+)\.(\w+)`\.$")  # a method that says no more than that of its base


def sections(text: str) -> dict[str, str]:
    """Return a numpydoc docstring's sections by their titles; the summary's is empty."""
    lines = inspect.cleandoc(text).splitlines()
    found, title = {"": ""}, ""
    for i, line in enumerate(lines):
        below = lines[i + 1] if i + 1 < len(lines) else ""
        if line and below and set(below) == {"-"} and len(below) == len(line):
            title = line
            found[title] = ""
        elif not (line and set(line) == {"-"}):
            found[title] += line + "\n"
    return found


def parameters(section: str) -> dict[str, tuple[str, str]]:
    """Return type and text by the name of each parameter that a section tells of."""
    found: dict[str, tuple[str, str]] = {}
    names: list[str] = []
    for line in section.splitlines():
        if line and not line[0].isspace():
            head, _, kind = line.partition(" : ")
            names = [name.strip().lstrip("*") for name in head.split(",")]
            found |= dict.fromkeys(names, (kind, ""))
        elif line.strip():
            found |= {name: (found[name][0], f"{found[name][1]} {line.strip()}") for name in names}
    return found


def public_callables() -> Iterator[tuple[str, Any, bool]]:
    """Yield a name, what it is, and whether it is a class, for all that clsim exports and the methods of its classes."""
    exported = [(name, getattr(clsim, name)) for name in clsim.__all__]
    exported += [(f"score.{name}", getattr(clsim.score, name)) for name in clsim.score.__all__]
    for name, value in exported:
        yield name, value, inspect.isclass(value)
        for method, raw in _methods(value) if inspect.isclass(value) else ():
            yield f"{name}.{method}", raw, False


def _methods(value: type) -> Iterator[tuple[str, Any]]:
    found = {
        name: raw
        for base in reversed(value.__mro__)
        if base.__module__.startswith("clsim.")
        for name, raw in vars(base).items()
    }
    for name, raw in found.items():
        plain = raw.__func__ if isinstance(raw, classmethod | staticmethod) else raw
        if not name.startswith("_") and (inspect.isfunction(plain) or isinstance(raw, property)):
            yield name, raw.fget if isinstance(raw, property) else plain


def raises(function: Callable[..., Any]) -> bool:
    """Test that a function's own text raises another error than InputError, of which the page of conventions tells."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    return any(isinstance(n, ast.Raise) and "InputError" not in ast.unparse(n) for n in ast.walk(tree))


def fields_of(value: type, summary: str) -> dict[str, tuple[str, str]]:
    """Return the fields that a class's docstring describes, and those of the public classes that its summary names."""
    described: dict[str, tuple[str, str]] = {}
    for base in reversed(value.__mro__):
        if base is value or (base.__name__ in clsim.__all__ and f"`{base.__name__}`" in summary):
            described |= parameters(sections(base.__doc__ or "").get("Attributes", ""))
    return described


def missing(name: str, value: Any, is_class: bool) -> Iterator[str]:
    """Yield what the docstring of one public thing lacks."""
    told = sections(value.__doc__ or "")
    if not told[""].strip():
        yield f"{name}: no docstring"
        return
    if (seen := OVERRIDDEN.search(told[""])) is not None and list(told) == [""]:
        modules = [module for name, module in sys.modules.items() if name.startswith("clsim.")]
        base = next(vars(module)[seen[1]] for module in modules if seen[1] in vars(module))
        told_by_base = sections(getattr(base, seen[2]).__doc__)
        told = told_by_base | {"": told[""] + told_by_base[""]}
    if is_class and issubclass(value, Exception | Warning):
        return
    signature = inspect.signature(value)
    arguments = [p for n, p in signature.parameters.items() if n not in ("self", "cls") and not n.startswith("_")]
    described = parameters(told.get("Parameters", "")) | (fields_of(value, told[""]) if is_class else {})
    owner = getattr(clsim, name.partition(".")[0], None)
    if not is_class and inspect.isclass(owner):  # what the class describes need not be described again
        described = parameters(sections(owner.__doc__ or "").get("Parameters", "")) | described
    for argument in arguments:
        kind, text = described.get(argument.name, (None, ""))
        if kind is None and f"`{argument.name}`" in told[""] and not is_class:  # the first sentence describes it
            kind, text = re.sub("Floats|ArrayLike|NDArray", "ndarray", str(argument.annotation)), told[""]
        if lacks := lacking(argument.name, kind, text):
            yield f"{name}: parameter {argument.name} {lacks}"
    checks = (vars(value).get("__post_init__") or vars(value).get("__init__")) if is_class else value
    own = isinstance(checks, types.FunctionType) and checks.__code__.co_filename != "<string>"
    if (own or not is_class) and raises(checks) and "Raises" not in told:
        yield f"{name}: no Raises"
    if not is_class and not {"Returns", "Yields"} & set(told) and not told_in_full(signature, arguments, told[""]):
        yield f"{name}: no Returns"


def lacking(argument: str, kind: str | None, text: str) -> str:
    """What the description of a parameter lacks."""
    if kind is None:
        return "is not described"
    if not kind and not text.strip().startswith(("As ", "See ", "Passed ", "Of ")):
        return "has no type"
    if NUMBERS.search(kind) and not re.search(r"\bint|bool", kind) and not UNIT.search(f"{argument} {kind} {text}"):
        return "has no unit"
    return "has no shape" if re.search(r"array|Floats", kind) and not SHAPE.search(f"{kind} {text}") else ""


def told_in_full(signature: inspect.Signature, arguments: list[inspect.Parameter], first: str) -> bool:
    """Test that the first sentence tells shape and unit of what is returned, where that has any."""
    answer = str(signature.return_annotation)
    needs_shape = "NDArray" in answer or "Floats" in answer or "Complexes" in answer
    needs_unit = "float" in answer.lower() or "Complexes" in answer
    shapeless = needs_shape and not re.search(rf"{SHAPE.pattern}|shaped as", first)
    return not arguments or not (shapeless or (needs_unit and not UNIT.search(first)))


def none(found: Iterable[str]) -> None:
    listed = sorted(found)
    assert not listed, "\n".join([f"{len(listed)} found", *listed])


def test_public_docstrings_are_whole() -> None:
    everything = list(public_callables())
    assert len(everything) > 100
    none(line for one in everything for line in missing(*one))


def good(x: float, names: object = ()) -> float:
    """Do something.

    Parameters
    ----------
    x : float
        Length, m.
    names : sequence of str
        Of all.

    Returns
    -------
    float
        Area, m².

    Raises
    ------
    ValueError
        If it is none.
    """
    if x < 0:
        raise ValueError
    return x * x


@pytest.mark.parametrize(
    ("cut", "left", "message"),
    [
        ("x : float\n        Length, m.\n    ", "", "parameter x is not described"), ("Length, m.", "Length.", "parameter x has no unit"),
        (" : float\n        Length", "\n        Length", "parameter x has no type"), ("x : float", "x : ndarray", "parameter x has no shape"),
        ("Returns\n    -------", "Notes\n    -----", "no Returns"), ("Raises\n    ------", "Notes\n    -----", "no Raises"),
    ],
)  # fmt: skip
def test_what_a_docstring_lacks_is_seen(cut: str, left: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(missing("good", good, False)) == []
    assert good.__doc__ is not None
    assert good.__doc__.count(cut) == 1
    monkeypatch.setattr(good, "__doc__", good.__doc__.replace(cut, left))
    assert list(missing("good", good, False)) == [f"good: {message}"]


def formulae() -> Iterator[tuple[str, str]]:
    """Yield the names of functions that compute by formulae, and their docstrings in one line."""
    for package in (clsim.acoustics, clsim.numerics):
        for found in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
            module = importlib.import_module(found.name)
            for name, value in vars(module).items():
                if inspect.isfunction(value) and value.__module__ == module.__name__ and not name.startswith("_"):
                    yield f"{found.name}.{name}", " ".join((value.__doc__ or "").split())


def test_formulae_name_their_sources() -> None:
    everything = dict(formulae())
    names = {name.rpartition(".")[2]: name for name in everything}
    none(f"{name}: no function" for name in OWN.keys() - names.keys())
    derived = [names[name] for name, why in OWN.items() if why.startswith("derived")]
    none(f"{name}: no derivation" for name in derived if "Our own derivation" not in everything[name])
    for name in OWN:
        del everything[names[name]]
    assert len(everything) > 20
    found = [f"{name}: no source" for name, text in everything.items() if not SOURCE.search(text)]
    found += [f"{name}: no number of equation, section or table" for name, text in everything.items() if SOURCE.search(text) and not EQUATION.search(text)]  # fmt: skip
    none(found)


def validation_rows() -> list[str]:
    text = (ROOT / "docs" / "validation.md").read_text("utf-8")
    return [line for line in text.splitlines() if line.startswith("| ")]


def test_validation_names_files_that_there_are() -> None:
    named = {name for row in validation_rows() for name in re.findall(r"`((?:unit|physics|parity|integration|compare)/[\w/]+\.py)`", row)}  # fmt: skip
    assert len(named) > 30
    none(name for name in named if not (ROOT / "tests" / name).exists())


def test_figures_of_validation_are_written_by_their_tests() -> None:
    page = (ROOT / "docs" / "validation.md").read_text("utf-8")
    figures = loaded("../docs/site/figures")
    rows, stated, found = figures.written(page)
    assert stated == found, "edited by hand: run make measured"
    assert len(rows) > 20
    for test, claim in rows:
        assert "measured(" in (ROOT / "tests" / test).read_text("utf-8"), f"{test}: {claim}: notes no figure"
    by_hand = page[: figures.BEGIN.search(page).start()]
    none(re.findall(r".*\d (?:dB|mm|µm|µs|ns)\b.*|.*\de-\d.*", by_hand.partition("| claim |")[0]))
    none(
        row
        for row in by_hand.splitlines()
        if row.startswith("| ") and (row.count(" |") > 3 or re.search(r"\d dB|\de-\d", row))
    )


def test_a_figure_typed_by_hand_is_found() -> None:
    figures = loaded("../docs/site/figures")
    rows = {
        ("unit/test_errors.py", "a claim"): "| `unit/test_errors.py` | a claim | an oracle | -85 dB | -101 to -98 dB |"
    }
    page = figures.update(f"# A page\n\n<!-- written by make measured:  -->\n{figures.END}\n", rows, ROOT / "tests")
    assert figures.written(page)[0] == rows
    assert len({*figures.written(page)[1:]}) == 1
    assert len({*figures.written(page.replace("-98", "-99"))[1:]}) == 2
    assert figures.update(page, {}, ROOT / "tests") == page  # of tests that did not run, rows stay


def loaded(name: str) -> types.ModuleType:
    """Return a file of tests as a module."""
    spec = importlib.util.spec_from_file_location(Path(name).name, ROOT / "tests" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


COUNT = re.compile(r"(\d+) (?:mutants|wrong kernels)")
COUNTED = [row for row in validation_rows() if COUNT.search(row)]


def test_all_files_with_many_mutants_are_counted() -> None:
    counted = " ".join(COUNTED)
    for path in sorted((ROOT / "tests" / "parity").glob("test_*.py")):
        assert f"`parity/{path.name}`" in counted or "\nMUTANTS = " not in path.read_text("utf-8"), path.name


@pytest.mark.parametrize("row", COUNTED, ids=lambda row: row.split("|")[1].strip()[:30])
def test_validation_counts_mutants_as_tests_do(row: str) -> None:
    name = re.search(r"`(\w+/\w+)\.py`", row)
    assert name is not None
    there = loaded(name[1])
    assert [int(n) for n in COUNT.findall(row)] == [len(there.MUTANTS) + len(getattr(there, "ELSEWHERE", ()))]
