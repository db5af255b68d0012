"""Derivatives where ends move, at the centre frequency and at bounds, and errors of what has none."""

from typing import Any

import numpy as np
import pytest
from exhaustive import few

import clsim
from clsim.render.options import RenderOptions
from clsim.sensitivity.linear_map import plan_of, received

RATE = 96e3
CHIRP = clsim.Signal.chirp(3e3, 12e3, 0.015, sampling_rate=RATE, fade=0.004)
NARROW = clsim.Signal.chirp(7.3e3, 8.7e3, 0.03, sampling_rate=RATE, fade=0.005)
FIXED = clsim.Trajectory.fixed
GAIN, CLOCK, PLACE = "sources[0].gain_db", "receivers[0].electronics.clock_ppm", "receivers[0].position"


def paths(
    x: float = 3.2, speed: float = 0.0, ears: bool = False, turning: float = 0.0, signal: Any = CHIRP, **air: Any
) -> Any:
    """Return the direct path, or that to two ears, from a source at rest or on a line."""
    times, turns = np.linspace(0.0, 1.0, 5), 0.5 * turning * np.linspace(0.0, 1.0, 5)
    turned = np.stack([0.0 * turns, 0.0 * turns, np.sin(turns), np.cos(turns)], axis=1)
    head = clsim.Trajectory.waypoints(times, np.tile([x, 2.9, 1.8], (5, 1)), orientations=turned)
    here, there = (1.3, 1.1, 1.2), (1.3 + speed, 1.1, 1.2)
    way = clsim.Trajectory.line(here, there, 1.0) if speed else FIXED(here)
    end = (
        clsim.Receiver.binaural("r", head if turning else FIXED((x, 2.9, 1.8)))
        if ears
        else clsim.Receiver("r", FIXED((x, 2.9, 1.8)))
    )
    room = clsim.Shoebox((15.0, 4.0, 3.0), clsim.Material.from_reflection(0.7))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(**air), [clsim.Source("s", signal, way)], [end]), 0)


def far(found: Any, wanted: Any) -> float:
    """Return the distance of signals, relative to one."""
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def test_the_delays_derivative_acts_on_the_signals_own_at_the_centre_frequency() -> None:
    """A tone at the centre in place of the chirp is 26 % off."""
    options: dict[str, Any] = {
        "duration": 0.04, "responses": "centre", "interpolator": clsim.Bandlimited(error_db=-110.0),
    }  # fmt: skip
    found = clsim.sensitivities(paths(), [PLACE], RATE, **options).jacobian[0]
    ahead, behind = (clsim.render(paths(3.2 + h), RATE, engine="reference", **options).pressure for h in (1e-4, -1e-4))
    wanted = (ahead.astype(float) - behind) / 2e-4
    assert far(found, wanted) <= 3e-4  # float32 samples of the recording over the step leave 2e-4
    back = clsim.gradient(paths(), found, [PLACE], RATE, **options)[PLACE][0]
    assert back == pytest.approx(np.sum(found**2), rel=1e-5)


@pytest.mark.parametrize(("speed", "turning"), few([(10.0, 0.0), (1.0, 0.0), (0.0, 2.0)]))
def test_what_ears_filter_by_gain(speed: float, turning: float, engine: str) -> None:
    """By a gain it is the recording itself, as it is by the emitted signal: at emitted frequencies 7.5e-4 off at 1 m/s."""
    passing, options = paths(speed=speed, ears=True, turning=turning), {"duration": 0.03, "engine": engine}
    found = clsim.sensitivities(passing, [GAIN], RATE, **options).jacobian[0]
    wanted = clsim.render(passing, RATE, **options).pressure
    allowed = 3e-5 + 1e-5 * speed
    assert far(found * 20.0 / np.log(10.0), wanted) <= allowed
    if engine == "reference":
        back = clsim.gradient(passing, wanted, ["sources[0].signal"], RATE)["sources[0].signal"]
        assert back @ CHIRP.read(0, CHIRP.count) == pytest.approx(np.sum(wanted.astype(float) ** 2), rel=allowed)


def test_a_clock_alone_in_baseband() -> None:
    """Its effect begins with nothing at time 0, and the error of the first block, of 40 ms, does not: 9e-2."""
    passing, options = paths(speed=5.0, signal=NARROW), {"duration": 0.06, "baseband": (8e3, 4e3)}
    each = [clsim.sensitivities(passing, [CLOCK], RATE, engine=e, **options).jacobian for e in ("opencl", "reference")]
    assert far(*each) <= 5e-5


