"""Paths by bodies that move: closed forms, brute force, and what is rendered of them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from scipy.optimize import brentq, minimize
from scipy.special import jv

import clsim
from clsim.paths.legs.events import Events, find_events
from clsim.paths.legs.mirrors import Mirrors
from clsim.paths.propagation import UniformAir
from clsim.scene.motion.trajectory import Trajectory

C = 343.0
HARD = clsim.Material.from_reflection(1.0)
TONE = clsim.Signal.tone(40e3, duration=0.02, sampling_rate=192e3)
FIXED = clsim.Trajectory.fixed
LINE = clsim.Trajectory.line
BIG = np.array([50.0, 50.0, 50.0])  # in the middle of a room that is far away


def sheet(name: str, normal: Sequence[float], height: float, trajectory: Trajectory, size: float = 2.0) -> clsim.Body:
    """Return a square of a side that lies in the plane normal @ x = height of its own coordinates."""
    n = np.array(normal) / np.linalg.norm(normal)
    a = np.cross(n, [0.3, 0.5, 0.9])
    a /= np.linalg.norm(a)
    corners = [height * n + 0.5 * size * (s * a + t * np.cross(n, a)) for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return clsim.Body(name, clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], HARD), trajectory)


def scene_of(
    source: Trajectory, receiver: Trajectory, bodies: Sequence[clsim.Body], signal: clsim.Signal = TONE, **more: Any
) -> clsim.Scene:
    """Return a scene far from the walls of its room."""
    ends = [clsim.Source("s", signal, source)], [clsim.Receiver("r", receiver)]
    air = clsim.Air(speed_of_sound=C, absorption=False, **more)
    return clsim.Scene(clsim.Shoebox(2.0 * BIG, clsim.Material.from_reflection(0.0)), air, *ends, bodies=bodies)


def at(*place: float) -> Any:
    """Return a place from the middle of the room, m."""
    return BIG + np.array(place)


# Images of events of an evenly moving plane, worked out on paper: delay in ms by the speed of the wall.
WAYS = {
    1.0: {(0,): 10.984945, (0, 2): 13.842919, (0, 3): 20.585805, (0, 3, 0): 31.972542, (0, 1): 22.319411},
    -3.0: {(0,): 17.894287, (0, 2): 19.794705, (0, 3): 27.664110, (0, 3, 0): 46.868391, (0, 1): 25.051438},
}


@pytest.mark.parametrize("speed", WAYS)
def test_delays_are_those_of_images_of_events(speed: float) -> None:
    """Sound that is emitted at 0.3 s while source, receiver, a wall and an oblique one move; printed to 0.5 ns."""
    oblique = np.array([-0.9, -0.3, 0.3]) / np.linalg.norm([-0.9, -0.3, 0.3])
    source = LINE(at(0.2, 0.3, 0.9), at(0.45, 0.3, 0.9), 0.5)
    receiver = LINE(at(0.8, -0.4, 0.1), at(0.8, -0.9, 0.1), 0.5)
    away = LINE(BIG, at(0.5 * speed, 0.0, 0.0), 0.5)
    aslant = LINE(BIG, BIG - 0.3 * speed * oblique, 0.5)
    still = FIXED(BIG)
    mirrors = [
        sheet("moving", (1, 0, 0), -1.5, away, 1.0), sheet("oblique", oblique, -2.4, aslant, 1.0),
        sheet("floor", (0, 0, 1), -1.0, still, 1.0), sheet("fixed", (1, 0, 0), 2.5, still, 1.0),
    ]  # fmt: skip
    scene = scene_of(FIXED(BIG + 20.0), FIXED(BIG - 20.0), mirrors)
    for walls, milliseconds in WAYS[speed].items():
        faces, ends = np.array([walls]) + 6, (source, receiver)

        def found(time: float, faces: Any = faces, ends: Any = ends) -> float:
            return float(
                find_events(Mirrors.of(scene.room, scene.bodies), faces, ends, UniformAir(C), np.array([time])).delay[
                    0, 0
                ]
            )

        time = brentq(lambda t, found=found: t - found(t) - 0.3, 0.3, 0.4, xtol=1e-15)
        assert 1e3 * (time - 0.3) == pytest.approx(milliseconds, abs=6e-7)
        slope = (found(time + 1e-5) - found(time - 1e-5)) / 2e-5
        rate = find_events(Mirrors.of(scene.room, scene.bodies), faces, ends, UniformAir(C), np.array([time])).rate[
            0, 0
        ]
        assert rate == pytest.approx(slope, abs=1e-9)


def test_doppler_shifts_are_those_of_a_moving_mirror() -> None:
    """Einstein's 1905 formula for a mirror, (1 + M) / (1 - M) at normal incidence, with the speed of sound."""
    for speed, shift in ((1.0, 233.918), (5.0, 1183.432), (20.0, 4953.560)):
        approaching = LINE(at(6.0, 0, 0), at(6.0 - 0.06 * speed, 0, 0), 0.06)
        scene = scene_of(FIXED(BIG), FIXED(at(0.0, 0.02, 0.0)), [sheet("wall", (1, 0, 0), 0.0, approaching)])
        table = clsim.find_paths(scene, 1).table([0.05])
        row = np.flatnonzero(table.interactions[:, 0] == 3)
        factor = (1.0 + speed / C) / (
            1.0 - speed / C
        )  # 10 mm off the normal over 2 m to 6 m: by up to 1.3e-5 of the shift less
        assert table.doppler_shift[row, 0] == pytest.approx([shift], rel=1.3e-5, abs=1e-3)
        assert 40e3 * (factor - 1.0) == pytest.approx(shift, abs=5e-4)
    # Oblique, as the angle of incidence is in the air at rest.
    moving = LINE(BIG, at(-4.0, 0.0, 0.0), 0.2)
    angle, mach = np.radians(35.0), 20.0 / C
    scene = scene_of(FIXED(BIG - 20.0), FIXED(BIG + 20.0), [sheet("wall", (1, 0, 0), 0.0, moving)])
    ends = FIXED(at(-5.0, 0.0, 0.0)), FIXED(at(-5.0, 7.0, 0.0))
    found = find_events(Mirrors.of(scene.room, scene.bodies), np.array([[6]]), ends, UniformAir(C), np.array([0.1]))
    incidence = found.departure[0, 0] @ [1.0, 0.0, 0.0]
    expected = (1.0 + 2.0 * mach * incidence + mach**2) / (1.0 - mach**2)
    assert 1.0 - found.rate[0, 0] == pytest.approx(expected, rel=1e-12)
    assert (1.0 + 2.0 * mach * np.cos(angle) + mach**2) / (1.0 - mach**2) == pytest.approx(1.1026769187596, abs=1e-13)


