"""Scenes and studies of valid parts, most of them with something wrong, and the files that they name.

Any of them again: `python tests/unit/fuzzing.py SEED NUMBER` prints its text, `... SEED NUMBER study` a study's.
"""

import copy
import math
import struct
import sys
import wave
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from fuzzed_things import align, body, pick, scatterer

NUMBERS: list[Any] = [
    math.nan, math.inf, -math.inf, -0.0, 0.0, 0, 1, -1, 2, 0.5, -0.5, 1e300, -1e300, 1e308, 1e-300, 5e-324, 1e200, 1e20,
    1e12, 1e9, -1e9, 1e8, 1e6, 1e5, 34300, 2e3, 100.0, 1e-3, 1e-4, 1e-15, 1e-6, 1e-12, 40e3, 96e3, 192e3, 2**31, 2**53 + 1, 2**63 - 1, 2**63, -(2**63), 2**64,
]  # fmt: skip
NASTY: list[Any] = [
    *NUMBERS,
    10**400, True, False, "", " ", "0", "nan", "x" * 300, "a/b", "../up", "/dev/zero", "pipe", ".", "wörter \u202e\U0001f399",
    "$\\frac$", "\x01", "\n", [], {}, [[]], [{}], [math.nan], [1e300, 1e300], [-1e300] * 3, [0, 0, 0], [0.0] * 3, [5e-324] * 3,
    [1e-200, 0, 0], [1, 1, 1], [1, 2, 3, 4], ["a"], [1, "a", 2], [[1, 2, 3]], {"kind": "tone"}, {"kind": ""}, {"kind": 5},
    {"a": 1}, {"": 1}, {"value": {"value": {"value": 1}}},
]  # fmt: skip
# What grows with these only takes time, which has tests of its own; of COUNTED, absurd numbers are refused at once.
PACE = {"duration", "start", "end", "times", "time_offset", "normal", "range"}
COUNTED = {"count", "period", "repeats", "bits", "x", "y", "z", "draws", "position", "positions", "center", "translate"}
MODERATE, FASTEST, ABSURD = 20, 192e3, 1e9

