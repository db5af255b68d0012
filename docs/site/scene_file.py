"""Writes docs/scene_file.md: every table and key of a scene file, from the models that read it and the constructors they call.

``python docs/site/scene_file.py``; a test compares the page with what this makes.
"""

import ast
import inspect
import re
import sys
import textwrap
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from clsim.render.options import RenderOptions
from clsim.scene.ends import Receiver
from clsim.scene.fluctuation import Fluctuation
from clsim.scene_file.model import kinds, tables_of
from clsim.scene_file.scene import SceneModel, _Common

PAGE = Path(__file__).parents[1] / "scene_file.md"
UNIT = re.compile(
    r"(?<![\w^`])(m/s|m²|Hz|dB/m|dB|Pa/V|V/Pa|Pa|rad|ppm|°C|°|kg/m³|N s/m⁴|samples|MiB|m|s|V)(?=[;.,]|$| of|\))"
)
HEAD = """# Scene files

This page lists every table and key with its meaning, unit and default. Paths of files are relative
to the scene file. Unknown keys are errors.

| command | what it does |
|---|---|
| `clsim new` | writes a commented file to begin with |
| `clsim check` | reports what a file would compute |
| `clsim schema` | writes a JSON schema for editors |

Texts are in quotes and lists in brackets. Numbers may be written as `40e3`.

"""
# Of keys that no constructor has: they choose one, or are written otherwise.
TEXTS = {
    "kind": "The kind of this table.",
    "format": "Version of the file's format; 1.",
    "room": "The room with its walls.",
    "air": "The air in the room.",
    "sources": "Sources of sound: one `[[sources]]` each.",
    "receivers": "Receivers: one `[[receivers]]` each. A receiver with `positions` is an array.",
    "scatterers": "Scatterers that may move: one `[[scatterers]]` each.",
    "paths": "Options of the search for paths.",
    "render": "Options of rendering.",
    "path": "A file, relative to the scene file.",
    "phases_path": "A second file, with the phases in degrees.",
    "materials": "A material, or materials by the names of groups and `default`.",
    "walls": "A material, or materials by wall: `x_min` to `z_max` and `default`.",
    "obstacles": "Obstacles in the room: one `[[room.obstacles]]` each, a mesh or a plan.",
    "default": "Material of walls that are not named.",
    "roughness": "Standard deviation of the surface's height, m.",
    "leave_out": "Materials whose polygons are not in the room.",
    "sheets_below": "Shells thinner than this are taken as sheets, m; 0 for none.",
    "reflection": "The same factor at all frequencies: a number, or `[real, imaginary]`.",
    "reverberation_time": "Reverberation time by Eyring, s, or a table by frequency: it gives the absorption of the one material of all walls of a shoebox. Obstacles and the absorption of the air are left out.",
    "named": "Name of a built-in material: `clsim materials` lists them.",
    "pulse": "The repeated signal, a table of its own.",
    "positions": "Positions of the elements: a grid or a file.",
    "pillars": "Outlines of pillars: lists of corners, m.",
    "speed_of_sound": "m/s, or `\"iso9613\"`; from temperature, humidity and pressure if left out.",
    "interpolator": "The fractional delay filter.",
    "baseband": "Complex envelopes about a carrier instead of sound.",
    "phases": "One per magnitude, rad.",
    "aim": "A fixed direction of the axis, or `\"forward\"` for the direction of motion. Only for trajectories without orientations of their own.",
    "flush": "Whether it sits in a wall, or in a face of the body that carries it. A direction names the side: off that wall or face.",
    "rear": "Values beyond the last angle of the table: those of that angle, mirrored ones, or zero.",
    "side": "The side that is used of a table from -180° to 180°.",
    "outside": "`\"hold\"` takes the nearest frequency outside the given ones. If left out, this is an error.",
    "relative_to_axis": "Whether values are divided by the value on the axis.",
    "sequence": "The kind of sequence of chips.",
    "magnitudes": "One per frequency, Pa/V of sources and V/Pa of receivers.",
}  # fmt: skip
# Of keys that mean something else in one table than in others, or that no constructor tells of by their names.
IN_TABLE = {
    "_Segment": {"start": "Name of the joint at which it begins.", "end": "Name of the joint at which it ends.", "radius": "Radius of its cross-section, m."},
    "_Direct": {"source": "Name of the source.", "receiver": "Name of the receiver.", "level_db": "Level of the direct sound, dB."},
    "_Scattering": {"frequencies": "Increasing, Hz.", "values": "Scattering coefficients at these frequencies, 0 to 1."},
    "_Transmission": {
        "surface_mass": "Mass of a limp panel by area, 1e-3 to 1e5 kg/m², for the mass law.",
        "frequencies": "Frequencies of a table in place of the mass, increasing, Hz.",
        "losses_db": "Transmission losses at these frequencies, 0 to 300 dB.",
    },
    "_Waypoints": {"positions": "Positions at these times: three coordinates for each, m."},
    "_File": {
        "format": "Format of the file: lines of `t x y z qx qy qz qw` (TUM), the CSV of EuRoC, CSV with a header, or a ROS bag.",
        "rotate": "Unit quaternion x y z w. After `scale` it turns the axes of the file into those of the room.",
        "scale": "Metres in the file's unit of length: 0.001 for millimetres.",
        "translate": "Displacement after scaling and turning, m.",
    },
    "PolygonsRoomModel": {"path": "A TOML file of corners and polygons: see [meshes](meshes.md)."},
    "_Decay": {"frequencies": "Positive and increasing, Hz.", "seconds": "Reverberation times at these frequencies, s."},
    "_ResponseTable": {"outside": "Outside the given frequencies, `\"zero\"` takes no response and `\"hold\"` that of the nearest one. If left out, this is an error."},
    "_Porous": {"outside": "`\"extend\"` uses the model also where it was not fitted. If left out, this is an error."},
}  # fmt: skip


