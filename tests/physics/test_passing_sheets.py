"""Ends that pass the plane of a sheet beyond one of its edges, where they go from one face to the other as others see it."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from edge_fields import field

import clsim
from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse

RATE, TONE, LENGTH = 192e3, 40e3, 0.1
AIR = clsim.Air(absorption=False, speed_of_sound=343.0)
SHEET = clsim.MeshRoom(
    [(0, 0, -3), (0, 0, 3), (-1, 0, 3), (-1, 0, -3)], [(0, 1, 2), (0, 2, 3)], clsim.Material.from_reflection(0.9)
)
STILL = np.array([0.3, -2.0, 0.0])
FIXED = clsim.Trajectory.fixed


def found(ends: tuple[clsim.Trajectory, clsim.Trajectory], order: int, edges: int) -> PathSet:
    tone = clsim.Signal.tone(TONE, LENGTH, RATE, fade=0.001)
    scene = clsim.Scene(SHEET, AIR, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])])
    return clsim.find_paths(scene, order, diffraction=edges, edge_fades=False)


def passing(speed: float) -> clsim.Trajectory:
    """Return a way through the sheet's plane 5 cm beside it, there at the middle of the run."""
    half = np.array([0.0, 0.5 * LENGTH * speed, 0.0])
    place = np.array([-1.05, 0.0, 0.2])
    return clsim.Trajectory.line(place + half, place - half, LENGTH)


@pytest.mark.parametrize(("order", "edges"), [(0, 1), (1, 2)])
@pytest.mark.parametrize("moving", ["receiver", "source"])
def test_all_is_as_it_is_for_ends_at_rest(moving: str, order: int, edges: int) -> None:
    """On both sides of the plane, whatever came before.

    A source at 1 mm/s goes by 5 um while other ways take up to 15 ms more: 1e-2 of a radian, of what is soft.
    """
    way = passing(2.0 if moving == "receiver" else 1e-3)
    sides = (FIXED(STILL), way) if moving == "receiver" else (way, FIXED(STILL))
    paths = found(sides, order, edges)
    times = np.array([0.025, 0.045, 0.08, 0.09])
    sums = field(paths, times, TONE)
    for time, one in zip(times, sums, strict=True):
        delay = 0.0
        for _ in range(5 * (moving == "source")):
            delay = float(np.linalg.norm(way.position(time - delay) - STILL)) / AIR.speed_of_sound
        there = FIXED(way.position(time - delay))
        rest = found((FIXED(STILL), there) if moving == "receiver" else (there, FIXED(STILL)), order, edges)
        wanted = field(rest, np.array([0.05]), TONE)[0]
        within = 1e-10 if moving == "receiver" else 4e-3
        assert abs(one - wanted) < within * abs(wanted), time


@cache
def over_the_far_edge(moving: str) -> PathSet:
    """Return the paths over the edge at x = 0 alone: two intervals."""
    sides = (FIXED(STILL), passing(2.0))
    paths = found(sides if moving == "receiver" else sides[::-1], 0, 1)
    edge = paths.families[1]
    rows = np.flatnonzero(
        (edge.vertex.end_side == 0) & (np.abs(edge.vertex.frame[:, 0, 0]) < 1e-9) & (edge.vertex.frame[:, 3, 0] == 0.0)
    )
    return PathSet(paths.scene, (edge.part(rows),))


@pytest.mark.parametrize("moving", ["receiver", "source"])
def test_pieces_go_on_smoothly_beyond_the_plane(moving: str, engine: str, measured: Callable[..., float]) -> None:
    """At 2 m/s: nodes beyond the ends of pieces, and what is rendered of them, next to the cut, without a warning."""
    paths = over_the_far_edge(moving)
    pieces = paths.families[0]
    assert len(pieces) == 2
    mine = int(moving == "receiver")
    assert pieces.vertex.beside[:, mine].tolist() in ([1, -1], [-1, 1])
    cut = float(pieces.end[0])
    assert cut == pieces.start[1]
    at = SceneResponse(paths.scene, 0, np.array([TONE]))
    gains = []
    for row in range(2):
        around = cut + np.linspace(-5e-3, 5e-3, 21)
        one = pieces.arrivals(np.array([row]), around)
        gains.append(pieces.response(np.array([row]), one, around, at)[0, :, 0])
        assert np.abs(np.diff(gains[-1], 2)).max() < 1e-3 * np.abs(gains[-1]).max()
    assert np.abs(gains[1] - gains[0]).max() > 0.5 * np.abs(gains[0]).max()  # what goes over both edges is between
    heard = clsim.render(paths, RATE, duration=0.095, engine=engine).pressure[0]
    for row, steps in ((0, np.arange(-800, -115)), (1, np.arange(116, 800))):  # but for the transition
        n = round(cut * RATE) + steps
        one = pieces.arrivals(np.array([row]), n / RATE)
        gain = pieces.response(np.array([row]), one, n / RATE, at)[0, :, 0]
        wanted = np.imag(gain * np.exp(2j * np.pi * TONE * (n / RATE - one.delay[0])))
        error = float(20.0 * np.log10(np.abs(heard[n] - wanted).max() / np.abs(gain).max()))
        measured("past a sheet, both sides of the cut", "gains and delays of each path", error, -85.0)
