"""The manifest of kernels: of every program its files, its arguments in order, and its compile-time constants.

A test holds every entry against the sources. ``kernels/README.md`` says what each program does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from clsim.errors import ClsimError


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of a kernel.

    Attributes
    ----------
    type : str
        In OpenCL C: of the number, or of the elements of the buffer.
    shape : str
        Of a buffer, outermost first, in constants and in the names of other arguments or of words; empty for a number.
    access : {"", "in", "out", "in out"}
        How a buffer is used; empty for a number.
    """

    type: str
    shape: str = ""
    access: str = ""


@dataclass(frozen=True, slots=True)
class Program:
    """A program of one kernel, which has its name.

    Attributes
    ----------
    files : tuple of str
        Joined in this order.
    arguments : dict
        By name, in the order of the signature.
    constants : frozenset of str
        What is given at compile time (``-D``), all of it at every build.
    """

    files: tuple[str, ...]
    arguments: dict[str, Argument]
    constants: frozenset[str]


def _in(kind: str, shape: str) -> Argument:
    return Argument(kind, shape, "in")


def _out(kind: str, shape: str) -> Argument:
    return Argument(kind, shape, "out")


def _both(kind: str, shape: str) -> Argument:
    return Argument(kind, shape, "in out")


_INT, _FLOAT, _DOUBLE = Argument("int"), Argument("float"), Argument("double")

_TRIPLES = ("common/triple.h",)
_PROPAGATION = (*_TRIPLES, "common/side_by_side.h", "paths/trajectory.h", "paths/delay.h")
_WALLS = ("paths/wall_tree.h", "paths/walls.h")
_INTERVAL_FILES = (
    *_PROPAGATION, *_WALLS, "paths/trajectory_tables.h", "paths/unfolded.h", "paths/visibility.h",
)  # fmt: skip
_POLYNOMIALS = ("common/polynomials.h",)
_ROUNDING = ("common/rounding.h",)
_GAINS = ("common/gains.h",)
_MASK = ("common/mask.h",)

