"""The manifest of kernels: of every program its files, its arguments in order, and its compile-time constants.

A test holds every entry against the sources. ``kernels/README.md`` says what each program does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from clsim.errors import ClsimError
from clsim.opencl.arguments import (
    BASIS,
    BLOCK_NUMBERS,
    BLOCKS,
    BRANCHES,
    CROSSINGS,
    DOUBLE,
    EDGE_INTERVALS,
    ENVELOPE,
    FADES,
    FIELD_TABLES,
    FLOAT,
    IMAGES,
    INT,
    INTERVALS,
    MEETINGS,
    MOMENTS,
    MOTION,
    NODES_MADE,
    PATHS_ACTIVE,
    PRESSURE,
    RAYS,
    SCATTER,
    TABLES,
    TAPER_GAINS,
    TRIM_ACTIVITY,
    VIEWS,
    Argument,
    changed,
    made,
    structure,
    taken,
)


@dataclass(frozen=True, slots=True)
class Program:
    """A program of one kernel, which has its name."""

    files: tuple[str, ...]  # joined in this order
    arguments: dict[str, Argument]  # by name, in the order of the signature
    constants: frozenset[str]  # what is given at compile time (``-D``), all of it at every build


_TRIPLES = ("common/float64.h", "common/triple.h")
_PROPAGATION = (*_TRIPLES, "common/side_by_side.h", "paths/trajectory.h", "paths/delay.h")
_PATHS = (
    "paths/pose.h", "nodes/path.h", "nodes/legs/static.h", "nodes/legs/moving.h", "nodes/legs/events.h",
    "nodes/vertices/edge.h", "nodes/vertices/ellipsoid.h", "nodes/vertices/capsule.h", "nodes/vertices/scatterer.h",
    "nodes/vertices/scattered_legs.h",
)  # fmt: skip
_FIELDS = (
    "nodes/prediction.h", "nodes/vertices/transition.h", "nodes/solve.h", "nodes/vertices/angles.h",
    "nodes/vertices/edge_end.h", "nodes/vertices/edge_field.h", "nodes/vertices/outline.h", "nodes/vertices/strings.h",
    "nodes/vertices/outline_field.h", "nodes/vertices/shade.h", "nodes/vertices/silhouette.h",
    "nodes/vertices/capsule_field.h", "nodes/vertices/sphere.h", "nodes/vertices/scattered_field.h",
    "nodes/legs/mirrored_field.h", "nodes/node_gains.h",
)  # fmt: skip
_POLYNOMIALS, _WALLS = ("common/polynomials.h",), ("paths/wall_tree.h", "paths/walls.h")
_INTERVAL_FILES = (
    *_PROPAGATION, *_WALLS, "paths/wall_walk.h", "paths/trajectory_tables.h", "paths/unfolded.h", "paths/visibility.h",
)  # fmt: skip
_EDGES = "paths/edge.h", "paths/edge_gap.h", "paths/edge_evaluate.h", "paths/gap_evaluate.h", "paths/spans.h"
_GAINS, _MASK, _ROUNDING = ("common/gains.h",), ("common/mask.h",), ("common/rounding.h",)

_INTERVAL_CONSTANTS = {
    "ORDER", "DEPTH", "GRAZE_TIME", "ALONG", "CERTAIN", "LEAST_SHARE", "EVER", "INNER", "PARALLEL", "AT_EDGE",
    "TOUCHING", "GROUPED", "SOURCE_PERTURBATION", "RECEIVER_PERTURBATION",
}  # fmt: skip
_CROSSED = {"MOST", "INNER", "PARALLEL"}
_NODE_CONSTANTS = {
    "CELL", "SPARSE", "DELAY_TERMS", "FUNCTIONS", "FREQUENCIES", "PARTS", "CELLS", "SIDE", "FACE_CELLS",
    "CUBIC_COLUMNS", "MACH_EXPONENT", "SOURCE_DIRECTIVITY", "RECEIVER_DIRECTIVITY", "OMNI", "AXIAL", "SPHERICAL",
    "GAIN_ERROR", "AIR_TERMS", "HARMONIC", "CHANNELS",
}  # fmt: skip
_DELAY_CONSTANTS = {"KNOT_COLUMNS", "NODES_AT_ONCE", "RETARDED", "STATIC_RECEIVERS", "WIND"}
_EDGE_CONSTANTS = _DELAY_CONSTANTS | _INTERVAL_CONSTANTS | {
    "CONTRACTIONS", "CONTRACTED", "HALF_TURN", "ON_LINE", "GAP", "NEWTON", "FOUND", "STEPS", "SMALL", "SPARE",
    "IN_AIR", "OVERLAP",
}  # fmt: skip
# What is between the ends, and how it is found where they are scattered.
_KINDS = {
    "LEG", "STATIC", "MOVING", "MIRRORS", "VERTEX", "NONE", "EDGE", "SCATTERER", "POINT", "CAPSULE", "ELONGATED",
    "OUTWARD_STEPS", "LONGEST_STEP", "SPECULAR_FAR", "SPECULAR_FOUND", "SETTLED", "FLATTEST", "NO_PATH", "ON_LINE",
    "PATIENCE", "BEYOND_LEG", "POSE_COLUMNS", "FACE_COLUMNS",
}  # fmt: skip
_OF_GAINS = {
    "SMOOTH_ERROR", "HALF_TURN", "ON_BOUNDARY", "PENUMBRA", "NEAR_JUNCTION", "LEFT_OUT", "END_CELLS", "END_TERMS",
    "BOTH", "AT_CORNER", "FOCK_FIRST", "FOCK_LAST", "FOCK_COUNT", "FOCK_WHOLE", "FOCK_NONE", "COSINE_WHOLE", "WITHIN",
    "COSINE_NONE", "NEAR_WHOLE", "NEAR_NONE", "GRAZING", "GRAZED", "SHORTEST", "ELLIPSOID", "SPHERE", "KNOWN_AT",
    "NEAREST_END", "NEAR_AXIS", "CAP_FADE", "SHARP",
}  # fmt: skip

DECLARATIONS = "common/opencl_c.h"  # joined by the compiler, where that pays

PROGRAMS = {
    "emit": Program(
        ("render/emit.cl",),
        {
            "count": INT, "places": taken("int", "count"), "values": taken("float", "rows, count"), "clear": INT,
            "stride": Argument("long"),
            "emitted": made("float", "rows, stride"),
        },
        frozenset(),
    ),
    "branches": Program(
        (*_ROUNDING, "common/vector.h", "render/branches.cl"),
        {
            "emitted": taken("float", "rows of emitted samples"),
            "first_emitted": Argument("long"),
            "taps": taken("float", "rows, tap_count"),
            "tap_count": INT, "width": INT, "stride": INT, "first_row": INT,
            "rows": made("float", "rows, stride"),
            "sparse": INT,
            "following": taken("int", "cells"),
        },
        frozenset({"LANES", "VECTORS", "OVERSAMPLING", "CELL"}),
    ),
    "coarse_delays": Program(
        (*_PROPAGATION, *_PATHS, "nodes/coarse_delays.cl"),
        {
            **MOTION,
            **IMAGES,
            **VIEWS,
            "receivers": taken("receiver_node", "receivers, ends"),
            "ends": INT,
            "segment_time": DOUBLE,
            "delays": made("double", "ends, 2, slots"),
            "states": made("double", "ends, STATE_NUMBERS, slots"),
        },
        frozenset(_DELAY_CONSTANTS | _KINDS | {"RECEIVER_DIRECTIVITY", "OMNI", "SPHERICAL", "CUBIC_COLUMNS"}),
    ),
    "tracks": Program(
        (
            *_PROPAGATION, *_ROUNDING, *_GAINS, "nodes/spectrum.h", "nodes/lookup_tables.h", "nodes/harmonics.h",
            "nodes/response.h", *_PATHS, *_FIELDS, *_POLYNOMIALS, "nodes/delay_polynomials.h", "nodes/block.h",
            "nodes/smooth.h", "nodes/cell.h", *_MASK, "nodes/activity.h", "nodes/tracks.cl",
        ),
        {
            **MOTION,
            "run": structure(
                "run_numbers", sampling_rate=DOUBLE, delay_samples=DOUBLE, emitted_first=DOUBLE, emitted_last=DOUBLE,
                origin=DOUBLE, max_rate=DOUBLE, middle=DOUBLE, angular_frequency=FLOAT, smooth=FLOAT, first_segment=INT,
                oversampling=INT, **BLOCK_NUMBERS,
            ),
            **IMAGES,
            **VIEWS,
            **PATHS_ACTIVE,
            "receivers": taken("receiver_node", "receivers, nodes"),
            "coarse_delays": taken("double", "ends of segments, 2, slots"),
            "coarse_states": taken("double", "ends of segments, STATE_NUMBERS, slots"),
            **BASIS,
            **TABLES,
            **NODES_MADE,
            **FIELD_TABLES,
        },
        frozenset(_DELAY_CONSTANTS | _NODE_CONSTANTS | _KINDS | _OF_GAINS),
    ),
    "pair_tracks": Program(
        (
            "common/float32.h", "common/triple.h", "common/pairs.h", *_ROUNDING, *_GAINS, "nodes/spectrum.h",
            "nodes/lookup_tables.h", "nodes/harmonics.h", "nodes/response.h", "nodes/pair_delay.h", *_POLYNOMIALS,
            "nodes/block.h", *_MASK, "nodes/activity.h", "nodes/pair_tracks.cl",
        ),
        {
            "run": structure(
                "pair_run_numbers", knot_rate=FLOAT, speed_of_sound=FLOAT, emitted_first=FLOAT, emitted_last=FLOAT,
                angular_frequency=FLOAT, origin=FLOAT, max_rate=FLOAT, knot_count=INT, **BLOCK_NUMBERS,
            ),
            "image_matrix": taken("float2", "9, slots"),
            "image_offset": taken("float2", "3, slots"),
            "receiver_of": taken("int", "slots"),
            **PATHS_ACTIVE,
            "receivers": taken("pair_receiver", "receivers, nodes"),
            "knots": taken("float", "knot_count, KNOT_COLUMNS"),
            "rests": taken("float", "knot_count, CUBIC_COLUMNS"),
            "numbers": taken("float2", "6"),
            **BASIS,
            **TABLES,
            **NODES_MADE,
        },
        frozenset(_NODE_CONSTANTS | {"KNOT_COLUMNS", "RETARDED", "STATIC_RECEIVERS"}),
    ),
    "meetings": Program((*_TRIPLES, *_WALLS, "paths/meetings.cl"), MEETINGS, frozenset({"PARALLEL"})),
    "crossings": Program((*_TRIPLES, *_WALLS, "paths/crossings.cl"), CROSSINGS, frozenset(_CROSSED)),
    "intervals": Program(
        (*_INTERVAL_FILES, "paths/evaluate.h", "paths/spans.h", "paths/intervals.cl"), INTERVALS,
        frozenset(_DELAY_CONSTANTS | _INTERVAL_CONSTANTS),
    ),
    "edge_intervals": Program(
        (*_INTERVAL_FILES, *_EDGES, "paths/edge_intervals.cl"), EDGE_INTERVALS | INTERVALS, frozenset(_EDGE_CONSTANTS)
    ),
    "rays": Program(*RAYS),
    "fades": Program(
        (*_POLYNOMIALS, "render/phases.h", "render/transition.h", "render/fades.cl"),
        {
            **BRANCHES,
            "functions": INT, "first_row": taken("int", "functions + 1"), "channels": INT,
            **BLOCKS, **FADES, "subblock": INT, **PRESSURE,
        },
        frozenset({"DELAY_TERMS", "OVERSAMPLING", "SPARSE", "TRIMMED"}),
    ),
    "trim_activity": Program(*TRIM_ACTIVITY),
    "clear_gains": Program(
        (*_POLYNOMIALS, "render/clear_gains.cl"),
        {
            "count": INT, "slot": taken("int", "count"), "block": taken("int", "count"), "functions": INT,
            "polynomials": changed("float", "blocks, slots, terms"),
            "slots": INT,
        },
        frozenset({"DELAY_TERMS", "SPARSE"}),
    ),
    "taper_gains": Program(*TAPER_GAINS),
    "render": Program(
        (
            *_ROUNDING, "common/vector.h", *_POLYNOMIALS, *_GAINS, *_MASK, "render/phases.h", "render/subblock.h",
            "render/farrow.h", "render/render.cl",
        ),
        {
            **BRANCHES,
            "first_row": taken("int", "functions + 1"),
            "functions": INT, "first_gain": INT, "first_function": INT, "functions_here": INT,
            **BLOCKS,
            "first_slot": taken("int", "receivers + 1"), "block_subblocks": INT, "subblocks": INT,
            "pressure_row": taken("int", "receivers"),
            **PRESSURE,
        },
        frozenset({
            "LANES", "VECTORS", "WORKERS", "SPARSE", "FINE", "OVERSAMPLING", "BATCH", "TILE", "SUBBLOCKS",
            "DELAY_TERMS", "FUNCTIONS", "CHANNELS", "APART",
        }),
    ),
    "moments": Program(*MOMENTS),
    "scatter": Program(
        (*_ROUNDING, "common/vector.h", *_POLYNOMIALS, "common/taper.h", "render/carrier.h", "channels/scatter.cl"),
        SCATTER,
        frozenset({
            "LANES", "DELAY_TERMS", "SPARSE", "FUNCTIONS", "PHASES", "TAPS", "TOGETHER", "TAPERED", "TAPER_TERMS",
        }),
    ),
    "plane_waves": Program(
        (*_ROUNDING, "common/vector.h", "render/plane_waves.cl"),
        {
            "streams": taken("float", "total, stride"),
            "count": INT, "total": INT, "stride": INT, "lead": INT,
            "whole": taken("int", "listeners, nodes, count"),
            "motion": taken("float4", "listeners, nodes, count"),
            "nodes": INT,
            "bank": taken("float", "POWERS, TAPS"),
            "received": made("float", "listeners, nodes NODE"),
        },
        frozenset({"LANES", "NODE", "POWERS", "TAPS"}),
    ),
    "baseband": Program(
        (*_ROUNDING, "common/vector.h", *_POLYNOMIALS, *_MASK, "render/carrier.h", "render/group.h",
         "render/branch_powers.h", "render/baseband.cl"),
        {
            **BRANCHES,
            "first_row": taken("int", "FUNCTIONS + 1"),
            **BLOCKS,
            "first_slot": taken("int", "receivers + 1"), "block_samples": INT, "groups": INT,
            "envelope_row": taken("int", "receivers"), **ENVELOPE,
        },
        frozenset({"LANES", "GROUPS", "BATCH", "SPARSE", "DELAY_TERMS", "FUNCTIONS", "CHANNELS", "SUBBLOCK"})
        | {"FINE", "COUNTS", "PAIRED", "TILTED"},
    ),
    "baseband_fades": Program(
        (
            *_ROUNDING, "common/vector.h", *_POLYNOMIALS, "render/carrier.h", "render/transition.h",
            "render/baseband_fades.cl",
        ),
        {
            **BRANCHES,
            "first_row": taken("int", "FUNCTIONS + 1"),
            **BLOCKS,
            **FADES,
            **ENVELOPE,
        },
        frozenset({"LANES", "SPARSE", "DELAY_TERMS", "FUNCTIONS", "CHANNELS", "PAIRED"}),
    ),
}  # fmt: skip


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
    """Text of a program: its files in order, each behind a ``#line`` that names it; structures before the last one."""
    folder = kernel_folder()
    *files, last = (f'#line 1 "{n}"\n{(folder / n).read_text("utf-8")}' for n in PROGRAMS[program].files)
    return "\n".join([*files, *_structures(PROGRAMS[program]), last])


def _structures(program: Program) -> Iterator[str]:
    """Yield declarations of the structures that a program takes by value."""
    for argument in program.arguments.values():
        if argument.numbers:
            fields = (f"{a.type} {n}{f'[{a.shape}]' if a.shape else ''};" for n, a in argument.numbers)
            yield f"typedef struct {{ {' '.join(fields)} }} {argument.type};"