def test_doppler_factors_have_ten_digits() -> None:
    """At normal incidence for ends at one place, and at 35 degrees for a receiver where what is reflected goes."""
    for speed, shift in ((1.0, 233.918), (5.0, 1183.432), (20.0, 4953.560)):
        scene = scene_of(FIXED(BIG - 20.0), FIXED(BIG + 20.0), [sheet("wall", (1, 0, 0), 0.0, approaching(6.0, speed))])
        place = FIXED(BIG)
        found = find_events(
            Mirrors.of(scene.room, scene.bodies), np.array([[6]]), (place, place), UniformAir(C), np.array([0.05])
        )
        assert 1.0 - found.rate[0, 0] == pytest.approx((1.0 + speed / C) / (1.0 - speed / C), rel=1e-12)
        assert -40e3 * found.rate[0, 0] == pytest.approx(shift, abs=5.1e-4)
    angle, mach, told = np.radians(35.0), 20.0 / C, 1.1026769187596
    met = 6.0 / (C * np.cos(angle) + 20.0)  # emitted at 0 s in the middle
    hit = C * met * np.array([np.cos(angle), np.sin(angle), 0.0])
    aslant = np.arcsin(np.sin(angle) / told)  # along the mirror slownesses are as before
    ear = FIXED(BIG + hit + 4.0 * np.array([-np.cos(aslant), np.sin(aslant), 0.0]))
    scene = scene_of(FIXED(BIG - 20.0), FIXED(BIG + 20.0), [sheet("wall", (1, 0, 0), 0.0, approaching(6.0, 20.0))])
    heard = np.array([met + 4.0 / C])
    found = find_events(Mirrors.of(scene.room, scene.bodies), np.array([[6]]), (FIXED(BIG), ear), UniformAir(C), heard)
    assert found.delay[0, 0] == pytest.approx(heard[0], abs=1e-13)
    assert 1.0 - found.rate[0, 0] == pytest.approx(
        (1.0 + 2.0 * mach * np.cos(angle) + mach**2) / (1.0 - mach**2), rel=1e-12
    )
    assert 1.0 - found.rate[0, 0] == pytest.approx(told, abs=1e-12)


