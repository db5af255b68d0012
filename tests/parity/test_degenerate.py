"""Things on symmetry planes, in lines and at equal heights: finite, alike in both engines, and continuous."""

from typing import Any

import numpy as np
import pytest
from exhaustive import few

import clsim
from clsim.paths.path_set import PathSet

pytestmark = [pytest.mark.usefixtures("device"), pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")]
RATE, TOP, C = 192e3, 46e3, 343.0
PULSE = clsim.Signal.chirp(34e3, TOP, 0.004, RATE, window="hann")
HARD = clsim.Material.from_reflection(0.8)
AIR = clsim.Air(speed_of_sound=C)
ASIDE = 1e-7 * np.array([0.5, -0.6, 0.62])  # m, to where nothing is degenerate
# By a displacement d of a thing every path is 2 d longer at most, which turns it by 2 k d; all of them at once, in phase.
CONTINUOUS_DB = 20.0 * np.log10(2.0 * 2.0 * np.pi * TOP / C * np.linalg.norm(ASIDE))
ALIKE_DB = -80.0  # of both engines, whose errors are -90 dB by default, of several paths
# Root of the sum of squares, Pa, of what 0.1 mm of strength sends over 10 m^2: what hides the ends from each other sends nothing.
WEAK = 1e-5 * np.sqrt(0.004 * RATE * 3.0 / 16.0)
HALF = np.sqrt(0.5)
TURNS = {"x": (0.0, HALF, 0.0, HALF), "y": (-HALF, 0.0, 0.0, HALF), "z": (0.0, 0.0, 0.0, 1.0)}  # of a thing's own z


def way(place: Any, velocity: Any, axis: str) -> clsim.Trajectory:
    times = np.array([0.0, 0.4, 0.8])
    return clsim.Trajectory.waypoints(times, place + np.outer(times, velocity), np.tile(TURNS[axis], (3, 1)))


def things(kind: str, place: Any, velocity: Any, axis: str) -> dict[str, Any]:
    """Return the scatterers or bodies of a kind."""
    along = way(place, velocity, axis)
    if kind == "hand":
        opening = [(0.0, 1.0), (0.4, 0.0), (0.8, 1.0)]
        return {"scatterers": clsim.hand("t", clsim.Trajectory.fixed(place), opening=opening)}
    if kind in ("box", "plate"):
        return {"bodies": [clsim.Body.box("t", (0.4, 0.3, 0.2 if kind == "box" else 0.0), HARD, along)]}
    made = {
        "capsule": lambda: clsim.Scatterer.capsule("t", 0.01, 0.1, along),
        "sphere": lambda: clsim.Scatterer.sphere("t", 0.05, along),
        "ellipsoid": lambda: clsim.Scatterer.ellipsoid("t", (0.05, 0.1, 0.03), along),
        "geometrical sphere": lambda: clsim.Scatterer.sphere("t", 0.05, along, model="geometrical"),
        "point": lambda: clsim.Scatterer.point("t", -20.0, along),
    }  # fmt: skip
    return {"scatterers": [made[kind]()]}


def drawn(number: int) -> dict[str, Any]:
    """Return the source, the receiver and a thing in a line, or at equal heights, or in a symmetry plane."""
    random = np.random.default_rng([33, number])
    kinds = ["capsule", "capsule", "hand", "sphere", "ellipsoid", "geometrical sphere", "point", "box", "plate"]
    y, z = random.choice([0.5, 0.75, 1.0, 1.25, 1.5], 2)
    source, receiver = np.array([random.choice([0.5, 1.0]), y, z]), np.array([random.choice([3.0, 3.5]), y, z])
    place = np.array([random.choice([1.5, 1.75, 2.0, 2.5]), y, z])
    how = random.integers(4)
    if how == 1:
        place[1] = random.choice([0.5, 1.0, 2.0, 2.5])
    elif how == 2:
        place[2] = random.choice([0.5, 1.0, 1.5])
    elif how == 3:
        place[:2] = random.choice([source[0], 0.5 * (source[0] + receiver[0])]), random.choice([2.0, 2.5])
    velocity = 0.1 * np.eye(3)[random.integers(3)] * random.choice([-1.0, 1.0])
    return {
        "kind": kinds[number % len(kinds)], "source": source, "receiver": receiver, "place": place,
        "velocity": velocity, "axis": str(random.choice(list(TURNS))),
    }  # fmt: skip


def heard(of: dict[str, Any], aside: Any, engine: str, order: int | None = None) -> Any:
    made = things(of["kind"], of["place"] + aside, of["velocity"], of["axis"])
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.0), HARD), AIR,
        [clsim.Source("s", PULSE, clsim.Trajectory.fixed(of["source"]))],
        [clsim.Receiver("r", clsim.Trajectory.fixed(of["receiver"]))], **made,
    )  # fmt: skip
    order = int("bodies" in made) if order is None else order
    paths = clsim.find_paths(scene, order, scattering_order=order)
    if "scatterers" in made:  # the free way is louder
        paths = PathSet(scene, paths.families[1:])
    exact: Any = {"engine": engine, "convolve_static": False, "scattering_error_db": -90.0}
    return clsim.render(paths, RATE, duration=0.02, **exact).pressure[0].astype(float)


