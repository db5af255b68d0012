"""Beams, the polygons they cut, and the tables of how ends move."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import clsim
from clsim.paths.beams import beam_planes, clip_rings
from clsim.paths.movers import bounding_ball, movers

SQUARE = np.array([[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]], float)  # counterclockwise about +x


def planes_of(centre, radius: float, ring: np.ndarray = SQUARE) -> np.ndarray:
    filled = np.concatenate([ring, np.repeat(ring[-1:], 2, axis=0)])[None]
    normal = np.cross(ring[1] - ring[0], ring[2] - ring[1])
    normal /= np.linalg.norm(normal)
    return beam_planes(np.array([centre], float), radius, filled, np.array([len(ring)]), normal[None], 10.0)[0]


def inside(planes: np.ndarray, x) -> bool:
    return bool(np.all(planes[:, :3] @ np.asarray(x, float) >= planes[:, 3] - 1e-9))


def test_a_point_lights_a_pyramid() -> None:
    planes = planes_of((0, 0, 0), 0.0)
    assert inside(planes, (2, 1.99, -1.99))
    assert not inside(planes, (2, 2.01, 0))
    assert not inside(planes, (2, 0, -2.01))
    assert not inside(planes, (0.9, 0, 0)), "before the aperture"


def test_a_ball_lights_more() -> None:
    # The tangent through the edge at (1, 1) that touches the circle of radius 0.2 is 0.8 x - 0.6 y = 0.2.
    planes = planes_of((0, 0, 0), 0.2)
    assert inside(planes, (2, 2.33, 0))
    assert not inside(planes, (2, 2.34, 0))


def test_a_ball_that_reaches_through_its_aperture_lights_all() -> None:
    planes = planes_of((0.9, 0, 0), 0.2)
    for x in ((-5, 3, 1), (5, -7, 2), (1, 9, 9)):
        assert inside(planes, x)


def test_an_edge_within_the_ball_bounds_nothing() -> None:
    planes = planes_of((0.5, 1.0, 0.0), 0.45)  # 0.5 m before the plane and the edge at y = 1: no rays bounded there
    wide = planes_of((0.5, 1.0, 0.0), 0.55)
    assert not inside(planes, (1.1, 30, 0))
    assert inside(wide, (1.1, 30, 0))


unit = st.floats(-1.0, 1.0)


@settings(max_examples=300, deadline=None)
@given(
    st.tuples(st.floats(-4, 0.5), unit, unit), st.floats(0.0, 1.0), st.tuples(unit, unit, unit), st.tuples(unit, unit),
    st.floats(0.0, 20.0),
)  # fmt: skip
def test_no_ray_leaves_its_beam(centre, radius: float, offset, through, beyond: float) -> None:
    start = np.array(centre) + radius * np.array(offset) / max(1.0, float(np.linalg.norm(offset)))
    hit = np.array([1.0, *through])
    if start[0] >= 1.0:
        return  # from behind
    x = hit + beyond * (hit - start)
    planes = planes_of(centre, radius + 1e-9)
    assert np.all(planes[:, :3] @ x >= planes[:, 3] - 1e-6 * (1.0 + np.linalg.norm(x)))


def area(ring: np.ndarray) -> float:
    return 0.5 * float(np.linalg.norm(np.sum(np.cross(ring, np.roll(ring, -1, axis=0)), axis=0)))


def test_clipping_keeps_what_random_points_say(rng) -> None:
    count, sides = 40, 4
    ring = np.repeat(SQUARE[None], count, axis=0)
    planes = rng.normal(size=(count, 5, 4))
    planes[:, :, :3] /= np.linalg.norm(planes[:, :, :3], axis=2, keepdims=True)
    planes[:, :, 3] = planes[:, :, 0] + 0.6 * rng.normal(size=(count, 5))  # near the square's middle
    clipped, corners = clip_rings(ring, np.full(count, sides), planes)
    points = np.concatenate([np.ones((20_000, 1)), rng.uniform(-1, 1, (20_000, 2))], axis=1)
    for r, n, half in zip(clipped, corners, planes, strict=True):
        held = np.mean(np.all(points @ half[:, :3].T >= half[:, 3], axis=1))
        wanted = area(r[:n]) / 4.0 if n >= 3 else 0.0
        assert wanted == pytest.approx(held, abs=4.5 * math.sqrt(0.25 / len(points)))
        assert np.all(r[n:] == r[max(n - 1, 0)]) or n == 0


MOTIONS = {
    "circle": clsim.Trajectory.circle((1, 2, 3), 0.7, 0.31, 1.0, axis=(1, 1, 0)),
    "spline": clsim.Trajectory.waypoints([0.0, 0.2, 0.5, 1.1], [(0, 0, 0), (1, 0, 0), (1, 2, 0), (0, 0, 1)]),
    "corners": clsim.Trajectory.waypoints([0.0, 0.25, 1.0], [(0, 0, 0), (1, 0, 0), (1, 2, 0)], smooth=False),
    "fixed": clsim.Trajectory.fixed((3, 1, 2)),
    "line": clsim.Trajectory.line((0, 0, 0), (5, 1, 2), 0.4),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_tables_hold_the_motion(name: str, rng) -> None:
    motion = MOTIONS[name]
    table = movers(MOTIONS["fixed"], [MOTIONS["line"], motion])
    last = 1.0 if math.isinf(motion.end) else motion.end
    times = np.sort(rng.uniform(0.0, last, 500))
    row = np.full(500, 2)
    allowed = 2e-4 if name == "corners" else 2e-8  # a corner between knots
    np.testing.assert_allclose(table.position(row, times), motion.position(times), rtol=0, atol=allowed)
    centre, radius = bounding_ball(motion)
    assert np.linalg.norm(motion.position(times) - centre, axis=1).max() <= radius + allowed
    begin, end = np.sort(rng.uniform(0.0, last, (2, 500)), axis=0)
    bound = table.speed_over(row, begin, end)
    for a, b, most in zip(begin, end, bound, strict=True):
        inner = np.linspace(a, b, 50)
        assert np.linalg.norm(motion.velocity(inner), axis=1).max() <= most * (1 + 1e-6) + 1e-6
    np.testing.assert_allclose(table.position(row, np.array([-1.0] * 500)), motion.position(np.zeros(500)), atol=1e-12)
