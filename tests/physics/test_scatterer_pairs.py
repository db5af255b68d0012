"""Paths by two scatterers in a row, against products of the far fields of rigid spheres; the oracle uses SciPy alone."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from edge_fields import field
from scipy.special import eval_legendre, spherical_jn, spherical_yn

import clsim
from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse

RATE, TONE, C = 192e3, 40e3, 343.0
AIR = clsim.Air(absorption=False, speed_of_sound=C)
FIXED = clsim.Trajectory.fixed
OPEN = clsim.MeshRoom([(90, 90, 90), (91, 90, 90), (90, 91, 90)], [(0, 1, 2)], clsim.Material.from_reflection(0.0))
K = 2.0 * math.pi * TONE / C


def found(things: list, ends: tuple, order: int = 0, room: object = OPEN, **more: object) -> PathSet:
    tone = clsim.Signal.tone(TONE, 0.06, RATE, fade=0.001)
    scene = clsim.Scene(
        room, AIR, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])], scatterers=things
    )
    options = {"scatterers_in_row": 2, "scattering_order": order} | more
    return clsim.find_paths(scene, order, **options)


def pairs(paths: PathSet) -> PathSet:
    """Return the paths by two scatterers alone."""
    return PathSet(paths.scene, tuple(f for f in paths.families if getattr(f, "kind", "") == "static scatterer pair"))


def far_field(radius: float, cosine: float) -> complex:
    """Pressure that a rigid sphere sends to 1 m of a plane wave of 1 Pa, by the angle to the way on, ``exp(+jωt)``."""
    n, x = np.arange(40), K * radius
    hankel = spherical_jn(n, x, True) - 1j * spherical_yn(n, x, True)
    return complex(np.sum((2 * n + 1) * spherical_jn(n, x, True) / hankel * eval_legendre(n, cosine)) * -1.0 / (1j * K))


def decibels(ratio: float) -> float:
    return 20.0 * math.log10(max(ratio, 1e-300))


@pytest.mark.parametrize("radii", [(0.002, 0.0015), (0.003, 0.001)])
def test_two_small_spheres_send_the_product_of_their_far_fields(radii: tuple[float, float]) -> None:
    """In either order, some 20 m apart: what is left of the near field, n (n + 1) / (2 k d), is below -60 dB."""
    places = {"source": (0.0, 0.0, 0.0), "a": (20.0, 3.0, 1.0), "b": (12.0, 24.0, -2.0), "receiver": (-9.0, 16.0, 5.0)}
    at = {name: np.array(place) for name, place in places.items()}
    things = [clsim.Scatterer.sphere(name, r, FIXED(places[name])) for name, r in zip("ab", radii, strict=True)]
    paths = pairs(found(things, (FIXED(places["source"]), FIXED(places["receiver"]))))
    assert paths.order.tolist() == [2, 2]
    assert paths.interactions.tolist() == [[2, 2], [2, 2]]
    response = paths.families[0]
    zero = np.zeros(1)
    arrivals = response.arrivals(slice(None), zero)
    got = response.response(slice(None), arrivals, zero, SceneResponse(paths.scene, 0, np.array([TONE])))[:, 0, 0]
    got = got * np.exp(-1j * K * C * arrivals.delay[:, 0])
    for row, (first, second) in enumerate((("a", "b"), ("b", "a"))):
        stops = [at["source"], at[first], at[second], at["receiver"]]
        legs = [b - a for a, b in itertools.pairwise(stops)]
        lengths = [float(np.linalg.norm(leg)) for leg in legs]
        wanted = np.exp(-1j * K * sum(lengths)) / math.prod(lengths)
        for i, name in enumerate((first, second)):
            cosine = float(legs[i] @ legs[i + 1]) / (lengths[i] * lengths[i + 1])
            wanted *= far_field(radii["ab".index(name)], cosine)
        assert decibels(abs(got[row] - wanted) / abs(wanted)) < -60.0


def test_both_ways_are_one(measured: Callable[..., float]) -> None:
    """Spheres of 10 cm, 1 m from each other and their ends, a floor below: the sums of all paths agree to -100 dB."""
    floor = clsim.MeshRoom([(-9, -9, 0), (9, -9, 0), (0, 18, 0)], [(0, 1, 2)], clsim.Material.from_reflection(0.7))
    ends = FIXED((0.0, 0.0, 1.0)), FIXED((1.6, 0.3, 1.4))
    things = [clsim.Scatterer.sphere(n, 0.1, FIXED(p)) for n, p in (("a", (0.9, 1.1, 0.8)), ("b", (-0.2, 1.3, 1.5)))]
    sums = [field(pairs(found(things, way, 1, floor)), np.zeros(1), TONE)[0] for way in (ends, ends[::-1])]
    assert len(pairs(found(things, ends, 1, floor))) == 8
    measured(
        "two scatterers in a row, both ways", "reciprocity", decibels(abs(sums[0] - sums[1]) / abs(sums[0])), -100.0
    )


def moving_points() -> tuple[list[clsim.Scatterer], tuple[clsim.Trajectory, clsim.Trajectory]]:
    line = clsim.Trajectory.line
    ends = line((0.0, 0.0, 0.0), (0.6, 0.4, 0.0), 0.06), line((2.0, -1.0, 0.5), (2.0, -1.6, 0.7), 0.06)
    ways = line((1.0, 2.0, 0.0), (1.8, 1.6, 0.4), 0.06), line((3.0, 1.5, 0.3), (2.6, 0.7, 0.3), 0.06)
    return [clsim.Scatterer.point(n, 0.0, way) for n, way in zip("ab", ways, strict=True)], ends


def chain_of(ways: list, time: float) -> tuple[list[float], list[np.ndarray]]:
    """Times of reception, both events and emission, and where, by bisection of each travel time from the last on."""
    times, places = [time], [ways[-1].position(time)]
    for way in ways[-2::-1]:
        low, high = times[-1] - 1.0, times[-1]
        for _ in range(200):
            middle = 0.5 * (low + high)
            arrives = middle + float(np.linalg.norm(places[-1] - way.position(middle))) / C
            low, high = (middle, high) if arrives < times[-1] else (low, middle)
        times.append(0.5 * (low + high))
        places.append(way.position(times[-1]))
    return times, places


def test_points_that_all_move_are_three_delays_in_a_row(engine: str) -> None:
    """Delays, Doppler factors and amplitudes at 11 to 17 m/s, and what is rendered of all within -75 dB."""
    things, ends = moving_points()
    paths = pairs(found(things, ends))
    at = np.array([0.045, 0.055])
    table = paths.table(at)
    for row, order in enumerate((things, things[::-1])):
        ways = [ends[0], *(thing.trajectory for thing in order), ends[1]]
        for i, time in enumerate(at.tolist()):
            times, places = chain_of(ways, time)
            assert abs(table.delay[row, i] - (time - times[-1])) < 1e-12
            early, late = (chain_of(ways, time + step)[0][-1] for step in (-1e-5, 1e-5))
            assert abs(table.doppler_factor[row, i] - (late - early) / 2e-5) < 1e-7
            wanted = 1.0
            for k in range(1, 4):  # from each event on: the sender's Mach number towards what comes next
                leg = places[k - 1] - places[k]
                length = float(np.linalg.norm(leg))
                mach = float(ways[3 - k].velocity(times[k]) @ leg) / (length * C)
                wanted /= length * (1.0 - mach)
            assert table.gain[row, i] == pytest.approx(wanted, rel=1e-8)  # of travel times within 1e-9 s
    heard = clsim.render(paths, RATE, duration=0.06, engine=engine).pressure[0]
    samples = np.arange(8000, 11000)
    fine = paths.table(samples / RATE)
    exact = np.sum(fine.gain * np.sin(2.0 * math.pi * TONE * (samples / RATE - fine.delay)), axis=0)
    assert decibels(np.abs(heard[samples] - exact).max() / np.abs(fine.gain).max()) < -75.0


def test_all_stays_within_the_bounds_that_rendering_relies_on() -> None:
    things, ends = moving_points()
    spheres = [clsim.Scatterer.sphere(t.name, 0.05, t.trajectory) for t in things]
    for some in (things, spheres):
        family: clsim.paths.chain.Chain = pairs(found(some, ends)).families[0]
        times, rows = np.linspace(0.03, 0.06, 40), slice(None)
        found_at = family.arrivals(rows, times)
        at = SceneResponse(family.scene, 0, np.array([TONE]))
        gain = np.abs(family.response(rows, found_at, times, at)[..., 0])
        assert np.all(gain * found_at.length <= 1.2 * family.gain_bound(rows, at))
        assert np.abs(found_at.delay_rate).max() <= family.max_rate(13.0, 11.0)
        speeds = clsim.paths.family.PeakSpeeds(np.array([13.0]), np.array([11.0]))
        low, high = family.delay_bounds(rows, 0.03, 0.06, speeds)
        assert np.all((low[:, None] <= found_at.delay) & (found_at.delay <= high[:, None]))


def test_a_wall_between_both_hides_one_from_the_other() -> None:
    screen = clsim.MeshRoom([(1, -9, -9), (1, 9, -9), (1, 0, 9)], [(0, 1, 2)], clsim.Material.from_reflection(0.7))
    things = [clsim.Scatterer.point(n, 0.0, FIXED(p)) for n, p in (("a", (0.5, 1.0, 0.0)), ("b", (1.5, 1.0, 0.0)))]
    ends = FIXED((0.0, 0.0, 0.0)), FIXED((0.2, 0.1, 0.0))
    assert len(pairs(found(things, ends, 0, screen))) == 0
    assert len(pairs(found(things, ends))) == 2


def test_what_is_not_supported_is_refused() -> None:
    things, ends = moving_points()
    tone = clsim.Signal.tone(TONE, 0.06, RATE, fade=0.001)
    windy = clsim.Air(absorption=False, wind=(1.0, 0.0, 0.0))
    scene = clsim.Scene(
        OPEN, windy, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])], scatterers=things
    )
    with pytest.raises(clsim.InputError, match="scatterers_in_row: must be 1 where the air moves"):
        clsim.find_paths(scene, 0, scatterers_in_row=2)
    with pytest.raises(clsim.InputError, match="scatterers_in_row: must be from 1 to 2, but is 3"):
        clsim.find_paths(scene, 0, scatterers_in_row=3)


def test_what_rests_is_heard_as_it_is_in_the_table(device: None, measured: Callable[..., float]) -> None:
    """A ball and an ellipsoid 0.3 m apart: the default call convolves an impulse response, the table solves delays."""
    things = [
        clsim.Scatterer.sphere("ball", 0.05, FIXED((2.5, 1.6, 1.1))),
        clsim.Scatterer.ellipsoid("arm", (0.05, 0.1, 0.2), FIXED((2.8, 1.6, 1.2))),
    ]
    walls = clsim.Material.from_reflection(0.8)
    room = clsim.MeshRoom.from_plan([(0, 0), (4.5, 0), (4.5, 3.4), (0, 3.4)], 2.6, walls)
    paths = pairs(found(things, (FIXED((1.0, 1.2, 1.1)), FIXED((3.2, 1.9, 1.3))), 1, room))
    samples = np.arange(round(0.05 * RATE), round(0.06 * RATE), 7)
    table = paths.table(samples[:1] / RATE)
    tone = np.exp(2j * np.pi * TONE * (samples / RATE - table.delay - 0.25 / TONE))
    wanted = np.sum(np.real(table.gain * tone), axis=0)
    heard = clsim.render(paths, RATE, duration=0.06).pressure[0, samples]
    error = decibels(float(np.linalg.norm(heard - wanted) / np.linalg.norm(wanted)))
    measured("two scatterers at rest, convolved", "gains and delays of the table", error, -80.0)
