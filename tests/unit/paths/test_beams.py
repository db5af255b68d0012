"""Beams, the polygons they cut, and the tables of how ends move."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

import clsim
from clsim.paths.visibility.intervals import trajectory_tables
from clsim.paths.visibility.occlusion import beam_planes, clip_rings

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


@settings(max_examples=300, deadline=None)
@given(
    st.integers(3, 8), st.integers(0, 2**32 - 1), st.floats(0.0, 2.0), st.floats(-1.0, 3.0), st.floats(0.0, 20.0),
)  # fmt: skip
def test_no_ray_leaves_the_beam_of_any_aperture(sides: int, seed: int, radius: float, before: float, beyond: float):
    # A convex aperture anywhere, of any shape and corners that repeat, and a ball before, across or behind its plane.
    rng = np.random.default_rng(seed)
    frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    frame[:, 0] *= np.linalg.det(frame)  # right-handed: the normal last
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, sides))
    flat = np.stack([rng.uniform(0.1, 2.0) * np.cos(angle), rng.uniform(0.1, 2.0) * np.sin(angle)], axis=1)
    place = rng.uniform(-5.0, 5.0, 3)
    ring = place + flat @ frame[:, :2].T
    centre = place + frame @ np.array([*rng.uniform(-3.0, 3.0, 2), -before])
    filled = np.concatenate([ring, np.repeat(ring[-1:], 3, axis=0)])[None]
    planes = beam_planes(centre[None], radius + 1e-9, filled, np.array([sides]), frame[:, 2][None], 10.0)[0]
    for _ in range(10):
        offset = rng.normal(size=3)
        start = centre + radius * rng.uniform() ** (1.0 / 3.0) * offset / np.linalg.norm(offset)
        hit = rng.dirichlet(np.ones(sides)) @ ring
        x = hit + beyond * (hit - start)
        assert np.all(planes[:, :3] @ x >= planes[:, 3] - 1e-6 * (1.0 + np.linalg.norm(x)))


def test_a_ball_that_only_just_touches_its_aperture() -> None:
    for gap, bounded in ((1e-6, True), (-1e-6, False)):
        planes = planes_of((1.0 - 0.3 - gap, 0, 0), 0.3)
        assert inside(planes, (1.5, 0, 0))
        assert inside(planes, (0.5, 0, 0)) != bounded


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


def exact_area(half: np.ndarray) -> float:
    """Return the area that half-planes leave of the square, from Qhull."""
    sides = np.concatenate([half[:, 1:], [[1, 0, -1], [-1, 0, -1], [0, 1, -1], [0, -1, -1]]])
    norm = np.linalg.norm(sides[:, :2], axis=1)
    a = np.column_stack([-sides[:, :2], norm])  # the largest disc within: its centre is an inner point
    best = linprog([0, 0, -1], A_ub=a, b_ub=-sides[:, 2], bounds=[(None, None), (None, None), (None, 1.0)])
    if best.status != 0 or best.x[2] < 1e-6:
        return 0.0
    corners = HalfspaceIntersection(np.column_stack([-sides[:, :2], sides[:, 2]]), best.x[:2]).intersections
    return float(ConvexHull(corners).volume)  # in a plane: the area


def test_clipping_leaves_the_area_of_the_intersection(rng) -> None:
    count = 300
    planes = rng.normal(size=(count, 4, 4))
    planes[:, :, :3] /= np.linalg.norm(planes[:, :, :3], axis=2, keepdims=True)
    planes[:, :, 3] = planes[:, :, 0] + 0.5 * rng.normal(size=(count, 4))
    clipped, corners = clip_rings(np.repeat(SQUARE[None], count, axis=0), np.full(count, 4), planes)
    in_plane = np.concatenate([planes[..., :1] * 0.0, planes[..., 1:3], planes[..., 3:] - planes[..., :1]], axis=2)
    wanted = np.array([exact_area(half) for half in in_plane])
    got = np.array([area(r[:n]) if n >= 3 else 0.0 for r, n in zip(clipped, corners, strict=True)])
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-9)
    assert np.sum(wanted == 0.0) > 50
    assert np.sum(wanted > 0.1) > 50


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
    table = trajectory_tables(MOTIONS["fixed"], [MOTIONS["line"], motion])
    last = 1.0 if math.isinf(motion.end) else motion.end
    times = np.sort(rng.uniform(0.0, last, 500))
    row = np.full(500, 2)
    # In the span of knots that holds a corner, a smooth cubic replaces it; elsewhere 1e-8 m is promised for the middle.
    allowed = 4.0 / 3200.0 / 6.0 if name == "corners" else 1.1e-8
    away = np.abs(times - 0.25) > 1.0 / 3200.0
    exact = table.position(row, times)[away] - motion.position(times)[away]
    assert np.abs(exact).max() <= 1.1e-8
    np.testing.assert_allclose(table.position(row, times), motion.position(times), rtol=0, atol=allowed)
    centre, radius = table.sphere(2)
    assert np.linalg.norm(motion.position(times) - centre, axis=1).max() <= radius + allowed
    begin, end = np.sort(rng.uniform(0.0, last, (2, 500)), axis=0)
    bound = table.speed_over(row, begin, end)
    far = np.linalg.norm(motion.position(end) - motion.position(begin), axis=1)
    assert np.all(far <= bound * (end - begin) * (1 + 1e-9) + 2 * allowed)
    for a, b in zip(begin[:50], end[:50], strict=True):  # a ball of a part of it
        centre, radius = table.sphere(2, a, b)
        part = motion.position(np.linspace(a, b, 60))
        assert np.linalg.norm(part - centre, axis=1).max() <= radius + allowed
    for a, b, most in zip(begin, end, bound, strict=True):
        inner = np.linspace(a, b, 50)
        assert np.linalg.norm(motion.velocity(inner), axis=1).max() <= most * (1 + 1e-6) + 1e-6
    np.testing.assert_allclose(table.position(row, np.array([-1.0] * 500)), motion.position(np.zeros(500)), atol=1e-12)