_IMAGES = {
    "image_matrix": _in("double", "9, slots"),
    "image_offset": _in("double", "3, slots"),
    "receiver_of": _in("int", "slots"),
}
_TRAJECTORY = {
    "knots": _in("double", "knot_count, KNOT_COLUMNS"),
    "knot_count": _INT, "first_knot": _DOUBLE, "knot_rate": _DOUBLE,
}  # fmt: skip
_MEDIUM = {"speed_of_sound": _DOUBLE, "wind": _in("double", "3")}
_BRANCHES = {"branches": _in("float", "rows, stride"), "stride": _INT, "lead": _INT}
_BLOCKS = {
    "delay": _in("int", "blocks, slots"),
    "polynomials": _in("float", "blocks, slots, terms"),
    "activity": _in("int", "blocks, slots"),
    "slots": _INT,
    "first_block": _INT,
}
_PRESSURE = {
    "pressure": _both("float", "receivers, pressure_stride"), "pressure_stride": _INT, "first_sample": _INT,
}  # fmt: skip
_ENVELOPE = {
    "envelope": _both("float", "receivers, 2, envelope_stride"),
    "envelope_stride": _INT,
    "first_sample": _INT,
    "turn_per_sample": Argument("ulong"),
    "half_turns_per_sample": _FLOAT,
}
_FADES = {
    "slot_of": _in("int", "fades"),
    "start": _in("float", "fades"),
    "end": _in("float", "fades"),
    "first": _in("int", "places + 1"),
    "row": _in("int", "places"),
    "block": _in("int", "places"),
    "per_ramp": _FLOAT,
    "block_samples": _INT,
    "samples": _INT,
}
_ROOM = {
    "tolerance": _DOUBLE, "thickness": _DOUBLE, "plane": _in("double4", "walls"), "sphere": _in("double4", "walls"),
    "same": _in("int", "walls"), "first_edge": _in("int", "walls + 1"), "first_piece": _in("int", "walls + 1"),
    "first_line": _in("int", "pieces + 1"), "first_twin": _in("int", "walls + 1"), "edge": _in("edge_ends", "edges"),
    "line": _in("double4", "lines"), "twin": _in("int", "twins"), "box_count": _INT,
    "box_middle": _in("double4", "box_count"), "box_extent": _in("double4", "box_count"),
    "box_wall": _in("int", "box_count"), "box_skip": _in("int", "box_count"),
}  # fmt: skip
_MEETINGS = {
    **_ROOM, "half_spaces": _in("double4", "beams, half_space_count"), "half_space_count": _INT, "beams": _INT,
    "centre": _in("double", "beams, 3"), "radius": _DOUBLE, "slack": _DOUBLE, "last_wall": _in("int", "beams"),
    "side": _in("int", "wall_count"), "receivers": _in("double4", "receiver_count"), "seen": _in("double4", "sides"),
    "first_seen": _in("int", "receiver_count * wall_count + 1"), "receiver_count": _INT, "wall_count": _INT,
    "capacity": _INT, "found": _out("int2", "capacity"), "found_count": _both("int", "1"),
}  # fmt: skip
_CROSSINGS = {
    **_ROOM, "start": _in("double", "segments, 3"), "stop": _in("double", "segments, 3"), "segments": _INT,
    "found": _out("int", "segments, MOST"),
}  # fmt: skip
_INTERVALS = {
    **_ROOM, "places": _in("table_place", "1 + receivers"), "scales": _in("table_scale", "1 + receivers"),
    "knots": _in("double", "knots, KNOT_COLUMNS"), "speeds": _in("double", "speeds"),
    "mounts": _in("double4", "1 + receivers"), **_MEDIUM, "slowest": _DOUBLE, "sequences": _in("int", "paths, ORDER"),
    "receiver_of": _in("int", "paths"), "active": _in("int", "active_count"), "active_count": _INT,
    "resolution": _DOUBLE, "smallest_move": _DOUBLE, "graze": _DOUBLE, "budget": _INT,
    "states": _both("progress", "paths"), "found": _out("interval", "found"), "found_count": _both("int", "1"),
}  # fmt: skip
_EDGE_INTERVALS = {
    "others": _in("int", "paths, other_count"), "other_count": _INT, "edges": _in("edge_of_room", "edges of the room"),
    "edge_of": _in("int", "paths, 2"), "face_of": _in("int", "paths, 2"), "end_of": _in("int", "paths"),
    "from_receiver": _INT, "far": _DOUBLE,
}  # fmt: skip
_INTERVAL_CONSTANTS = {
    "ORDER", "DEPTH", "GRAZE_TIME", "CERTAIN", "LEAST_SHARE", "EVER", "INNER", "PARALLEL", "AT_EDGE", "TOUCHING",
    "SOURCE_PERTURBATION", "RECEIVER_PERTURBATION",
}  # fmt: skip
_CROSSING_CONSTANTS = {"MOST", "INNER", "PARALLEL"}
_DELAY_CONSTANTS = {"KNOT_COLUMNS", "NODES_AT_ONCE", "RETARDED", "STATIC_RECEIVERS", "WIND"}

DECLARATIONS = "common/opencl_c.h"  # joined by the compiler, where that pays

