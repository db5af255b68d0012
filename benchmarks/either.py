"""One way to call two versions of clsim whose public names differ, for `frozen.py` and `paired.py`.

The tables say what is called otherwise in one of them; a renaming is a line in one of them.
"""

import importlib
import inspect
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import clsim

OPTIONS = {  # keyword of a function: what else it is called
    "convolve_at_rest": ("convolve_static",),
    "quietest_db": ("prune_below_db",),
}
NAMES = {  # of clsim: what else it is called
    "Cardioid": ("FirstOrder",),
    "DirectivityTable": ("AxialDirectivity",),
    "SphericalTable": ("SphericalDirectivity",),
    "direct_truth": ("ground_truth", "direct_path"),
}
ARRAYS = {  # new name of an array that is written: old one
    "objects": "walls",
    "object_names": "wall_names",
    "path_objects": "path_walls",
    "doppler": "doppler_factor",
}
# Of scene files, new: old. Files are written with the new word where the schema has it.
KEYS = {"convolve_static": "convolve_at_rest", "prune_below_db": "quietest_db"}
VALUES = {("kind", "first-order"): ("kind", "cardioid")}
ADDED: dict[str, Any] = {
    "responses": "band",
    "tail": "off",
    "tail_directions": 64,
    "tail_error_db": 0.25,
    "tail_seed": 0,
    "tail_scattering": "size",
}  # key of a completed scene that only one version has: value at which it says nothing new
GROUND_TRUTH = "ground_truth" if hasattr(clsim, "direct_path") else "truth"
DIRECTIVITY_HOMES = ("clsim", "clsim.scene.directivity", "clsim.scene.directivity.patterns")


def found(name: str) -> Any:
    """Return a public thing of clsim by its old name."""
    for candidate in (name, *NAMES.get(name, ())):
        if hasattr(clsim, candidate):
            return getattr(clsim, candidate)
    raise AttributeError(f"clsim has no {name}; add its new name to NAMES in either.py")


def named_directivity(name: str) -> Any:
    """Return a directivity from the library."""
    if hasattr(clsim, "named_directivity"):
        return clsim.named_directivity(name)
    for home in DIRECTIVITY_HOMES:
        try:
            return importlib.import_module(home).Directivity.named(name)
        except (ImportError, AttributeError):
            continue
    raise AttributeError("clsim has no Directivity.named; add its module to DIRECTIVITY_HOMES in either.py")


def named_transducer(name: str) -> clsim.Transducer:
    """Return a transducer from the library."""
    if hasattr(clsim, "named_transducer"):
        return clsim.named_transducer(name)
    return clsim.Transducer.named(name)


def _accepted(function: Callable) -> set[str]:
    """Return the keywords of a function; of one that passes them on, those of the render options too."""
    parameters = inspect.signature(function).parameters
    names = set(parameters)
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        names |= {field.name for field in fields(importlib.import_module("clsim.render.options").RenderOptions)}
    return names


def call(function: Callable, paths: clsim.PathSet, *arguments: Any, **options: Any) -> Any:
    """Return the result of a function for paths, with or without their scene as first argument."""
    accepted = _accepted(function)
    first = (paths.scene, paths) if "scene" in accepted else (paths,)
    return function(*first, *arguments, **renamed(accepted, options))


def renamed(accepted: set[str], options: dict[str, Any]) -> dict[str, Any]:
    """Return options by the names that are accepted."""
    if "responses" in accepted:
        if options.get("transition") == "gate":
            options = options | {"transition": 0.0}
        if options.get("response_error_db") == "centre":
            options = {n: v for n, v in options.items() if n != "response_error_db"} | {"responses": "centre"}
    names = {n: next((m for m in (n, *OPTIONS.get(n, ())) if m in accepted), n) for n in options}
    return {names[n]: value for n, value in options.items()}


def render(paths: clsim.PathSet, rate: float, **options: Any) -> clsim.Recording:
    """Return the recording."""
    return call(clsim.render, paths, rate, **options)


def plan_render(paths: clsim.PathSet, rate: float, **options: Any) -> Any:
    """Return the plan."""
    return call(clsim.plan_render, paths, rate, **options)


def render_tracks(signals: list, tracks: clsim.Tracks, rate: float, **options: Any) -> clsim.Recording:
    """Return the recording of tracks."""
    return clsim.render_tracks(signals, tracks, rate, **renamed(_accepted(clsim.render_tracks), options))


def impulse_responses(paths: clsim.PathSet, rate: float, **options: Any) -> Any:
    """Return the impulse responses."""
    return call(clsim.impulse_responses, paths, rate, **options)


def walls(holder: Any) -> Any:
    """Return the walls of paths (P, max_order), of a set or a table."""
    return holder.walls if hasattr(holder, "walls") else holder.objects


def old_words(value: Any) -> Any:
    """Return the content of a completed scene with the old keys and values."""
    if isinstance(value, list):
        return [old_words(part) for part in value]
    if not isinstance(value, dict):
        return value
    said = {}
    for key, part in value.items():
        if key in ADDED and part == ADDED[key]:
            continue
        key, part = KEYS.get(key, key), old_words(part)
        key, part = VALUES.get((key, part), (key, part)) if isinstance(part, str) else (key, part)
        said[key] = part
    return said


def new_words(value: Any, schema: str) -> Any:
    """Return the content of a scene file with those new keys and values that the schema, JSON, knows."""
    keys = {old: new for new, old in KEYS.items() if f'"{new}"' in schema}
    values = {old: new for new, old in VALUES.items() if f'"{new[1]}"' in schema}
    if isinstance(value, list):
        return [new_words(part, schema) for part in value]
    if not isinstance(value, dict):
        return value
    said = {}
    for key, part in value.items():
        key, part = keys.get(key, key), new_words(part, schema)
        key, part = values.get((key, part), (key, part)) if isinstance(part, str) else (key, part)
        said[key] = part
    return said
