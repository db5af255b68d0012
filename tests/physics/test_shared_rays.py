"""Rays that serve several bands and several zones of a source: the same energies, or means within the same error."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsim
from clsim.numerics.sphere import fibonacci_sphere
from clsim.tail.host_rays import HostRays
from clsim.tail.ray_room import WallEnergies, ray_room
from clsim.tail.rays import Received, Spheres, Tracer

CENTRES = np.array([500.0, 1000.0, 2000.0, 4000.0, 5000.0])
PLACES = np.array([[1.5, 1.2, 1.4], [2.2, 1.5, 1.4], [4.6, 3.0, 1.1]])
HEARD, RADIUS = np.array([[3.4, 2.6, 1.5]]), 0.7


def tracer(material: clsim.Material, even: bool) -> Tracer:
    room = clsim.Shoebox((5.2, 4.1, 2.7), material)
    tone = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=16e3)
    source = clsim.Source("s", tone, clsim.Trajectory.fixed(PLACES[0]))
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed(HEARD[0]))
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=343.0), [source], [receiver])
    energies = WallEnergies.of(scene, CENTRES)
    return Tracer(ray_room(room), energies, HostRays(), 343.0, 2, (0, 0), even=even)


def traced(of: Tracer, levels: Any, error_db: float, shares: list[float] | None = None) -> list[Received]:
    """Return energies of places of a source that emits at levels, the same in all directions and bands."""

    def emitting(level: float) -> Any:
        return lambda directions: np.full((len(directions), len(CENTRES)), level)

    volume = np.array([4.0 / 3.0 * np.pi * RADIUS**3])
    spheres = Spheres(HEARD, volume, RADIUS, fibonacci_sphere(16), fibonacci_sphere(8))
    emitted = [emitting(level) for level in levels]
    told = [] if shares is None else shares
    ((first, found),) = of.received(PLACES[: len(levels)], emitted, spheres, error_db, told.append)
    assert first == 0
    return found


def test_bands_that_walls_send_alike_are_traced_once() -> None:
    table = clsim.Material.from_absorption([1000.0, 2000.0, 4000.0], [0.3, 0.3, 0.5], scattering=0.2)
    once, each = (tracer(table, even) for even in (True, False))
    groups = [bands.tolist() for bands in once.carried[0]]
    assert groups == [[0, 3]]  # of 500 Hz to 2 kHz, and from 4 kHz on
    assert once.carried[1].tolist() == [0, 0, 0, 1, 1]
    assert [bands.tolist() for bands in each.carried[0]] == [[0, 1, 2, 3, 4]]
    (found,), (expected,) = (traced(of, [1.0], 3.0) for of in (once, each))
    assert found.rays == expected.rays
    for name in ("early", "late", "images"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.late.sum() > 0.0


def late_db(one: Received, other: Received) -> float:
    return abs(float(10.0 * np.log10(one.late.sum() / other.late.sum())))


def test_zones_share_late_energies_where_these_are_alike() -> None:
    of, shares = tracer(clsim.Material.from_absorption([1000.0], [0.25]), True), list[float]()
    first, second, third = traced(of, [1.0, 1.0, 2.0], 0.5, shares)
    np.testing.assert_array_equal(first.late, second.late)
    assert not np.array_equal(first.early, second.early)
    assert late_db(third, first) == pytest.approx(3.0, abs=0.6)  # twice as loud: it shares nothing
    assert max(first.error_db, second.error_db, third.error_db) <= 0.5
    assert np.all(np.diff(shares) > 0.0)
    assert shares[-1] < 1.0


def test_what_zones_share_is_what_each_finds_by_itself() -> None:
    of = tracer(clsim.Material.from_absorption([1000.0], [0.25], scattering=0.1), True)
    together, alone = traced(of, [1.0, 1.0], 0.5), traced(of, [1.0], 0.2)[0]

    def by_window(one: Received) -> NDArray[Any]:
        late = one.late[0].sum(axis=(1, 2), dtype=np.float64)
        return late[: 5 * 20].reshape(5, 20).sum(axis=1)

    off_db = 10.0 * np.log10(by_window(together[0]) / by_window(alone))
    assert np.sqrt(np.mean(off_db**2)) < 1.0
