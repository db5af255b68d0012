"""The delay equation: both solvers, and the bounds that engines and pruning rest on, in air that rests and that moves."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.paths.propagation import SpeedRange, UniformAir, arrivals_by, contract_delay, straight
from clsim.paths.response import RETARDED, Arrivals

C, WIND = 340.0, (30.0, -8.0, 5.0)
FLYING = clsim.Trajectory.circle((0.0, 0.0, 1.0), 2.0, 0.25, 1.0)  # 50 m/s
FALLING = clsim.Trajectory.line((9.0, 8.0, 6.0), (9.5, 8.0, 1.0), 1.0)


@pytest.fixture(params=[None, WIND], ids=["still", "windy"])
def air(request: pytest.FixtureRequest) -> UniformAir:
    return UniformAir(C, request.param)


@dataclass(frozen=True)
class To:
    """Straight ways to places (P, T, 3)."""

    stop: np.ndarray

    def leave(self, p: Any, t: Any, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return straight(start, self.stop[p, t])

    def arrive(self, start: np.ndarray) -> np.ndarray:
        return straight(start, self.stop)[1]

    def bends(self, p: Any, t: Any, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise AssertionError("the air is the same everywhere")

    def seen(self) -> np.ndarray:
        return self.stop


def to_places(heard_at: np.ndarray) -> To:
    return To(heard_at[None])


def brought(air: UniformAir, receiver: clsim.Trajectory, times: np.ndarray) -> Arrivals:
    return arrivals_by(to_places, air, (FLYING, receiver), times, RETARDED)


def test_both_solvers_meet_where_the_equation_holds(air: UniformAir) -> None:
    """In the air's own frame sound goes at c from where it was emitted, whatever the wind."""
    times = np.linspace(0.3, 0.9, 9)
    delay = brought(air, FALLING, times).delay[0]
    heard_at = FALLING.position(times)
    flown = heard_at - FLYING.position(times - delay) - delay[:, None] * np.array(air.wind or (0.0, 0.0, 0.0))
    np.testing.assert_allclose(np.linalg.norm(flown, axis=1), C * delay, rtol=1e-14)
    np.testing.assert_allclose(contract_delay(air, FLYING.position, heard_at, heard_at, times), delay, atol=1e-12)


def test_what_is_brought_is_that_of_still_air_in_which_all_moves() -> None:
    """Delay, Doppler factor, directions and gain of the direct sound, to rounding; ends seen from the wind."""
    times, wind = np.linspace(0.3, 0.9, 9), np.array(WIND)

    class Seen:
        def __init__(self, motion: clsim.Trajectory) -> None:
            self.motion, self.end = motion, 1.0

        def position(self, time: np.ndarray) -> np.ndarray:
            return self.motion.position(time) - time[:, None] * wind

        def velocity(self, time: np.ndarray) -> np.ndarray:
            return self.motion.velocity(time) - wind

    source, receiver = Seen(FLYING), Seen(FALLING)
    still = arrivals_by(to_places, UniformAir(C), (source, receiver), times, RETARDED)
    windy = brought(UniformAir(C, WIND), FALLING, times)
    for name in ("delay", "departure", "arrival", "through"):
        np.testing.assert_allclose(getattr(windy, name), getattr(still, name), rtol=1e-12, err_msg=name)
    np.testing.assert_allclose(1.0 - windy.delay_rate, 1.0 - still.delay_rate, rtol=1e-12)
    np.testing.assert_allclose(windy.mach_factor / windy.length, still.mach_factor / still.length, rtol=1e-12)


def test_rates_are_the_derivatives_of_delays(air: UniformAir) -> None:
    times, step = np.linspace(0.3, 0.9, 9), 1e-5
    before, now, after = (brought(air, FALLING, times + h) for h in (-step, 0.0, step))
    np.testing.assert_allclose(now.delay_rate, (after.delay - before.delay) / (2.0 * step), atol=3e-9)


def test_bounds_hold_and_are_close(air: UniformAir) -> None:
    times = np.linspace(0.4, 0.6, 201)
    place = clsim.Trajectory.fixed((12.0, 30.0, 5.0))
    delay = brought(air, place, times).delay[0]
    speed = 16.0 * np.pi
    assert np.linalg.norm(FLYING.velocity(times), axis=1).max() == pytest.approx(speed)
    length = np.linalg.norm(FLYING.position(np.array([0.5])) - place.position(np.zeros(1)), axis=1)
    bounds = SpeedRange(air.slowest, air.fastest, air.fluctuation)
    low, high = bounds.delay_bounds(length, 0.1 * speed, speed)
    assert low[0] <= delay.min()
    assert delay.max() <= high[0]
    wind = 0.0 if air.wind is None else np.linalg.norm(WIND)
    assert high[0] - low[0] < 0.2 * speed / (C - wind) + 2.5 * length[0] * (speed + wind) / (C - wind - speed) ** 2 * 2
    assert np.abs(np.diff(delay)).max() / 1e-3 <= bounds.max_delay_rate(speed, 0.0)


def test_two_ways_cancel_a_wind_to_first_order() -> None:
    """There and back is late by d w² / c³ along the wind, of what one way is by d w / c²."""
    a, b, air = np.zeros((1, 3)), np.array([[5.0, 0.0, 0.0]]), UniformAir(343.0, (0.3, 0.0, 0.0))
    there, back, still = (
        m.passage(np.array([5.0]), apart).time[0] for m, apart in ((air, b - a), (air, a - b), (UniformAir(343.0), b))
    )
    assert there == pytest.approx(5.0 / 343.3, rel=1e-15)
    assert 343.0 * (there - still) == pytest.approx(-4.37e-3, abs=5e-6)
    assert 343.0 * (there + back - 2.0 * still) == pytest.approx(10.0 * (0.3 / 343.0) ** 2, rel=1e-5)