def type_of(annotation: Any) -> str:
    """Return the type of a key in words."""
    if get_origin(annotation) is Annotated:
        return type_of(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        parts = [part for part in get_args(annotation) if part is not type(None)]
        return " or ".join(dict.fromkeys(type_of(part) for part in parts))
    if get_origin(annotation) is Literal:
        return " or ".join(f'`"{word}"`' if isinstance(word, str) else str(word) for word in get_args(annotation))
    if get_origin(annotation) is list:
        inner = type_of(get_args(annotation)[0])
        return "list of tables" if "table" in inner else f"list of {inner}s" if " " not in inner else f"list ({inner})"
    if get_origin(annotation) is dict or tables_of(annotation):
        return "table"
    return {float: "number", int: "whole number", str: "text", bool: "true or false"}.get(annotation, "value")


def default_of(field: Any) -> str:
    """Return a key's default as the file has it; a dash where there is none, nothing where it must be given."""
    if field.is_required():
        return "must be given"
    value = field.get_default(call_default_factory=True)
    if value is None or value is PydanticUndefined:
        return "–"
    if isinstance(value, BaseModel):
        kind = getattr(value, "kind", "")
        return f'`{{ kind = "{kind}" }}`' if kind else "`{}`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def constructors(model: type[BaseModel]) -> Iterator[Callable[..., Any]]:
    """Yield the constructors whose arguments a model's keys are: its own, or what its methods call by name."""
    if own := getattr(model, "constructor", None):
        yield own
        yield vars(sys.modules[own.__module__]).get(own.__qualname__.partition(".")[0], own)  # its class
    methods = [
        (name, found) for base in model.__mro__ for name, found in vars(base).items() if inspect.isfunction(found)
    ]
    for name, method in methods:
        if name not in ("build", "parts") or not method.__module__.startswith("clsim."):
            continue
        tree = ast.parse(textwrap.dedent(inspect.getsource(method)))
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call | ast.Attribute)):
            target = ast.unparse(call.func if isinstance(call, ast.Call) else call)
            if re.fullmatch(r"[A-Za-z_][\w.]*", target) and target.split(".")[0] in method.__globals__:
                found: Any = method.__globals__[target.split(".")[0]]
                for part in target.split(".")[1:]:
                    found = getattr(found, part, None)
                if callable(found) and str(getattr(found, "__module__", "")).startswith("clsim."):
                    yield found


