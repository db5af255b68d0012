"""Derivatives of recordings against central differences of the float64 reference, and against their transpose."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.paths.arrivals import RETARDED
from clsim.paths.family import PairPaths
from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse
from clsim.render.options import RenderOptions
from clsim.sensitivity.linear_map import plan_of, received, representatives, scene_tracks
from clsim.sensitivity.parameters import WITHOUT_DERIVATIVE, parameters_of
from clsim.sensitivity.tangents import Tangents

RATE, C = 96e3, 343.0
EXACT: dict[str, Any] = {
    "engine": "reference", "duration": 0.024, "response_error_db": -120.0,
    "interpolator": clsim.Bandlimited(error_db=-120.0),
}  # fmt: skip
PULSE = clsim.Signal.chirp(18e3, 22e3, 0.006, sampling_rate=RATE, fade=0.0025)
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


def ball(h: float, what: str) -> PathSet:
    """Return paths with a scattering sphere that passes."""
    move = {name: h * EYE[0] if name == what else np.zeros(3) for name in ("ball", "receiver")}
    way = LINE(move["ball"] + [2.0, 1.0, 1.2], move["ball"] + [2.1, 1.3, 1.2], 0.1)
    return shoebox(
        receiver=FIXED(np.array([3.1, 2.3, 1.4]) + move["receiver"]),
        scatterers=[clsim.Scatterer.sphere("ball", 0.05, way)],
    )


def two_balls(h: float) -> PathSet:
    """Return paths by one and by two scattering spheres, beside the direct sound."""
    balls = [
        clsim.Scatterer.sphere("ball", 0.05, FIXED((2.0 + h, 1.0, 1.2))),
        clsim.Scatterer.sphere("other", 0.04, FIXED((2.6, 1.9, 1.3))),
    ]
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), HARD), clsim.Air(speed_of_sound=C, absorption=False),
        [clsim.Source("s", PULSE, SOURCE)], [clsim.Receiver("r", RECEIVER)], scatterers=balls,
    )  # fmt: skip
    return clsim.find_paths(scene, 0, scattering_order=0, scatterers_in_row=2)


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
    "scatterer": (lambda h: ball(h, "ball"), "scatterers[0].position.x", 4e-5),
    "orientation": (lambda h: shoebox(aimed(h)), "sources[0].orientation.z", 0.08),
    "moving and directive": (lambda h: shoebox(aimed(0.0, h)), "sources[0].position.z", 8e-5),
    "receiver and directive": (
        lambda h: shoebox(aimed(0.0), FIXED((3.1, 2.3 + h, 1.4))), "receivers[0].position.y", 8e-5,
    ),
    "pressure": (lambda h: shoebox(air=clsim.Air(pressure=101325.0 + h)), "air.pressure", 400.0),
    "receiver and scatterer": (lambda h: ball(h, "receiver"), "receivers[0].position.x", 8e-5),
}  # fmt: skip


def vector(name: str) -> str:
    """Return the name to ask for, of which a parameter is one."""
    return (
        name.split(".positions")[0] if ".positions" in name else name[:-2] if name[-2:] in (".x", ".y", ".z") else name
    )


@pytest.mark.parametrize("case", CASES)
def test_differences_of_scenes_made_anew(case: str) -> None:
    """Their error falls as h²; what is left of it is below 1e-4."""
    made, name, step = CASES[case]
    found = clsim.sensitivities(made(0.0), [vector(name)], RATE, **EXACT)
    derivative = found.jacobian[found.parameters.index(name)]
    wrong = []
    for h in (step, 0.5 * step, 0.25 * step):
        ahead, behind = (received(plan_of(made(x), RenderOptions(RATE, **EXACT))) for x in (h, -h))
        wrong.append(np.linalg.norm((ahead - behind) / (2.0 * h) - derivative) / np.linalg.norm(derivative))
    assert wrong[2] <= 1e-4, wrong
    # Down to what filters and rounding leave.
    assert all(finer <= 0.3 * coarser + 1e-5 for coarser, finer in pairwise(wrong)), wrong


@pytest.mark.parametrize("name", ["sources[0].position", "receivers[0].position"])
@pytest.mark.parametrize("where", ["room", "plate"])
def test_delays_follow_fermats_principle(name: str, where: str) -> None:
    """Only the ends matter: ``dtau = -u d / (c (1 - M))`` at the source, whatever moves between; u leads along the path.

    The receiver sees a wave that passes it: ``dtau = u d / c (1 - dtau/dt) / (1 - u v / c)``.
    """
    paths = behind_a_plate() if where == "plate" else shoebox(MOVING, LINE((3.1, 2.3, 1.4), (3.2, 2.2, 1.4), 0.1))
    times, tones = np.array([0.02, 0.04]), np.array([10e3, 30e3])
    c = paths.scene.air.speed_of_sound
    for axis, parameter in enumerate(parameters_of(paths, [name])):
        for family in paths.families:
            rows, at = slice(None), SceneResponse(paths.scene, 0, tones)
            found = family.arrivals(rows, times)
            pair = PairPaths(family, rows, 0, 0)
            tangents = Tangents.of(pair, times, found, at, RETARDED).by(parameter)[0]
            turns = tangents / family.response(rows, found, times, at)  # of which the gain's part does not turn
            turned = -np.diff(turns.imag, axis=2)[..., 0] / (2.0 * np.pi * np.diff(tones)[0])
            if name.startswith("sources"):
                expected = -found.departure[..., axis] / c * found.frequency_ratio
            else:
                passing = np.sum(-found.arrival * paths.scene.receivers[0].trajectory.velocity(times), axis=-1) / c
                expected = -found.arrival[..., axis] / c * (1.0 - found.delay_rate) / (1.0 - passing)
            np.testing.assert_allclose(turned, expected, rtol=1e-6, atol=1e-7 / c)


def walk(count: int = 2, **electronics: Any) -> PathSet:
    """Return the paths from a source on a curved way to receivers."""
    way = clsim.Trajectory.waypoints(np.linspace(0.0, 0.1, 4), KNOTS)
    ends = [clsim.Electronics(low_cut=5e3, **electronics) for _ in range(count)]
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.7)), clsim.Air(), [clsim.Source("s", PULSE, way)],
        [clsim.Receiver(f"r{i}", FIXED((3.1, 2.3 - 0.4 * i, 1.4)), electronics=e) for i, e in enumerate(ends)],
    )  # fmt: skip
    return clsim.find_paths(scene, 1)


ALL = [
    "sources[0].position", "sources[0].trajectory", "receivers[1].position", "receivers[0].electronics.clock_ppm",
    "air.temperature_celsius", "room.walls.z_min.reflection", "sources[0].gain_db",
]  # fmt: skip


def test_the_transpose(engine: str, rng: np.random.Generator) -> None:
    """``<J d, w> = <d, J' w>`` within 1e-6 of the lengths, for weights near ``J d``: nothing cancels.

    Of the device 5e-6: within subblocks a render leaves out powers of gains that the transpose does not.
    """
    paths, options = walk(), {"engine": engine, "duration": 0.024}
    jacobian = clsim.sensitivities(paths, ALL, RATE, **options).jacobian
    scale = rng.standard_normal(len(jacobian)) / np.linalg.norm(jacobian, axis=(1, 2))
    ahead = np.tensordot(scale, jacobian, 1)
    weights = ahead + rng.standard_normal(ahead.shape) * np.std(ahead)
    found = clsim.gradient(paths, weights, ALL, RATE, engine=engine)
    back = scale @ np.concatenate([np.ravel(found[name]) for name in ALL])
    lengths = np.linalg.norm(ahead) * np.linalg.norm(weights)
    assert abs(back - np.sum(ahead * weights)) <= (1e-6 if engine == "reference" else 5e-6) * lengths
    assert found["sources[0].trajectory"].shape == (4, 3)


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


@pytest.mark.parametrize("dispersion", [False, True])
def test_the_transpose_of_each_kind(dispersion: bool, rng: np.random.Generator) -> None:
    """Parameters of every kind, in a scene whose responses depend on directions and on time."""
    names = [
        "sources[0].trajectory", "sources[0].orientation", "sources[0].start", "receivers[0].position",
        "receivers[0].trajectory", "receivers[0].orientation", "receivers[0].electronics.clock_ppm",
        "receivers[0].electronics.clock_offset", "receivers[0].electronics.gain_db", "air.temperature_celsius",
        "air.relative_humidity", "room.walls.x_max.reflection", "room.walls.x_min.reflection",
        "room.walls.x_max.displacement", "room.walls.z_min.displacement",
    ]  # fmt: skip
    paths = turning(clsim.Air(dispersion=dispersion))
    jacobian = clsim.sensitivities(paths, names, RATE, engine="reference", duration=0.024).jacobian
    weights = jacobian / np.linalg.norm(jacobian, axis=(1, 2), keepdims=True)
    weights = np.tensordot(rng.standard_normal(len(jacobian)), weights, 1)
    found = clsim.gradient(paths, weights, names, RATE, engine="reference")
    back = np.concatenate([np.ravel(found[name]) for name in names])
    lengths = np.linalg.norm(jacobian, axis=(1, 2)) * np.linalg.norm(weights)
    np.testing.assert_allclose(back / lengths, np.tensordot(jacobian, weights, 2) / lengths, rtol=0, atol=1e-6)


def test_paths_that_begin_and_end(engine: str, rng: np.random.Generator) -> None:
    """Transitions weigh arrivals as they do in a render."""
    paths = walk()
    family = paths.families[0]
    start, end = np.array(family.start), np.array(family.end)
    start[::3], end[1::3] = 0.0121, 0.0133
    cut = PathSet(paths.scene, (replace(family, start=start, end=end),))
    jacobian = clsim.sensitivities(cut, ALL, RATE, engine=engine, duration=0.024).jacobian
    weights = jacobian[0] + rng.standard_normal(jacobian.shape[1:]) * np.std(jacobian[0])
    found = clsim.gradient(cut, weights, ["sources[0].position"], RATE, engine=engine)["sources[0].position"]
    np.testing.assert_allclose(found[0], np.sum(jacobian[0] * weights), rtol=2e-6)


def test_both_engines_agree() -> None:
    """The device's derivative is within -80 dB of the reference's: both hold their filters within -86 dB."""
    fast, exact = (
        clsim.sensitivities(walk(), ALL[:2], RATE, engine=e, duration=0.024).jacobian for e in ("opencl", "reference")
    )
    wrong, length = (np.linalg.norm(x, axis=(1, 2)) for x in (fast - exact, exact))
    np.testing.assert_array_less(wrong, 1e-4 * length)


def test_by_the_emitted_signal(rng: np.random.Generator) -> None:
    """The render is linear in what is emitted: its derivative times the signal is the weighted recording."""
    paths = walk()
    y = received(plan_of(paths, RenderOptions(RATE, **EXACT)))
    weights = y + rng.standard_normal(y.shape) * np.std(y)
    exact = {name: value for name, value in EXACT.items() if name != "duration"}
    found = clsim.gradient(paths, weights, ["sources[0].signal"], RATE, **exact)["sources[0].signal"]
    assert found.shape == (PULSE.count,)
    assert found @ PULSE.read(0, PULSE.count) == pytest.approx(np.sum(weights * y), rel=1e-5)


def test_filters_are_designed_for_every_kind_of_path() -> None:
    """Each kind is drawn with each coordinate, though one kind does not change with any of them.

    Two scatterers beside the direct sound were once wrong by 2e-4: a coordinate met one kind of path alone.
    """
    paths = two_balls(0.0)
    plan = plan_of(paths, RenderOptions(RATE, engine="reference", duration=0.001, responses="centre"))
    drawn = representatives(scene_tracks(plan), parameters_of(paths, ["scatterers[0].position"]))
    assert drawn is not None
    seen = {(family.interactions.shape[1], family.parameter.name[-1]) for family in drawn.families}  # type: ignore[attr-defined]
    assert seen == {(count, axis) for count in (1, 2) for axis in "xyz"}


def test_noise_and_rounding_are_left_out() -> None:
    plain, noisy = (
        clsim.sensitivities(walk(**more), ALL[:1], RATE, engine="reference", duration=0.02).jacobian
        for more in ({}, {"ambient_noise_db": 40.0, "adc_bits": 8, "adc_full_scale": 1.0})
    )
    np.testing.assert_array_equal(plain, noisy)


@pytest.mark.parametrize(
    ("wrt", "message"),
    [
        ([], "wrt: must be a list of names"),
        (["sources[1].position"], "wrt: must name parameters of the scene"),
        (["sources[0].name"], "wrt: must name parameters that have a derivative"),
        (["receivers[0].trajectory"], "wrt: must name positions, not the trajectory, of what has no knots"),
        (["room.walls.door.reflection"], "wrt: must name a wall of the room"),
        (["air.wind", "air.wind"], "wrt: must name each parameter once"),
    ],
)
def test_names_without_a_derivative_are_refused(wrt: list[str], message: str) -> None:
    with pytest.raises(clsim.InputError, match=message.replace("[", r"\[")):
        clsim.sensitivities(walk(), wrt, RATE)


def test_walls_at_edges_are_refused() -> None:
    edges = l_room(FIXED((0.9, 3.1, 1.4)), 1)
    wall = edges.scene.room.faces.names[0]
    with pytest.raises(clsim.InputError, match="edges move with walls"):
        clsim.sensitivities(edges, [f"room.walls.{wall}.displacement"], RATE)


LOW, HEARD = clsim.Signal.chirp(3e3, 5e3, 0.006, sampling_rate=24e3, fade=0.0025), "receivers[0]"


def several(kind: str, h: float = 0.0, what: str = "") -> PathSet:
    """Return paths to a receiver of several channels that moves, of which one thing is displaced by h."""
    half = 0.5 * np.radians(30.0 + h * (what == "orientation.z"))
    turning = FIXED((0, 0, 0), (0.0, 0.0, np.sin(half), np.cos(half))).turning
    places = np.array([[3.1, 2.3, 1.4], [3.0, 2.2, 1.5]]) + h * (what == "position.x") * EYE[0]
    way = replace(LINE(*places, 0.1), turning=turning)
    knots = KNOTS + h * (what == "trajectory.positions[1].y") * np.outer(np.arange(4) == 1, EYE[1])
    ends = {
        "ambisonic": lambda: [clsim.Receiver.ambisonic("r", way)],
        "head": lambda: [clsim.Receiver("r", way, directivity=clsim.SphericalHead(0.0875))],
        "array": lambda: clsim.receiver_array("r", [[0.0, 0.03, 0.0], [h * (what == "element"), -0.03, 0.0]], way),
    }[kind]()
    source = clsim.Source("s", LOW, clsim.Trajectory.waypoints(np.linspace(0.0, 0.1, 4), knots))
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.7))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(speed_of_sound=C, absorption=False), [source], ends), 1)


@pytest.mark.parametrize("kind", ["ambisonic", "head"])
@pytest.mark.parametrize(
    ("what", "h"), [("position.x", 5e-5), ("orientation.z", 0.02), ("trajectory.positions[1].y", 5e-5)]
)
def test_receivers_of_several_channels(kind: str, what: str, h: float) -> None:
    """Channels change with the direction of arrival, ears with the time of arrival as well."""
    name, options = f"{'sources[0]' if 'traj' in what else HEARD}.{what}", EXACT | {"response_error_db": -110.0}
    found = clsim.sensitivities(several(kind), [vector(name)], 24e3, **options)
    derivative = found.jacobian[found.parameters.index(name)]
    ahead, behind = (received(plan_of(several(kind, x, what), RenderOptions(24e3, **options))) for x in (h, -h))
    assert len(derivative) == len(found.receivers) == (4 if kind == "ambisonic" else 2)
    assert np.linalg.norm((ahead - behind) / (2.0 * h) - derivative) <= 5e-5 * np.linalg.norm(derivative)
    weights = derivative + np.std(derivative)
    back = clsim.gradient(
        several(kind), weights, [vector(name)], 24e3, **{k: v for k, v in options.items() if k != "duration"}
    )
    lengths = np.linalg.norm(weights) * np.linalg.norm(derivative)
    there = np.ravel(back[vector(name)])[found.parameters.index(name)]
    assert abs(there - np.sum(weights * derivative)) <= 1e-6 * lengths


def test_elements_of_arrays() -> None:
    """Each is a receiver: its place in the array's frame, which is turned by 30 degrees, is one in the room."""
    found = clsim.sensitivities(several("array"), ["receivers[1].position"], 24e3, **EXACT).jacobian
    derivative = np.tensordot([np.cos(np.radians(30.0)), np.sin(np.radians(30.0)), 0.0], found, 1)
    ahead, behind = (
        received(plan_of(several("array", x, "element"), RenderOptions(24e3, **EXACT))) for x in (5e-5, -5e-5)
    )
    assert np.linalg.norm((ahead - behind) / 1e-4 - derivative) <= 5e-5 * np.linalg.norm(derivative)


