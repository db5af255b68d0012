"""Responses by frequency along moving paths, against a sum over the spectrum that shares no code with the engines."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import spectral_sums

import clsim
from clsim.render.methods.per_sample import ReferenceEngine
from clsim.render.planning import plan_render
from clsim.render.render import record

RATE, C = 192e3, 343.0
AIR = clsim.Air(speed_of_sound=C, relative_humidity=0.4)
TABLE = np.linspace(10e3, 90e3, 81)


def approach(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distance at emission and delay of a source that comes from 11 m at 2 m/s towards the origin."""
    # d = 11 - 2 (t - d / c)
    distance = (11.0 - 2.0 * t) / (1.0 - 2.0 / C)
    return distance, distance / C


@cache
def received(chirp: clsim.Signal) -> np.ndarray:
    """Return the received samples of an approaching source within WINDOW."""
    times = np.arange(WINDOW.start, WINDOW.stop) / RATE
    distance, delay = approach(times)
    assert np.all((times - delay > -2e-3) & (times - delay < chirp.duration + 2e-3))  # the sum is periodic

    def response(f: float) -> np.ndarray:
        return (10 ** (-AIR.absorption_at(f) * (distance - 1.0) / 20) / (distance * (1.0 - 2.0 / C)))[None]

    return spectral_sums.heard(chirp, (times - delay)[None], response, margin=2e-3)


CHIRP = clsim.Signal.chirp(20e3, 80e3, 0.04, RATE, window="tukey")
WINDOW = slice(round(0.034 * RATE), round(0.069 * RATE))


def test_a_chirp_over_ten_metres(engine: str, measured) -> None:
    way = clsim.Trajectory.line((13.0, 2, 2), (11.0, 2, 2), 1.0)
    room = clsim.Shoebox((20, 4, 4), clsim.Material.from_reflection(0.0))
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((2.0, 2, 2)))]
    scene = clsim.Scene(room, AIR, [clsim.Source("s", CHIRP, way)], ears)
    made = clsim.render(clsim.find_paths(scene, 0), RATE, engine=engine, duration=0.08).pressure[0]
    got, wanted = made[WINDOW], received(CHIRP)
    found = 20 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted))
    measured("responses by frequency over 10 m", "sum over the spectrum", found, -75.0)
    # The air alone tilts the spectrum: at one frequency for all the error would be gross.
    flat = clsim.render(clsim.find_paths(scene, 0), RATE, engine=engine, duration=0.08, responses="centre")
    assert np.linalg.norm(flat.pressure[0][len(made) // 2 :] - made[len(made) // 2 :]) > 0.1 * np.linalg.norm(
        made[len(made) // 2 :]
    )
    # The peak of the correlation does not move: parabola through its top.
    correlation = np.correlate(got.astype(float), wanted, "full")
    top = int(np.argmax(correlation))
    a, b, c = correlation[top - 1 : top + 2]
    assert top == len(wanted) - 1
    assert abs(0.5 * (a - c) / (a - 2 * b + c)) < 0.01


def walls() -> list[clsim.Material]:
    """Return six walls, five of which depend on frequency."""
    factors = [
        0.97 + 0.0 * TABLE, 0.98 - 0.2 * TABLE / 80e3, 0.97 * np.exp(-2 * (2 * np.pi * TABLE / C * 0.4e-3) ** 2),
        0.8 + 0.1 * np.cos(2 * np.pi * TABLE / 60e3), 0.95 - 0.3 * np.exp(-(((TABLE - 45e3) / 15e3) ** 2)),
        np.sqrt(0.9 - 0.3 * TABLE / 80e3),
    ]  # fmt: skip
    return [clsim.Material.from_absorption(TABLE, 1.0 - f**2) for f in factors]


def room_scene(low: float, high: float, beam: bool = True) -> clsim.Scene:
    chirp = clsim.Signal.chirp(low, high, 0.02, RATE, window="hann")
    way = clsim.Trajectory.sampled(
        lambda t: np.stack([4 + np.cos(2 * t), 3 + np.sin(2 * t), 1.5 + 0 * t], 1), 0.3, 500.0
    )
    source = clsim.Source(
        "s", chirp, way, clsim.Piston(0.0047) if beam else clsim.Omni(), aim=(1, 0.4, 0.2) if beam else None
    )
    ears = [clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 1.2, 2.5)))]
    return clsim.Scene(clsim.Shoebox((8, 6, 3), walls()), AIR, [source], ears)


