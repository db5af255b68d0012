"""A sonar among three things that scatter: its scene file, and the paths of it."""

from pathlib import Path

import numpy as np

import clsim
from clsim.paths.path_set import PathSet
from clsim.scene_file.scene import SceneFile

RATE = 96e3
SCENE = """
format = 1
[room]
kind = "shoebox"
size = [6.0, 5.0, 3.0]
walls = { reflection = 0.8 }
[[sources]]
name = "sonar"
signal = { kind = "chirp", start = 24e3, stop = 26e3, duration = 0.02, sampling_rate = 96e3, window = "hann" }
trajectory = { kind = "fixed", position = [1.0, 2.0, 1.0] }
[[receivers]]
name = "ear"
trajectory = { kind = "fixed", position = [1.0, 2.2, 1.0] }
[[scatterers]]
kind = "ellipsoid"
name = "hand"
semi_axes = [0.02, 0.05, 0.09]
trajectory = { kind = "line", start = [3.0, 2.0, 1.0], end = [2.9, 2.2, 1.1], duration = 0.2 }
[[scatterers]]
kind = "sphere"
name = "ball"
radius = 0.03
trajectory = { kind = "fixed", position = [3.0, 3.0, 1.0] }
[[scatterers]]
kind = "point"
name = "bat"
target_strength_db = -30.0
fluctuation = { correlation_time = 0.05, steady = 0.3, seed = 7 }
trajectory = { kind = "circle", center = [3.0, 2.5, 2.0], radius = 0.3, period = 0.5, duration = 0.2 }
[paths]
max_order = 1
scattering_order = 1
[render]
sampling_rate = 96e3
duration = 0.06
chunk = 18432
"""


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
