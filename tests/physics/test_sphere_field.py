"""The sound about a rigid sphere, direct and scattered, against the sum over its modes at the true distances.

The sum is made here of SciPy's spherical functions, and shares no code with clsim. Errors are relative to the free field:
0.1 dB and 10 µm of path are 1.2 % and, at 80 kHz, 1.5 %.
"""

import itertools
import warnings
from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import eval_legendre, spherical_jn, spherical_yn

import clsim
from clsim.paths.response import QUASI_STATIC, SceneResponse

C, RATE = 343.0, 192e3
AIR = clsim.Air(speed_of_sound=C, absorption=False)
SILENT, MIRROR = (clsim.Material.from_reflection(factor) for factor in (0.0, 1.0))
SIDE = 12.0
MIDDLE = np.full(3, 0.5 * SIDE)
LEAST_GAP = 0.0101  # m, of ends from surfaces


def hankel(n: np.ndarray, x: float, derivative: bool = False) -> np.ndarray:
    return spherical_jn(n, x, derivative) - 1j * spherical_yn(n, x, derivative)


def field(wave: float, radius: float, source: np.ndarray, receiver: np.ndarray) -> tuple[complex, complex]:
    """Return the direct and the scattered pressure of a source of 1 Pa at 1 m, with a sphere at the origin."""
    far = [float(np.linalg.norm(end)) for end in (source, receiver)]
    away, ka = float(np.linalg.norm(receiver - source)), wave * radius
    n = np.arange(int(ka + 6.0 * ka ** (1.0 / 3.0)) + 180)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of modes far beyond those that matter
        modes = (2 * n + 1) * spherical_jn(n, ka, derivative=True) * (hankel(n, wave * far[0]) / hankel(n, ka, True))
        modes = modes * hankel(n, wave * far[1]) * eval_legendre(n, source @ receiver / (far[0] * far[1]))
    return np.exp(-1j * wave * away) / away, 1j * wave * modes[np.isfinite(modes)].sum()


def about(
    radius: float, source: np.ndarray, receiver: clsim.Trajectory, signal: clsim.Signal, **options: str
) -> clsim.Scene:
    """Return a scene with a sphere in the middle of nothing, and a source beside it."""
    ball = clsim.Scatterer.sphere("ball", radius, clsim.Trajectory.fixed(MIDDLE), **options)
    return clsim.Scene(
        clsim.Shoebox((SIDE, SIDE, SIDE), SILENT), AIR,
        [clsim.Source("s", signal, clsim.Trajectory.fixed(MIDDLE + source))], [clsim.Receiver("r", receiver)],
        scatterers=[ball],
    )  # fmt: skip


def heard(paths: clsim.PathSet, frequency: float, times: np.ndarray) -> np.ndarray:
    """Return the sum (T,) of all paths at a frequency."""
    total, at = np.zeros(len(times), dtype=complex), SceneResponse(paths.scene, 0, np.array([frequency]))
    for family in paths.families:
        found = family.arrivals(slice(None), times)
        turn = np.exp(-2j * np.pi * frequency * found.delay)
        total += np.sum(family.response(slice(None), found, times, at)[..., 0] * turn, axis=0)
    return total


def error(radius: float, frequency: float, source: np.ndarray, receiver: np.ndarray, **options: str) -> float:
    """Return the error of the total pressure, relative to the free field."""
    tone = clsim.Signal.tone(frequency, 0.01, 4.0 * frequency)
    paths = clsim.find_paths(about(radius, source, clsim.Trajectory.fixed(MIDDLE + receiver), tone, **options), 0)
    direct, scattered = field(2.0 * np.pi * frequency / C, radius, source, receiver)
    return float(abs(heard(paths, frequency, np.zeros(1))[0] - direct - scattered) / abs(direct))


