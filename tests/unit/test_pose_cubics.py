"""Cubics of poses: as the device looks them up, against the motions themselves."""

import numpy as np

import clsim
from clsim.numerics.quaternions import rotate
from clsim.paths.cubics import knot_rate, pose_knots, pose_rate
from clsim.scene.motion.motion import Motion

TOLERANCE = 1e-8  # m


def looked_up(knots: np.ndarray, cells: np.ndarray, first: float, rate: float, times: np.ndarray) -> np.ndarray:
    """Return position and two axes (n, 3, 3) of a thing, as `pose.h` does."""
    cell = np.clip(((times - first) * rate).astype(int), 0, len(cells) - 2)
    knot = np.array(cells[cell])
    while np.any(on := (knot + 1 < cells[cell + 1]) & (times >= knots[np.minimum(knot + 1, len(knots) - 1), 0])):
        knot += on
    u = np.clip((times - knots[knot, 0]) * knots[knot, 1], 0.0, 1.0)
    return np.einsum("np,napx->nax", u[:, None] ** np.arange(4), knots[knot, 2:].reshape(-1, 3, 4, 3))


def largest_error(motions: list[Motion], radius: float, start: float, end: float) -> float:
    rate = pose_rate(tuple(motions), (radius,) * len(motions), end, TOLERANCE)
    knots, cells, first = pose_knots(tuple(motions), start, end, rate)
    times, wrong = np.random.default_rng(4).uniform(start, end, 20_000), 0.0
    for motion, mine in zip(motions, cells, strict=True):
        got, turned = looked_up(knots, mine, first, rate, times), motion.orientation(times)
        apart = np.linalg.norm(got[:, 0] - motion.position(times), axis=1)
        for i, axis in enumerate(np.eye(3)[:2]):
            apart += radius * np.linalg.norm(got[:, 1 + i] - rotate(turned, axis), axis=1)
        wrong = max(wrong, float(apart.max()))
    return wrong


def test_poses_are_right_at_corners_of_ways_and_of_turning() -> None:
    """Legs with corners, and turns that change from one moment to the next, at times that are no multiples of a cell."""
    times = np.array([0.0, 0.137, 0.2911, 0.4])
    angle = np.array([0.0, 0.6, -0.3, 0.1])[:, None]
    turned = np.concatenate([np.sin(angle) * np.array([0.36, 0.48, 0.8]), np.cos(angle)], axis=1)
    corners = [(1.0, 1.0, 1.0), (1.3, 1.0, 1.2), (1.2, 1.4, 1.0), (1.0, 1.4, 1.1)]
    ways = [
        clsim.Trajectory.waypoints(times, corners, turned, smooth=False),
        clsim.Trajectory.line((0.0, 0.0, 0.0), (1.0, 0.5, 0.2), 0.4),
        clsim.Trajectory.fixed((2.0, 1.0, 1.0)),
    ]
    assert len(ways[0].breaks)
    # Outside of 0.4 s it goes on for 0.05 s; turning by 10 rad/s, h^4 w^4 / 384 is 2e-9 rad for h of 1/50 s.
    assert largest_error(ways, 0.3, -0.03, 0.47) < 2.0 * TOLERANCE


def test_what_repeats_with_every_cell_is_seen() -> None:
    """At 50 and 100 knots a second a way of 50 Hz is the same at all knots, and in the middle between them."""
    swaying = clsim.Trajectory.sampled(
        lambda t: np.stack([2.0 + 5e-4 * np.sin(100.0 * np.pi * t), 3.0 + 0 * t, 2.0 + 0 * t], axis=1), 0.2, 20e3
    )
    assert largest_error([swaying], 0.0, 0.0, 0.2) < 2.0 * TOLERANCE
    source = clsim.Source("s", clsim.Signal.tone(40e3, 0.15, 192e3), swaying)
    knots = knot_rate(source, 0.15, TOLERANCE)
    # Of the fourth derivative, which the cubics lack, h^4 / 384 is left: from 1060 a second on it is at most 1e-8 m.
    assert knots >= 1060.0