def approaching(away: float, speed: float) -> Trajectory:
    """Return a way from so far, m, towards the middle at a speed, m/s."""
    return LINE(at(away, 0, 0), at(away - 0.1 * speed, 0, 0), 0.1)


def test_bodies_at_rest_are_walls() -> None:
    """A body that never moves gives the paths of the same room with it as a wall."""
    material = clsim.Material.from_porous(20e3, 0.05)
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.8))
    corners = np.array([(1.5, 1.0, 0.4), (1.5, 2.0, 0.4), (1.7, 2.0, 1.9), (1.7, 1.0, 1.9)])
    mesh = clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], material)
    ends = (
        [clsim.Source("s", TONE, LINE((0.7, 1.2, 1.1), (0.9, 1.3, 1.0), 0.1))],
        [clsim.Receiver("r", FIXED((3.1, 1.9, 1.2))), clsim.Receiver("near", FIXED((0.6, 1.6, 1.3)))],
    )
    turned = np.array([0.0, 0.0, np.sin(0.2), np.cos(0.2)])
    pose = FIXED((0.1, -0.2, 0.3), turned)
    own = clsim.MeshRoom(
        clsim.Body("other", mesh, pose).seen(mesh.vertices, np.zeros(len(mesh.vertices))), mesh.triangles, material
    )
    with_wall = clsim.Scene(clsim.MeshRoom.joined([room, mesh]), clsim.Air(speed_of_sound=C), *ends)
    with_body = clsim.Scene(room, clsim.Air(speed_of_sound=C), *ends, bodies=[clsim.Body("screen", own, pose)])
    times = np.array([0.02, 0.05])
    one, other = (clsim.find_paths(scene, 2).table(times) for scene in (with_wall, with_body))

    def rows(table: clsim.PathTable) -> Any:
        found = [
            (table.receiver[p], table.delay[p, i], table.doppler_factor[p, i], table.gain[p, i])
            for p, i in zip(*np.nonzero(np.isfinite(table.delay)), strict=True)
        ]
        return np.array(sorted(found, key=lambda row: (row[0], row[1].real)))

    assert rows(one).shape == rows(other).shape
    assert np.abs(rows(one) - rows(other)).max() < 1e-12
    assert np.any(other.interactions == 3)


def fermat(
    places: Sequence[Callable[[Any, float], Any]], source: Any, receiver: Callable[[float], Any], start: Any
) -> float:
    """Return when what is emitted at 0 s arrives, as the earliest way over points of surfaces that move, s.

    Each surface gives where its point (u, v) is at a time.
    """

    def arrival(points: Any) -> float:
        time, where = 0.0, source
        for place, point in zip([*places, lambda _, t: receiver(t)], [*points.reshape(-1, 2), None], strict=True):
            flight = 0.0
            for _ in range(60):
                step = np.linalg.norm(place(point, time + flight) - where) / C - flight
                flight += step
                if abs(step) < 1e-15:
                    break
            time += flight
            where = place(point, time)
        return C * time

    found = minimize(arrival, start, method="BFGS", options={"gtol": 1e-6})
    return float(found.fun) / C


