"""The delay equation: both solvers, and the bounds that engines and pruning rest on."""

import numpy as np
import pytest

import clsim
from clsim.paths.propagation import StillAir, contract_delay, delay_bounds, max_delay_rate, refine_delay, solve_delay

C = 340.0
AIR = StillAir(C)
FLYING = clsim.Trajectory.circle((0.0, 0.0, 1.0), 2.0, 0.25, 1.0)  # 50 m/s


def test_both_solvers_meet_where_the_equation_holds(rng: np.random.Generator) -> None:
    stop, times = rng.uniform(5.0, 40.0, (6, 9, 3)), np.linspace(0.3, 0.9, 9)
    delay = solve_delay(AIR, FLYING, stop, times)
    emitted_at = FLYING.position((times - delay).ravel()).reshape(stop.shape)
    np.testing.assert_allclose(AIR.travel_time(emitted_at, stop), delay, atol=4e-16)
    flat = contract_delay(AIR, FLYING.position, stop.reshape(-1, 3), np.tile(times, 6))
    np.testing.assert_allclose(flat, delay.ravel(), atol=1e-12)


def test_a_way_of_two_legs_is_solved_alike(rng: np.random.Generator) -> None:
    """By a place at rest: the second leg only makes the sound late."""
    by, stop, times = np.array([9.0, 1.0, 2.0]), np.array([3.0, 8.0, 1.0]), np.linspace(0.3, 0.9, 5)

    def travel(p: np.ndarray, t: np.ndarray, emission_time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        first = AIR.leg(FLYING.position(emission_time), by)
        return first.time + AIR.travel_time(by, stop), first.mach_at_departure(FLYING.velocity(emission_time))

    delay = refine_delay(travel, np.zeros((1, 5)), times)[0]
    later = AIR.travel_time(by, stop)
    single = solve_delay(AIR, FLYING, np.broadcast_to(by, (1, 5, 3)), times - later)[0]
    np.testing.assert_allclose(delay, single + later, atol=1e-15)


def test_derivatives_of_a_leg_are_those_of_its_time(rng: np.random.Generator) -> None:
    start, stop, velocity = (rng.normal(size=(20, 3)) for _ in range(3))
    leg, h = AIR.leg(start, stop), 1e-6
    by_start = (AIR.travel_time(start + h * velocity, stop) - AIR.travel_time(start - h * velocity, stop)) / (2 * h)
    by_stop = (AIR.travel_time(start, stop + h * velocity) - AIR.travel_time(start, stop - h * velocity)) / (2 * h)
    np.testing.assert_allclose(leg.mach_at_departure(velocity), -by_start, atol=1e-10)
    np.testing.assert_allclose(leg.mach_at_arrival(velocity), by_stop, atol=1e-10)


def test_bounds_hold_and_are_close(rng: np.random.Generator) -> None:
    place, times = rng.uniform(5.0, 40.0, 3), np.linspace(0.4, 0.6, 201)
    delay = solve_delay(AIR, FLYING, np.broadcast_to(place, (1, 201, 3)), times)[0]
    speed = 16.0 * np.pi
    assert np.linalg.norm(FLYING.velocity(times), axis=1).max() == pytest.approx(speed)
    length = np.linalg.norm(FLYING.position(np.array([0.5])) - place, axis=1)
    low, high = delay_bounds(AIR, length, 0.1 * speed, speed)
    assert low[0] <= delay.min()
    assert delay.max() <= high[0]
    assert high[0] - low[0] < 0.2 * speed / C + 0.4 * length[0] / C
    assert np.abs(np.diff(delay)).max() / 1e-3 <= max_delay_rate(AIR, speed, 0.0)