PROGRAMS = {
    "emit": Program(
        ("render/emit.cl",),
        {
            "count": _INT,
            "places": _in("int", "count"),
            "values": _in("float", "rows, count"),
            "clear": _INT,
            "stride": Argument("long"),
            "emitted": _out("float", "rows, stride"),
        },
        frozenset(),
    ),
    "branches": Program(
        (*_ROUNDING, "common/vector.h", "render/branches.cl"),
        {
            "emitted": _in("float", "rows of emitted samples"),
            "first_emitted": Argument("long"),
            "taps": _in("float", "rows, tap_count"),
            "tap_count": _INT, "width": _INT, "stride": _INT, "first_row": _INT,
            "rows": _out("float", "rows, stride"),
            "sparse": _INT,
            "following": _in("int", "cells"),
        },
        frozenset({"LANES", "VECTORS", "OVERSAMPLING", "CELL"}),
    ),
    "coarse_delays": Program(
        (*_PROPAGATION, "nodes/image.h", "nodes/coarse_delays.cl"),
        {
            **_IMAGES,
            "receivers": _in("receiver_node", "receivers, ends"),
            "ends": _INT,
            **_TRAJECTORY,
            "start": _DOUBLE,
            "walk_time": _DOUBLE,
            **_MEDIUM,
            "delays": _out("double", "ends, 2, slots"),
        },
        frozenset(_DELAY_CONSTANTS | {"RECEIVER_DIRECTIVITY", "OMNI", "SPHERICAL"}),
    ),
    "tracks": Program(
        (
            *_PROPAGATION, *_ROUNDING, *_GAINS, "nodes/spectrum.h", "nodes/lookup_tables.h", "nodes/response.h",
            "nodes/image.h", "nodes/solve_nodes.h", *_POLYNOMIALS, "nodes/septic.h", "nodes/block.h",
            "nodes/smooth.h", *_MASK, "nodes/activity.h", "nodes/tracks.cl",
        ),
        {
            **_IMAGES,
            "reflection": _in("bins", "slots, PARTS, BIN_VECTORS"),
            "wall_of": _in("int", "angular, slots"),
            "normal": _in("float", "angular, 3, slots"),
            "heard_from": _in("int", "slots"),
            "heard_until": _in("int", "slots"),
            "receivers": _in("receiver_node", "receivers, nodes"),
            "nodes": _INT,
            "coarse_delays": _in("double", "ends of walks, 2, slots"),
            "first_walk": _INT,
            **_TRAJECTORY,
            "start": _DOUBLE,
            "sampling_rate": _DOUBLE,
            **_MEDIUM,
            "nepers": _in("bins", "BIN_VECTORS"),
            "projection": _in("gains", "PARTS, FREQUENCIES, GAIN_VECTORS"),
            "functions": _in("bins", "function_count, PARTS, BIN_VECTORS"),
            "weight": _in("bins", "BIN_VECTORS"),
            "strengths": _in("gains", "GAIN_VECTORS"),
            "function_count": _INT, "angular": _INT,
            "delay_samples": _DOUBLE,
            "emitted_first": _DOUBLE,
            "emitted_last": _DOUBLE,
            "angular_frequency": _FLOAT,
            "smooth": _FLOAT,
            "wall_tables": _in("bins", "materials, CELLS, 4, PARTS, BIN_VECTORS"),
            "source_directivity": _in("bins", "a table"),
            "receiver_directivities": _in("bins", "tables"),
            "directivity_of": _in("int", "receivers"),
            "blocks": _INT, "block_samples": _INT, "walk_blocks": _INT,
            "subblock_samples": _INT, "subblock_share": _FLOAT, "oversampling": _INT,
            "delay": _out("int", "blocks, slots"),
            "polynomials": _out("float", "blocks, slots, terms"),
            "found": _out("float4", "walks, slots"),
            "unheld": _out("float", "walks, slots"),
            "following": _in("int", "cells"),
            "preceding": _in("int", "cells"),
            "cells": _INT,
            "origin": _DOUBLE,
            "max_rate": _DOUBLE,
            "activity": _out("int", "blocks, slots"),
        },
        frozenset(
            _DELAY_CONSTANTS
            | {
                "CELL", "SPARSE", "DELAY_TERMS", "FUNCTIONS", "FREQUENCIES", "PARTS", "CELLS", "SIDE", "FACE_CELLS",
                "CUBIC_COLUMNS", "MACH_EXPONENT", "SOURCE_DIRECTIVITY", "RECEIVER_DIRECTIVITY", "OMNI", "AXIAL",
                "SPHERICAL", "GAIN_ERROR", "SMOOTH_ERROR",
            }
        ),
    ),
    "meetings": Program((*_TRIPLES, *_WALLS, "paths/meetings.cl"), _MEETINGS, frozenset({"PARALLEL"})),
    "crossings": Program((*_TRIPLES, *_WALLS, "paths/crossings.cl"), _CROSSINGS, frozenset(_CROSSING_CONSTANTS)),
    "intervals": Program(
        (*_INTERVAL_FILES, "paths/evaluate.h", "paths/spans.h", "paths/intervals.cl"), _INTERVALS,
        frozenset(_DELAY_CONSTANTS | _INTERVAL_CONSTANTS),
    ),
    "edge_intervals": Program(
        (*_INTERVAL_FILES, "paths/edge.h", "paths/edge_evaluate.h", "paths/spans.h", "paths/edge_intervals.cl"),
        _EDGE_INTERVALS | _INTERVALS,
        frozenset(_DELAY_CONSTANTS | _INTERVAL_CONSTANTS | {"CONTRACTIONS", "CONTRACTED", "HALF_TURN"}),
    ),
    "fades": Program(
        (*_POLYNOMIALS, "render/phases.h", "render/transition.h", "render/fades.cl"),
        {
            **_BRANCHES, "functions": _INT, "first_row": _in("int", "functions + 1"),
            **_BLOCKS, **_FADES, **_PRESSURE,
        },
        frozenset({"DELAY_TERMS", "OVERSAMPLING", "SPARSE"}),
    ),
    "clear_gains": Program(
        (*_POLYNOMIALS, "render/clear_gains.cl"),
        {
            "count": _INT, "slot": _in("int", "count"), "block": _in("int", "count"), "functions": _INT,
            "polynomials": _both("float", "blocks, slots, terms"),
            "slots": _INT,
        },
        frozenset({"DELAY_TERMS", "SPARSE"}),
    ),
    "render": Program(
        (
            *_ROUNDING, "common/vector.h", *_POLYNOMIALS, *_GAINS, *_MASK, "render/phases.h", "render/subblock.h",
            "render/farrow.h", "render/render.cl",
        ),
        {
            **_BRANCHES,
            "first_row": _in("int", "functions + 1"),
            "functions": _INT, "first_function": _INT, "functions_here": _INT,
            **_BLOCKS,
            "first_slot": _in("int", "receivers + 1"), "block_subblocks": _INT, "subblocks": _INT,
            "pressure_row": _in("int", "receivers"),
            **_PRESSURE,
        },
        frozenset(
            {
                "LANES", "VECTORS", "WORKERS", "SPARSE", "FINE", "OVERSAMPLING", "BATCH", "TILE", "SUBBLOCKS",
                "DELAY_TERMS", "FUNCTIONS", "ROWS",
            }
        ),
    ),
    "baseband": Program(
        (*_ROUNDING, "common/vector.h", *_POLYNOMIALS, *_MASK, "render/carrier.h", "render/baseband.cl"),
        {
            **_BRANCHES,
            "first_row": _in("int", "FUNCTIONS + 1"),
            **_BLOCKS,
            "first_slot": _in("int", "receivers + 1"),
            "block_samples": _INT,
            "envelope_row": _in("int", "receivers"),
            **_ENVELOPE,
        },
        frozenset({"LANES", "VECTORS", "SPARSE", "DELAY_TERMS", "FUNCTIONS", "SUBBLOCK"}),
    ),
    "baseband_fades": Program(
        (
            *_ROUNDING, "common/vector.h", *_POLYNOMIALS, "render/carrier.h", "render/transition.h",
            "render/baseband_fades.cl",
        ),
        {
            **_BRANCHES, "first_row": _in("int", "FUNCTIONS + 1"), **_BLOCKS, **_FADES, **_ENVELOPE,
        },
        frozenset({"LANES", "SPARSE", "DELAY_TERMS", "FUNCTIONS"}),
    ),
}  # fmt: skip


def kernel_folder() -> Path:
    """Return the folder of the kernels: in the installed package, or beside it in a checkout.

    Raises
    ------
    ClsimError
        If there is none; the installation is broken.
    """
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
    """Return what the kernels use of OpenCL C itself, to stand before a program whose compiler is told to read none."""
    return (kernel_folder() / DECLARATIONS).read_text("utf-8")


@cache
def kernel_source(program: str) -> str:
    """Return the text of a program: its files in order, each behind a ``#line`` that names it."""
    folder = kernel_folder()
    files = PROGRAMS[program].files
    return "\n".join(f'#line 1 "{name}"\n{(folder / name).read_text("utf-8")}' for name in files)
