"""A sonar among three things that scatter: its scene file, and the paths of it."""

from pathlib import Path

import numpy as np
from scene_texts import along, chirp_of, receiver_at, scene_text, shoebox_of, source_at, thing_at

import clsim
from clsim.paths.path_set import PathSet
from clsim.scene_file.scene import SceneFile

RATE = 96e3
SCENE = scene_text(
    source_at("sonar", chirp_of(24e3, 26e3, 0.02, 96e3, window="hann"), (1.0, 2.0, 1.0)),
    receiver_at("ear", (1.0, 2.2, 1.0)),
    thing_at(
        "scatterers", "hand", along((3.0, 2.0, 1.0), (2.9, 2.2, 1.1), 0.2), kind="ellipsoid",
        semi_axes=(0.02, 0.05, 0.09),
    ),
    thing_at("scatterers", "ball", (3.0, 3.0, 1.0), kind="sphere", radius=0.03),
    thing_at(
        "scatterers",
        "bat",
        {"kind": "circle", "center": (3.0, 2.5, 2.0), "radius": 0.3, "period": 0.5, "duration": 0.2},
        kind="point",
        target_strength_db=-30.0,
        fluctuation={"correlation_time": 0.05, "steady": 0.3, "seed": 7},
    ),
    room=shoebox_of(6.0, 5.0, 3.0, reflection=0.8),
    paths={"scattering_order": 1},
    rate=96e3,
    render={"duration": 0.06, "chunk": 18432},
)  # fmt: skip


def sonar(folder: Path) -> SceneFile:
    """Return the scene file, read."""
    (folder / "scene.toml").write_text(SCENE, "utf-8")
    return clsim.load_scene(folder / "scene.toml")


def sonar_paths(file: SceneFile) -> PathSet:
    """Return its paths, by one wall at most before a scatterer and after it."""
    return clsim.find_paths(file.scene, **file.paths)


def level_db(part: np.ndarray, whole: np.ndarray) -> float:
    """Return the level of a signal relative to another, dB."""
    return float(20.0 * np.log10(np.linalg.norm(part) / np.linalg.norm(whole)))