def test_walls_and_a_beam_in_a_room(engine: str, once: Callable[..., Any], measured) -> None:
    scene = room_scene(25e3, 55e3)
    paths = clsim.find_paths(scene, 2)
    made = clsim.render(paths, RATE, engine=engine, duration=0.06).pressure[0]
    window = slice(round(0.012 * RATE), round(0.05 * RATE))
    times = np.arange(window.start, window.stop, 31) / RATE
    wanted = once("walls and a beam in a room", lambda: walls_and_a_beam(scene, paths, times))
    got = made[window][::31]
    found = 20 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted))
    measured("walls and a beam by frequency", "sum over the spectrum", found, -75.0)


def walls_and_a_beam(scene: clsim.Scene, paths: clsim.PathSet, times: np.ndarray) -> np.ndarray:
    """Return the pressure at times, a sum over the spectrum."""
    table = paths.table(times)
    materials, distance = walls(), table.delay * C
    cosine = np.clip(table.departure @ (np.array([1, 0.4, 0.2]) / np.linalg.norm([1, 0.4, 0.2])), -1, 1)
    centre = scene.sources[0].signal.centre_frequency

    def by_hand(f: float) -> np.ndarray:
        of_wall = np.array([*(m.reflection_at(f) for m in materials), 1.0])  # -1 is no wall
        beam = clsim.Piston(0.0047).gain(cosine, f, C)
        return (
            of_wall[paths.walls].prod(axis=1)[:, None]
            * beam
            * 10 ** (-AIR.absorption_at(f) * (distance - 1) / 20)
            / distance
        )

    stretch = table.gain / by_hand(centre)  # the Mach factor, the same at all frequencies
    return spectral_sums.heard(
        scene.sources[0].signal, times - table.delay, lambda f: by_hand(f) * stretch, margin=2e-3
    )


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(("low", "high", "most"), [(39e3, 41e3, 3), (30e3, 50e3, 6), (20e3, 80e3, 10)])
def test_order_six_needs_few_functions(low: float, high: float, most: int) -> None:
    scene = room_scene(low, high)
    paths = clsim.find_paths(scene, 6)
    plan = plan_render(paths, RATE, duration=0.05)
    basis = plan.source_filters[0].basis
    assert 1 < len(basis) <= most
    assert basis.error_db < -80.0
    # Of paths and times that were not looked at: the same bound, for what a response is at any frequency of the band.
    tracks, rng = plan.tracks, np.random.default_rng(5)
    from clsim.numerics.band_filters import chebyshev_points
    from clsim.paths.response import SceneResponse

    # The chirp's spectrum fades towards the ends of its band, and so does what is asked there.
    times, f = rng.uniform(0.0, 0.05, 7), chebyshev_points(low + 0.15 * (high - low), high - 0.15 * (high - low), 40)
    pair = tracks.pair_paths[0]
    found = pair.arrivals(times)
    true = pair.response(found, times, SceneResponse(scene, 0, f))
    gains = basis.gains(pair.response(found, times, SceneResponse(scene, 0, basis.nodes)))
    half = basis.half
    shapes = np.real(basis.filters @ np.exp(-2j * np.pi * np.outer(np.arange(-half, half + 1), f) / RATE))
    wrong = np.sqrt(np.mean((gains @ shapes - true) ** 2, axis=2)) / np.abs(true).max()
    assert wrong.max() < 10 ** (-78 / 20)


@pytest.mark.usefixtures("device")
def test_engines_agree_over_a_band() -> None:
    scene = room_scene(25e3, 60e3)
    paths = clsim.find_paths(scene, 6)
    plan = plan_render(paths, RATE, duration=0.034)
    fast = record(plan).pressure[:, 5500:]
    slow = ReferenceEngine(plan).render(5500, plan.samples)  # all paths are in
    assert np.linalg.norm(fast - slow) < 10 ** (-80 / 20) * np.linalg.norm(slow)


def test_narrow_signals_need_few_functions() -> None:
    tone = clsim.Signal.tone(40e3, 0.2, RATE, fade=0.02)
    scene = room_scene(20e3, 80e3)
    source = clsim.Source("s", tone, scene.sources[0].trajectory, clsim.Piston(0.0047), aim=(1, 0.4, 0.2))
    one = clsim.Scene(scene.room, AIR, [source], scene.receivers)
    plan = plan_render(clsim.find_paths(one, 3), RATE, duration=0.1)
    assert len(plan.source_filters[0].basis) <= 3
    assert any("functions of frequency" in line for line in plan.describe())


def test_bounds_that_are_none_are_refused() -> None:
    scene = room_scene(39e3, 41e3)
    paths = clsim.find_paths(scene, 0)
    for value in (0.0, -200.0, float("nan"), "fine"):
        with pytest.raises(clsim.InputError, match="response_error_db: must be"):
            plan_render(paths, RATE, response_error_db=value)  # type: ignore[arg-type]
