"""The arguments of kernels, and those that programs have in common: the first half of the manifest."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of a kernel."""

    type: str  # in OpenCL C: of the number, or of the elements of the buffer
    # Of a buffer, outermost first, in constants and in the names of other arguments or of words; empty for a number.
    shape: str = ""
    access: str = ""  # how a buffer is used; empty for a number
    # Of a structure by value: its numbers by name, wide ones first. Launches are given these by name, too.
    numbers: tuple[tuple[str, Argument], ...] = ()


def taken(kind: str, shape: str) -> Argument:
    """Return the argument of a buffer that is read."""
    return Argument(kind, shape, "in")


def made(kind: str, shape: str) -> Argument:
    """Return the argument of a buffer that is written."""
    return Argument(kind, shape, "out")


def changed(kind: str, shape: str) -> Argument:
    """Return the argument of a buffer that is read and written."""
    return Argument(kind, shape, "in out")


def structure(kind: str, **numbers: Argument) -> Argument:
    """Argument of a structure by value, whose declaration the manifest writes; a shape makes a number an array."""
    return Argument(kind, numbers=tuple(numbers.items()))


INT, FLOAT, DOUBLE = Argument("int"), Argument("float"), Argument("double")

IMAGES = {
    "image_matrix": taken("double", "9, slots"),
    "image_offset": taken("double", "3, slots"),
    "receiver_of": taken("int", "slots"),
}
VIEWS = {"views": taken("view", "slots")}
MOTION = {
    "motion": structure(
        "motion_numbers", first_knot=DOUBLE, knot_rate=DOUBLE, first_pose=DOUBLE, pose_rate=DOUBLE, start=DOUBLE,
        speed_of_sound=DOUBLE, wind=Argument("double", "3"), knot_count=INT, pose_count=INT,
    ),
    "knots": taken("double", "knot_count, KNOT_COLUMNS"),
    "poses": taken("double", "knots, numbers of the kind"),
    "pose_cells": taken("int", "things, pose_count + 1"),
}  # fmt: skip
MEDIUM = {"speed_of_sound": DOUBLE, "wind": taken("double", "3")}
PATHS_ACTIVE = {
    "reflection": taken("bins", "slots, PARTS, BIN_VECTORS"),
    "wall_of": taken("int", "angular, slots"),
    "normal": taken("float", "angular, 3, slots"),
    "active_from": taken("int", "slots"),
    "active_until": taken("int", "slots"),
}  # fmt: skip
BASIS = {
    "air_and_functions": taken("bins", "2 AIR_TERMS + 1 + function_count PARTS, BIN_VECTORS"),
    "projection": taken("gains", "PARTS FREQUENCIES + 1, GAIN_VECTORS"),
}
TABLES = {
    "wall_tables": taken("bins", "materials, CELLS, 4, PARTS, BIN_VECTORS"),
    "source_directivity": taken("bins", "a table"),
    "receiver_directivities": taken("bins", "tables"),
    "directivity_of": taken("int", "receivers"),
}
NODES_MADE = {
    "delay": made("int", "blocks, slots"),
    "polynomials": made("float", "blocks, slots, terms"),
    "found": made("float4", "segments, slots"),
    "residual": made("float", "segments, slots"),
    "active_cells": taken("int", "2, cells"),
    "activity": made("int", "blocks, slots"),
}
BLOCK_NUMBERS = {
    "subblock_share": FLOAT, "function_count": INT, "angular": INT, "nodes": INT, "blocks": INT, "block_samples": INT,
    "segment_blocks": INT, "subblock_samples": INT, "cells": INT,
}  # fmt: skip
FIELD_TABLES = {
    "field_tables": taken("bins", "1 + CELLS 4 PARTS, BIN_VECTORS"),
    "faces": taken("bins", "slots, 2, PARTS, BIN_VECTORS"),
    "modes": taken("double", "Fock's function, spheres, outlines: see path_columns.py"),
}  # fmt: skip
BRANCHES = {"branches": taken("float", "rows, stride"), "stride": INT, "lead": INT}
BLOCKS = {
    "delay": taken("int", "blocks, slots"),
    "polynomials": taken("float", "blocks, slots, terms"),
    "activity": taken("int", "blocks, slots"),
    "slots": INT,
    "first_block": INT,
}
PRESSURE = {
    "pressure": changed("float", "receivers, pressure_stride"), "pressure_stride": INT, "first_sample": INT,
}  # fmt: skip
ENVELOPE = {
    "envelope": changed("float", "receivers, 2, envelope_stride"),
    "envelope_stride": INT,
    "first_sample": INT,
    "turn_per_sample": Argument("ulong"),
    "half_turns_per_sample": FLOAT,
    "tilt": structure(
        "tilt_numbers", tilt_per_sample=FLOAT, stretch=FLOAT, per_stretch=FLOAT, first_stretch=INT, stretches=INT
    ),
}
FADES = {
    "slot_of": taken("int", "fades"),
    "start": taken("float", "fades"),
    "end": taken("float", "fades"),
    "first": taken("int", "places + 1"),
    "row": taken("int", "places"),
    "block": taken("int", "places"),
    "per_ramp": FLOAT,
    "block_samples": INT,
    "samples": INT,
}
MOMENTS = (
    (
        "common/rounding.h", "common/vector.h", "common/polynomials.h", "render/phases.h", "render/transition.h",
        "render/moments.cl",
    ),
    {
        **BRANCHES,
        "first_row": taken("int", "FUNCTIONS + 1"),
        **BLOCKS,
        "start": taken("float", "slots"), "end": taken("float", "slots"), "per_ramp": FLOAT, "block_subblocks": INT,
        "blocks": INT, "row": taken("int", "slots"), "weights": taken("float", "rows, weight_stride"),
        "weight_stride": INT, "first_sample": INT,
        "taken": made("float", "groups, slots, FUNCTIONS, 4"),
    },
    frozenset({"LANES", "SUBBLOCK", "OVERSAMPLING", "DELAY_TERMS", "SPARSE", "FUNCTIONS", "TOGETHER", "GAINS"}),
)  # fmt: skip
ROOM = {
    "tolerance": DOUBLE, "thickness": DOUBLE, "plane": taken("double4", "walls"), "sphere": taken("double4", "walls"),
    "same": taken("int", "walls"), "first_edge": taken("int", "walls + 1"), "first_piece": taken("int", "walls + 1"),
    "first_line": taken("int", "pieces + 1"), "first_twin": taken("int", "walls + 1"),
    "edge": taken("edge_ends", "edges"),
    "line": taken("double4", "lines"), "twin": taken("int", "twins"), "box_count": INT,
    "box_middle": taken("double4", "box_count"), "box_extent": taken("double4", "box_count"),
    "box_wall": taken("int", "box_count"), "box_skip": taken("int", "box_count"),
}  # fmt: skip
MEETINGS = {
    **ROOM, "half_spaces": taken("double4", "beams, half_space_count"), "half_space_count": INT, "beams": INT,
    "centre": taken("double", "beams, 3"), "radius": DOUBLE, "slack": DOUBLE, "last_wall": taken("int", "beams"),
    "side": taken("int", "wall_count"), "receivers": taken("double4", "receiver_count"),
    "seen": taken("double4", "sides"),
    "first_seen": taken("int", "receiver_count * wall_count + 1"), "receiver_count": INT, "wall_count": INT,
    "capacity": INT, "found": made("int2", "capacity"), "found_count": changed("int", "1"),
}  # fmt: skip
CROSSINGS = {
    **ROOM, "start": taken("double", "segments, 3"), "stop": taken("double", "segments, 3"), "segments": INT,
    "found": made("int", "segments, MOST"),
}  # fmt: skip
INTERVALS = {
    **ROOM, "places": taken("table_place", "1 + receivers"), "scales": taken("table_scale", "1 + receivers"),
    "knots": taken("double", "knots, KNOT_COLUMNS"), "speeds": taken("double", "speeds"),
    "mounts": taken("double4", "1 + receivers"), **MEDIUM, "slowest": DOUBLE, "sequences": taken("int", "paths, ORDER"),
    "receiver_of": taken("int", "paths"), "active": taken("int", "active_count"), "active_count": INT,
    "resolution": DOUBLE, "smallest_move": DOUBLE, "graze": DOUBLE, "budget": INT,
    "states": changed("progress", "paths"), "found": made("interval", "found"), "found_count": changed("int", "1"),
}  # fmt: skip
EDGE_INTERVALS = {
    "others": taken("int", "paths, counts[0]"), "counts": taken("int", "4"),
    "seen": taken("edge_of_room", "pairs of edges"),
    "edges": taken("edge_of_room", "edges of the room"), "edge_of": taken("int", "paths, 2"),
    "face_of": taken("int", "paths, 2"), "end_of": taken("int", "paths"), "far": DOUBLE,
}  # fmt: skip
TAPERS = {
    "rise": taken("float", "slots"), "fall": taken("float", "slots"), "terms": taken("float", "TAPER_TERMS"),
    "per_half": FLOAT,
}  # fmt: skip
TAPER_GAINS = (
    ("common/rounding.h", "common/vector.h", "common/polynomials.h", "common/taper.h", "render/taper_gains.cl"),
    {
        "functions": INT, "activity": taken("int", "blocks, slots"), "slots": INT, "first_block": INT, "blocks": INT,
        "block_samples": INT, "ramp": FLOAT, **TAPERS, "polynomials": changed("float", "blocks, slots, terms"),
    },
    frozenset({"LANES", "DELAY_TERMS", "SPARSE", "TAPER_TERMS"}),
)  # fmt: skip
TRIM_ACTIVITY = (
    ("common/mask.h", "render/transition.h", "render/trim_activity.cl"),
    {
        "count": INT, "slot_of": taken("int", "count"), "block": taken("int", "count"),
        "start": taken("float", "count"), "end": taken("float", "count"), "per_ramp": FLOAT, "subblock": INT,
        "activity": changed("int", "blocks, slots"), "slots": INT,
    },
    frozenset[str](),
)  # fmt: skip
SCATTER = {
    "delay": taken("int", "blocks, slots"),
    "polynomials": taken("float", "blocks, slots, terms"),
    "slots": INT, "functions": INT,
    "node_block": taken("int", "nodes"),
    "node_place": taken("float", "nodes"),
    "node_sample": taken("float", "nodes"),
    "nodes": INT,
    **TAPERS,
    "first_slot": taken("int", "receivers + 1"),
    "receivers": INT,
    "window": taken("float", "PHASES + 3, 2, TAPS"),
    "first": INT, "shift": FLOAT, "points": INT, "reached": INT,
    "turn_per_sample": Argument("ulong"), "half_turns_per_sample": FLOAT,
    "grids": changed("float", "nodes, receivers, functions, parts, points"),
}  # fmt: skip
RAY_NUMBERS = structure(
    "ray_numbers", **dict.fromkeys(("radius", "off", "scale", "escape_scale", "rain", "floor_share"), FLOAT),
    bins_per_metre=FLOAT, windows_per_metre=FLOAT, origin=Argument("float", "3"),
    **dict.fromkeys(("count", "first_ray", "groups", "bands", "zone_count", "bins", "early_bins"), INT),
    **dict.fromkeys(("window_count", "arrival_count", "departure_count", "walls", "max_order"), INT),
    stream=Argument("uint"), key=Argument("uint", "2"),
)  # fmt: skip
_OF_RAYS = {
    "run": RAY_NUMBERS, "directions": taken("float", "count, 3"), "emitted": taken("float", "count, bands"),
    "departure": taken("int", "count"), "first_band": taken("int", "groups + 1"), "until": taken("float", "groups"),
    "wavelength": taken("float", "groups"), "plane": taken("float4", "walls"), "along": taken("float4", "walls"),
    "across": taken("float4", "walls"), "kind": taken("int", "walls"),
    "returned": taken("float", "kinds, ANGLES, bands"), "scattered": taken("float", "kinds, ANGLES, groups"),
    "boxes": taken("float8", "nodes, 6"), "children": taken("int8", "nodes"), "leaves": taken("float8", "leaves, 13"),
    "wall_of": taken("int8", "leaves"), "zones": taken("float4", "zone_count"), "late_row": taken("int", "zone_count"),
    "arrivals": taken("float8", "arrival_count / 8, 3"),
    "early": changed("uint2", "zone_count, early_bins, arrival_count, bands"),
    "late": changed("uint2", "rows, bins - early_bins, arrival_count, bands"),
    "images": changed("uint2", "zone_count, bins, bands"),
    "windows": changed("uint2", "SLOTS, zone_count, window_count, bands"),
    "departures": changed("uint2", "zone_count, departure_count"), "escaped": changed("uint2", "walls + 1, bands"),
    "ends": made("float4", "groups, count, 2"),
}  # fmt: skip
RAYS = (  # files, arguments and constants of their program
    ("rays/philox.h", "rays/next_wall.h", "rays/energies.h", "rays/scatter.h", "rays/rays.cl"), _OF_RAYS,
    frozenset(
        {"CONVEX", "SIZED", "BANDS", "SLOTS", "ANGLES", "MOST_REFLECTIONS", "FAINT", "NOT_ESCAPED", "PI", "FARTHEST"}
    ),
)  # fmt: skip