OBJ = """o box
v 0 0 0
v 4 0 0
v 4 3 0
v 0 3 0
v 0 0 2
v 4 0 2
v 4 3 2
v 0 3 2
usemtl soft
f 1 2 3 4
f 5 6 7 8
usemtl hard
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""
OFF = "OFF\n4 4 0\n2 2.5 1\n2.2 2.5 1\n2 2.7 1\n2 2.5 1.2\n3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n"
BEAM = "angle,10e3,40e3,60e3\n0,0,0,0\n45,-3,-6,-8\n90,-10,-20,-25\n"
PLACES = "x,y,z\n1,1,1\n2,1,1\n"
EUROC = "".join(f"{1_400_000_000_000_000_000 + 10_000_000 * i},{1 + 0.01 * i},1,1,1,0,0,0\n" for i in range(8))
CSV = "t,x,y,z\n" + "".join(f"{0.01 * i},{1 + 0.01 * i},1,1\n" for i in range(8))
TUM = "".join(f"{0.01 * i} {1 + 0.01 * i} 1 1 0 0 0 1\n" for i in range(8))


def write_files(folder: Path) -> None:
    """Write the files that scenes name."""
    for name, text in (
        ("room.obj", OBJ), ("thing.off", OFF), ("beam.csv", BEAM), ("places.txt", PLACES), ("poses.csv", CSV),
        ("poses.tum", TUM), ("poses.euroc", EUROC),
    ):  # fmt: skip
        (folder / name).write_text(text)
    samples = (2e4 * np.sin(np.arange(480) * 1.5) * np.hanning(480)).astype("<i2")
    with wave.open(str(folder / "sound.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(64_000)
        file.writeframes(samples.tobytes())
    stl = b"\0" * 80 + struct.pack("<I", 1) + struct.pack("<12fH", 0, 0, 1, 2, 2.5, 1, 2.2, 2.5, 1, 2, 2.7, 1, 0)
    (folder / "thing.stl").write_bytes(stl)
    angles = np.arange(0.0, 181.0, 45.0)
    values = 1.1 + np.cos(np.radians(angles))[:, None] * np.ones(3)
    np.savez(folder / "beam.npz", angles=angles, frequencies=[1e3, 40e3, 70e3], values=values)


DAMAGED = ("room.obj", "thing.off", "thing.stl", "beam.csv", "beam.npz", "places.txt", "poses.csv", "poses.tum",
           "poses.euroc", "sound.wav")  # fmt: skip


MATERIALS: list[Any] = [
    {"reflection": 0.9}, {"reflection": 0.0}, {"reflection": -0.5}, {"reflection": [0.5, 0.4]}, {"named": "concrete"},
    {"reflection": 0.5, "roughness": 0.001},
    {"absorption": {"frequencies": [8e3, 24e3], "coefficients": [0.1, 0.3]}},
    {"table": {"frequencies": [8e3, 24e3], "factors": [0.9, [0.5, 0.2]], "outside": "hold"}},
    {"impedance": {"frequencies": [8e3, 24e3], "impedances": [[3.0, 1.0], [4.0, -1.0]], "outside": "hold"}},
    {"impulse_response": {"samples": [0.5, 0.1], "sampling_rate": 64e3, "reference": 0.0, "band": [100.0, 3e4], "outside": "hold", "tolerance": 0.05}},
    {"solid": {"density": 2300.0, "sound_speed": 3500.0}},
    {"porous": {"flow_resistivity": 5e4, "thickness": 0.02, "outside": "extend"}},
    {"wav": {"path": "sound.wav", "scale": 0.001, "outside": "hold"}},
]  # fmt: skip


def signal(random: np.random.Generator) -> dict[str, Any]:
    # Far from 0 Hz and from half the sampling rate, where filters are long.
    tone = {"kind": "tone", "frequency": 16e3, "duration": 0.01, "sampling_rate": 64e3, "fade": 0.005}
    chirp = {"kind": "chirp", "start": 12e3, "stop": 20e3, "duration": 0.01, "sampling_rate": 64e3, "window": "hann"}
    return pick(random, [
        tone, tone | {"amplitude": 2.0, "phase": 1.0}, chirp, chirp | {"method": "exponential"},
        {"kind": "noise", "duration": 0.01, "sampling_rate": 64e3, "seed": 1, "band": [12e3, 20e3], "rms": 0.1},
        {"kind": "sequence", "carrier": 16e3, "chip_rate": 4e3, "sampling_rate": 64e3, "bits": 3, "code": 1, "repeats": 2},
        {"kind": "sequence", "sequence": "gold", "carrier": 16e3, "chip_rate": 4e3, "sampling_rate": 64e3, "bits": 5},
        {"kind": "wav", "path": "sound.wav", "scale": 2.0, "channel": 0},
        {"kind": "pulses", "pulse": tone, "period": 0.02, "count": 3},
    ])  # fmt: skip


def trajectory(random: np.random.Generator, x: float) -> dict[str, Any]:
    return pick(random, [
        {"kind": "fixed", "position": [x, 1.0, 1.0]},
        {"kind": "fixed", "position": [x, 1.0, 1.0], "orientation": [0.0, 0.0, 0.0, 1.0]},
        {"kind": "line", "start": [x, 1.0, 1.0], "end": [x, 1.5, 1.0], "duration": 0.5},
        {"kind": "circle", "center": [x, 1.2, 1.0], "radius": 0.2, "period": 1.0, "duration": 0.5, "axis": [0.0, 0.0, 1.0], "phase": 0.5},
        {"kind": "waypoints", "times": [0.0, 0.2, 0.5], "positions": [[x, 1.0, 1.0], [x, 1.1, 1.0], [x, 1.3, 1.0]]},
        {"kind": "waypoints", "times": [0.0, 0.2, 0.5], "positions": [[x, 1.0, 1.0], [x, 1.1, 1.0], [x, 1.3, 1.0]],
         "smooth": False, "orientations": [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0]]},
        {"kind": "file", "path": "poses.csv", "format": "csv", "translate": [x - 1.0, 0.0, 0.0], "smooth": False},
        {"kind": "file", "path": "poses.tum", "format": "tum", "translate": [x - 1.0, 0.0, 0.0], "repair": ["gaps", "jumps"],
         "scale": 1.0, "max_speed": 20.0, "max_gap": 1.0, "rotate": [0.0, 0.0, 0.0, 1.0], "time_offset": 0.0},
        {"kind": "file", "path": "poses.euroc", "format": "euroc", "translate": [x - 1.0, 0.0, 0.0], "smooth": 0.001},
    ], [6, 1, 3, 2, 1, 1, 1, 1, 1])  # fmt: skip


def directivity(random: np.random.Generator) -> dict[str, Any]:
    return pick(random, [
        {"kind": "omni"}, {"kind": "first-order", "weight": 0.5}, {"kind": "piston", "radius": 0.005},
        {"kind": "table", "path": "beam.csv", "scale": "db", "rear": "hold", "outside": "hold"},
        {"kind": "table", "path": "beam.npz", "scale": "linear", "outside": "hold"},
        {"kind": "named", "name": "MA40S4S", "outside": "hold"},
    ])  # fmt: skip


def transducer(random: np.random.Generator) -> dict[str, Any]:
    return pick(random, [
        {"kind": "resonance", "frequency": 16e3, "width": 4e3, "sensitivity": 0.5},
        {"kind": "table", "frequencies": [4e3, 16e3, 28e3], "magnitudes": [0.1, 0.5, 0.1], "outside": "zero"},
        {"kind": "table", "frequencies": [4e3, 16e3, 28e3], "magnitudes": [0.1, 0.5, 0.1], "phases": [0.0, -0.5, -1.0], "outside": "hold"},
        {"kind": "impulse-response", "samples": [1.0, 0.5], "sampling_rate": 64e3},
        {"kind": "wav", "path": "sound.wav", "scale": 0.1},
    ], [3, 1, 1, 2, 1])  # fmt: skip


def electronics(random: np.random.Generator) -> dict[str, Any]:
    return pick(random, [
        {"ambient_noise_db": 10.0, "seed": 1}, {"snr_db": 20.0, "reference_level_db": 60.0}, {"self_noise_db": 3.0, "gain_db": 20.0},
        {"low_cut": 100.0, "high_cut": 24e3, "order": 3}, {"adc_bits": 12, "adc_full_scale": 1.0}, {"clock_ppm": 20.0, "clock_offset": 0.001},
    ])  # fmt: skip


def room(random: np.random.Generator, plain: bool) -> dict[str, Any]:
    def material(random: np.random.Generator) -> dict[str, Any]:
        return pick(random, MATERIALS[:3] if plain else MATERIALS)

    def walls(random: np.random.Generator) -> dict[str, Any]:
        return pick(random, [material(random), {"default": material(random), "z_min": material(random)}])

    made = pick(random, [
        {"kind": "shoebox", "size": [4.0, 3.0, 2.0], "walls": walls(random)},
        {"kind": "plan", "outline": [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]], "height": 2.0, "materials": material(random)},
        {"kind": "plan", "outline": [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]], "height": 2.0, "materials": {"default": material(random)},
         "pillars": [[[2.0, 2.0], [2.2, 2.0], [2.2, 2.2]]]},
        {"kind": "mesh", "path": "room.obj", "scale": 1.0, "up": "z", "flatness": 1e-3, "materials": {"soft": material(random), "hard": material(random)}},
    ], [12, 1, 1, 2])  # fmt: skip
    if random.random() < 0.05:
        made["obstacles"] = [{"path": str(random.choice(["thing.off", "thing.stl"])), "materials": material(random)}]
    return made


def receiver(random: np.random.Generator, name: str, plain: bool) -> dict[str, Any]:
    made: dict[str, Any] = {"name": name}
    if random.random() < 0.15:
        made["positions"] = pick(random, [
            {"kind": "grid", "x": [2.5, 3.5, 2], "y": 2.0, "z": 1.5}, {"kind": "file", "path": "places.txt"},
        ])  # fmt: skip
    else:
        made["trajectory"] = trajectory(random, 3.0)
    makers = {"electronics": electronics} | ({} if plain else {"directivity": directivity, "transducer": transducer})
    return made | options(random, makers)


def options(random: np.random.Generator, makers: dict[str, Any]) -> dict[str, Any]:
    made = {name: make(random) for name, make in makers.items() if random.random() < 0.2}
    return made | ({"aim": [1.0, 0.0, 0.0]} if random.random() < 0.1 else {})


def settings(random: np.random.Generator, plain: bool) -> dict[str, Any]:
    made: dict[str, Any] = {
        "sampling_rate": 64e3, "engine": "reference", "interpolator": {"kind": "lagrange", "order": 3},
        **({"responses": "centre"} if plain else {"response_error_db": -20.0}),
    }  # fmt: skip
    choices: dict[str, list[Any]] = {
        "interpolator": [
            {"kind": "lagrange", "order": 5}, {"kind": "truncated-lagrange", "order": 9, "length": 4},
            {"kind": "bandlimited", "error_db": -40.0},
        ],
        "motion": ["quasi-static"], "amplitude": ["static", "convective"], "transition": [0.0, 0.001],
        "baseband": [{"carrier": 16e3, "bandwidth": 8e3}],
        "prune_below_db": [-60.0, -100.0], "duration": [0.01], "chunk": [1000], "convolve_static": [False], "engine": ["opencl"],
    }  # fmt: skip
    for name, values in choices.items():
        if random.random() < 0.08:
            made[name] = pick(random, values)
    return made


def scene(random: np.random.Generator) -> dict[str, Any]:
    """Return the content of a valid scene file; one in twelve has walls and ends that take time to be planned."""
    plain = bool(random.random() < 11 / 12)
    made: dict[str, Any] = {
        "format": 1, "room": room(random, plain),
        "sources": [
            {"name": f"s{i}", "signal": signal(random), "trajectory": trajectory(random, 1.0 + 0.2 * i)}
            | options(random, {} if plain else {"directivity": directivity, "transducer": transducer})
            for i in range(1 + (random.random() < 0.1))
        ],
        "receivers": [receiver(random, f"r{i}", plain) for i in range(1 + (random.random() < 0.2))],
        "paths": {"max_order": int(random.integers(0, 2))}, "render": settings(random, plain),
    }  # fmt: skip
    if random.random() < 0.2:
        made["air"] = pick(random, [
            {"temperature_celsius": 15.0, "relative_humidity": 0.4, "pressure": 1e5}, {"speed_of_sound": 343.0},
            {"speed_of_sound": "iso9613"},
        ])  # fmt: skip
    if random.random() < 0.15:
        made["scatterers"] = [scatterer(random, "s")]
        made["paths"]["scattering_order"] = int(random.integers(0, 2))
    if random.random() < 0.15:
        made["bodies"] = [body(random, "b", MATERIALS[:3])]
    return made


def places(content: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all values."""
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [place for key, value in inner for place in [(*above, key), *places(value, (*above, key))]]