def apart_db(one: Any, other: Any) -> float:
    assert np.all(np.isfinite(one))
    assert np.all(np.isfinite(other))
    return float(20.0 * np.log10(np.linalg.norm(one - other) / max(np.linalg.norm(other), WEAK) + 1e-30))


@pytest.mark.parametrize("number", few(range(90), kept=range(0), many=True))
def test_of_things(number: int) -> None:
    of = drawn(number)
    fast = heard(of, 0.0, "opencl")
    assert apart_db(fast, heard(of, 0.0, "reference")) < ALIKE_DB
    assert apart_db(heard(of, ASIDE, "opencl"), fast) < CONTINUOUS_DB


def in_line(kind: str, velocity: Any, *along: float, axis: str = "x") -> Any:
    source, place, receiver = (np.array([x, 0.9, 0.9]) for x in along)
    made = {"kind": kind, "axis": axis, "velocity": np.array(velocity)}
    return pytest.param(made | {"source": source, "receiver": receiver, "place": place}, id=f"{kind} {velocity}")


BETWEEN = [
    in_line("capsule", (0.0, 0.1, 0.0), 1.0, 2.0, 3.0),
    in_line("capsule", (0.1, 0.0, 0.0), 0.3, 1.7, 2.7),
    in_line("hand", (0.0, 0.0, 0.0), 1.0, 2.0, 3.0, axis="z"),
]


@pytest.mark.parametrize("of", BETWEEN)
def test_what_lies_between_the_ends(of: dict[str, Any]) -> None:
    """Capsules whose axis is the line from the source to the receiver, and a hand that closes upon it."""
    assert apart_db(heard(of, ASIDE, "opencl", order=1), heard(of, 0.0, "opencl", order=1)) < CONTINUOUS_DB


def by_edges(number: int, aside: Any, engine: str) -> Any:
    """Return the samples near a screen or a pillar with both ends in its planes, on its diagonal or at equal heights."""
    random = np.random.default_rng([34, number])
    if number % 2:
        room: Any = clsim.MeshRoom([(0, 0, -2), (0, 0, 2), (-2, 0, 2), (-2, 0, -2)], [(0, 1, 2), (0, 2, 3)], HARD)
        ends = [
            (0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.5, 1.0), (0.5, -1.0, 2.0),
            (-0.5, 1.0, 1.0),
        ]  # fmt: skip
    else:
        corners = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-1.0, 1.0)]
        faces = [
            (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6),
            (0, 6, 4), (1, 5, 7), (1, 7, 3),
        ]  # fmt: skip
        room = clsim.MeshRoom(corners, faces, HARD)
        ends = [
            (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (1.5, 0.0, 0.0), (-1.5, 0.0, 0.5), (0.0, 1.5, 0.0),
            (1.0, 1.0, 2.0), (1.5, 0.5, 0.0),
        ]  # fmt: skip
    first, second = random.permutation(len(ends))[:2]
    start = np.add(ends[second], aside)
    moving = clsim.Trajectory.line(start, start + 0.01 * np.eye(3)[number % 3], 0.1)
    scene = clsim.Scene(
        room, AIR, [clsim.Source("s", PULSE, clsim.Trajectory.fixed(ends[first]))], [clsim.Receiver("r", moving)]
    )
    paths = clsim.find_paths(scene, 1, diffraction=1 + number // 2 % 2)
    return clsim.render(paths, RATE, duration=0.03, engine=engine, convolve_static=False).pressure[0].astype(float)


@pytest.mark.parametrize("number", few(range(24), kept=range(0), many=True))
def test_of_edges(number: int) -> None:
    fast = by_edges(number, 0.0, "opencl")
    assert apart_db(fast, by_edges(number, 0.0, "reference")) < ALIKE_DB
    assert apart_db(by_edges(number, ASIDE, "opencl"), fast) < CONTINUOUS_DB
