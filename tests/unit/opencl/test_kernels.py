"""Programs of kernels: arguments and constants as read from their sources, layouts of structures, sizes of files."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

import clsim
from clsim.opencl import launch
from clsim.opencl.device import able_processor, better_name, find_device, list_devices
from clsim.opencl.launch import (
    ALONE,
    DECLARATIONS,
    LONG_ALONE,
    LONG_KERNELS,
    NUMBERS,
    PROGRAMS,
    Argument,
    Launch,
    arguments_of,
    as_built,
    compiler_of,
    declarations,
    kernel_folder,
    kernel_source,
    upload,
)
from clsim.paths.visibility.device import INTERVAL, SPAN, progress
from clsim.render.opencl.environment import RECEIVER_NODE, VECTOR
from clsim.render.opencl.host_nodes import PAIR_RECEIVER
from clsim.render.opencl.node_constants import EDGE_VIEW, MIRROR_VIEW, SCATTERER_VIEW

AVX2 = "sse2 sse4_2 abm avx avx2 bmi1 bmi2 f16c fma movbe"

# In a process of its own, for the name is that of all the process: first as PoCL would have it by itself.
UNKNOWN = """
import numpy as np
import pyopencl as cl
from clsim.opencl.device import find_device
from clsim.opencl.device import UNKNOWN, processor, set_processor

def build():
    program = cl.Program(context, "__kernel void root(__global double *a) { a[get_global_id(0)] = sqrt(a[get_global_id(0)]); }")
    values = np.arange(16.0) ** 2
    buffer = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=values)
    queue = cl.CommandQueue(context)
    program.build(cache_dir=False).root(queue, (16,), None, buffer)
    cl.enqueue_copy(queue, values, buffer)
    return values.tolist()

pocl = [platform for platform in cl.get_platforms() if platform.name == "Portable Computing Language"]
found = [device for platform in pocl for device in platform.get_devices() if processor(device)]
if not found:
    raise SystemExit  # another release of PoCL
device = found[0]
context = cl.Context([device])
set_processor(device, UNKNOWN)
try:
    build()
except cl.RuntimeError as error:
    print("unknown target CPU" in str(error))
find_device("Portable Computing Language")
print(processor(device) not in {UNKNOWN, None})
print(build())
"""


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        (f"{AVX2} avx512f avx512bw avx512cd avx512dq avx512vl avx512_bf16", "skylake-avx512"),
        (f"{AVX2} avx512f avx512cd", "haswell"),
        (AVX2, "haswell"),
        ("sse2 sse4_2 avx", "x86-64"),
    ],
)
def test_a_processor_is_one_whose_instructions_are_all_there(flags: str, name: str) -> None:
    assert able_processor(flags.split()) == name


@pytest.mark.parametrize(
    ("known", "more", "name"),
    [
        ("znver3", "", "znver3"),
        ("znver3", " avx512f avx512bw avx512cd avx512dq avx512vl", "skylake-avx512"),
        ("generic", "", "haswell"),
    ],
)
def test_later_processors_of_amd_use_all_their_instructions(known: str, more: str, name: str) -> None:
    assert better_name(known, (AVX2 + more).split()) == name


@pytest.mark.skipif(sys.platform != "linux" or os.uname().machine != "x86_64", reason="PoCL's name for it is good here")
def test_pocl_builds_where_it_does_not_know_the_processor(tmp_path: Path) -> None:
    if not any(device.platform == "Portable Computing Language" for device in list_devices()):
        pytest.skip("no PoCL on this machine")
    done = subprocess.run(
        [sys.executable, "-c", UNKNOWN], env=os.environ | {"POCL_CACHE_DIR": str(tmp_path)}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    if not done.stdout:
        pytest.skip("PoCL's description of its device does not tell the processor")
    refused, named, roots = done.stdout.splitlines()
    assert (refused, named) == ("True", "True")
    assert roots == str([float(i) for i in range(16)])


TYPEDEFS = {"bins", "gains"}  # vectors of float, as wide as constants say
BY_KIND = {"view"}  # a structure for each kind of paths
DEPTH = 5
STRUCTURES = {
    "receiver_node": ("tracks", RECEIVER_NODE),
    "pair_receiver": ("pair_tracks", PAIR_RECEIVER),
    "span": ("intervals", SPAN),
    "progress": ("intervals", progress(DEPTH)),
    "interval": ("intervals", INTERVAL),
    # Arrays of numbers in Python: Walls.edge and TrajectoryTables.
    "edge_ends": ("intervals", np.dtype([("from", "f8", 3), ("to", "f8", 3)])),
    "table_place": ("intervals", np.dtype([("first_knot", "i8"), ("first_speed", "i8"), ("knots", "i8")])),
    "edge_of_room": (
        "edge_intervals",
        np.dtype([*((name, "f8", 3) for name in ("start", "across", "out", "along")), ("length", "f8"), ("n", "f8")]),
    ),
    "edge_view": ("tracks", EDGE_VIEW),
    "scatterer_view": ("tracks", SCATTERER_VIEW),
    "mirror_view": ("tracks", MIRROR_VIEW),
    **{
        argument.type: (name, argument.layout)
        for name, program in PROGRAMS.items()
        for argument in program.arguments.values()
        if argument.layout is not None
    },
    "table_scale": ("intervals", np.dtype([("first_knot", "f8"), ("knot_rate", "f8"), ("fastest", "f8")])),
}


def without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/", "", re.sub(r"//[^\n]*", "", text), flags=re.DOTALL)


def test_arguments_and_constants_are_read_from_the_text() -> None:
    text = """#line 1 "A_FILE.h"