def test_ten_drawn_ways_are_the_earliest(rng: np.random.Generator) -> None:
    """Up to three mirrors at rest, sliding and swinging, against the earliest arrival over all points of all of them."""
    steady = 0
    for _ in range(10):
        normals = [np.array([np.cos(a), np.sin(a), 0.2]) for a in (0.3, 2.4, 4.5) + 0.3 * rng.standard_normal(3)]
        hinge = rng.standard_normal(3)
        bodies = [
            sheet("rest", normals[0], 3.0 + rng.random(), FIXED(BIG)),
            sheet("slide", normals[1], 3.0 + rng.random(), LINE(BIG, BIG + 0.4 * rng.standard_normal(3), 0.2)),
            sheet("swing", normals[2], 3.0 + rng.random(),
                  clsim.Trajectory.swing(BIG, hinge, rng.uniform(-1, 1) * np.array([0.0, 0.1, 0.2]), [0.0, 0.1, 0.2])),
        ]  # fmt: skip
        scene = scene_of(FIXED(at(0, 0, 20.0)), FIXED(at(0, 0, -20.0)), bodies)
        source, receiver = BIG + rng.uniform(-1, 1, 3), LINE(BIG + rng.uniform(-1, 1, 3), BIG, 0.2)
        order = rng.integers(1, 4)
        walls = [int(rng.integers(3))]
        while len(walls) < order:
            walls.append(int((walls[-1] + rng.integers(1, 3)) % 3))
        ends, faces = (FIXED(source), receiver), np.array([walls]) + 6
        flat = Mirrors.of(scene.room, scene.bodies)

        def found(time: float, flat: Mirrors = flat, faces: Any = faces, ends: Any = ends) -> Events:
            return find_events(flat, faces, ends, UniformAir(C), np.array([time]))

        when = brentq(lambda t: t - found(t).delay[0, 0], 1e-3, 0.15, xtol=1e-16)

        def place(body: clsim.Body) -> Callable[[Any, float], Any]:
            corner, along, across = (body.mesh.vertices[i] for i in (0, 1, 3))
            return lambda uv, t: body.placed(corner + uv[0] * (along - corner) + uv[1] * (across - corner), np.array(t))

        met = [place(bodies[w]) for w in walls]
        exact = fermat(met, source, receiver.position, np.full(2 * len(walls), 0.5))
        assert C * abs(when - exact) < 1e-7, walls
        steady += walls == [0]
    assert steady < 5


def test_everything_that_moves_is_wind() -> None:
    """Ends and mirrors that all move with u in still air hear what rests in wind of -u."""
    u = np.array([6.0, -3.0, 1.0])
    normals, heights = ((1.0, 0.2, 0.1), (1.0, 0.25, 0.0)), (2.0, -1.5)
    moved = [sheet(str(h), n, h, LINE(BIG, BIG + 0.06 * u, 0.06)) for n, h in zip(normals, heights, strict=True)]
    still = [sheet(str(h), n, h, FIXED(BIG)) for n, h in zip(normals, heights, strict=True)]
    ends = [at(0.3, 0.2, 0.5), at(-0.4, -0.3, 0.1)]
    one = scene_of(*(LINE(x, x + 0.06 * u, 0.06) for x in ends), moved)
    other = scene_of(*(FIXED(x) for x in ends), still, wind=tuple(-u))
    paths = [clsim.find_paths(scene, 2).families[-1] for scene in (one, other)]
    found = [family.arrivals(np.arange(len(family)), np.array([0.03])) for family in paths]
    assert paths[0].order.tolist() == paths[1].order.tolist()
    assert len(paths[0]) >= 3
    for name in ("delay", "delay_rate", "departure", "arrival"):
        assert getattr(found[0], name) == pytest.approx(getattr(found[1], name), abs=1e-13)
    pressures = [arrival.mach_factor / arrival.length for arrival in found]
    assert pressures[0] == pytest.approx(pressures[1], rel=1e-12)


def swinging(signal: clsim.Signal, speed: float = 1.0) -> clsim.Scene:
    """Return a door that swings at a speed, rad/s, and sends sound back to where it is from; nothing else is heard."""
    end = speed * signal.duration
    hinge = clsim.Trajectory.swing(at(1.0, -0.5, 0.0), (0, 0, 1), [0.0, 0.5 * end, end], np.linspace(0, end / speed, 3))
    door = clsim.Body.box("door", (0.0, 1.0, 2.0), HARD, hinge, centre=(0.0, 0.5, 0.0))
    return scene_of(FIXED(at(0.0, 0.0, 0.0)), FIXED(at(0.0, 0.1, 0.0)), [door], signal)


