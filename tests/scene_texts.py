"""Scene files of tests, written from what is particular to each."""

import json
from typing import Any


def toml(value: Any) -> str:
    """Return a value as TOML writes it in a line."""
    if isinstance(value, dict):
        keys = (key if key.isidentifier() and key.isascii() else json.dumps(key, ensure_ascii=False) for key in value)
        return "{ " + ", ".join(f"{key} = {toml(each)}" for key, each in zip(keys, value.values(), strict=True)) + " }"
    if value in ("%s", "%d"):  # to be filled in
        return value
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, float):
        return f"{value / 1000.0:g}e3" if value >= 1000.0 and value % 100.0 == 0.0 else repr(value)
    return json.dumps(value, ensure_ascii=False)


def tone_of(frequency: float, duration: float, rate: float = 192e3, **more: Any) -> dict[str, Any]:
    return {"kind": "tone", "frequency": frequency, "duration": duration, "sampling_rate": rate, **more}


def chirp_of(start: float, stop: float, duration: float, rate: float, **more: Any) -> dict[str, Any]:
    return {"kind": "chirp", "start": start, "stop": stop, "duration": duration, "sampling_rate": rate, **more}


def along(start: Any, end: Any, duration: float) -> dict[str, Any]:
    return {"kind": "line", "start": start, "end": end, "duration": duration}


def thing_at(table: str, name: str, at: Any, **more: Any) -> str:
    """Return a table of something at a place, or on a trajectory; at None of several, by their `positions`."""
    fields = {"name": name, **more}
    if at is not None:
        fields["trajectory"] = at if isinstance(at, dict) else {"kind": "fixed", "position": at}
    return f"[[{table}]]\n" + "".join(f"{key} = {toml(value)}\n" for key, value in fields.items())


def source_at(name: str, signal: Any, at: Any, **more: Any) -> str:
    return thing_at("sources", name, at, signal=signal, **more)


def receiver_at(name: str, at: Any, **more: Any) -> str:
    return thing_at("receivers", name, at, **more)


def shoebox_of(*size: float, reflection: float = 0.9) -> dict[str, Any]:
    return {"kind": "shoebox", "size": size or (4.0, 3.0, 2.5), "walls": {"reflection": reflection}}


def scene_text(*things: str, max_order: Any = 1, rate: float = 192e3, **tables: dict[str, Any]) -> str:
    """Return a scene file: `paths` and `render` are what these tables have besides order and sampling rate."""
    tables = {"room": shoebox_of()} | tables
    paths = {"max_order": max_order} | tables.pop("paths", {})
    render = {"sampling_rate": rate} | tables.pop("render", {})
    head, tail = tables, {"paths": paths, "render": render}

    def written(name: str, fields: dict[str, Any]) -> str:
        return f"[{name}]\n" + "".join(f"{key} = {toml(value)}\n" for key, value in fields.items())

    parts = [*(written(*each) for each in head.items()), *things, *(written(*each) for each in tail.items())]
    return "\nformat = 1\n" + "".join(parts)
