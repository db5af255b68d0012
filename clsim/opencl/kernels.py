"""The programs of kernels: the files of each; its arguments and compile-time constants are read from their text.

``kernels/README.md`` says what each program does.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from clsim.errors import ClsimError

NUMBERS: dict[str, type[np.generic]] = {
    "int": np.int32, "uint": np.uint32, "long": np.int64, "ulong": np.uint64, "float": np.float32, "double": np.float64,
}  # fmt: skip
_OPENCL_C = {"CLK_LOCAL_MEM_FENCE", "OPENCL", "FP_CONTRACT", "OFF"}  # words that are no constants of a program
_NO_CODE = re.compile(r'//[^\n]*|/\*.*?\*/|"[^"]*"', re.DOTALL)
_STRUCTURE = r"typedef struct {{([^{{}}]*)}} {};"
_SIGNATURE = r"__kernel\b[^;{{]*?\bvoid\s+{}\s*\(([^{{]*)\)\s*{{"


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of a kernel."""

    type: str  # in OpenCL C: of the number, or of the elements of the buffer
    access: str = ""  # "in" of a buffer that is only read, "out" of another one; empty for a number
    layout: np.dtype[np.void] | None = None  # of a structure by value, whose numbers launches are given by name


def arguments_of(program: str, text: str) -> dict[str, Argument]:
    """Read the arguments of a kernel from the text of its program, by name in the order of the signature."""
    code, found = _NO_CODE.sub("", text), {}
    (signature,) = re.findall(_SIGNATURE.format(program), code)
    for declared in signature.split(","):
        *words, name = re.findall(r"\w+|\*", declared)
        (kind,) = {*words} - {"__global", "__constant", "const", "restrict", "*"}
        if "*" in words:
            found[name] = Argument(kind, "in" if {"const", "__constant"} & {*words} else "out")
        else:
            found[name] = Argument(kind, layout=None if kind in NUMBERS else _layout(kind, code))
    return found


def _layout(structure: str, code: str) -> np.dtype[np.void]:
    """Type of a structure of numbers and arrays of them, laid out as in C."""
    (body,) = re.findall(_STRUCTURE.format(structure), code)
    fields: list[tuple[str, type[np.generic], tuple[int, ...]]] = []
    for kind, names in re.findall(r"(\w+) ([^;]+);", body):
        fields += [
            (n, NUMBERS[kind], (int(count),) if count else ()) for n, count in re.findall(r"(\w+)(?:\[(\d+)\])?", names)
        ]
    return np.dtype(fields, align=True)


@dataclass(frozen=True)
class Program:
    """A program of one kernel, which has its name."""

    name: str
    files: list[str]  # joined in this order

    @cached_property
    def arguments(self) -> dict[str, Argument]:
        """Arguments by name, in the order of the signature."""
        return arguments_of(self.name, kernel_source(self.name))

    @cached_property
    def constants(self) -> set[str]:
        """Constants that are given at compile time (``-D``), all of them at every build."""
        code = _NO_CODE.sub("", kernel_source(self.name))
        defined = set(re.findall(r"#define\s+(\w+)", code))
        return set(re.findall(r"\b[A-Z][A-Z_]+\b", code)) - defined - _OPENCL_C


_TRIPLES = "common/float64.h common/triple.h "
_PROPAGATION = _TRIPLES + "common/side_by_side.h paths/trajectory.h paths/delay.h "
_PATHS = (
    "paths/pose.h nodes/path.h nodes/legs/static.h nodes/legs/moving.h nodes/legs/events.h nodes/vertices/edge.h "
    "nodes/vertices/ellipsoid.h nodes/vertices/capsule.h nodes/vertices/scatterer.h nodes/vertices/scattered_legs.h "
)
_FIELDS = (
    "nodes/prediction.h nodes/vertices/transition.h nodes/solve.h nodes/vertices/angles.h nodes/vertices/edge_end.h "
    "nodes/vertices/edge_field.h nodes/vertices/outline.h nodes/vertices/strings.h nodes/vertices/outline_field.h "
    "nodes/vertices/shade.h nodes/vertices/silhouette.h nodes/vertices/capsule_field.h nodes/vertices/sphere.h "
    "nodes/vertices/scattered_field.h nodes/legs/mirrored_field.h nodes/node_gains.h "
)
_RESPONSE = (
    "common/rounding.h common/gains.h nodes/spectrum.h nodes/lookup_tables.h nodes/harmonics.h nodes/response.h "
)
_POLYNOMIALS, _WALLS = "common/polynomials.h ", "paths/wall_tree.h paths/walls.h "
_INTERVALS = _PROPAGATION + _WALLS + "paths/wall_walk.h paths/trajectory_tables.h paths/unfolded.h paths/visibility.h "
_EDGES = "paths/edge.h paths/edge_gap.h paths/edge_evaluate.h paths/gap_evaluate.h "
_VECTORS = "common/rounding.h common/vector.h "