def test_the_transpose_by_dense_points() -> None:
    """``<J, w>`` with w a row of J, within 1e-6 of the lengths, where both are held better than that."""
    times, rate, name = np.linspace(0.0, 0.6, 16), 192e3, "sources[0].trajectory"
    chirp = clsim.Signal.chirp(30e3, 45e3, 0.1, sampling_rate=rate, fade=0.005)
    way = np.stack([1.0 + 2.0 * times, 1.0 + 1.5 * times + 0.1 * np.sin(9.0 * times), 1.0 + 0.3 * times], axis=1)
    scene = clsim.Scene(
        clsim.Shoebox((5.0, 4.0, 2.8), clsim.Material.from_reflection(0.8)), clsim.Air(),
        [clsim.Source("s", chirp, clsim.Trajectory.waypoints(times, way))],
        [clsim.Receiver("r", FIXED((3.9, 2.2, 1.9)))],
    )  # fmt: skip
    moving = clsim.find_paths(scene, 0)
    options: dict[str, Any] = {"response_error_db": -120.0, "interpolator": clsim.Bandlimited(error_db=-110.0)}
    jacobian = clsim.sensitivities(moving, [name], rate, duration=0.12, **options).jacobian.reshape(48, -1)
    back = np.ravel(clsim.gradient(moving, jacobian[None, 7], [name], rate, **options)[name])
    lengths = np.linalg.norm(jacobian[7]) * np.linalg.norm(jacobian, axis=1)
    np.testing.assert_array_less(np.abs(back - jacobian @ jacobian[7]), 1e-6 * lengths + 1e-9 * lengths.max())


@pytest.mark.filterwarnings("ignore:ISO 9613-1:clsim.ClsimWarning")
@pytest.mark.parametrize(("humidity", "step"), [(0.0, 2e-5), (1.0, -1e-3)])
def test_the_humidity_at_its_bounds(humidity: float, step: float) -> None:
    """Against one-sided differences of the second order."""
    options: dict[str, Any] = {"duration": 0.03, "engine": "reference", "response_error_db": -110.0}
    found = clsim.sensitivities(paths(relative_humidity=humidity), ["air.relative_humidity"], RATE, **options).jacobian[
        0
    ]
    at, one, two = (
        received(plan_of(paths(relative_humidity=humidity + k * step), RenderOptions(RATE, **options)))
        for k in range(3)
    )
    assert far(found, (4.0 * one - 3.0 * at - two) / (2.0 * step)) <= 1e-3


def test_a_loss_of_any_size() -> None:
    weights = np.random.default_rng(0).standard_normal((1, 2400))
    one, large, small = (
        clsim.gradient(paths(), size * weights, [PLACE], RATE)[PLACE] / size for size in (1.0, 2.0**300, 2.0**-300)
    )
    np.testing.assert_array_equal(large, one)
    np.testing.assert_array_equal(small, one)


SOME = np.ones((1, 240))
FOUND: dict[str, Any] = {}


def known() -> Any:
    """Return derivatives, made once."""
    if not FOUND:
        wrt = ["receivers[0].electronics.clock_offset", "sources[0].start", GAIN]
        FOUND["it"] = clsim.sensitivities(paths(), wrt, RATE, duration=0.03, engine="reference")
    return FOUND["it"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: known().bounds("a"), "noise: must be numbers, but is 'a'"),
        (lambda: known().bounds([1.0, 2.0]), "noise: must have the shape 1, but has 2"),
        (lambda: known().bounds(1e-200), "noise: must be at least 1e-15, but is 1e-200"),
        (lambda: known().bounds(np.inf), "noise: must be finite, but is inf"),
        (lambda: known().bounds(-1.0), "noise: must be at least 1e-15, but is -1.0"),
        (
            lambda: known().bounds(0.1),
            "wrt: must be distinguishable, but receivers[0].electronics.clock_offset, sources[0].start are not: "
            "fix one of them",
        ),
        (
            lambda: clsim.sensitivities(paths(), [GAIN], RATE, durations=1.0),
            "options: must be one of 21 names, but is 'durations'; did you mean \"duration\"?",
        ),
        (
            lambda: clsim.gradient(paths(), SOME, [GAIN], RATE, duration=1.0),
            "duration: must be that of loss_gradient, 0.0025 s, or left out, but is 1 s",
        ),
        (
            lambda: clsim.gradient(paths(), 1e300 * SOME, [GAIN], RATE),
            "loss_gradient[0][0]: must be within 1e+100, but is 1e+300",
        ),
        (lambda: clsim.gradient(paths(), SOME, [], RATE), "wrt: must be a list of names, but is []"),
        (lambda: clsim.gradient(paths(), SOME, [3], RATE), "wrt: must be a list of names, but is [3]"),
        (
            lambda: clsim.gradient(paths(), SOME, [GAIN, GAIN], RATE),
            f"wrt: must name each parameter once, but names {GAIN} twice",
        ),
    ],
)  # fmt: skip
def test_errors_name_field_rule_and_value(call: Any, message: str) -> None:
    with pytest.raises(clsim.InputError) as error:
        call()
    assert str(error.value) == message
