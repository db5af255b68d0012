"""Kernels: their programs, each built once for a context and adapted to PoCL, and launches by the names of arguments.

Arguments and compile-time constants are read from the text. ``kernels/README.md`` says what each program does.
"""

from __future__ import annotations

import logging
import re
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.errors import ClsimError, DeviceError
from clsim.opencl.device import refuse_after_fork
from clsim.opencl.kernel_cache import Trial, TriedKernel

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
    "nodes/vertices/silhouette.h nodes/vertices/shade.h nodes/vertices/capsule_field.h nodes/vertices/sphere.h "
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
    "channels/scatter": _VECTORS + _POLYNOMIALS
    + "common/taper.h render/carrier.h channels/places.h channels/transform.h channels/convolve.h",
    "channels/components": _VECTORS + _POLYNOMIALS + "common/taper.h channels/places.h",
    "render/plane_waves": _VECTORS,
    "render/baseband": _VECTORS + _POLYNOMIALS
    + "common/mask.h render/carrier.h render/group.h render/branch_powers.h render/joined.h",
    "render/baseband_fades": _VECTORS + _POLYNOMIALS + "render/carrier.h render/transition.h",
}  # fmt: skip
PROGRAMS = {
    path.partition("/")[2]: Program(path.partition("/")[2], [*files.split(), f"{path}.cl"])
    for path, files in _FILES.items()
}