def spoil(random: np.random.Generator, content: Any) -> None:
    """Change one value somewhere."""
    every = places(content)
    numbers = [place for place in every if isinstance(_at(content, place), int | float)]
    chosen = numbers if numbers and random.random() < 0.75 else every
    path = chosen[int(random.integers(len(chosen)))]
    parent, key, way = _at(content, path[:-1]), path[-1], random.random()
    old = parent[key]
    number = isinstance(old, int | float) and not isinstance(old, bool)
    if way < 0.04 and isinstance(parent, dict):
        parent[pick(random, ["", "kind", "path", "unknown", "x" * 200, "schlüssel", "a.b", "scale"])] = pick(
            random, NASTY
        )
    elif way < 0.08:
        parent.pop(key)
    elif way < 0.12 and isinstance(parent, list):
        parent.append(copy.deepcopy(old))
    elif way < 0.5 and number:
        with np.errstate(over="ignore"):
            new = old * 10.0 ** random.choice([-12, -9, -6, -3, -2, -1, 1, 2, 3, 6, 9, 12]) * random.choice([1.0, -1.0])
        parent[key] = int(new) if isinstance(old, int) and random.random() < 0.7 else new
    elif way < 0.85 and number:
        parent[key] = float(pick(random, NUMBERS)) if isinstance(old, float) else pick(random, NUMBERS)
    elif way < 0.55 and isinstance(old, str):
        parent[key] = pick(random, ["room.obj", "sound.wav", "beam.csv", "beam.npz", "missing", ".", "", "poses.csv"])
    elif way < 0.6:
        parent[key] = pick(random, [content[k] for k in ("room", "sources", "paths") if k in content] or [1])
    else:
        parent[key] = pick(random, NASTY)