def door_answer(scene: clsim.Scene, times: Any) -> tuple[Any, Any]:
    """Return delay, s, and gain of what a hinged mirror sends back, from the way over any of its points, to 1e-12 m.

    At an emission the ways over points u along the door, at the height of both ends, arrive the earliest at one: there
    Newton's method ends. The image of the source is as far as the plane's speed there, V, says: ``d = c (delay - t_i)``.
    """
    (door,), x, y = scene.bodies, BIG, at(0.0, 0.1, 0.0)
    omega = float(door.trajectory.angular_velocity(0.0)[2])

    def way(emission: Any, u: Any) -> tuple[Any, Any, Any]:
        hit = emission
        for _ in range(9):
            place = door.placed(u[:, None] * [0.0, 1.0, 0.0], hit)
            hit = emission + np.linalg.norm(place - x, axis=1) / C
        return hit + np.linalg.norm(place - y, axis=1) / C, hit, place

    def earliest(emission: Any) -> Any:
        u, h = np.full(len(emission), 0.5), 1e-3
        for _ in range(4):
            early, here, late = (way(emission, u + s * h)[0] for s in (-1, 0, 1))
            u = u - 0.5 * h * (late - early) / (late - 2.0 * here + early)
        return u

    emission, heard = times - 0.006, np.full(len(times), np.inf)
    for _ in range(6):
        u = earliest(emission)
        heard, hit, place = way(emission, u)
        emission = emission + times - heard
    step = 1e-4
    stretch = way(emission + step, earliest(emission + step))[0] - way(emission - step, earliest(emission - step))[0]
    angle = omega * hit
    normal = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    speed = omega * u * -1.0
    before = np.linalg.norm(place - x, axis=1)
    height = np.sum(normal * (x - place), axis=1) + speed * (hit - emission)
    late = -2.0 * height * speed / (C**2 - speed**2)
    assert before.min() > 0.5
    return times - emission, 1.0 / (C * (times - emission - late) * stretch / (2.0 * step))


@pytest.mark.parametrize("kind", few(["chirp", "tone"]))
def test_what_a_door_sends_back_is_exact(kind: str, engine: str, once: Any, measured: Callable[..., float]) -> None:
    """At 1 rad/s, at default settings: within -80 dB of the answer that changes with time."""
    if kind == "tone":
        signal = clsim.Signal.tone(40e3, duration=0.1, sampling_rate=192e3, fade=0.01)
        emitted: Callable[[Any], Any] = lambda t: np.sin(2 * np.pi * 40e3 * t)  # noqa: E731
    else:
        signal = clsim.Signal.chirp(25e3, 55e3, duration=0.1, sampling_rate=192e3, window="tukey")
        emitted = lambda t: np.sin(2 * np.pi * (25e3 * t + 0.5 * 30e3 / 0.1 * t**2))  # noqa: E731
    scene = swinging(signal)
    paths = clsim.find_paths(scene, 1, direct=False)
    assert (len(paths.families[-1]), paths.object_names[-1]) == (1, "door")
    heard = clsim.render(paths, sampling_rate=192e3, engine=engine).samples[0]
    some = np.arange(int(0.025 * 192e3), int(0.085 * 192e3), 29)
    delay, gain = once("what a door sends back", lambda: door_answer(scene, some / 192e3))
    expected = gain * emitted(some / 192e3 - delay)
    error_db = 20.0 * np.log10(np.linalg.norm(heard[some] - expected) / np.linalg.norm(expected))
    measured("what a swinging door sends back", "earliest way over its points", error_db, -80.0)


def test_a_vibrating_plate_has_sidebands_of_bessel_functions() -> None:
    """0.5 mm at 50 Hz, normal incidence, 40 kHz: lines J_m(2 k A), rendered, to 0.05 dB, of complex baseband."""
    amplitude, frequency = 0.5e-3, 50.0
    signal = clsim.Signal.tone(40e3, duration=0.3, sampling_rate=192e3, fade=0.02)
    shake = clsim.Trajectory.sampled(
        lambda t: at(1.0, 0.0, 0.0) + amplitude * np.sin(2 * np.pi * frequency * t)[:, None] * np.eye(3)[0], 0.3, 5e3
    )
    plate = clsim.Body.box("plate", (0.0, 0.5, 0.5), HARD, shake)
    scene = scene_of(FIXED(BIG), FIXED(at(0.0, 0.011, 0.0)), [plate], signal)
    paths = clsim.find_paths(scene, 1, direct=False)
    envelope = clsim.render(paths, sampling_rate=192e3, baseband=(40e3, 4e3)).samples[0]
    rate = len(envelope) / 0.3
    some = envelope[int(0.05 * rate) : int(0.05 * rate) + int(0.2 * rate)]  # ten periods of the plate
    lines = np.abs(np.fft.fft(some * np.exp(0j)) / len(some))
    modulation = 2.0 * 2.0 * np.pi * 40e3 / C * amplitude
    assert modulation == pytest.approx(0.733, abs=5e-4)
    for m in (1, 2):
        both = np.array([lines[10 * m], lines[-10 * m]])
        level = 20.0 * np.log10(both / lines[0])
        assert level == pytest.approx(20.0 * np.log10(jv(m, modulation) / jv(0, modulation)), abs=0.05)
