"""Cubics of faces that move against where these are."""

import numpy as np

import clsim
from clsim.paths.cubics import face_knots, face_rate
from clsim.paths.legs.mirrors import Mirrors

WOOD = clsim.Material.from_reflection(0.9)
TOLERANCE = 2e-9  # m
SPAN = 0.2, 0.8  # s


def mirrors() -> Mirrors:
    """Return the walls of a room, a door that swings and a box that goes in circles and turns."""
    hinge = clsim.Trajectory.swing((1.0, 2.0, 0.0), (0, 0, 1), [0.0, 0.2, 0.9, 1.2], [0.0, 0.3, 0.7, 1.0])
    door = clsim.Body.box("door", (0.9, 0.0, 2.0), WOOD, hinge, centre=(0.5, 0.0, 1.1))
    box = clsim.Body.box("box", (0.2, 0.3, 0.1), WOOD, clsim.Trajectory.circle((3.0, 1.0, 1.0), 0.4, 2.0, 1.0))
    return Mirrors.of(clsim.Shoebox((4.0, 3.0, 2.5), WOOD), [door, box])


def test_faces_are_where_they_are_said_to_be_and_as_fast() -> None:
    found = mirrors()
    rate = face_rate(found, 1.0, TOLERANCE)
    faces = np.arange(len(found.owner))
    knots, first = face_knots(found, faces, *SPAN, rate)
    times = np.linspace(*SPAN, 997)
    place = np.array([0.4, -0.3, 0.2])  # from the origin of each body
    at = (times - first) * rate
    cell = at.astype(np.int64)
    u = (at - cell)[:, None] ** np.arange(4)
    slope = np.arange(1, 4) * u[:, :3] * rate
    for face in faces.tolist():
        body = None if found.owner[face] < 0 else found.bodies[found.owner[face]]
        lever = 1.0 if body is None else body.radius
        origin = np.zeros((len(times), 3)) if body is None else body.trajectory.position(times)
        cubics = knots[face, cell]
        normal = np.einsum("tp,tpx->tx", u, cubics[:, :12].reshape(-1, 4, 3))
        height = np.sum(u * cubics[:, 12:], axis=1)
        events = (origin + place)[None]
        walls, zero = np.array([face]), np.zeros((1, len(times)))
        exact = found.planes(walls, times[None], zero, events)
        off = normal - exact.normal[0]
        assert np.linalg.norm(off, axis=1).max() * lever <= 2.0 * TOLERANCE
        assert np.abs(height - exact.offset[0] - np.sum(off * origin, axis=1)).max() <= 2.0 * TOLERANCE
        turning = np.einsum("tp,tpx->tx", slope, cubics[:, 3:12].reshape(-1, 3, 3))
        rising = np.sum(slope * cubics[:, 13:], axis=1)
        # Between knots the slope is wrong by some 10 times the error over the distance of knots.
        assert np.abs(rising - np.sum(turning * events[0], axis=1) - exact.speed[0]).max() <= 40.0 * TOLERANCE * rate


def test_rates_follow_what_is_asked() -> None:
    found = mirrors()
    rates = [face_rate(found, 1.0, tolerance) for tolerance in (1e-3, 1e-6, TOLERANCE)]
    assert rates[0] == 50.0
    assert rates == sorted(rates)
    assert rates[-1] > rates[0]
