"""Derivatives of recordings against central differences of the float64 reference, and against their transpose."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from exhaustive import few
from moved_scenes import (
    CASES,
    EXACT,
    FIXED,
    LINE,
    MOVING,
    RATE,
    balls,
    behind_a_plate,
    l_room,
    shoebox,
    vector,
    walk,
)

import clsim
from clsim.paths.family import PairPaths
from clsim.paths.path_set import PathSet
from clsim.paths.response import RETARDED
from clsim.render.options import RenderOptions
from clsim.sensitivity.displaced import TangentResponse
from clsim.sensitivity.linear_map import plan_of, received, representatives, scene_tracks
from clsim.sensitivity.parameters import parameters_of
from clsim.sensitivity.tangents import Tangents


@pytest.mark.parametrize("case", few(CASES, range(0, 25, 4)))
def test_differences_of_scenes_made_anew(case: str) -> None:
    """Their error falls as h²; what is left of it is below 1e-4."""
    check_differences(*CASES[case], RATE)


@pytest.mark.parametrize(("count", "what"), few([(2, "ball"), (1, "ball"), (1, "receiver")]))
def test_differences_with_scatterers(count: int, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One sphere that moves, and two in a row, beside the direct sound; few instants tell of their few lobes."""
    monkeypatch.setattr("clsim.tracks.picked._MOST_TIMES", 8)
    name = "receivers[0].position.x" if what == "receiver" else "scatterers[0].position.x"
    check_differences(lambda h: balls(h, what, count), name, 3e-4, 24e3)


def check_differences(made: Callable[[float], PathSet], name: str, step: float, rate: float) -> None:
    """Compare derivatives with central differences at three steps."""
    found = clsim.sensitivities(made(0.0), [vector(name)], rate, **EXACT)
    derivative = found.jacobian[found.parameters.index(name)]
    wrong = []
    for h in (step, 0.5 * step, 0.25 * step):
        ahead, behind = (received(plan_of(made(x), RenderOptions(rate, **EXACT))) for x in (h, -h))
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
            rows, at = slice(None), TangentResponse(paths.scene, 0, tones)
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


def test_filters_are_designed_for_every_kind_of_path() -> None:
    """Each kind is drawn with each coordinate, though one kind does not change with any of them.

    Two scatterers beside the direct sound were once wrong by 2e-4: a coordinate met one kind of path alone.
    """
    paths = balls(0.0, "ball", 2)
    plan = plan_of(paths, RenderOptions(RATE, engine="reference", duration=0.001, responses="centre"))
    drawn = representatives(scene_tracks(plan), parameters_of(paths, ["scatterers[0].position"]), False)
    assert drawn is not None
    seen = {(family.interactions.shape[1], family.parameter.name[-1]) for family in drawn.families}  # type: ignore[attr-defined]
    assert seen == {(count, axis) for count in (1, 2) for axis in "xyz"}


def test_noise_and_rounding_are_left_out() -> None:
    plain, noisy = (
        clsim.sensitivities(walk(**more), ["sources[0].position"], RATE, engine="reference", duration=0.02).jacobian
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


def test_bounds_are_those_of_known_signals() -> None:
    """One receiver and a gain alone: the bound is noise over the length of the derivative."""
    found = clsim.sensitivities(walk(1), ["sources[0].gain_db"], RATE, engine="reference", duration=0.02)
    assert found.bounds(0.1)[0] == pytest.approx(0.1 / np.linalg.norm(found.jacobian))
    assert found.to_xarray().dims == ("parameter", "receiver", "time")
    with pytest.raises(clsim.InputError, match="noise: must be at least 1e-15"):
        found.fisher(0.0)
    two = clsim.sensitivities(
        walk(1), ["sources[0].gain_db", "receivers[0].electronics.gain_db"], RATE, engine="reference", duration=0.02
    )
    with pytest.raises(clsim.InputError, match="must be distinguishable"):
        two.bounds(0.1)