DECLARATIONS = "common/opencl_c.h"  # joined by the compiler, where that pays

# The files before the one of the kernel, by folder and name of that one.
_FILES = {
    "render/emit": "",
    "render/branches": _VECTORS,
    "nodes/coarse_delays": _PROPAGATION + _PATHS,
    "nodes/tracks": _PROPAGATION + _RESPONSE + _PATHS + _FIELDS + _POLYNOMIALS
    + "nodes/delay_polynomials.h nodes/block.h nodes/smooth.h nodes/cell.h common/mask.h nodes/activity.h",
    "nodes/pair_tracks": "common/float32.h common/triple.h common/pairs.h " + _RESPONSE + "nodes/pair_delay.h "
    + _POLYNOMIALS + "nodes/block.h common/mask.h nodes/activity.h",
    "paths/meetings": _TRIPLES + _WALLS,
    "paths/crossings": _TRIPLES + _WALLS,
    "paths/intervals": _INTERVALS + "paths/evaluate.h paths/spans.h",
    "paths/edge_intervals": _INTERVALS + _EDGES + "paths/spans.h",
    "rays/rays": "rays/philox.h rays/next_wall.h rays/energies.h rays/scatter.h",
    "render/fades": _POLYNOMIALS + "render/phases.h render/transition.h",
    "render/trim_activity": "common/mask.h render/transition.h",
    "render/clear_gains": _POLYNOMIALS,
    "render/taper_gains": _VECTORS + _POLYNOMIALS + "common/taper.h",
    "render/render": _VECTORS + _POLYNOMIALS
    + "common/gains.h common/mask.h render/phases.h render/subblock.h render/farrow.h",
    "render/moments": _VECTORS + _POLYNOMIALS + "render/phases.h render/transition.h",
    "channels/scatter": _VECTORS + _POLYNOMIALS + "common/taper.h",
    "render/plane_waves": _VECTORS,
    "render/baseband": _VECTORS + _POLYNOMIALS
    + "common/mask.h render/carrier.h render/group.h render/branch_powers.h",
    "render/baseband_fades": _VECTORS + _POLYNOMIALS + "render/carrier.h render/transition.h",
}  # fmt: skip
PROGRAMS = {
    path.partition("/")[2]: Program(path.partition("/")[2], [*files.split(), f"{path}.cl"])
    for path, files in _FILES.items()
}


def kernel_folder() -> Path:
    """Return the folder of the kernels: in the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    checkout = package.parent
    for folder, exists in (
        (package / "kernels", (package / "kernels").is_dir()),
        (checkout / "kernels", (checkout / "pyproject.toml").is_file()),
    ):
        if exists:
            return folder
    raise ClsimError(f"no kernels beside {package}: install clsim again")


@cache
def declarations() -> str:
    """Return declarations of the OpenCL C functions that kernels use, for compilers that skip its header."""
    return (kernel_folder() / DECLARATIONS).read_text("utf-8")


@cache
def kernel_source(program: str) -> str:
    """Text of a program: its files in order, each behind a ``#line`` that names it."""
    folder = kernel_folder()
    return "\n".join(f'#line 1 "{n}"\n{(folder / n).read_text("utf-8")}' for n in PROGRAMS[program].files)
