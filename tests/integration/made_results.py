"""A small scene, and what a run of it leaves."""

from pathlib import Path

import numpy as np
import soundfile

from clsim.cli import main
from clsim.paths.path_table import PathTable

SCENE = """
format = 1
[room]
kind = "shoebox"
size = [4.0, 3.0, 2.5]
walls = { reflection = 0.9 }
[[sources]]
name = "robot"
signal = %s
trajectory = { kind = "line", start = [1, 1, 1], end = [1.05, 1, 1], duration = 0.05 }
[[receivers]]
name = "left"
trajectory = { kind = "fixed", position = [3.0, 1.0, 2.0] }
[[receivers]]
name = "%s"
trajectory = { kind = "fixed", position = [3.0, 2.0, 2.0] }
[paths]
max_order = 0
[render]
sampling_rate = 16e3
interpolator = { kind = "lagrange", order = 4 }
engine = "reference"
"""
TONE = '{ kind = "tone", frequency = 2e3, duration = 0.02, sampling_rate = 16e3, fade = 0.005 }'
WAV = '{ kind = "wav", path = "%s" }'


def write_scene(path: Path, signal: str = TONE, name: str = "right") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(SCENE % (signal, name), "utf-8")
    return path


def run(scene: Path, out: Path, *more: str) -> int:
    return main(["run", str(scene), "-o", str(out), "--no-plots", *more])


def everything(folder: Path) -> dict[str, object]:
    """Return all that is under a folder, links as links."""
    return {
        str(p.relative_to(folder)): p.readlink() if p.is_symlink() else p.read_bytes() if p.is_file() else None
        for p in folder.rglob("*")
    }


def wav_input(folder: Path, name: str) -> Path:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(folder / name, np.hanning(320) * np.sin(np.arange(320)), 16_000, subtype="FLOAT")
    return write_scene(folder / "s.toml", WAV % name)


def read_table(path: Path) -> PathTable:
    with np.load(path) as file:
        columns = {name: file[name] for name in PathTable.__dataclass_fields__}
    return PathTable(**{k: tuple(map(str, v)) if k.endswith("_names") else v for k, v in columns.items()})