typedef struct { double wide, three[3]; int count; } numbers;  // NOT, A constant
#define OWN 3
__kernel void told(const numbers run, /* a, b */ __global const float4* restrict given, __constant bins* table,
                   __global int* out, ulong key)  // [OTHER]
{ out[OWN] = GIVEN; }"""
    wanted = {"given": Argument("float4", "in"), "table": Argument("bins", "in"), "out": Argument("int", "out")}
    found = arguments_of("told", text)
    assert list(found) == ["run", *wanted, "key"]
    assert found == {"run": found["run"], **wanted, "key": Argument("ulong")}
    assert found["run"].layout == np.dtype([("wide", "f8"), ("three", "f8", 3), ("count", "i4")], align=True)
    assert PROGRAMS["branches"].constants == {"LANES", "VECTORS", "ROWS", "PARTS", "OVERSAMPLING", "CELL"}


@pytest.mark.parametrize("program", PROGRAMS)
def test_types_of_arguments_are_known(program: str) -> None:
    for name, argument in PROGRAMS[program].arguments.items():
        if argument.access:
            assert argument.type.rstrip("248") in {*NUMBERS, *TYPEDEFS, *STRUCTURES, *BY_KIND}, name


def test_structures_by_value_keep_signatures_short() -> None:
    assert max(len(program.arguments) for program in PROGRAMS.values()) <= 44
    assert len(PROGRAMS["tracks"].arguments) <= 32


def test_numbers_of_structures_arrive_in_their_own_types(device: None) -> None:
    """A launch takes them by name among the other arguments; an array within a structure keeps its order."""
    fields = "double wide; double three[3]; float narrow; int count;"
    source = (
        f"typedef struct {{ {fields} }} numbers; __kernel void told(int factor, const numbers n, __global double* out) "
        "{ out[0] = n.wide; for (int i = 0; i < 3; i++) out[1 + i] = n.three[i]; out[4] = n.narrow; out[5] = n.count * factor; }"
    )
    context = compiler_of(find_device(None)[1]).context
    queue, out = cl.CommandQueue(context), np.zeros(6)
    launch, buffer = (
        Launch("told", cl.Kernel(cl.Program(context, source).build(), "told"), arguments_of("told", source)),
        upload(context, out),
    )
    given = {"count": 3.0, "narrow": 0.1, "three": np.array([5.0, 6.0, 7.0]), "wide": 0.1, "factor": 2, "out": buffer}
    launch(queue, ((1,), (1,)), **given)
    cl.enqueue_copy(queue, out, buffer)
    assert out.tolist() == [0.1, 5.0, 6.0, 7.0, float(np.float32(0.1)), 6.0]
    with pytest.raises(clsim.ClsimError, match=r"told: it lacks narrow$"):
        launch(queue, ((1,), (1,)), **{n: given[n] for n in given if n != "narrow"})
    with pytest.raises(clsim.ClsimError, match=r"told: it has no numbers$"):
        launch(queue, ((1,), (1,)), **given, numbers=0)


def test_every_file_belongs_to_a_program_and_says_what_it_is() -> None:
    folder = kernel_folder()
    files = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.suffix in {".h", ".cl"}}
    assert files == {name for program in PROGRAMS.values() for name in program.files} | {DECLARATIONS}
    told = (folder / "README.md").read_text("utf-8")
    for name, program in PROGRAMS.items():
        assert f"`{name}`" in told
        assert program.files[-1].endswith(f"/{name}.cl")
    for name in files:
        assert (folder / name).read_text("utf-8").startswith("// "), name
        assert f"`{name.split('/')[-1]}`" in told, name


def test_functions_of_opencl_are_declared() -> None:
    called = re.compile(r"\b([a-z]\w+)\s*\(")
    told = set(called.findall(declarations())) - {"overloadable"}
    used, own = set(), set()  # files that programs share may name what only one of them has
    for program in PROGRAMS:
        text = re.sub(r'__attribute__\(\(.*?\)\)|"[^"]*"', "", without_comments(kernel_source(program)))
        own |= set(re.findall(r"\b\w+\*?\s+(\w+)\([^()]*\)\s*{", text))
        used |= set(called.findall(text)) - {"if", "for", "while", "switch", "return", "sizeof", "define"}
    used -= own
    assert {name for name in used if not name.startswith("as_")} == told  # those are macros of another header


def test_pocl_reads_the_declarations_that_kernels_need_and_no_others(device: None) -> None:
    compiler = compiler_of(find_device(None)[1])
    if compiler.context.devices[0].platform.name != "Portable Computing Language":
        pytest.skip("another platform than PoCL")
    built = compiler._build("emit", kernel_source("emit"), ["-DOF_A_TEST"])
    assert built.source.startswith(declarations())


def test_long_kernels_call_a_body_that_pocl_compiles_once() -> None:
    which = re.compile(r"get_\w+\(\d\)")
    for name in LONG_KERNELS | LONG_ALONE:
        source = kernel_source(name)
        body, kernel = as_built(name, source, [ALONE]).split("__kernel ")
        (called,) = re.findall(rf"{name}_body\((.*)\);", kernel)
        assert called.split(", ") == [*PROGRAMS[name].arguments, *sorted(set(which.findall(source)))]
        assert re.search(rf"noinline\)\)\s+void {name}_body\(", body)
        assert not which.findall(body)
    for name in LONG_ALONE:
        assert as_built(name, kernel_source(name), ["-DWORKERS=8"]).endswith(kernel_source(name))


def test_files_are_small() -> None:
    for program in PROGRAMS.values():
        for name in program.files:
            text = without_comments((kernel_folder() / name).read_text("utf-8"))
            assert sum(bool(line.strip()) for line in text.splitlines()) <= 150, name


def test_what_needs_no_float64_has_none() -> None:
    """Nor constants of it: a device without it may round them, or refuse them."""
    for program in ("pair_tracks", "render", "branches", "emit", "fades", "clear_gains", "baseband", "baseband_fades"):
        text = without_comments(kernel_source(program))
        text = re.sub(r"#define ROUNDING_DOUBLE .*", "", text)
        assert "double" not in text, program
        assert not re.findall(r"(?<![\w.])\d+\.\d*(?:e[-+]?\d+)?(?![\w.])", text), program


def fields_of(dtype: np.dtype, at: int = 0) -> list[tuple[str, int]]:
    return [(name, at + dtype.fields[name][1]) for name in dtype.names]


@pytest.mark.parametrize("name", STRUCTURES)
def test_structures_are_laid_out_alike(name: str, device: None) -> None:
    program, dtype = STRUCTURES[name]
    text = without_comments(kernel_source(program))
    definition = re.search(rf"typedef struct {{[^{{}}]*}} {name};", text)
    before = "".join(re.findall(r"typedef struct {[^{}]*} span;", text)) if name == "progress" else ""
    told = "".join(
        f"out[{i + 1}] = (__global char*)&p->{field} - (__global char*)p;"
        for i, (field, _) in enumerate(fields_of(dtype))
    )
    before += "typedef float2 pair;" if name == "pair_receiver" else ""
    source = f"{before}\n{definition[0]}\n__kernel void layout(__global {name}* p, __global long* out) {{ out[0] = sizeof({name}); {told} }}"
    context = compiler_of(find_device(None)[1]).context
    queue = cl.CommandQueue(context)
    out = np.zeros(1 + len(dtype.names), dtype=np.int64)
    buffer, held = upload(context, out), upload(context, np.zeros(dtype.itemsize, np.int8))
    cl.Kernel(cl.Program(context, source).build([f"-DDEPTH={DEPTH}"]), "layout")(queue, (1,), (1,), held, buffer)
    cl.enqueue_copy(queue, out, buffer)
    assert out.tolist() == [dtype.itemsize, *(offset for _, offset in fields_of(dtype))]


def test_vectors_are_as_wide_as_python_pads_them() -> None:
    text = kernel_source("tracks")
    for name in TYPEDEFS:
        assert re.findall(rf"typedef (\w+) {name};", text) == ["float", f"float{VECTOR}"]
    assert f"(FREQUENCIES / {VECTOR})" in text
    assert f"((FUNCTIONS + {VECTOR - 1}) / {VECTOR})" in text


def test_launches_refuse_names_that_are_wrong() -> None:
    seen = []
    launch = Launch("clear_gains", lambda *taken: seen.append(taken), PROGRAMS["clear_gains"].arguments)
    given = {"slots": 4, "polynomials": "p", "functions": 1.0, "block": "b", "slot": "s", "count": np.int64(3)}
    launch("queue", ((32,), (8,)), **given)
    assert seen == [("queue", (32,), (8,), 3, "s", "b", 1, "p", 4)]
    assert [type(seen[0][i]) for i in (3, 6, 8)] == [np.int32] * 3
    with pytest.raises(clsim.ClsimError, match=r"clear_gains: it lacks functions, slot$"):
        launch("queue", ((32,), (8,)), **{n: given[n] for n in given if n not in ("slot", "functions")})
    with pytest.raises(clsim.ClsimError, match=r"clear_gains: it has no nodes$"):
        launch("queue", ((32,), (8,)), **given, nodes=1)
    with pytest.raises(clsim.ClsimError, match=r"clear_gains: it lacks slot and has no place$"):
        launch("queue", ((32,), (8,)), **{n: given[n] for n in given if n != "slot"}, place=1)
    assert len(seen) == 1


def test_arrays_are_uploaded_in_the_type_of_the_argument(device: None) -> None:
    context = compiler_of(find_device(None)[1]).context
    queue, seen = cl.CommandQueue(context), []
    launch = Launch("emit", lambda *taken: seen.append(taken), PROGRAMS["emit"].arguments)
    given = {"count": 2, "clear": 0, "stride": 2, "emitted": None, "values": np.array([0.5, 1.5])}
    launch(queue, ((32,), (8,)), places=np.array([3, 4]), **given)
    places, values = np.empty(2, np.int32), np.empty(2, np.float32)
    cl.enqueue_copy(queue, places, seen[0][4])
    cl.enqueue_copy(queue, values, seen[0][5])
    assert (places.tolist(), values.tolist()) == ([3, 4], [0.5, 1.5])
    with pytest.raises(TypeError, match="Cannot cast"):
        launch(queue, ((32,), (8,)), places=np.array([3.0, 4.0]), **given)


def test_a_text_is_built_once_for_all_threads_and_constants_are_checked(device: None) -> None:
    from concurrent.futures import ThreadPoolExecutor

    compiler = compiler_of(find_device(None)[1])
    assert compiler_of(find_device(None)[1]) is compiler
    first = compiler.kernel("emit", {})
    assert compiler.kernel("emit", {}) is first
    built = len(compiler._built)
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(compiler.kernel, "emit", {}).result()
    assert other is not first  # arguments of a kernel are set before it is run
    assert len(compiler._built) == built
    with pytest.raises(clsim.ClsimError, match="constants of program emit: missing or unknown LANES"):
        compiler.kernel("emit", {"LANES": 8})


def test_the_short_header_declares_what_kernels_of_edges_call(device, caplog, monkeypatch) -> None:
    """Four nodes of an edge's path are solved in a vector; a function that lacks a declaration costs a second build."""

    monkeypatch.setattr(launch, "_compilers", {})
    hard, still = clsim.Material.from_reflection(1.0), clsim.Trajectory.fixed((3.0, 0.4, 1.2))
    sheet = clsim.MeshRoom([(3, 1, 0.2), (3, 3, 0.2), (3, 3, 1.7), (3, 1, 1.7)], [(0, 1, 2), (0, 2, 3)], hard)
    room = clsim.MeshRoom.joined([clsim.Shoebox((6, 6, 6), clsim.Material.from_reflection(0.0)), sheet])
    source = clsim.Source("s", clsim.Signal.tone(20e3, 0.02, 96e3, fade=0.005), still)
    receiver = clsim.Receiver("r", clsim.Trajectory.line((2, 4, 1.3), (2.1, 4, 1.2), 1.0))
    with caplog.at_level("INFO", logger="clsim.opencl.launch"):
        clsim.render(clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [receiver]), 0, diffraction=1), 96e3)
    assert "coarse_delays: program built" in caplog.text
    assert "tried otherwise" not in caplog.text
