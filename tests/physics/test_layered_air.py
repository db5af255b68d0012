"""Air that depends on the height: closed forms, Snell's law, absorption, edges, and what is rendered of it."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from default_oracle import error_db
from made_meshes import box, screen
from oracle import as_the_paths_say
from scipy.integrate import quad
from scipy.optimize import brentq

import clsim
from clsim.acoustics.air import absorption_iso9613, speed_of_sound_cramer

SIZE = (9.0, 6.0, 4.0)
FLOOR, CEILING = 19.0, 23.0  # °C: 1 K/m
TONE = 40e3


def speed(height: float) -> float:
    return speed_of_sound_cramer(FLOOR + (CEILING - FLOOR) * height / SIZE[2], 0.5, 101_325.0)


def scene(source: clsim.Trajectory, receiver: clsim.Trajectory, air: clsim.Air, room=None) -> clsim.Scene:
    tone = clsim.Signal.tone(TONE, 0.5, 192e3, fade=0.01)
    room = room or clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.9))
    return clsim.Scene(room, air, [clsim.Source("s", tone, source)], [clsim.Receiver("r", receiver)])


def heated(**changes: object) -> clsim.Air:
    return clsim.Air(**{"temperature_celsius": (FLOOR, CEILING), "dispersion": False, **changes})


A, B = (1.0, 1.5, 0.4), (8.0, 4.5, 3.7)
MOVING = clsim.Trajectory.line(A, (2.0, 2.0, 1.9), 0.5)
RISING = clsim.Trajectory.line((8.0, 4.5, 1.7), (7.0, 4.3, 3.5), 0.5)


def at_rest(air: clsim.Air, order: int, room=None) -> clsim.PathSet:
    return clsim.find_paths(scene(clsim.Trajectory.fixed(A), clsim.Trajectory.fixed(B), air, room), order)


# --- travel times -----------------------------------------------------------------------------------------------------


def test_the_direct_sound_is_that_of_the_closed_form_of_a_linear_speed() -> None:
    """``t = arccosh(1 + g² d² / (2 c1 c2)) / |g|``: an arc of a circle."""
    delay = at_rest(heated(), 0).table([0.0]).delay[0, 0]
    d, c1, c2 = np.linalg.norm(np.subtract(B, A)), speed(A[2]), speed(B[2])
    g = (c2 - c1) / (B[2] - A[2])
    exact = np.arccosh(1.0 + (g * d) ** 2 / (2.0 * c1 * c2)) / abs(g)
    assert abs(delay - exact) < 1e-6
    assert abs(d / c1 - exact) > 20e-6  # the speed at the floor is wrong by much more


def test_the_direct_sound_is_that_of_snells_law(measured) -> None:
    """Rays that keep the horizontal slowness, by shooting in the true profile."""
    level = np.hypot(*np.subtract(B, A)[:2])

    def missed(p: float) -> float:
        return quad(lambda z: p * speed(z) / np.sqrt(1.0 - (p * speed(z)) ** 2), A[2], B[2], epsabs=1e-12)[0] - level

    p = brentq(missed, 1e-4, (1.0 - 1e-9) / speed(B[2]), xtol=1e-18)
    exact = quad(lambda z: 1.0 / (speed(z) * np.sqrt(1.0 - (p * speed(z)) ** 2)), A[2], B[2], epsabs=1e-15)[0]
    late = at_rest(heated(), 0).table([0.0]).delay[0, 0] - exact
    d, g = np.linalg.norm(np.subtract(B, A)), (speed(SIZE[2]) - speed(0.0)) / SIZE[2]
    assert late == pytest.approx(g**2 * d * level**2 / (24.0 * speed(2.0) ** 3), rel=0.1)  # what straight legs are late
    measured("air by height: rays over 8.3 m at 1 K/m", "Snell's law in the true profile", 1e6 * late, 1.0, "µs")


def folded(height: float) -> float:
    height = abs(height) % (2.0 * SIZE[2])
    return min(height, 2.0 * SIZE[2] - height)


@pytest.mark.parametrize("as_mesh", [False, True])
def test_images_take_the_mean_slowness_of_their_folded_way(as_mesh: bool) -> None:
    """Quadrature along the unfolded line, whose height is folded between floor and ceiling."""
    room = clsim.MeshRoom(*box(SIZE), clsim.Material.from_reflection(0.9)) if as_mesh else None
    paths = at_rest(heated(), 3, room)
    images = paths.families[0]
    table = paths.table([0.0])
    some = np.flatnonzero(table.order >= 2)[::7]
    for row in some:
        start = images.legs[0].matrix[row] @ A + images.legs[0].offset[row]
        bends = [k * SIZE[2] for k in range(-4, 5)]
        turns = sorted(
            (z - start[2]) / (B[2] - start[2]) for z in bends if min(start[2], B[2]) < z < max(start[2], B[2])
        )
        edges = [0.0, *turns, 1.0]

        def slowness(u: float, low: float = start[2]) -> float:
            return 1.0 / speed(folded(low + u * (B[2] - low)))

        mean = sum(quad(slowness, a, b)[0] for a, b in pairwise(edges))
        assert table.delay[row, 0] == pytest.approx(np.linalg.norm(B - start) * mean, abs=3e-13)
    assert len(some) > 4


def test_absorption_is_the_mean_along_the_way() -> None:
    humid = heated(relative_humidity=(0.3, 0.7))
    gain = at_rest(humid, 0).table([0.0]).gain[0, 0]
    d = np.linalg.norm(np.subtract(B, A))

    def loss(u: float) -> float:
        share = (A[2] + u * (B[2] - A[2])) / SIZE[2]
        return float(absorption_iso9613(TONE, FLOOR + 4.0 * share, 0.3 + 0.4 * share, 101_325.0))

    exact = 10.0 ** (-quad(loss, 0.0, 1.0)[0] * (d - 1.0) / 20.0) / d
    assert gain == pytest.approx(exact, rel=1e-6)
    assert abs(at_rest(heated(relative_humidity=0.3), 0).table([0.0]).gain[0, 0] / exact - 1.0) > 0.01


def test_air_that_is_the_same_everywhere_is_the_plain_one_to_the_last_bit() -> None:
    plain = at_rest(clsim.Air(21.0, 0.4), 2).table([0.0])
    for air in (clsim.Air((21.0, 21.0), (0.4, 0.4)), clsim.Air(lambda z: 21.0 + 0.0 * z, 0.4, heights=(0.0, 1.0))):
        same = at_rest(air, 2).table([0.0])
        np.testing.assert_array_equal(same.delay, plain.delay)
        np.testing.assert_array_equal(same.gain, plain.gain)


@pytest.mark.parametrize("kind", ["shoebox", "mesh", "edges"])
def test_air_that_is_the_same_everywhere_is_rendered_as_the_plain_one_to_the_last_bit(kind: str) -> None:
    """Paths by walls and over edges, of ends that move."""
    wall = clsim.Material.from_reflection(0.9)
    room = {"mesh": clsim.MeshRoom(*box(SIZE), wall), "edges": corner()}.get(kind)
    found = []
    for air in (clsim.Air(21.0, 0.4), clsim.Air((21.0, 21.0), lambda z: 0.4 + 0.0 * z)):
        paths = clsim.find_paths(scene(MOVING, RISING, air, room), 1, diffraction=int(kind == "edges"))
        table = paths.table(np.linspace(0.0, 0.4, 9))
        heard = clsim.render(paths, 192e3, duration=0.05).pressure
        assert np.abs(heard).max() > 1e-3
        assert (kind == "edges") == bool((table.interactions == 1).any())
        found.append((table.delay, table.gain, table.doppler_factor, heard))
    for same, plain in zip(*found, strict=True):
        np.testing.assert_array_equal(same, plain)


def test_air_that_is_another_near_the_floor_alone_is_not_the_same_everywhere() -> None:
    """Colder below 0.1 m, where none of the first few points is that are looked at."""
    with pytest.warns(clsim.ClsimWarning, match="changes so suddenly"):
        air = clsim.Air(lambda z: np.interp(z, [0.0, 0.1], [15.0, 21.0])).between(0.0, 3.0)
    assert len(air.layers) > 3


def test_pairs_hold_at_told_heights_and_functions_everywhere() -> None:
    told = at_rest(heated(temperature_celsius=(20.0, 22.0), heights=(1.0, 3.0)), 1).table([0.0]).delay
    np.testing.assert_allclose(at_rest(heated(), 1).table([0.0]).delay, told, rtol=1e-12)
    function = heated(temperature_celsius=lambda z: FLOOR + z)
    np.testing.assert_allclose(at_rest(function, 1).table([0.0]).delay, told, rtol=1e-12)


# --- motion, rendering ------------------------------------------------------------------------------------------------


def corner() -> clsim.MeshRoom:
    return clsim.MeshRoom(*screen((4.0, -2.0, 0.0), (0.0, 8.0, 0.3), 2.5), clsim.Material.from_reflection(0.9))


@pytest.mark.parametrize("kind", ["images", "edges", "slanted walls", "wind"])
def test_rates_are_the_derivatives_of_delays(kind: str) -> None:
    air = heated(wind=(2.0, -1.0, 0.5)) if kind == "wind" else heated()
    room = {"edges": corner(), "slanted walls": clsim.MeshRoom(*slanted(), clsim.Material.from_reflection(0.9))}.get(
        kind
    )
    paths = clsim.find_paths(scene(MOVING, RISING, air, room), 2, diffraction=int(kind == "edges"))
    step, now = 1e-5, 0.25
    table = paths.table([now - step, now, now + step])
    heard = np.flatnonzero(np.isfinite(table.delay).all(axis=1))
    if kind == "edges":
        heard = heard[(table.interactions[heard] == 1).any(axis=1)]
    assert len(heard) > 1
    rate = (table.delay[heard, 2] - table.delay[heard, 0]) / (2.0 * step)
    np.testing.assert_allclose(1.0 - table.doppler_factor[heard, 1], rate, atol=2e-10)
    flat = clsim.find_paths(
        scene(MOVING, RISING, heated(temperature_celsius=21.0), room), 2, diffraction=int(kind == "edges")
    )
    assert np.abs(flat.table([now]).doppler_factor[heard, 0] - table.doppler_factor[heard, 1]).max() > 1e-6


@pytest.mark.parametrize("air", [heated(), clsim.Air(fluctuation=clsim.Fluctuation(1e-6, 1.0, 1.0))])
def test_paths_over_two_edges_are_refused(air: clsim.Air) -> None:
    with pytest.raises(clsim.InputError, match="diffraction: must be at most 1 where the air depends on the height"):
        clsim.find_paths(scene(MOVING, RISING, air, corner()), 0, diffraction=2)


def slanted() -> tuple[np.ndarray, np.ndarray]:
    """Return a box whose ceiling rises along x."""
    points, triangles = box(SIZE)
    points = points.copy()
    points[:, 2] += np.where(points[:, 2] > 1.0, 0.1 * (points[:, 0] - SIZE[0]), 0.0)
    return points, triangles


def test_what_is_rendered_is_what_the_paths_say(engine: str, measured: Any) -> None:
    """Wind and gradient with moving ends, within what is promised at default settings; in chunks the same."""
    paths = clsim.find_paths(scene(MOVING, RISING, heated(relative_humidity=(0.3, 0.6), wind=(1.0, 0.0, 0.2))), 1)
    assert paths.families[0].device is None
    seconds = 0.2 if engine == "opencl" else 0.08
    n = np.arange(9_000, int(seconds * 192e3) - 100, 29)
    got = clsim.render(paths, 192e3, duration=seconds, engine=engine).pressure[0]
    error = error_db(got[n], as_the_paths_say(paths, n / 192e3))
    measured("air by height, rendered", "each path's delay and gain in float64", error, -85.0)


def test_bounds_hold() -> None:
    from clsim.tracks.tracks import track

    tracks = track(clsim.find_paths(scene(MOVING, RISING, heated(wind=(3.0, 1.0, 0.0))), 3))
    low, high = tracks.delay_range(0, 0.1, 0.3)
    delay = tracks.paths.table(np.linspace(0.1, 0.3, 21)).delay
    assert np.all(low[:, None] <= delay)
    assert np.all(delay <= high[:, None])
    assert np.abs(np.diff(delay, axis=1)).max() / 0.01 <= tracks.max_rate(0)


def test_air_that_disperses_does_so_in_every_layer() -> None:
    """Phase and absorption at other frequencies than the signal's own are the integrals along the way."""
    from clsim.paths.response import SceneResponse

    paths = at_rest(heated(relative_humidity=(0.3, 0.7), dispersion=True), 0)
    family, times, f = paths.families[0], np.array([0.0]), np.array([20e3, 60e3])
    found = family.arrivals(slice(None), times)
    response = family.response(slice(None), found, times, SceneResponse(paths.scene, 0, f))[0, 0]
    d = float(np.linalg.norm(np.subtract(B, A)))

    def wavenumbers(u: float, frequencies: np.ndarray) -> np.ndarray:
        share = (A[2] + u * (B[2] - A[2])) / SIZE[2]
        return clsim.Air(FLOOR + 4.0 * share, 0.3 + 0.4 * share, dispersion=True).wavenumber_at(frequencies)

    places, weights = np.polynomial.legendre.leggauss(24)
    k, carrier = (
        sum(0.5 * w * wavenumbers(0.5 * (1.0 + x), at) for x, w in zip(places, weights, strict=True))
        for at in (f, np.array([TONE]))
    )
    late = carrier.real / (2.0 * np.pi * TONE)  # s/m, of the phase at the signal's centre
    np.testing.assert_allclose(found.delay[0], d * late, rtol=1e-9)
    exact = np.exp((d - 1.0) * 1j * (2.0 * np.pi * f * late - k)) / d
    np.testing.assert_allclose(response, exact, rtol=1e-5)
    around = TONE * np.array([1.0 - 1e-3, 1.0 + 1e-3])
    both = family.response(slice(None), found, times, SceneResponse(paths.scene, 0, around))[0, 0]
    lag = -np.angle(both[1] / both[0]) / (2.0 * np.pi * (around[1] - around[0]))
    np.testing.assert_allclose(paths.table(times).delay[0, 0] - found.delay[0, 0], lag, rtol=1e-5)