def test_channels_on_a_device() -> None:
    """The device's derivative and its transpose, of channels, too."""
    names = ["receivers[0].position", "sources[0].gain_db"]
    fast, exact = (
        clsim.sensitivities(several("ambisonic"), names, 24e3, engine=e, duration=0.024).jacobian
        for e in ("opencl", "reference")
    )
    wrong, length = (np.linalg.norm(x, axis=(1, 2)) for x in (fast - exact, exact))
    np.testing.assert_array_less(wrong, 3e-4 * length)  # -80 dB, and 10 dB that tangents are given
    found = clsim.gradient(several("ambisonic"), fast[0], names, 24e3)
    back = np.concatenate([np.ravel(found[name]) for name in names])
    np.testing.assert_allclose(back / length, np.tensordot(fast, fast[0], 2) / length, atol=5e-6 * length[0])


SLOW = KNOTS[0] + 0.1 * (KNOTS - KNOTS[0])
BAND: dict[str, Any] = {
    "baseband": (20e3, 8e3, 12e3), "duration": 0.024, "response_error_db": -100.0,
    "interpolator": clsim.Bandlimited(error_db=-100.0),
}  # fmt: skip
BEACONS: dict[str, tuple[Callable[[float], PathSet], str, float]] = {
    name: CASES[name] for name in ("static receiver", "clock rate", "temperature", "wind", "wall")
} | {
    "trajectory": (
        lambda h: shoebox(source=clsim.Trajectory.waypoints(
            np.linspace(0.0, 0.1, 4), SLOW + h * np.outer(np.arange(4) == 1, EYE[1]))),
        "sources[0].trajectory.positions[1].y", 8e-5,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BEACONS)
def test_complex_envelopes(case: str) -> None:
    """Derivatives of baseband against differences, and their transpose by real and imaginary parts."""
    made, name, step = BEACONS[case]
    options = BAND | {"engine": "reference"}
    found = clsim.sensitivities(made(0.0), [vector(name)], RATE, **options)
    derivative, wrong = found.jacobian[found.parameters.index(name)], []
    for h in (0.5 * step, 0.25 * step):
        ahead, behind = (received(plan_of(made(x), RenderOptions(RATE, **options))) for x in (h, -h))
        wrong.append(np.linalg.norm((ahead - behind) / (2.0 * h) - derivative) / np.linalg.norm(derivative))
    assert np.iscomplexobj(derivative)
    assert wrong[1] <= 0.3 * wrong[0] + 1e-5, wrong
    assert wrong[1] <= 3e-5, wrong
    weights = derivative * np.exp(0.3j) + 0.1 * np.std(derivative)
    back = clsim.gradient(
        made(0.0), weights, [vector(name)], RATE, **{k: v for k, v in options.items() if k != "duration"}
    )
    there = np.ravel(back[vector(name)])[found.parameters.index(name)]
    assert there == pytest.approx(np.sum(np.conj(weights) * derivative).real, rel=1e-6)


def test_information_of_envelopes() -> None:
    """Noise is that of the real and of the imaginary part: a gain's bound is that over the length of its derivative."""
    paths, name = BEACONS["static receiver"][0](0.0), ["sources[0].gain_db"]
    found = clsim.sensitivities(paths, name, RATE, **BAND | {"engine": "reference"})
    assert found.bounds(0.1)[0] == pytest.approx(0.1 / np.linalg.norm(found.jacobian))
    fast = clsim.sensitivities(paths, name, RATE, **BAND).jacobian
    assert np.linalg.norm(fast - found.jacobian) <= 1e-4 * np.linalg.norm(fast)
    with pytest.raises(clsim.InputError, match=r"must not have 'sources\[0\]\.signal' in baseband"):
        clsim.gradient(paths, found.jacobian[0], ["sources[0].signal"], RATE, baseband=BAND["baseband"])


def test_tails_are_left_out_with_a_note() -> None:
    """With a tail the derivative is that of the paths, over the recording with its tail."""
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.8))
    ends = [clsim.Source("s", LOW, SOURCE)], [clsim.Receiver("r", RECEIVER)]
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), *ends), 1)
    options: dict[str, Any] = {"engine": "reference", "duration": 0.05}
    without, beside = (
        clsim.sensitivities(paths, ["receivers[0].position"], 24e3, tail=tail, **options) for tail in ("off", "auto")
    )
    assert (without.notes, len(beside.notes)) == ((), 1)
    assert "tail is left out" in beside.notes[0]
    np.testing.assert_array_equal(without.jacobian, beside.jacobian)
    by = (clsim.gradient(paths, beside.jacobian[0], ["receivers[0].position"], 24e3, tail=t) for t in ("off", "auto"))
    np.testing.assert_array_equal(*(found["receivers[0].position"] for found in by))


def test_the_page_lists_what_has_no_derivative() -> None:
    page = (Path(clsim.__file__).parents[1] / "docs" / "sensitivities.md").read_text("utf-8")
    table = page.split("## What has no derivative")[1].split("|---|---|\n")[1].split("\n\n")[0]
    assert table.splitlines() == [f"| {what} | {instead} |" for what, instead in WITHOUT_DERIVATIVE.items()]


def test_bounds_are_those_of_known_signals() -> None:
    """One receiver and a gain alone: the bound is noise over the length of the derivative."""
    found = clsim.sensitivities(walk(1), ["sources[0].gain_db"], RATE, engine="reference", duration=0.02)
    assert found.bounds(0.1)[0] == pytest.approx(0.1 / np.linalg.norm(found.jacobian))
    assert found.to_xarray().dims == ("parameter", "receiver", "time")
    with pytest.raises(clsim.InputError, match="noise: must be above 0"):
        found.fisher(0.0)
    two = clsim.sensitivities(
        walk(1), ["sources[0].gain_db", "receivers[0].electronics.gain_db"], RATE, engine="reference", duration=0.02
    )
    with pytest.raises(clsim.InputError, match="must be distinguishable"):
        two.bounds(0.1)
