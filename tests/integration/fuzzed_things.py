"""Drawn things that move, for tables of scene files."""

import copy
from typing import Any

import numpy as np


def pick(random: np.random.Generator, values: list[Any], weights: list[int] | None = None) -> Any:
    share = None if weights is None else np.array(weights) / sum(weights)
    return copy.deepcopy(values[int(random.choice(len(values), p=share))])


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
        "kind": "swing",
        "axis_point": [2.1, 0.4, 0.5],
        "axis": [0.0, 0.0, 1.0],
        "angles": [0.0, 0.2, 0.3],
        "times": [0.0, 0.2, 0.5],
    }
    wall = pick(random, materials)
    return {"name": name} | pick(random, [
        {"kind": "box", "size": [0.3, 0.2, 0.4], "material": wall, "trajectory": slide},
        {"kind": "box", "size": [0.3, 0.0, 0.4], "centre": [0.15, 0.0, 0.0], "material": wall, "trajectory": swing},
        {"kind": "faces", "vertices": [[0.0, -0.2, -0.2], [0.0, 0.2, -0.2], [0.0, 0.2, 0.2], [0.0, -0.2, 0.2]],
         "triangles": [[0, 1, 2], [0, 2, 3]], "material": wall, "trajectory": swing},
        {"kind": "mesh", "mesh": {"path": "thing.off", "translate": [-2.1, -2.6, -1.1], "materials": wall}, "trajectory": slide},
    ])  # fmt: skip
