"""A small study whose members note by which process they were run."""

import json
import os
import sys
from pathlib import Path

from scene_texts import along, receiver_at, scene_text, source_at, tone_of

ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
SCENE = scene_text(
    source_at("robot", tone_of(40e3, 0.02, fade=0.005), along((1, 1, 1), (2, 1, 1), 1.0)),
    receiver_at("left", (3.0, 1.0, 2.0)),
    receiver_at("right", (3.0, 2.0, 2.0)),
)
# What ran is noted beside the study, a file per run and member.
METRICS = """
import os
import time
import uuid
from pathlib import Path

import numpy as np


def level(recording, paths, parameters):
    note = Path(__file__).parent / "ran"
    note.mkdir(exist_ok=True)
    (note / f"{parameters['order']}-{parameters['length']}-{os.getpid()}-{uuid.uuid4().hex}").touch()
    time.sleep(parameters["length"] % 1)
    if parameters["length"] == 1.125:
        raise ValueError("not this one")
    return {"rms": np.sqrt(np.mean(recording.samples**2, axis=1)), "paths_found": len(paths)}
"""
STUDY = """
format = 1
scene = "scene.toml"
metrics = "judge:level"
keep = ["recording", "ground_truth", "paths", "metrics"]
[[vary]]
field = "paths.max_order"
name = "order"
values = %s
[[vary]]
field = "sources[0].trajectory.duration"
name = "length"
values = %s
"""


def write_scene(folder: Path) -> Path:
    (folder / "scene.toml").write_text(SCENE, "utf-8")
    (folder / "judge.py").write_text(METRICS, "utf-8")
    return folder


def write(folder: Path, orders: list[int], seconds: list[float]) -> list[str]:
    (folder / "study.toml").write_text(STUDY % (orders, seconds), "utf-8")
    return ["study", str(folder / "study.toml"), "-o", str(folder / "out")]


def runs(folder: Path) -> dict[tuple[int, float], list[int]]:
    """Return the processes that ran each member to its metrics."""
    found: dict[tuple[int, float], list[int]] = {}
    for path in (folder / "ran").iterdir() if (folder / "ran").exists() else []:
        order, seconds, process, _ = path.name.split("-")
        found.setdefault((int(order), float(seconds)), []).append(int(process))
    return found


def index(folder: Path) -> dict[int, dict]:
    rows = [json.loads(line) for line in (folder / "out" / "index.jsonl").read_text("utf-8").splitlines()]
    assert len({row["member"] for row in rows}) == len(rows)
    return {row["member"]: row for row in rows}
