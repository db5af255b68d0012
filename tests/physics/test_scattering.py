"""Scatterers that move: delays against brute force, what is rendered against sums.

Nothing here takes delays or specular points from clsim: they are minima and roots found by other means.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.special import eval_legendre, jv, spherical_jn, spherical_yn

import clsim
from clsim.numerics.quaternions import rotate
from clsim.paths.response import SceneResponse
from clsim.paths.search.scatterers import direct_legs

C, RATE = 343.0, 192e3
AIR = clsim.Air(speed_of_sound=C, absorption=False)
OPEN = clsim.Shoebox((8.0, 6.0, 4.0), clsim.Material.from_reflection(0.0))
ROOM = clsim.Shoebox((8.0, 6.0, 4.0), clsim.Material.from_reflection(0.8))


def scene_of(scatterers: list[clsim.Scatterer], source: Any, receiver: Any, **options: Any) -> clsim.Scene:
    """Return a scene with one source and one receiver on trajectories."""
    signal = options.pop("signal", None) or clsim.Signal.tone(40e3, 0.5, RATE)
    ends = [clsim.Source("s", signal, source)], [clsim.Receiver("r", receiver)]
    return clsim.Scene(options.pop("room", OPEN), AIR, *ends, scatterers=scatterers)


# --- delays -----------------------------------------------------------------------------------------------------------


def swinging() -> list[clsim.Scatterer]:
    """Return a point, a sphere, an ellipsoid and a capsule that move, the last two turn as well."""
    t = np.linspace(-0.1, 0.6, 15)
    angle = 1.5 * t + 0.3
    turns = np.stack([0 * t, 0 * t, np.sin(angle / 2), np.cos(angle / 2)], axis=1)
    way = np.stack([5.0 + 3.0 * t, 3.0 - t, 1.5 + 0.3 * np.sin(4.0 * t)], axis=1)
    return [
        clsim.Scatterer.point("point", -20.0, clsim.Trajectory.line((3.0, 2.0, 1.0), (3.0, 4.0, 1.0), 0.5)),
        clsim.Scatterer.sphere("ball", 0.06, clsim.Trajectory.circle((4.0, 2.0, 1.5), 0.3, 0.5, 0.5)),
        clsim.Scatterer.ellipsoid("arm", (0.1, 0.3, 0.15), clsim.Trajectory.waypoints(t, way, turns)),
        clsim.Scatterer.capsule(
            "leg", 0.08, 0.3, clsim.Trajectory.waypoints(t, way + np.array([0.0, 1.0, -0.2]), turns[::-1])
        ),
    ]


MOVING = (
    clsim.Trajectory.line((1.0, 1.0, 1.2), (3.0, 1.2, 1.2), 0.5), clsim.Trajectory.line((2.0, 4.0, 2.0), (1.0, 4.5, 2.0), 0.5)
)  # fmt: skip


@pytest.fixture(scope="module")
def moving() -> clsim.PathSet:
    """Return paths in a room where all moves."""
    return clsim.find_paths(scene_of(swinging(), *MOVING, room=ROOM), 1, scattering_order=1)


def exact_delay(scene: clsim.Scene, body: clsim.Scatterer, walls: tuple[list[int], list[int]], t: float) -> float:
    """Return the delay by a scatterer: over all of its surface the sound that is emitted last."""
    faces, (before, after) = scene.room.faces, walls
    source, receiver = scene.sources[0].trajectory, scene.receivers[0].trajectory

    def image(place: np.ndarray, sequence: list[int]) -> np.ndarray:
        for wall in sequence:
            place = place - 2.0 * (place @ faces.normals[wall] - faces.offsets[wall]) * faces.normals[wall]
        return place

    heard_at = image(receiver.position(t), after)

    def emitted(v: np.ndarray) -> float:
        """Return the delay of the sound from the surface point in the direction v, s."""
        own = surface(body, v / np.linalg.norm(v))

        def place(event: float) -> np.ndarray:
            return body.trajectory.position(event) + rotate(body.trajectory.orientation(event), own)

        event = brentq(lambda e: t - e - np.linalg.norm(place(e) - heard_at) / C, t - 0.2, t, xtol=1e-16)
        met = place(event)
        return t - brentq(
            lambda e: event - e - np.linalg.norm(image(source.position(e), before) - met) / C, t - 0.3, event, xtol=1e-16
        )  # fmt: skip

    if body.shape.radius == 0.0:
        return emitted(np.ones(3))
    towards = rotate(body.trajectory.orientation(t) * [-1, -1, -1, 1], heard_at - body.trajectory.position(t))
    other = image(source.position(t), before) - body.trajectory.position(t)
    other = rotate(body.trajectory.orientation(t) * [-1, -1, -1, 1], other)
    start = towards / np.linalg.norm(towards) + other / np.linalg.norm(other)
    start /= np.linalg.norm(start)
    across = np.linalg.svd(start[None])[2][1:]
    found = minimize(
        lambda y: 1e3 * emitted(start + y @ across), np.zeros(2), method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-11, "initial_simplex": 0.05 * np.array([[0, 0], [1, 0], [0, 1]])},
    )  # fmt: skip
    return 1e-3 * float(found.fun)


def surface(body: clsim.Scatterer, v: np.ndarray) -> np.ndarray:
    """Return the place on the surface that a unit vector stands for."""
    if body.name != "leg":
        return getattr(body.shape, "semi_axes", body.shape.radius * np.ones(3)) * v
    radius, half = body.shape.cylinder_radius, 0.5 * body.shape.length
    aside = np.hypot(v[0], v[1])
    if radius * abs(v[2]) <= half * aside:
        return v * radius / aside
    along = abs(v[2]) * half  # on the sphere about the nearer end: |s v - c| = radius
    return v * (along + np.sqrt(along**2 - half**2 + radius**2))


@pytest.mark.parametrize("name", ["point", "ball", "arm", "leg"])
def test_delays_are_those_of_the_shortest_way_at_the_time_of_each_event(moving: clsim.PathSet, name: str) -> None:
    """Brute force over the surface and two roots, for walls on either side, to 1e-9 s."""
    time = 0.3
    table, scene = moving.table(np.array([time])), moving.scene
    body = next(s for s in scene.scatterers if s.name == name)
    for way in (name, f"x_min, {name}", f"{name}, z_max", f"y_max, {name}, x_max"):
        row = next(i for i in range(len(moving)) if table.name_objects(i) == way)
        parts = [[scene.room.faces.names.index(w) for w in side.split(", ") if w] for side in way.split(name)]
        wanted = exact_delay(scene, body, (parts[0], parts[1][::-1]), time)
        assert table.delay[row, 0] == pytest.approx(wanted, abs=1e-12), way


def test_doppler_factors_are_the_derivatives_of_delays_to_ten_digits(moving: clsim.PathSet) -> None:
    family, times, h = moving.families[1], np.array([0.12, 0.27, 0.41]), 1e-4
    fine = [family.arrivals(slice(None), times + k * h).delay for k in (-2, -1, 1, 2)]
    wanted = (fine[0] - fine[3] + 8.0 * (fine[2] - fine[1])) / (12.0 * h)
    np.testing.assert_allclose(family.arrivals(slice(None), times).delay_rate, wanted, atol=2e-11)


def test_ways_that_begin_at_those_before_and_after_are_the_same(moving: clsim.PathSet) -> None:
    """At many times splines say where Newton's method begins, at few the geometry does."""
    family, times = moving.families[1], np.arange(0.1, 0.45, 0.004)
    every = family.arrivals(slice(None), times)
    for first in range(0, len(times), 10):
        few = family.arrivals(slice(None), times[first : first + 10])
        here = (slice(None), slice(first, first + 10))
        np.testing.assert_allclose(every.delay[here], few.delay, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(every.delay_rate[here], few.delay_rate, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(every.more["strength"][here], few.more["strength"], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("speed", "shift"), [(1.0, 233.918), (5.0, 1183.432), (20.0, 4953.560)])
def test_a_point_that_comes_nearer_is_a_moving_mirror(speed: float, shift: float) -> None:
    """Its Doppler factor is that of a mirror at normal incidence, (1 + M) / (1 - M)."""
    place = clsim.Trajectory.fixed((1.0, 2.0, 2.0))
    ends = place, clsim.Trajectory.fixed((0.98, 2.0, 2.0))
    way = clsim.Trajectory.line((1.5 + 0.2 * speed, 2.0, 2.0), (1.5, 2.0, 2.0), 0.2)
    signal = clsim.Signal.tone(40e3, 0.1, RATE)
    scene = scene_of([clsim.Scatterer.point("p", 0.0, way)], *ends, signal=signal)
    rate = direct_legs(scene).arrivals(slice(None), np.array([0.1])).delay_rate[0, 0]
    mach = speed / C
    assert -rate == pytest.approx((1.0 + mach) / (1.0 - mach) - 1.0, rel=1e-10)
    assert -rate * 40e3 == pytest.approx(shift, abs=1e-3)


def test_a_sweep_off_what_moves_between_ends_that_rest(device: None) -> None:
    """The speeds that plans tell of are those of scatterers, too; a broad band takes the plain way or narrow parts alike."""
    ends = [clsim.Trajectory.fixed(p) for p in ((1.0, 2.0, 2.0), (1.5, 2.0, 2.0))]
    way = clsim.Trajectory.line((3.0, 2.0, 2.0), (2.0, 2.0, 2.0), 0.5)
    sweep = clsim.Signal.chirp(37e3, 43e3, 0.4, RATE, window="hann")
    paths = clsim.find_paths(scene_of([clsim.Scatterer.point("p", 0.0, way)], *ends, signal=sweep), 0)
    tracks = clsim.track(paths)
    speed, other = tracks.fastest(0, 2.0 * 2.0 * 2.0 / C)
    assert speed == pytest.approx(2.0, rel=0.03)
    assert other == pytest.approx(4.0, rel=0.03)
    carried = replace(paths.scene, scatterers=(), bodies=[clsim.Body.box("b", (0.1, 0.1, 0.1), ROOM.walls[0], way)])
    assert clsim.track(clsim.find_paths(carried, 0)).fastest(0, 0.0)[0] == pytest.approx(2.0, rel=0.03)
    wide, narrow = (clsim.render(paths, RATE, duration=0.1, narrowband=some).pressure[0] for some in (False, True))
    assert 20.0 * np.log10(np.linalg.norm(narrow - wide) / np.linalg.norm(wide)) < -85.0


def test_all_stays_within_the_bounds_that_rendering_relies_on(moving: clsim.PathSet) -> None:
    family, tracks = moving.families[1], clsim.track(moving)
    times = np.linspace(0.1, 0.4, 40)
    found = family.arrivals(slice(None), times)
    low, high = family.delay_bounds(slice(None), 0.1, 0.4, tracks.speeds)
    assert np.all(found.delay >= low[:, None])
    assert np.all(found.delay <= high[:, None])
    assert np.all(high - low < 0.05)
    most = family.max_rate(*(float(v.max()) for v in (tracks.speeds.source, tracks.speeds.receiver)))
    assert 0.3 * most < np.abs(found.delay_rate).max() < most
    from clsim.paths.response import SceneResponse

    at = SceneResponse(moving.scene, 0, np.array([20e3, 40e3]))
    gain = np.abs(family.response(slice(None), found, times, at)).max(axis=1)
    length = found.length.min(axis=1)[:, None]
    mach = (1.0 - float(tracks.speeds.source[0]) / C) ** -1
    assert np.all(gain * length <= family.gain_bound(slice(None), at) * mach)


# --- the same whichever way, and at rest --------------------------------------------------------------------------------


def test_source_and_receiver_change_places() -> None:
    at = [clsim.Trajectory.fixed(p) for p in ((1.0, 1.0, 1.0), (6.0, 4.0, 2.0))]
    turned = clsim.Trajectory.fixed((4.0, 2.0, 1.5), np.array([0.0, 0.6, 0.0, 0.8]))
    things = [
        clsim.Scatterer.ellipsoid("e", (0.3, 0.1, 0.2), turned), clsim.Scatterer.sphere("s", 0.05, turned),
        clsim.Scatterer.point("p", -10.0, turned), clsim.Scatterer.capsule("c", 0.05, 0.3, turned),
    ]  # fmt: skip
    tables = [
        clsim.find_paths(scene_of(things, *ends, room=ROOM), 0, scattering_order=1).table(np.array([0.1]))
        for ends in (at, at[::-1])
    ]
    backwards = {", ".join(reversed(tables[1].name_objects(i).split(", "))): i for i in range(len(tables[1].source))}
    assert len(backwards) == len(tables[0].source) == 1 + 4 * 49
    other = np.array([backwards[tables[0].name_objects(i)] for i in range(len(backwards))])
    np.testing.assert_allclose(tables[0].delay, tables[1].delay[other], rtol=1e-14)
    np.testing.assert_allclose(tables[0].gain, tables[1].gain[other], rtol=1e-10)
    np.testing.assert_allclose(tables[0].departure, tables[1].arrival[other], atol=1e-10)


def turning_bodies(height: float, sign: float, name: str = "") -> list[clsim.Scatterer]:
    """Return bodies above a plane at some height (1), or their images below it (-1)."""
    t = np.linspace(-0.05, 0.55, 13)
    turns = np.stack([np.sin(t), 0.0 * t, 0.0 * t, np.cos(t)], axis=1)
    way = np.stack([3.0 + t, 2.5 - 0.5 * t, 1.0 + 0.3 * t], axis=1)
    path = clsim.Trajectory.waypoints(t, [0, 0, height] + [1, 1, sign] * way, [sign, sign, 1, 1] * turns)
    return [
        clsim.Scatterer.ellipsoid("ellipsoid" + name, (0.2, 0.1, 0.15), path),
        clsim.Scatterer.sphere("sphere" + name, 0.04, path), clsim.Scatterer.capsule("capsule" + name, 0.05, 0.3, path),
    ]  # fmt: skip


def test_beside_a_wall_all_is_as_if_the_whole_scene_were_there_twice() -> None:
    """A mirror: four ways by each body equal those of the source and its image by the body and its image."""

    def end(height: float, sign: float) -> clsim.Trajectory:
        return clsim.Trajectory.line((1.0, 1.0, height + 0.7 * sign), (1.5, 1.0, height + 0.7 * sign), 0.5)

    def ear(height: float) -> list[clsim.Receiver]:
        return [clsim.Receiver("r", clsim.Trajectory.fixed((2.0, 4.0, height + 1.5)))]

    silent, mirror = (clsim.Material.from_reflection(r) for r in (0.0, 1.0))
    room = clsim.Shoebox((8.0, 6.0, 4.0), {"default": silent, "z_min": mirror})
    tone, times = clsim.Signal.tone(40e3, 0.5, RATE), np.array([0.1, 0.25, 0.4])
    walled = clsim.Scene(
        room, AIR, [clsim.Source("s", tone, end(0.0, 1.0))], ear(0.0), scatterers=turning_bodies(0.0, 1.0)
    )
    sources = [clsim.Source(name, tone, end(4.0, sign)) for name, sign in (("s", 1.0), ("image", -1.0))]
    every = [*turning_bodies(4.0, 1.0), *turning_bodies(4.0, -1.0, " image")]
    twice = clsim.Scene(clsim.Shoebox((8.0, 6.0, 8.0), silent), AIR, sources, ear(4.0), scatterers=every)
    table = clsim.find_paths(walled, 0, scattering_order=1, direct=False).table(times)
    images = clsim.find_paths(twice, 0, direct=False).table(times)
    for body in ("ellipsoid", "sphere", "capsule"):
        mine = [i for i in range(len(table.source)) if set(table.name_objects(i).split(", ")) <= {body, "z_min"}]
        theirs = [i for i in range(len(images.source)) if images.name_objects(i).startswith(body)]
        assert len(mine) == len(theirs) == 4
        rows = [np.array(some)[np.argsort(of.delay[some, 0])] for some, of in ((mine, table), (theirs, images))]
        np.testing.assert_allclose(table.delay[rows[0]], images.delay[rows[1]], rtol=1e-12)
        np.testing.assert_allclose(table.gain[rows[0]], images.gain[rows[1]], rtol=1e-6)


def test_a_huge_sphere_at_rest_is_a_mirror() -> None:
    """Near to it the whole divergence counts: what it sends back is as loud as an image."""
    ends = [clsim.Trajectory.fixed(p) for p in ((2.0, 1.0, 1.0), (4.0, 1.0, 1.0))]
    paths = direct_legs(scene_of([ball(1.0)], *ends))
    place = np.array([3.0, 3.0, 1.0])
    found = paths.arrivals(slice(None), np.array([0.0]))
    ways = [np.linalg.norm(x - (place - [0.0, 1.0, 0.0])) for x in ((2.0, 1.0, 1.0), (4.0, 1.0, 1.0))]
    assert found.delay[0, 0] * C == pytest.approx(sum(ways), rel=1e-14)
    # Convex mirror with R = 1 m, 45 degrees: 2 / (R cos) across, 2 cos / R in the plane... of the reflected wavefront.
    d, cosine = ways[0], np.sqrt(0.5)
    spread = [1.0 + (1.0 / d + 2.0 * f) * d for f in (cosine, 1.0 / cosine)]
    gain = found.more["strength"][0, 0] / np.prod(ways)
    lit = -np.expm1(-((cosine / 0.25) ** 3))
    assert gain == pytest.approx(lit / (d * np.sqrt(np.prod(spread))), rel=1e-9)


def ball(radius: float) -> clsim.Scatterer:
    """Return a ball in the middle of a floor."""
    return clsim.Scatterer.sphere("b", radius, clsim.Trajectory.fixed((3.0, 3.0, 1.0)), model="geometrical")


# --- what is rendered ---------------------------------------------------------------------------------------------------


def test_a_vibrating_scatterer_makes_the_sidebands_of_bessel(engine: str) -> None:
    """A sin(Omega t), seen back and forth: J_m(2 k A) within 0.05 dB, at the default settings.

    Retarded, the argument is ``k A (2 + m Omega / omega)``: 0.02 dB for the second line, and more for a faster one.
    """
    amplitude, vibration, duration = 0.5e-3, 50.0, 0.2

    def sway(t: np.ndarray) -> np.ndarray:
        return np.stack([2.0 + amplitude * np.sin(2.0 * np.pi * vibration * t), 3.0 + 0 * t, 2.0 + 0 * t], axis=1)

    # At the place of an end, but for what may not be nearer to another than 1 cm.
    ends = [clsim.Trajectory.fixed((1.0, 3.0, z)) for z in (1.99, 2.01)]
    thing = clsim.Scatterer.point("chest", 0.0, clsim.Trajectory.sampled(sway, duration, 20e3))
    scene = scene_of([thing], *ends, signal=clsim.Signal.tone(40e3, duration, RATE, fade=0.01))
    paths = clsim.find_paths(scene, 0)
    alone = clsim.PathSet(scene, paths.families[1:])
    first, count = round(0.03 * RATE), round(0.16 * RATE)
    heard = clsim.render(alone, RATE, duration=duration, engine=engine).pressure[0, first : first + count]
    spectrum = 2.0 * np.abs(np.fft.rfft(heard)) / count
    lines = np.round(np.array([40e3 + m * vibration for m in range(-2, 3)]) * count / RATE).astype(int)
    level = 20.0 * np.log10(spectrum[lines] * 1.0001)  # 1 m back and forth, 1 cm aside
    k_a = 2.0 * 2.0 * np.pi * 40e3 / C * amplitude * np.cos(np.arctan(0.01))
    np.testing.assert_allclose(level, 20.0 * np.log10(np.abs(jv(np.arange(-2, 3), k_a))), atol=0.05)


def test_a_sphere_that_moves_is_heard_as_its_series(device: None, measured: Callable[..., float]) -> None:
    """A chirp off a ball at 3.6 m/s: the sum over the spectrum of F(ka, gamma), float64, term by term; -85 dB."""
    radius = 0.03
    way = clsim.Trajectory.line((3.0, 2.0, 2.0), (2.8, 2.3, 2.0), 0.1)
    ends = clsim.Trajectory.fixed((1.0, 2.0, 2.0)), clsim.Trajectory.fixed((1.5, 3.5, 2.0))
    chirp = clsim.Signal.chirp(35e3, 45e3, 0.02, RATE, window="hann")
    scene = scene_of([clsim.Scatterer.sphere("ball", radius, way)], *ends, signal=chirp)
    alone = clsim.PathSet(scene, clsim.find_paths(scene, 0).families[1:])
    samples = np.arange(round(0.011 * RATE), round(0.035 * RATE), 7)
    wanted = heard_of_a_sphere(scene, radius, samples / RATE)
    for engine in ("opencl", "reference"):
        heard = clsim.render(alone, RATE, duration=0.04, engine=engine).pressure[0, samples]
        error_db = 20.0 * np.log10(np.linalg.norm(heard - wanted) / np.linalg.norm(wanted))
        claim, oracle = f"a ball that moves, {engine}", "its series, summed over the spectrum"
        measured(claim, oracle, error_db, -85.0)


def modes(radius: float, wave: np.ndarray, to: np.ndarray, back: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Return the field (n, F) scattered by a rigid sphere between ends at distances (n,), by the sum over its modes."""
    n = np.arange(round(radius * wave.max()) + 30)[:, None]

    def hankel(x: np.ndarray, derivative: bool = False) -> np.ndarray:
        return spherical_jn(n, x, derivative) - 1j * spherical_yn(n, x, derivative)

    factor = (2 * n + 1) * spherical_jn(n, radius * wave, derivative=True) / hankel(radius * wave, derivative=True)
    rows = [
        np.sum(factor * hankel(wave * d1) * hankel(wave * d2) * eval_legendre(n, mu), axis=0)
        for d1, d2, mu in zip(to, back, cosine, strict=True)
    ]
    return 1j * wave * np.array(rows)


def nearest(radius: float, front: list[np.ndarray], apart: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the angle (T,) from the source at which the shortest path meets a sphere, by bisection."""
    low, high = np.zeros(len(apart)), apart
    for _ in range(60):
        angle = 0.5 * (low + high)
        slopes = [
            d * np.sin(x) / np.sqrt(d**2 + radius**2 - 2.0 * d * radius * np.cos(x))
            for d, x in zip(front, (angle, apart - angle), strict=True)
        ]
        beyond = slopes[0] > weight * slopes[1]
        low, high = np.where(beyond, low, angle), np.where(beyond, angle, high)
    return 0.5 * (low + high)


def heard_of_a_sphere(scene: clsim.Scene, radius: float, times: np.ndarray) -> np.ndarray:
    """Return the pressure (T,) scattered by a moving sphere, by its nearest points and the series at each frequency."""
    ends = [end.trajectory.position(0.0) for end in (scene.sources[0], scene.receivers[0])]
    way, signal = scene.scatterers[0].trajectory, scene.sources[0].signal
    middle, half = 0.5 * (times[0] + times[-1]), 0.5 * (times[-1] - times[0])
    nodes = middle + half * np.cos(np.pi * (np.arange(7) + 0.5) / 7)
    exact = [exact_delay(scene, scene.scatterers[0], ([], []), float(t)) for t in (*nodes, middle + 0.3 * half)]
    fitted = np.polynomial.Polynomial.fit(nodes, exact[:-1], 6)
    assert fitted(middle + 0.3 * half) == pytest.approx(exact[-1], abs=1e-11)
    delay = fitted(times)
    late = times - delay
    event = late + 0.5 * delay
    weight = np.ones(len(times))
    for _ in range(60):  # when it was met, where the way by its surface is the shortest
        centre, velocity = way.position(event), way.velocity(event)
        front = [np.linalg.norm(x - centre, axis=1) for x in ends]
        towards = [(x - centre) / d[:, None] for x, d in zip(ends, front, strict=True)]
        apart = np.arccos(np.sum(towards[0] * towards[1], axis=1))
        from_source = nearest(radius, front, apart, weight)
        across = towards[1] - np.cos(apart)[:, None] * towards[0]
        across /= np.linalg.norm(across, axis=1)[:, None]
        place = centre + radius * (np.cos(from_source)[:, None] * towards[0] + np.sin(from_source)[:, None] * across)
        legs = [x - place for x in ends]
        lengths = [np.linalg.norm(leg, axis=1) for leg in legs]
        off, onwards = (np.sum(leg * velocity, axis=1) / d / C for leg, d in zip(legs, lengths, strict=True))
        event, weight = late + lengths[0] / C, (1.0 + off) / (1.0 - onwards)
    gain = weight  # as off a mirror that moves
    size = 2**13
    spectrum, out = np.fft.rfft(signal.read(0, signal.count), size), np.zeros(len(times), dtype=complex)
    loud = np.flatnonzero(np.abs(spectrum) > 1e-5 * np.abs(spectrum).max())
    wave = 2.0 * np.pi * loud * RATE / size / C
    some = np.linspace(0, len(times) - 1, 24).round().astype(int)
    series = modes(radius, wave, *(d[some] for d in front), np.cos(apart)[some])
    series *= np.exp(1j * np.outer(C * delay[some], wave))
    powers = [np.vander((event[i] - middle) / half, 12) for i in (some, slice(None))]
    fitted = np.linalg.lstsq(powers[0], series)[0]
    assert np.abs(powers[0] @ fitted - series).max() < 1e-7 * np.abs(series).max()
    for k, column in zip(loud, fitted.T, strict=True):
        out += spectrum[k] * (powers[1] @ column) * np.exp(2j * np.pi * k * RATE / size * late)
    return 2.0 / size * (out * gain).real


def test_echoes_of_capsules_do_not_jump_where_their_specular_point_leaves_the_side() -> None:
    """An arm rises past the point where it reflects from its round end: third differences stay those of smooth motion."""
    way = clsim.Trajectory.line((2.8, 1.3, 1.15), (2.8, 1.8, 1.4), 0.5)
    arm = clsim.Scatterer.capsule("arm", 0.05, 0.22, way, shadow=False)
    room = clsim.Shoebox((6.0, 5.0, 2.6), clsim.Material.from_reflection(0.0))
    ends = (clsim.Trajectory.fixed((1.0, 2.5, 1.2)), clsim.Trajectory.fixed((5.0, 2.4, 1.1)))
    scene = scene_of([arm], *ends, room=room)
    pairs, times = clsim.find_paths(scene, 0).families[-1].pairs(), np.arange(0.0, 0.39, 0.25e-3)[:1536]
    pair = next(iter(pairs))
    at = SceneResponse(scene, 0, np.array([40e3]))
    found = np.concatenate(
        [pair.response(pair.arrivals(some), some, at)[0, :, 0] for some in np.array_split(times, 8)]
    )  # many times together: specular points are then wrong by micrometres, as in renders
    assert np.abs(np.diff(found, 3)).max() < 1e-4 * np.abs(found).max()