def kernel_folder() -> Path:
    """Return the folder of the kernels: in the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    if (package / "kernels").is_dir():
        return package / "kernels"
    if (package.parent / "pyproject.toml").is_file():
        return package.parent / "kernels"
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


WorkItems = tuple[tuple[int, ...], tuple[int, ...]]  # in all, and in a group
Constant = int | float | str | np.float32

HEADER_READ = "-D_OPENCL_H_"  # by which the header of OpenCL C, 980 KiB of Clang's, knows that it was read

# Kernels whose work-items do so much that a call is nothing to them; small ones would no longer run side by side.
LONG_KERNELS = frozenset(
    {"coarse_delays", "tracks", "pair_tracks", "intervals", "edge_intervals", "baseband", "scatter", "rays"}
)
# The same where every work-item is a group of its own; those of a group wait for each other, which functions cannot.
LONG_ALONE = frozenset({"render"})
ALONE = "-DWORKERS=1"

_COMMENT = re.compile(r"//.*")
_PLACE = re.compile(r"\b(get_\w+)\((\d)\)")  # what tells a work-item which one it is


def as_built(program: str, text: str, options: Collection[str] = ()) -> str:
    """Return the text of a program for PoCL; numbers of lines stay those of its files.

    PoCL compiles all of a kernel three times, for three ways of launching it. A long kernel only calls its body: a
    function, compiled once, whose last arguments tell a work-item which one it is.
    """
    if program not in LONG_KERNELS and not (program in LONG_ALONE and ALONE in options):
        return f"{declarations()}\n{text}"
    before, head, kernel = re.split(rf"(__kernel .*\s*void {program}\()", text)
    signature, body = kernel.split("\n{", 1)
    parameters = _COMMENT.sub("", signature).rstrip().removesuffix(")")
    places = sorted(set(_PLACE.findall(body)))
    more = "".join(f", size_t {name}_{dimension}" for name, dimension in places)
    arguments = ", ".join([*PROGRAMS[program].arguments, *(f"{name}({dimension})" for name, dimension in places)])
    inner, lines = _PLACE.sub(r"\1_\2", body), "\n" * head.count("\n")
    return (
        f"{declarations()}\n{before}"
        f"static __attribute__((noinline)){lines} void {program}_body({parameters}{more})\n{{{inner}\n"
        f"{head}{parameters})\n{{\n    {program}_body({arguments});\n}}\n"
    )


_compilers: dict[Any, Compiler] = {}
_log = logging.getLogger(__name__)
_opening = threading.Lock()


def compiler_of(device: Any) -> Compiler:
    """Return the compiler of a device, with its context: the same one at every call in a process."""
    import pyopencl as cl

    with _opening:
        if device not in _compilers:
            _compilers[device] = Compiler(cl.Context([device]))
        return _compilers[device]


class Compiler:
    """Builds the programs of one context, each text with each set of constants once.

    Programs are those of all threads; every thread has kernels of its own, whose arguments are set before they run.
    """

    def __init__(self, context: Any) -> None:
        self.context = context
        self._built: dict[tuple[str, tuple[str, ...]], tuple[Any, Trial]] = {}
        self._building = threading.Lock()
        self._of_thread = threading.local()

    def kernel(self, program: str, constants: Mapping[str, Constant]) -> Launch:
        """Return the kernel of a program with compile-time constants."""
        refuse_after_fork()
        kernels: dict[Any, Launch] = self._of_thread.__dict__.setdefault("kernels", {})
        key = program, kernel_source(program), frozenset(constants.items())
        if key not in kernels:
            if constants.keys() != PROGRAMS[program].constants:
                wrong = ", ".join(sorted(constants.keys() ^ PROGRAMS[program].constants))
                raise ClsimError(f"constants of program {program}: missing or unknown {wrong}")
            # Python's numbers are int and double in OpenCL C, NumPy's float32 is float.
            texts = {n: f"{v!s}f" if isinstance(v, np.float32) else str(v) for n, v in sorted(constants.items())}
            kernels[key] = self._launch(program, tuple(f"-D{n}={text}" for n, text in texts.items()))
        return kernels[key]

    def _launch(self, program: str, options: tuple[str, ...]) -> Launch:
        import pyopencl as cl

        text = kernel_source(program)
        with self._building:
            if (text, options) not in self._built:
                device = self.context.devices[0]
                trial = Trial(program, f"{device.name} {device.driver_version}\n{text}", list(options))
                begun = time.monotonic()
                with trial.marked():
                    self._built[text, options] = self._build(program, text, trial.options), trial
                _log.info("%s: program built, or found, in %.2f s", program, time.monotonic() - begun)
            built, trial = self._built[text, options]
        return Launch(program, TriedKernel(cl.Kernel(built, program), trial), PROGRAMS[program].arguments)

    def _build(self, program: str, text: str, options: list[str]) -> Any:
        """Return the built program; it has been seen to hold its kernel."""
        import pyopencl as cl

        logging.getLogger("pyopencl").setLevel(logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # compilers have something to say about every program
            # A process that died while building can leave a broken entry in the cache of PyOpenCL or of the driver:
            # with a constant that nothing uses, the program is another one and is built anew.
            anew = [*options, f"-DANEW={uuid.uuid4().int % 2**31}"]
            uncached: Any = False  # as PyOpenCL takes it, but does not say in its types
            attempts = [(text, options, None), (text, anew, uncached)]
            if self.context.devices[0].platform.name == "Portable Computing Language":
                attempts.insert(0, (as_built(program, text, options), [*options, HEADER_READ], None))
            for source, given, cache in attempts:
                try:
                    built = cl.Program(self.context, source).build(options=given, cache_dir=cache)
                    cl.Kernel(built, program)
                except cl.Error as error:
                    failed = error
                    _log.info("%s: not built as it stands, tried otherwise: %s", program, str(error)[:500])
                else:
                    return built
        device = self.context.devices[0].name.strip()
        raise DeviceError(
            f"{device} could not build {program}.cl: {str(failed)[:2000]}; update its driver, choose another "
            'device (see `clsim devices`), or use engine="reference"'
        ) from failed


class Launch:
    """A kernel that is launched with arguments by name."""

    def __init__(self, name: str, kernel: Callable[..., Any], arguments: Mapping[str, Argument]) -> None:
        self._name, self._kernel = name, kernel
        layouts = [(i, a.layout) for i, a in enumerate(arguments.values()) if a.layout is not None]
        direct = [n for n, a in arguments.items() if a.layout is None]
        self._known = {*direct, *(n for _, kind in layouts for n in kind.names or ())}
        self._ordered = itemgetter(*direct)
        self._structures = [(i, itemgetter(*(kind.names or ())), kind) for i, kind in layouts]
        places = [(i, arguments[n]) for i, n in enumerate(direct)]
        self._numbers = [(i, NUMBERS[a.type]) for i, a in places if not a.access]
        self._read = [(i, NUMBERS.get(a.type.rstrip("0123456789"))) for i, a in places if a.access == "in"]

    def __call__(self, queue: Any, items: WorkItems, /, **arguments: Any) -> Any:
        """Launch it; return the event. Arrays for buffers that are only read are uploaded; None is an unused buffer."""
        try:
            taken = list(self._ordered(arguments))
            values = [(i, np.array(tuple(of(arguments)), kind)) for i, of, kind in self._structures]
        except KeyError:
            raise self._refusal(arguments) from None
        if len(arguments) != len(self._known):
            raise self._refusal(arguments)
        for i, number in self._numbers:
            taken[i] = number(taken[i])
        if np.ndarray in map(type, taken):  # quicker than asking every argument
            for i, element in self._read:
                if isinstance(taken[i], np.ndarray):
                    given = taken[i] if element is None else taken[i].astype(element, casting="same_kind", copy=False)
                    taken[i] = upload(queue.context, given)  # structures are as they are
        for i, value in values:
            taken.insert(i, value)
        return self._kernel(queue, *items, *taken)

    def _refusal(self, arguments: Mapping[str, Any]) -> ClsimError:
        missing, unknown = self._known - arguments.keys(), arguments.keys() - self._known
        given = [f"{what} {', '.join(sorted(n))}" for what, n in (("lacks", missing), ("has no", unknown)) if n]
        return ClsimError(f"launch of kernel {self._name}: it {' and '.join(given)}")


def upload(context: Any, array: NDArray[Any]) -> Any:
    """Return a buffer of a context with a copy of an array."""
    import pyopencl as cl

    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    return cl.Buffer(context, flags, hostbuf=np.ascontiguousarray(array))


def work(count: int, *more: int, group: int = 32) -> WorkItems:
    """Return the size of a launch and of its work-groups: `group` items of the first dimension, rounded up to these."""
    # Left to itself a runtime may choose groups by the divisors of each size, and build the kernel anew for every one.
    return (-(-count // group) * group, *more), (group, *(1 for _ in more))


class Scratch:
    """Buffers of a context that are used again, by name: fresh memory at every step of a run costs time."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._kept: dict[Any, Any] = {}

    def take(self, name: Any, size: int, *, zeros: bool = False) -> Any:
        """Return the buffer of a name, of at least `size` bytes; its content may be lost. `zeros`: at first all 0."""
        import pyopencl as cl

        if name not in self._kept or self._kept[name].size < size:
            self._kept.pop(name, None)
            flags = cl.mem_flags.READ_WRITE | (cl.mem_flags.COPY_HOST_PTR if zeros else 0)
            self._kept[name] = cl.Buffer(self._context, flags, size, np.zeros(size, np.uint8) if zeros else None)
        return self._kept[name]