def described(function: Any) -> dict[str, str]:
    """Return a docstring's text for each parameter, in one line."""
    text = inspect.cleandoc(function.__doc__ or "")
    found: dict[str, str] = {}
    names: list[str] = []
    section = re.search(r"^(?:Parameters|Attributes)\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", text, re.MULTILINE | re.DOTALL)
    for line in (section[1] if section else "").splitlines():
        if line and not line[0].isspace():
            names = [name.strip().lstrip("*") for name in line.partition(" : ")[0].split(",")]
            found |= dict.fromkeys(names, "")
        elif line.strip():
            units = line.strip().rstrip(".").split(", ")
            # "s, Hz.": one for each.
            each = len(units) == len(names) > 1 and all(UNIT.fullmatch(unit) for unit in units)
            for i, name in enumerate(names):
                found[name] = f"{units[i]}." if each else f"{found[name]} {line.strip()}".strip()
    return found


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """Return the meaning of each key of a table."""
    told: dict[str, str] = {}
    owners = [*constructors(model), *((RenderOptions,) if model.__name__ == "_Render" else ())]
    if model.__name__ == "_Paths":
        from clsim.paths.find_paths import find_paths

        owners.append(find_paths)
    if issubclass(model, _Common):
        owners.append(Receiver)
    if model.__name__ == "_Fluctuation":
        owners.append(Fluctuation)
    if model is SceneModel:
        from clsim.scene.scene import Scene

        owners.append(Scene)
    for owner in owners:
        told = described(owner) | told
    own = {name: TEXTS[name] for name in model.model_fields if name in TEXTS}
    for name, field in model.model_fields.items():
        if name not in own and name not in told and tables_of(field.annotation):
            told[name] = (
                f"A table: see {' and '.join(dict.fromkeys(title(t) for _, t in tables_of(field.annotation)))}."
            )
    return told | own | IN_TABLE.get(model.__name__, {})


def title(model: type[BaseModel]) -> str:
    """Return the title of a table: words of the model's name, and its kind."""
    words = re.sub(r"Model$", "", model.__name__.strip("_"))
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", words).lower()
    return f'{words}, `kind = "{kinds(model)[0]}"`' if kinds(model) else words


def all_tables() -> dict[type[BaseModel], str]:
    """Return every table of a scene file, with where it first stands."""
    found: dict[type[BaseModel], str] = {SceneModel: ""}
    waiting = [SceneModel]
    while waiting:
        model = waiting.pop(0)
        for name, field in model.model_fields.items():
            for _, table in tables_of(field.annotation):
                if table not in found:
                    many = get_origin(field.annotation) is list or "list[" in str(field.annotation)[:40]
                    found[table] = f"{found[model]}.{name}".strip(".") + ("[]" if many else "")
                    waiting.append(table)
    return found


def unit_of(model: type[BaseModel], name: str, text: str) -> str:
    """Return the unit of a key's value: the one that its text names first, but for some."""
    if type_of(model.model_fields[name].annotation) in ("text", "table", "true or false", "list of tables"):
        return ""
    found = UNIT.search(text)
    return UNITS.get(f"{model.__name__}.{name}", UNITS.get(name, found[1] if found else ""))


def example_of(model: type[BaseModel], name: str, where: str = "") -> str:
    """Return a line of TOML in which the key stands, with its default or a value of its type."""
    field = model.model_fields[name]
    if tables_of(field.annotation):
        if type_of(field.annotation) == "list of tables":
            return f"[[{f'{where}.{name}'.strip('.').replace('[]', '')}]]"
        inner = tables_of(field.annotation)[0][1]
        kind = f'kind = "{kinds(inner)[0]}", ' if kinds(inner) else ""
        return f"{name} = {{ {kind}… }}"
    value = default_of(field)
    if value.startswith("`") and value not in ("`[]`",):
        return f"{name} = {value.strip('`')}"
    example = EXAMPLES.get(f"{model.__name__}.{name}") or EXAMPLES.get(name)
    return f"{name} = {example or _sample(field.annotation)}"


