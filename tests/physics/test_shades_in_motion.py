"""Shadows of bodies that move, to the first order of the Mach number: the same in all frames, and phases by events."""

import math
from collections.abc import Callable

import numpy as np
import pytest

import clsim
from clsim.paths.family import PathFamily
from clsim.paths.vertices.shade import _near

RATE, TONE, C, T = 192e3, 40e3, 343.0, 0.08
MIDDLE, OPEN = np.array([50.0, 50.0, 50.0]), clsim.Shoebox((100.0, 100.0, 100.0), clsim.Material.from_reflection(0.0))
TURNED = np.array([0.1, 0.3, 0.2, np.sqrt(1.0 - 0.14)])


def shaded(velocity: np.ndarray, wind: np.ndarray | None) -> tuple[clsim.PathSet, PathFamily]:
    """Return the direct sound past a leg and an arm, where all moves in the same way, and its shadow."""

    def at(*place: float, turn: np.ndarray | None = None) -> clsim.Trajectory:
        times = np.linspace(-0.05, T, 3)
        turns = None if turn is None else np.tile(turn, (3, 1))
        return clsim.Trajectory.waypoints(times, MIDDLE + np.array(place) + times[:, None] * velocity, turns)

    things = [
        clsim.Scatterer.capsule("leg", 0.1, 0.3, at(0.0, -0.05, 0.2, turn=TURNED)),
        clsim.Scatterer.ellipsoid("arm", (0.03, 0.1, 0.05), at(0.12, 0.1, 0.36, turn=TURNED)),
    ]
    air = clsim.Air(speed_of_sound=C, absorption=False, wind=None if wind is None else tuple(wind))
    source = clsim.Source("s", clsim.Signal.tone(TONE, T, RATE, fade=0.01), at(0.3, 0.2, 0.5))
    scene = clsim.Scene(OPEN, air, [source], [clsim.Receiver("r", at(-0.4, -0.3, 0.1))], scatterers=things)
    paths = clsim.find_paths(scene, 0)
    shadow = next(family for family in paths.families if family.adds)
    assert len(shadow) == 1
    return paths, shadow


def test_all_that_moves_in_still_air_is_shaded_as_in_wind(engine: str, measured: Callable[..., float]) -> None:
    """What all moves at 6.8 m/s hears what rests in wind: by lengths as in still air it would be 8 % off."""
    u = np.array([6.0, -3.0, 1.0])
    heard = []
    for velocity, wind in ((u, None), (0.0 * u, -u)):
        paths, shadow = shaded(velocity, wind)
        alone = clsim.PathSet(paths.scene, (shadow,))
        exact = {"convolve_static": False, "scattering_error_db": -90.0}
        heard.append(clsim.render(alone, RATE, duration=T, engine=engine, **exact).pressure[0].astype(float))
    inside = slice(round(0.02 * RATE), round(0.06 * RATE))
    apart, size = (float(np.linalg.norm(x[inside])) for x in (heard[0] - heard[1], heard[1]))
    assert size > 10.0
    measured("a shadow in all that moves", "wind", 20.0 * math.log10(apart / size), -70.0)


@pytest.mark.parametrize("own", [0.0, -5.0, 8.0])
def test_phases_by_a_moving_edge_are_those_of_events(own: float) -> None:
    """Sound by any point of a body that moves is emitted earlier, in its phase, by what scaled lengths say."""
    body, of_source = np.array([-4.0, 3.0, 2.0]), np.array([own, 2.0, -0.5 * own])
    received, wave, times = 0.05, 2.0 * math.pi * TONE / C, np.array([-0.1, 0.1])
    source = clsim.Trajectory.waypoints(times, MIDDLE + np.outer(times, of_source))
    end = MIDDLE + np.array([2.0, 0.3, 0.1])
    direct = _sent(source, None, np.zeros(3), end, received)
    begin = source.position(np.array([direct]))
    along = (end - begin[0]) / np.linalg.norm(end - begin[0])
    beside = begin[0] + 1.2 * along + np.array([0.0, 0.03, 0.02])  # when sound is there
    way = clsim.Trajectory.waypoints(times, beside + np.outer(times - 0.0475, body))
    thing = clsim.Scatterer.ellipsoid("b", (0.05, 0.05, 0.05), way)
    travel = np.array([direct]), np.array([received]), np.array([1.0 / (1.0 - float(of_source @ along) / C)])
    rows, first, last, scale = _near(thing, wave, (begin, end[None]), travel)
    assert len(rows) == 1
    allowed = 4.0 * (np.linalg.norm(body) + np.linalg.norm(of_source)) ** 2 / C**2
    for point in 0.05 * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.6, -0.8, 0.0], [-0.6, 0.0, 0.8]]):
        by_events = wave * C * (direct - _sent(source, way, point, end, received))
        place = scale[0] * point
        detour = np.linalg.norm(first[0] - place) + np.linalg.norm(last[0] - place) - np.linalg.norm(last[0] - first[0])
        assert by_events > 0.1
        assert abs(wave * detour / by_events - 1.0) < allowed < 0.01


def _sent(source: clsim.Trajectory, way: clsim.Trajectory | None, point: np.ndarray, end: np.ndarray, received: float):
    """Return when what passes a point of a body, or goes straight, was sent: fixed points, in still air."""
    met = out = received
    for _ in range(200):
        place = source.position(np.array([out]))[0]
        on_way = end if way is None else way.position(np.array([met]))[0] + point
        met = received - float(np.linalg.norm(end - on_way)) / C
        out = met - float(np.linalg.norm(on_way - place)) / C
    return out
