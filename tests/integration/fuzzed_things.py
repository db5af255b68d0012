"""Drawn things that move, for tables of scene files."""

import copy
from typing import Any

import numpy as np

_PLACES = ("position", "start", "end", "center", "positions", "translate")


def pick(random: np.random.Generator, values: list[Any], weights: list[int] | None = None) -> Any:
    share = None if weights is None else np.array(weights) / sum(weights)
    return copy.deepcopy(values[int(random.choice(len(values), p=share))])


def align(random: np.random.Generator, content: dict[str, Any]) -> None:
    """Move sources, receivers and scatterers to round places, most of them in one plane, at one height or in one line."""
    shared = random.choice([0.5, 1.0, 1.5], 3)
    same = random.random(3) < (0.0, 0.7, 0.7)
    for kind in ("sources", "receivers", "scatterers"):
        for thing in content.get(kind, []):
            motion = thing.get("trajectory")
            found = [] if motion is None else [motion[key] for key in _PLACES if key in motion]
            places = [place for part in found for place in (part if isinstance(part[0], list) else [part])]
            for axis in range(3 if places else 0):
                old = places[0][axis]
                new = shared[axis] if same[axis] and random.random() < 0.9 else round(2.0 * old) / 2.0
                for place in places:
                    place[axis] = float(place[axis] - old + new)


def scatterer(random: np.random.Generator, name: str) -> dict[str, Any]:
    way = {"kind": "line", "start": [2.2, 2.2, 0.8], "end": [2.3, 2.5, 0.8], "duration": 0.5}
    walk = {"kind": "line", "start": [2.0, 2.4, 0.0], "end": [2.5, 2.4, 0.0], "duration": 0.5}
    return {"name": name} | pick(random, [
        {"kind": "point", "target_strength_db": -20.0, "trajectory": way},
        {"kind": "point", "target_strength_db": -20.0, "trajectory": way,
         "fluctuation": {"correlation_time": 0.05, "steady": 0.3, "seed": 7}},
        {"kind": "sphere", "radius": 0.05, "trajectory": way}, {"kind": "sphere", "radius": 0.05, "model": "geometrical", "trajectory": way},
        {"kind": "ellipsoid", "semi_axes": [0.05, 0.1, 0.07], "trajectory": way},
        {"kind": "capsule", "radius": 0.03, "length": 0.2, "trajectory": way},
        {"kind": "person", "height": 1.6, "trajectory": walk}, {"kind": "hand", "trajectory": way, "opening": [[0.0, 1.0], [0.4, 0.0]]},
    ], [3, 1, 1, 1, 1, 1, 1, 1])  # fmt: skip


def body(random: np.random.Generator, name: str, materials: list[Any]) -> dict[str, Any]:
    slide = {"kind": "line", "start": [2.0, 0.4, 0.6], "end": [2.2, 0.4, 0.6], "duration": 0.5}
    swing = {
        "kind": "swing", "axis_point": [2.1, 0.4, 0.5], "axis": [0.0, 0.0, 1.0], "angles": [0.0, 0.2, 0.3],
        "times": [0.0, 0.2, 0.5],
    }  # fmt: skip
    wall = pick(random, materials)
    return {"name": name} | pick(random, [
        {"kind": "box", "size": [0.3, 0.2, 0.4], "material": wall, "trajectory": slide},
        {"kind": "box", "size": [0.3, 0.0, 0.4], "centre": [0.15, 0.0, 0.0], "material": wall, "trajectory": swing},
        {"kind": "faces", "vertices": [[0.0, -0.2, -0.2], [0.0, 0.2, -0.2], [0.0, 0.2, 0.2], [0.0, -0.2, 0.2]],
         "triangles": [[0, 1, 2], [0, 2, 3]], "material": wall, "trajectory": swing},
        {"kind": "mesh", "mesh": {"path": "thing.off", "materials": wall}, "trajectory": slide | {"start": [0.0, -2.1, -0.4], "end": [0.2, -2.1, -0.4]}},
    ])  # fmt: skip