# Of keys whose text names another unit first, or none; in one table, or in all.
UNITS = {
    "ambient_noise_db": "dB", "self_noise_db": "dB", "low_cut": "Hz", "high_cut": "Hz",
    "adc_full_scale": "V", "clock_ppm": "ppm", "clock_offset": "s", "flow_resistivity": "Pa s/m²", "temperature_celsius": "°C",
    "response_error_db": "dB", "prune_below_db": "dB", "sensitivity": "Pa/V, V/Pa", "rotate": "", "repeats": "", "samples": "",
    "narrowband": "", "outline": "m", "pillars": "m", "surface_mass": "kg/m²",
}  # fmt: skip
EXAMPLES = {
    "name": '"robot"', "path": '"room.obj"', "size": "[8.0, 6.0, 3.0]", "outline": "[[0, 0], [8, 0], [8, 5], [0, 5]]", "height": "3.0",
    "frequency": "40e3", "duration": "2.0", "sampling_rate": "192e3", "position": "[1.0, 1.0, 2.5]", "center": "[4.0, 3.0, 1.5]",
    "radius": "0.5", "period": "1.0", "start": "30e3", "stop": "50e3", "max_gap": "0.5", "repair": '["gaps"]', "topic": '"/robot/odom"',
    "aim": "[0.0, 0.0, -1.0]", "wind": "[0.3, 0.0, 0.0]", "heights": "[0.0, 3.0]", "max_order": "3", "carrier": "40e3", "bandwidth": "3e3",
    "frequencies": "[30e3, 50e3]", "coefficients": "[0.1, 0.2]", "factors": "[0.9, [0.8, 0.1]]", "impedances": "[[3.0, -1.0], [2.5, -0.5]]",
    "named": '"plywood"', "target_strength_db": "-20.0", "semi_axes": "[0.02, 0.05, 0.09]", "band": "[30e3, 50e3]", "bits": "8",
    "adc_bits": "12", "adc_full_scale": "1.0", "self_noise_db": "20.0", "ambient_noise_db": "30.0", "count": "10", "seed": "1",
    "_Line.start": "[1.0, 1.0, 1.5]", "_Line.end": "[3.0, 1.0, 1.5]", "_Segment.start": '"hip"', "_Segment.end": '"knee"',
    "orientation": "[0.0, 0.0, 0.0, 1.0]", "orientations": "[[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]", "times": "[0.0, 2.0]",
    "positions": "[[1.0, 1.0, 1.5], [3.0, 1.0, 1.5]]", "axis": "[0.0, 0.0, 1.0]", "axis_point": "[1.0, 0.0, 0.0]", "angles": "[0.0, 1.57]",
    "origin": "[0.0, 0.0, 0.0]", "pillars": "[[[2.0, 2.0], [2.4, 2.0], [2.4, 2.4]]]", "vertices": "[[0, 0, 0], [1, 0, 0], [0, 0, 1]]",
    "triangles": "[[0, 1, 2]]", "values": "[0.1, 0.3]", "chip_rate": "8e3", "width": "2.4e3", "low_cut": "20e3", "high_cut": "80e3",
    "phases": "[0.0, 0.1]", "prune_below_db": "-100.0", "_TruncatedLagrange.order": "13", "_TruncatedLagrange.length": "8", "chunk": "147456",
    "DirectivityTableModel.angle": '"angle"', "DirectivityTableModel.frequency": '"frequency"', "DirectivityTableModel.values": '"values"',
    "_NamedTransducer.name": '"MA40S4R"', "_Named.name": '"MA40S4S"', "_Person.height": "1.75", "_File.path": '"walk.txt"', "_Wav.path": '"call.wav"',
    "PolygonsRoomModel.path": '"studio.toml"', "leave_out": '["curtain"]', "_ImpulseResponseFile.path": '"response.wav"', "DirectivityTableModel.path": '"beam.csv"', "SofaModel.path": '"beam.sofa"',
    "_PositionsFile.path": '"microphones.csv"', "_CapturedPerson.path": '"walk.bvh"',
    "flow_resistivity": "20e3", "thickness": "0.05", "density": "1800.0", "sound_speed": "2500.0", "magnitudes": "[0.5, 1.0]",
}  # fmt: skip


def _sample(annotation: Any) -> str:
    kind = type_of(annotation)
    word = re.search(r'`("[^`]*")`', kind)
    if word:
        return word[1]
    if kind.startswith("list"):
        return "[0.0, 1.0, 2.0]"
    return {"number": "1.0", "whole number": "1", "text": '"…"', "true or false": "true"}.get(
        kind.split(" or ")[0], "…"
    )


def page() -> str:
    """Return the page."""
    parts = [HEAD]
    for model, where in all_tables().items():
        parts.append(f"## `{where or 'the file'}`: {title(model)}\n\n" if where else "## The file itself\n\n")
        parts.append("| key | what | type | unit | default | example |\n|---|---|---|---|---|---|\n")
        told = meanings(model)
        for name, field in model.model_fields.items():
            text = re.sub(r"\s+", " ", told.get(name, field.description or "")).replace("|", "or").replace("<", "&lt;")
            text = re.sub(r"``([^`]*)``", r"`\1`", text)
            shown = [f"`{name}`", text, type_of(field.annotation), unit_of(model, name, text), default_of(field)]
            parts.append("| " + " | ".join([*shown, f"`{example_of(model, name, where)}`"]) + " |\n")
        parts.append("\n")
    return "".join(parts).rstrip() + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