def _at(content: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        content = content[key]
    return content


def tame(content: Any, path: tuple[str, ...] = ()) -> Any:
    """Return a content in which nothing is so long, or so often, that it only takes time."""
    if isinstance(content, dict):
        return {key: tame(part, (*path, key)) for key, part in content.items()}
    if isinstance(content, list):
        return [tame(part, path) for part in content]
    if isinstance(content, bool | str) or not MODERATE < content < math.inf:
        return content
    if "sampling_rate" in path:
        return min(content, FASTEST) if content < ABSURD else content
    if PACE & set(path) and not {"signal", "start"} <= set(path):
        return type(content)(MODERATE)
    return type(content)(MODERATE) if COUNTED & set(path) and content < ABSURD else content


def is_round(number: int) -> bool:
    """Whether all stands at round places in a scene, of which something is wrong with fewer."""
    return number % 2 == 1


def scene_text(seed: int, number: int) -> bytes:
    """Return a scene file."""
    random = np.random.default_rng([seed, number])
    content, wrong = scene(random), [0.1, 0.7, 0.15, 0.05]
    if is_round(number):
        align(random, content)
        if random.random() < 0.2:
            content["paths"]["diffraction"] = 1
        wrong = [0.7, 0.2, 0.08, 0.02]
    for _ in range(int(random.choice(4, p=wrong))):
        spoil(random, content)
    return _spoilt_text(random, tame(content))


def study_text(seed: int, number: int, named: str) -> bytes:
    """Return a study file of a scene."""
    random = np.random.default_rng([seed, number, 1])
    vary: list[dict[str, Any]] = [
        {"field": "sources[0].signal.amplitude", "values": [1.0, 2.0]},
        {"field": "receivers[*].trajectory.position[2]", "range": {"start": 0.5, "stop": 1.5, "count": 2}},
        {"field": "air.temperature_celsius", "random": {"uniform": [10.0, 20.0]}},
        {"field": "air.relative_humidity", "random": {"log_uniform": [0.1, 0.5]}},
        {"field": "sources[0].start", "random": {"normal": [1.0, 0.1]}},
        {"field": "room.walls.reflection", "random": {"choice": [0.1, 0.2]}},
        {"field": ["paths.max_order", "min_distance"], "name": ["order", "near"], "values": [[0, 0.01], [1, 0.02]]},
    ]
    chosen = random.permutation(len(vary))[: int(random.integers(1, 4))]
    content: dict[str, Any] = {
        "format": 1, "scene": named, "keep": pick(random, [["recording"], ["ground_truth", "paths"], ["metrics"]], [5, 2, 1]),
        "seed": 3, "draws": 2, "table_rate": 100.0, "vary": [vary[i] for i in chosen],
    }  # fmt: skip
    if not any("random" in entry for entry in content["vary"]):
        content.pop("draws")
    for _ in range(int(random.choice(4, p=[0.1, 0.7, 0.15, 0.05]))):
        spoil(random, content)
    return _spoilt_text(random, tame(content))


def _spoilt_text(random: np.random.Generator, content: dict[str, Any]) -> bytes:
    """Return the file of a content, one in twelve with its text spoilt too."""
    try:
        text = tomli_w.dumps(content).encode()
    except (TypeError, ValueError, AttributeError):  # what TOML does not hold
        text = b"format = 1\n"
    if random.random() < 1 / 12:
        at = int(random.integers(len(text)))
        more = pick(random, [b"", b"\xef\xbb\xbf", b"\0", b"\xff\xfe", b"[" * 3000, b"a = " + b"[" * 500 + b"]" * 500, b"x = 1" + b"0" * 5000,
                             b"x = 0x" + b"f" * 5000, b"\n[[sources]]\n", b"\n[room]\n", b"'''", b"=", b"x" * 10_000])  # fmt: skip
        text = text[:at] + more + text[at + int(random.integers(0, 20)) :]
    return text


def damage(random: np.random.Generator, data: bytes) -> bytes:
    """Return a file's bytes with some of them others, gone or twice."""
    out = bytearray(data)
    for _ in range(int(random.integers(1, 5))):
        at, length = int(random.integers(len(out) + 1)), int(random.integers(1, 9))
        out[at : at + int(random.integers(0, 9))] = pick(random, [
            b"", random.bytes(length), b"\xff" * 4, b"\x7f\xff\xff\xff", b"-", b"1e300 ", b"nan", b"inf ", b"\n", b"1e999999999", b",", b" 99999999 ", bytes(out[at : at + 50]),
        ])  # fmt: skip
    return bytes(out[: int(random.integers(len(out) + 1))]) if random.random() < 0.2 else bytes(out)


if __name__ == "__main__":
    told = (
        study_text(int(sys.argv[1]), int(sys.argv[2]), "scene.toml")
        if len(sys.argv) > 3
        else scene_text(int(sys.argv[1]), int(sys.argv[2]))
    )
    sys.stdout.buffer.write(told)