def ends_at(angle: float, far: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return places of both ends at an angle, rad, and at distances, m, from a sphere at the origin."""
    one, other = np.array([0.6, 0.48, 0.64]), np.array([-0.8, 0.36, 0.48])
    return far[0] * one, far[1] * (np.cos(angle) * one + np.sin(angle) * other)


@pytest.mark.parametrize(("radius", "level"), [(0.3, -8.4), (0.1, 3.0), (0.05, 1.9)])
def test_behind_a_sphere_there_is_its_shadow(radius: float, level: float, measured: Callable[..., float]) -> None:
    """On the axis at 40 kHz, 1.5 m before it and 0.5 m behind; levels by mpmath with 60 digits."""
    source, receiver = np.array([-1.5, 0.0, 0.0]), np.array([0.5, 0.0, 0.0])
    direct, scattered = field(2.0 * np.pi * 40e3 / C, radius, source, receiver)
    assert 20.0 * np.log10(abs(1.0 + scattered / direct)) == pytest.approx(level, abs=0.05)
    error_db = error(radius, 40e3, source, receiver)
    measured("behind spheres of 5, 10 and 30 cm", "sum over modes", error_db, 1e-5, "of the free field")


DISTANCES = {"near": (1.05, 1.05), "near and far": (30.0, 1.05), "far": (8.0, 20.0)}
GRID = list(itertools.product((0.002, 0.02, 0.3), (2e3, 80e3), DISTANCES, (0.0, 1.5, 2.6, np.pi)))


@pytest.mark.parametrize("case", GRID[::7])
def test_all_about_spheres_is_right(case: tuple[float, float, str, float]) -> None:
    """At every angle and distance the sum differs by rounding and by modes that are left out."""
    radius, frequency, distances, angle = case
    check(radius, frequency, angle, DISTANCES[distances])


def check(radius: float, frequency: float, angle: float, far: tuple[float, float]) -> None:
    held = tuple(min(max(d * radius, radius + LEAST_GAP), 5.0) for d in far)
    source, receiver = ends_at(angle, held)
    if np.linalg.norm(source - receiver) < LEAST_GAP:
        source, receiver = ends_at(1.3 * LEAST_GAP / held[0], held)
    assert error(radius, frequency, source, receiver) < 1e-5


@pytest.mark.exhaustive
def test_all_about_drawn_spheres_is_right(rng: np.random.Generator) -> None:
    for case in GRID:
        check(*case[:2], case[3], DISTANCES[case[2]])
    for _ in range(500):
        radius, frequency = 10 ** rng.uniform(np.log10(0.002), np.log10(0.3)), 10 ** rng.uniform(3.3, 4.9)
        near = rng.random(2) < 0.3
        far = np.where(near, 1.05, 1.05 + 10 ** rng.uniform(-2.0, 1.5, 2))
        check(radius, frequency, rng.choice([np.pi, np.pi - 0.02, rng.uniform(0.0, np.pi)]), tuple(far.tolist()))


@pytest.mark.parametrize("radius", [0.02, 0.1])
def test_nothing_jumps_across_the_shadow(radius: float, measured: Callable[..., float]) -> None:
    """From far to touching, and across both boundaries and the axis: each step is that of the exact field."""
    wave, source = 2.0 * np.pi * 40e3 / C, np.array([-0.8, 0.0, 0.0])
    gap = radius + LEAST_GAP
    for begin, end in (((0.4, -2.0 * gap, 0.01), (0.4, 2.0 * gap, 0.01)), ((2.0, 0.0, 1e-4), (gap, 0.0, 1e-4))):
        places = np.linspace(begin, end, 41)
        way = clsim.Trajectory.line(MIDDLE + begin, MIDDLE + end, 40.0)
        scene = about(radius, source, way, clsim.Signal.tone(40e3, 0.01, RATE))
        exact = np.array([sum(field(wave, radius, source, place)) for place in places])
        free = np.linalg.norm(places - source, axis=1)
        family, times = clsim.find_paths(scene, 0), np.arange(41.0)
        found = heard_at_once(family, 40e3, times)
        error = float(np.abs((found - exact) * free).max())
        measured("across the shadow of a sphere, far to touching", "sum over modes", error, 1e-5, "of the free field")


def heard_at_once(paths: clsim.PathSet, frequency: float, times: np.ndarray) -> np.ndarray:
    """Return the sum of all paths where all is where it is at reception: of places, whatever brought things there."""
    total, at = np.zeros(len(times), dtype=complex), SceneResponse(paths.scene, 0, np.array([frequency]))
    for family in paths.families:
        found = family.arrivals(slice(None), times, QUASI_STATIC)
        turn = np.exp(-2j * np.pi * frequency * found.delay)
        total += np.sum(family.response(slice(None), found, times, at)[..., 0] * turn, axis=0)
    return total


@pytest.mark.parametrize("radius", [0.03, pytest.param(0.3, marks=pytest.mark.exhaustive)])
def test_a_receiver_that_walks_through_the_shadow(radius: float, device: None, measured: Callable[..., float]) -> None:
    """A tone, rendered at the default settings: where it rests, the pressure is the exact field at each place."""
    duration, source = 0.12, np.array([-1.5, 0.0, 0.0])
    start, end = np.array([0.5, -2.0 * radius, 0.01]), np.array([0.5 + radius, 0.3 * radius, 0.01])
    signal = clsim.Signal.tone(40e3, duration, RATE, fade=0.01)
    scene = about(radius, source, clsim.Trajectory.line(MIDDLE + start, MIDDLE + end, duration), signal)
    samples = np.arange(round(0.03 * RATE), round(0.11 * RATE), 191)
    times = samples / RATE
    # What is emitted where it rests: A sin or cos, by its samples.
    known = np.arange(round(0.05 * RATE), round(0.05 * RATE) + 480)
    turns = np.exp(2j * np.pi * 40e3 * known / RATE)
    emitted = 2.0 * np.mean(signal.read(int(known[0]), int(known[-1]) + 1) * np.conj(turns))
    places = start + (times / duration)[:, None] * (end - start)
    both = np.array([field(2.0 * np.pi * 40e3 / C, radius, source, place) for place in places])
    exact = (emitted * both.sum(axis=1) * np.exp(2j * np.pi * 40e3 * times)).real
    free = np.abs(emitted * both[:, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error", clsim.ClsimWarning)
        found = clsim.render(clsim.find_paths(scene, 0), RATE, duration=duration).pressure[0, samples]
    error_db = 20.0 * np.log10(np.abs((found - exact) / free).max())
    claim = f"behind a ball of {100 * radius:g} cm that a receiver passes, relative to the free field"
    measured(claim, "the sum over its modes", error_db, -75.0)


def test_what_a_wall_sends_past_a_ball_has_its_shadow() -> None:
    """With a reflection on either leg the ball is met before and after the wall: the field of the source's image."""
    radius, wave = 0.1, 2.0 * np.pi * 40e3 / C
    ends = [np.array([5.0, y, 2.0]) for y in (3.0, 4.2)]
    ball, image = np.array([6.5, 3.93, 2.0]), np.array([11.0, 3.0, 2.0])
    scene = clsim.Scene(
        clsim.Shoebox((8.0, 6.0, 4.0), {"default": SILENT, "x_max": MIRROR}), AIR,
        [clsim.Source("s", clsim.Signal.tone(40e3, 0.01, RATE), clsim.Trajectory.fixed(ends[0]))],
        [clsim.Receiver("r", clsim.Trajectory.fixed(ends[1]))],
        scatterers=[clsim.Scatterer.sphere("ball", radius, clsim.Trajectory.fixed(ball))],
    )  # fmt: skip
    paths, total = clsim.find_paths(scene, 1, scattering_order=1), 0.0
    table = paths.table(np.zeros(1))
    at = SceneResponse(scene, 0, np.array([40e3]))
    names, row = [table.name_objects(i) for i in range(len(paths))], 0
    for family in paths.families:
        found = family.arrivals(slice(None), np.zeros(1))
        response = family.response(slice(None), found, np.zeros(1), at)[:, 0, 0]
        for i in range(len(response)):
            if names[row + i] in ("x_max", "x_max, ball"):
                total += response[i] * np.exp(-2j * np.pi * 40e3 * found.delay[i, 0])
        row += len(response)
    direct, scattered = field(wave, radius, image - ball, ends[1] - ball)
    assert abs(1.0 + scattered / direct) < 10 ** (-8.0 / 20.0)
    assert abs(total - direct - scattered) < 1e-5 * abs(direct)


def test_geometrical_optics_on_the_axis_is_quiet() -> None:
    source, receiver = np.array([-1.5, 0.0, 0.0]), np.array([0.5, 0.0, 0.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = error(0.1, 40e3, source, receiver, model="geometrical")
    _, scattered = field(2.0 * np.pi * 40e3 / C, 0.1, source, receiver)
    assert found == pytest.approx(abs(scattered) * 2.0, rel=1e-9)  # it scatters nothing there


@pytest.mark.parametrize(("begin", "end", "order", "stands"), [
    ((6.5, 3.3, 2.0), (6.5, 3.3, 2.0), 0, True), ((6.5, 3.3, 2.0), (6.5, 3.3, 2.0), 1, False),
    ((7.4, 3.3, 2.0), (7.4, 3.3, 2.0), 0, False), ((6.5, 4.9, 2.0), (6.5, 3.3, 2.0), 0, True),
])  # fmt: skip
def test_echoes_without_shadows_are_told(begin: tuple[float, ...], end: tuple[float, ...], order: int, stands: bool):
    """A wall's echo past a ball was +0.2 dB, not -8.2, with the default `scattering_order` of 0, and nothing said so.

    The ball that moves comes to (6.5, 3.9, 2), where the echo of x_max passes on its way back.
    """
    tone, fixed = clsim.Signal.tone(40e3, 0.1, RATE, fade=0.01), clsim.Trajectory.fixed
    scene = clsim.Scene(
        clsim.Shoebox((8.0, 6.0, 4.0), MIRROR), AIR, [clsim.Source("s", tone, fixed((5.0, 3.0, 2.0)))],
        [clsim.Receiver("r", fixed((5.0, 4.2, 2.0)))],
        scatterers=[clsim.Scatterer.sphere("ball", 0.1, clsim.Trajectory.line(begin, end, 1.0))],
    )  # fmt: skip
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        clsim.find_paths(scene, 1, scattering_order=order)
    words = [str(one.message) for one in caught]
    assert (
        words
        == [
            f"'ball' stands in the way of echoes at {0.0 if begin == end else 0.625:.3g} s and casts no shadow on them: "
            "scattering_order is 0, and echoes of N walls have shadows from N on"
        ]
        * stands
    )
