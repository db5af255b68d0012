"""Scene files for `frozen_scenes.py`, the commands that it runs on them, and what these leave."""

import contextlib
import io
import json
import tomllib
from pathlib import Path
from typing import Any

import either
import numpy as np

import clsim

Arrays = dict[str, np.ndarray]
L_PLAN = [(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)]
PILLAR = [(2.0, 1.8), (2.4, 1.8), (2.4, 2.2), (2.0, 2.2)]


def command(*arguments: object) -> str:
    """Run the command line in this process, which has loaded and built most; return what it prints."""
    from clsim.cli import main

    told, problems = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(problems):
        status = main([str(argument) for argument in arguments])
    assert status == 0, f"{arguments}\n{problems.getvalue()}"
    return told.getvalue()


def results(folder: Path) -> Arrays:
    """Return the arrays of a folder of results: sound, tables, the completed scene."""
    import soundfile

    arrays: Arrays = {}
    for file in sorted(folder.iterdir()):
        if file.suffix == ".wav":
            arrays[file.name] = soundfile.read(file, dtype="float32")[0]
        elif file.suffix == ".npz":
            with np.load(file) as content:
                old = file.name.replace("ground_truth", "truth")
                arrays |= {f"{old}.{either.ARRAYS.get(n, n)}": content[n] for n in content.files}
        elif file.suffix in (".zarr", ".h5"):
            with clsim.open_store(file) as stored:
                arrays |= {f"{file.name}.{n}": np.asarray(stored[n]) for n in ("sound", "unit", "receiver", "position")}
        elif file.name == "scene.completed.toml":
            said = either.old_words(tomllib.loads(file.read_text("utf-8")))
            arrays[file.name] = np.array(json.dumps(said, indent=1, sort_keys=True))
    assert "scene.completed.toml" in arrays
    return arrays


def written_scene() -> dict[str, Any]:
    """Return a scene file with a mesh, a baseband and much else."""
    content = {
        "format": 1,
        "room": {
            "kind": "plan", "outline": [list(map(float, p)) for p in L_PLAN], "height": 3.0,
            "materials": {"default": {"reflection": 0.8}, "floor": {"reflection": 0.5}},
            "pillars": [[list(p) for p in PILLAR]],
        },
        "sources": [{
            "name": "s",
            "signal": {"kind": "chirp", "start": 39e3, "stop": 41e3, "duration": 0.2, "sampling_rate": 192e3, "window": "hann"},
            "trajectory": {"kind": "line", "start": [0.7, 5.0, 1.4], "end": [1.1, 4.1, 1.5], "duration": 0.2},
        }],
        "receivers": [{"name": "a b", "trajectory": {"kind": "fixed", "position": [7.2, 1.2, 2.0]}},
                      {"name": "c", "trajectory": {"kind": "fixed", "position": [1.0, 1.0, 1.0]}}],
        "paths": {"max_order": 2},
        "render": {"sampling_rate": 192e3, "baseband": {"carrier": 40e3, "bandwidth": 4e3}},
    }  # fmt: skip
    return either.new_words(content, command("schema"))


def clock_scene() -> dict[str, Any]:
    """Return a scene file with clocks, transducers, beams, an array, and renamed options."""
    noise, converter = {"self_noise_db": 5.0, "seed": 3}, {"adc_bits": 16, "adc_full_scale": 0.1}
    electronics = {"clock_ppm": 100.0, "clock_offset": 1e-4, **noise, **converter}
    content = {
        "format": 1,
        "room": {"kind": "shoebox", "size": [5.0, 4.0, 3.0], "walls": {"default": {"reflection": 0.9}}},
        "sources": [{
            "name": "s", "aim": [1.0, 0.0, 0.0], "directivity": {"kind": "named", "name": "MA40S4S"},
            "transducer": {"kind": "named", "name": "MA40S4S"},
            "signal": {"kind": "tone", "frequency": 40e3, "duration": 0.03, "sampling_rate": 192e3, "amplitude": 10.0},
            "trajectory": {"kind": "line", "start": [2.0, 2.0, 1.4], "end": [2.1, 2.0, 1.5], "duration": 0.1},
        }],
        "receivers": [
            {"name": "grid", "positions": {"kind": "grid", "x": [1.0, 4.0, 2.0], "y": [1.0, 3.0, 2.0], "z": 2.5},
             "transducer": {"kind": "resonance", "frequency": 40e3, "width": 3e3, "sensitivity": 0.01}, "electronics": electronics},
            {"name": "c", "aim": [0.0, 0.0, 1.0], "directivity": {"kind": "cardioid", "weight": 0.4},
             "trajectory": {"kind": "fixed", "position": [1.0, 1.0, 1.0]}},
        ],
        "paths": {"max_order": 2},
        "render": {"sampling_rate": 192e3, "quietest_db": -60.0, "convolve_at_rest": False},
    }  # fmt: skip
    return either.new_words(content, command("schema"))
