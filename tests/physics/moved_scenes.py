"""Small scenes in which one thing is as it is or moved a little, and names of what is moved."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import clsim
from clsim.paths.path_set import PathSet

RATE, C = 96e3, 343.0
EXACT: dict[str, Any] = {
    "engine": "reference", "duration": 0.024, "response_error_db": -120.0,
    "interpolator": clsim.Bandlimited(error_db=-120.0),
}  # fmt: skip
PULSE = clsim.Signal.chirp(18e3, 22e3, 0.006, sampling_rate=RATE, fade=0.0025)
LOW = clsim.Signal.chirp(3e3, 5e3, 0.006, sampling_rate=24e3, fade=0.0025)
FIXED, LINE = clsim.Trajectory.fixed, clsim.Trajectory.line
SOURCE, RECEIVER = FIXED((1.0, 1.2, 1.1)), FIXED((3.1, 2.3, 1.4))
HARD = clsim.Material.from_reflection(1.0)
KNOTS = np.array([[1.0, 1.2, 1.0], [1.2, 1.3, 1.1], [1.6, 1.5, 1.1], [1.8, 1.5, 1.3]])
EYE = np.eye(3)


def shoebox(
    source: Any = SOURCE, receiver: Any = RECEIVER, air: Any = None, size: float = 4.0,
    first: Any = 0.8, electronics: Any = None, transducer: Any = None, start: float = 0.0, **more: Any,
) -> PathSet:  # fmt: skip
    """Return the paths of a small room, each thing as it is or moved."""
    walls = {"x_min": clsim.Material.from_reflection(first)} | dict.fromkeys(
        ("x_max", "y_min", "y_max", "z_min", "z_max"), clsim.Material.from_reflection(0.7)
    )
    ends = (
        [source if isinstance(source, clsim.Source) else clsim.Source("s", PULSE, source, start=start)],
        [clsim.Receiver("r", receiver, electronics=electronics, transducer=transducer)],
    )
    scene = clsim.Scene(
        clsim.Shoebox((size, 3.0, 2.5), walls), air or clsim.Air(speed_of_sound=C, absorption=False), *ends,
        scatterers=more.get("scatterers", []), bodies=more.get("bodies", []),
    )  # fmt: skip
    return clsim.find_paths(scene, 1, scattering_order=0)


def l_room(receiver: Any, diffraction: int = 0) -> PathSet:
    """Return the paths of a room with an inner corner, round which nothing but edges is heard."""
    plan = [(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0)]
    room = clsim.MeshRoom.from_plan(plan, 2.5, clsim.Material.from_reflection(0.7))
    scene = clsim.Scene(
        room, clsim.Air(), [clsim.Source("s", PULSE, FIXED((3.3, 0.9, 1.1)))], [clsim.Receiver("r", receiver)]
    )
    return clsim.find_paths(scene, 1, diffraction=diffraction)


def at(*place: float) -> Any:
    """Return a place from the middle of a large room, m."""
    return np.array([5.0, 5.0, 5.0]) + place


def behind_a_plate(where: Any = (0.0, 0.0, 0.0), receiver: Any = (0.0, 0.0, 0.0)) -> PathSet:
    """Return the path by a moving plate."""
    corners = [(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)]
    mesh, middle = clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], HARD), np.array([5.0, 5.0, 5.0])
    plate = clsim.Body("plate", mesh, LINE(middle + where, middle + where + [0.0, 0.1, 0.3], 0.1))
    scene = clsim.Scene(
        clsim.Shoebox(2.0 * middle, clsim.Material.from_reflection(0.1)), clsim.Air(speed_of_sound=C),
        [clsim.Source("s", PULSE, LINE(at(-0.5, 0, 0.9), at(-0.3, 0.1, 0.9), 0.1))],
        [clsim.Receiver("r", FIXED(at(0.6, 0.1, 1.1) + receiver))], bodies=[plate],
    )  # fmt: skip
    return clsim.find_paths(scene, 1)


def balls(h: float, what: str, count: int = 1) -> PathSet:
    """Return the direct sound, and paths by one sphere that passes, or by two at rest, alone and one after the other."""
    move = {name: h * EYE[0] if name == what else np.zeros(3) for name in ("ball", "receiver")}
    way = LINE(move["ball"] + [2.0, 1.0, 1.2], move["ball"] + [2.1, 1.3, 1.2], 0.1)
    first = clsim.Scatterer.sphere("ball", 0.05, FIXED(move["ball"] + [2.0, 1.0, 1.2]) if count > 1 else way)
    other = clsim.Scatterer.sphere("other", 0.04, FIXED((2.6, 1.9, 1.3)))
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), HARD), clsim.Air(speed_of_sound=C, absorption=False),
        [clsim.Source("s", LOW, SOURCE)], [clsim.Receiver("r", FIXED(move["receiver"] + [3.1, 2.3, 1.4]))],
        scatterers=[first, other][:count],
    )  # fmt: skip
    return clsim.find_paths(scene, 0, scattering_order=0, scatterers_in_row=count)


def aimed(turn: float, up: float = 0.0) -> Any:
    """Return a source that moves, with a beam that is turned about the vertical axis, degrees."""
    half = 0.5 * np.radians(20.0 + turn)
    turning = FIXED((0, 0, 0), (0.0, 0.0, np.sin(half), np.cos(half))).turning
    way = LINE((1.0, 1.2, 1.1 + up), (1.3, 1.1, 1.2 + up), 0.1)
    return clsim.Source("s", PULSE, replace(way, turning=turning), directivity=clsim.Piston(0.008))


def air(h: float = 0.0, **more: Any) -> clsim.Air:
    return clsim.Air(temperature_celsius=20.0 + h, **more)


MOVING = LINE((1.0, 1.2, 1.1), (1.3, 1.1, 1.2), 0.1)
TURNING = replace(MOVING, turning=FIXED((0, 0, 0), (0.0, 0.0, 0.0, 1.0)).turning)


def vector(name: str) -> str:
    """Return the name to ask for, of which a parameter is one."""
    return (
        name.split(".positions")[0] if ".positions" in name else name[:-2] if name[-2:] in (".x", ".y", ".z") else name
    )


def walk(count: int = 2, points: int = 4, **electronics: Any) -> PathSet:
    """Return the paths from a source on a curved way, a slow one through more points, to receivers."""
    way = clsim.Trajectory.waypoints(np.linspace(0.0, 0.1, 4), KNOTS)
    if points > 4:
        times = np.linspace(0.0, 0.1, points)
        way = clsim.Trajectory.waypoints(times, KNOTS[0] + 0.1 * (way.position(times) - KNOTS[0]))
    ends = [clsim.Electronics(low_cut=5e3, **electronics) for _ in range(count)]
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.7)), clsim.Air(), [clsim.Source("s", PULSE, way)],
        [clsim.Receiver(f"r{i}", FIXED((3.1, 2.3 - 0.4 * i, 1.4)), electronics=e) for i, e in enumerate(ends)],
    )  # fmt: skip
    return clsim.find_paths(scene, 1)


def turning(air: clsim.Air) -> PathSet:
    """Return the paths between two beams that turn and move, by a wall that depends on the angle."""
    times, half = np.linspace(0.0, 0.1, 4), 0.5 * np.linspace(0.2, 0.6, 4)
    turns = np.stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)], axis=1)
    way = clsim.Trajectory.waypoints(times, KNOTS, orientations=turns)
    back = clsim.Trajectory.waypoints(times, KNOTS[::-1] + np.array([2.0, 0.8, 0.3]), orientations=turns)
    soft = clsim.Material.from_impedance([1e3, 48e3], [8.0 + 1.0j, 8.0 + 1.0j])
    walls = {"x_max": soft} | dict.fromkeys(
        ("x_min", "y_min", "y_max", "z_min", "z_max"), clsim.Material.from_reflection(0.7)
    )
    beam, clock = clsim.Piston(0.008), clsim.Electronics(clock_ppm=80.0)
    ends = (
        [clsim.Source("s", PULSE, way, directivity=beam)],
        [clsim.Receiver("r", back, directivity=beam, electronics=clock)],
    )
    return clsim.find_paths(clsim.Scene(clsim.Shoebox((4.0, 3.0, 2.5), walls), air, *ends), 1)


# The scene with a parameter larger by h, its name, and the largest step h.
CASES: dict[str, tuple[Callable[[float], PathSet], str, float]] = {
    "static receiver": (lambda h: shoebox(receiver=FIXED((3.1 + h, 2.3, 1.4))), "receivers[0].position.x", 8e-5),
    "static source": (lambda h: shoebox(source=FIXED((1.0, 1.2 + h, 1.1))), "sources[0].position.y", 8e-5),
    "moving source": (
        lambda h: shoebox(source=LINE((1.0, 1.2, 1.1 + h), (1.3, 1.1, 1.2 + h), 0.1)), "sources[0].position.z", 8e-5,
    ),
    "accelerating source": (
        lambda h: shoebox(source=clsim.Trajectory.waypoints(
            np.linspace(0.0, 0.1, 4), KNOTS + h * np.outer(np.arange(4) == 1, EYE[1]))),
        "sources[0].trajectory.positions[1].y", 8e-5,
    ),
    "clock rate": (lambda h: shoebox(MOVING, electronics=clsim.Electronics(clock_ppm=h)),
                   "receivers[0].electronics.clock_ppm", 16.0),
    "clock offset": (lambda h: shoebox(MOVING, electronics=clsim.Electronics(clock_offset=h)),
                     "receivers[0].electronics.clock_offset", 2e-7),
    "start": (lambda h: shoebox(MOVING, start=0.001 + h), "sources[0].start", 2e-7),
    "gain": (lambda h: shoebox(electronics=clsim.Electronics(gain_db=h)), "receivers[0].electronics.gain_db", 0.1),
    "speed of sound": (lambda h: shoebox(MOVING, air=clsim.Air(speed_of_sound=C + h)), "air.speed_of_sound", 8e-3),
    "temperature": (lambda h: shoebox(MOVING, air=air(h)), "air.temperature_celsius", 0.016),
    "dispersive air": (lambda h: shoebox(MOVING, air=air(h, dispersion=True)), "air.temperature_celsius", 0.016),
    "humidity": (lambda h: shoebox(air=clsim.Air(relative_humidity=0.4 + h)), "air.relative_humidity", 2e-3),
    "wind": (lambda h: shoebox(MOVING, air=clsim.Air(wind=(1.0, 2.0 + h, 0.5))), "air.wind.y", 8e-3),
    "layers": (lambda h: shoebox(MOVING, air=clsim.Air(temperature_celsius=(18.0 + h, 22.0 + h))),
               "air.temperature_celsius", 0.016),
    "receiver in layers": (
        lambda h: shoebox(MOVING, FIXED((3.1, 2.3, 1.4 + h)), clsim.Air(temperature_celsius=(18.0, 22.0))),
        "receivers[0].position.z", 8e-5,
    ),
    "reflection": (lambda h: shoebox(MOVING, first=0.8 + h), "room.walls.x_min.reflection", 0.01),
    "wall": (lambda h: shoebox(MOVING, size=4.0 - h), "room.walls.x_max.displacement", 4e-5),
    "mesh": (lambda h: l_room(FIXED((1.1, 1.3 + h, 1.4))), "receivers[0].position.y", 8e-5),
    "edge": (lambda h: l_room(FIXED((0.9 + h, 3.1, 1.4)), 1), "receivers[0].position.x", 8e-5),
    "body": (lambda h: behind_a_plate(where=h * EYE[2]), "bodies[0].position.z", 4e-5),
    "receiver and body": (lambda h: behind_a_plate(receiver=h * EYE[0]), "receivers[0].position.x", 8e-5),
    "orientation": (lambda h: shoebox(aimed(h)), "sources[0].orientation.z", 0.08),
    "moving and directive": (lambda h: shoebox(aimed(0.0, h)), "sources[0].position.z", 8e-5),
    "receiver and directive": (
        lambda h: shoebox(aimed(0.0), FIXED((3.1, 2.3 + h, 1.4))), "receivers[0].position.y", 8e-5,
    ),
    "pressure": (lambda h: shoebox(air=clsim.Air(pressure=101325.0 + h)), "air.pressure", 400.0),
}  # fmt: skip
