import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import make_smoothing_spline
from scipy.spatial.transform import Rotation, Slerp

from clsim.errors import InputError
from clsim.scene.motion import curves
from clsim.scene.motion.curves import CONTINUATION
from clsim.scene.motion.trajectory import Trajectory

TAU = 2.0 * math.pi


@pytest.fixture
def rng():
    return np.random.default_rng(20240611)


def circle_positions(t):
    return np.stack([4 + np.cos(TAU * t), 3 + np.sin(TAU * t), np.full_like(t, 1.5)], axis=1)


def moving(name):
    """Return one trajectory of each smooth kind, from 0 to 2 s."""
    return {
        "line": lambda: Trajectory.line((0, 1, 2), (3, -1, 2.5), duration=2.0),
        "circle": lambda: Trajectory.circle((4, 3, 1.5), 1.0, 1.0, 2.0, axis=(1, 2, 3), phase=0.3),
        "waypoints": lambda: Trajectory.waypoints(
            [0, 0.4, 1.1, 1.5, 2], [(0, 0, 0), (1, 0, 2), (1, 1, 1), (0, 2, 1), (1, 1, 0)]
        ),
        "sampled": lambda: Trajectory.sampled(circle_positions, 2.0, 200.0),
    }[name]()


SMOOTH = ["line", "circle", "waypoints", "sampled"]


def smoothed_by(smooth, times, values, *more):
    """Return the points of smoothing splines, and the root mean squares of their residuals."""
    left = smooth(times, values, *more)
    return SimpleNamespace(points=values - left, residual=np.sqrt(np.mean(left**2, axis=0)))


def test_fixed_point_stays_for_ever_and_velocity_is_zero():
    point = Trajectory.fixed((1.0, 2.0, 3.0))
    t = np.array([-1e6, 0.0, 5.0])
    np.testing.assert_array_equal(point.position(t), [[1, 2, 3]] * 3)
    np.testing.assert_array_equal(point.velocity(t), np.zeros((3, 3)))
    assert (point.start, point.end, point.duration) == (-math.inf, math.inf, math.inf)
    assert not point.has_orientation
    np.testing.assert_array_equal(point.orientation(t), [[0, 0, 0, 1]] * 3)


def test_fixed_orientations_do_not_turn_by_rounding(rng):
    """A receiver flush in a skew body at rest moved, by 2e-16 rad, for ever."""
    for quaternion in rng.normal(size=(50, 4)):
        assert not Trajectory.fixed((4.0, 3.0, 1.5), quaternion / np.linalg.norm(quaternion)).turns


def test_fixed_orientation_is_normalised_and_held():
    point = Trajectory.fixed((0, 0, 0), orientation=(0.6, 0, 0, 0.801))
    assert point.has_orientation
    q = point.orientation([-5.0, 5.0])
    np.testing.assert_array_equal(q[0], q[1])
    np.testing.assert_allclose(q[0], np.array([0.6, 0, 0, 0.801]) / math.hypot(0.6, 0.801), rtol=1e-15)


def test_line_begins_and_ends_where_it_is_told():
    line = Trajectory.line((0, 1, 2), (3, -1, 2.5), duration=2.0)
    np.testing.assert_allclose(line.position([0.0, 2.0]), [(0, 1, 2), (3, -1, 2.5)], rtol=1e-15)
    np.testing.assert_allclose(line.velocity(1.0), (1.5, -1.0, 0.25), rtol=1e-15)
    assert (line.start, line.end) == (0.0, 2.0)


def test_circle_starts_at_plus_x_and_turns_counterclockwise():
    circle = Trajectory.circle((4, 3, 1.5), radius=2.0, period=4.0, duration=8.0)
    np.testing.assert_allclose(circle.position([0.0, 1.0, 2.0]), [(6, 3, 1.5), (4, 5, 1.5), (2, 3, 1.5)], atol=1e-14)
    np.testing.assert_allclose(circle.velocity(0.0), (0, 2.0 * TAU / 4.0, 0), atol=1e-14)


def test_circle_phase_is_an_angle_forward():
    ahead = Trajectory.circle((0, 0, 0), 1.0, 2.0, 2.0, phase=math.pi / 2)
    np.testing.assert_allclose(ahead.position(0.0), (0, 1, 0), atol=1e-15)


@pytest.mark.parametrize(
    ("axis", "e1"),
    [
        ((0, 0, 5), (1, 0, 0)), ((0, 0, -1), (1, 0, 0)), ((0, 1e-9, 0), (1, 0, 0)), ((2, 0, 0), (0, 1, 0)),
        ((-1, 0, 0), (0, 1, 0)), ((1, 0, 1), (math.sqrt(0.5), 0, -math.sqrt(0.5))),
    ],
)  # fmt: skip
def test_circle_about_any_axis_keeps_to_the_right_hand_rule(axis, e1):
    circle = Trajectory.circle((0, 0, 0), 1.0, 1.0, 1.0, axis=axis)
    t = np.linspace(0.0, 1.0, 17)
    x, v = circle.position(t), circle.velocity(t)
    np.testing.assert_allclose(x[0], e1, atol=1e-15)
    unit = np.array(axis) / np.linalg.norm(axis)
    np.testing.assert_allclose(np.cross(x, v), np.tile(TAU * unit, (17, 1)), atol=1e-13)


@pytest.mark.parametrize("name", SMOOTH)
def test_velocity_is_the_derivative_also_shortly_outside(name):
    # Central differences of step h are wrong by h² x‴ / 6 (x‴ < 400 m/s³ here) and 1e-15 m / h of rounding.
    h = 1e-5
    trajectory = moving(name)
    t = np.linspace(-CONTINUATION + 2 * h, 2.0 + CONTINUATION - 2 * h, 997)
    numeric = (trajectory.position(t + h) - trajectory.position(t - h)) / (2 * h)
    np.testing.assert_allclose(trajectory.velocity(t), numeric, atol=h * h * 400 / 6 + 4e-10)


@pytest.mark.parametrize("name", ["waypoints", "sampled"])
def test_splines_continue_with_the_end_s_position_velocity_and_acceleration(name):
    trajectory = moving(name)
    second = trajectory.curve.polynomial
    u = np.array([0.01, 0.03, CONTINUATION])[:, None]
    for end, sign in ((0.0, -1.0), (2.0, 1.0)):
        inside = end - sign * 1e-9
        expected = trajectory.position(end) + trajectory.velocity(end) * sign * u + second(inside, nu=2) * u * u / 2
        np.testing.assert_allclose(trajectory.position(end + sign * u[:, 0]), expected, atol=1e-9)


@pytest.mark.parametrize("name", SMOOTH)
def test_everything_stands_still_beyond_the_continuation(name):
    trajectory = moving(name)
    t = np.array([-9.0, -CONTINUATION - 1e-9, 2.0 + CONTINUATION + 1e-9, 9.0])
    np.testing.assert_array_equal(trajectory.velocity(t), np.zeros((4, 3)))
    x = trajectory.position(t)
    np.testing.assert_array_equal(x[[0, 2]], x[[1, 3]])
    np.testing.assert_array_equal(x[[0, 3]], trajectory.position([-CONTINUATION, 2.0 + CONTINUATION]))
    assert np.all(np.linalg.norm(trajectory.velocity([-CONTINUATION + 1e-9, 2.0 + CONTINUATION - 1e-9]), axis=1) > 0.1)


@pytest.mark.parametrize("name", SMOOTH)
def test_any_shape_of_times_gives_the_same_values(name):
    trajectory = moving(name)
    t = np.linspace(0.0, 2.0, 12)
    for function, width in ((trajectory.position, 3), (trajectory.velocity, 3), (trajectory.orientation, 4)):
        flat = function(t)
        assert flat.shape == (12, width)
        np.testing.assert_array_equal(function(t.reshape(3, 4)), flat.reshape(3, 4, width))
        np.testing.assert_array_equal(function(t[::-1]), flat[::-1])
        assert function(float(t[5])).shape == (width,)
        np.testing.assert_array_equal(function(float(t[5])), flat[5])


def test_results_may_be_changed_by_the_caller():
    for trajectory in (Trajectory.fixed((1, 1, 1)), moving("line"), moving("sampled")):
        trajectory.position([0.0, 1.0])[:] = 7.0
        trajectory.velocity([0.0, 1.0])[:] = 7.0
        trajectory.orientation([0.0, 1.0])[:] = 7.0
        assert not np.any(trajectory.position([0.0, 1.0]) == 7.0)


def test_smooth_waypoints_reproduce_a_cubic_from_any_points():
    # Not-a-knot has the one cubic through the points of a cubic; rounding alone is left.
    t = np.array([1.0, 1.3, 2.2, 2.5, 3.1])

    def cubic(u):
        return np.stack([u**3 - u, 2 - u**2, 0.5 * u**3], axis=1)

    trajectory = Trajectory.waypoints(t, cubic(t))
    u = np.linspace(1.0, 3.1, 101)
    np.testing.assert_allclose(trajectory.position(u), cubic(u), atol=1e-13)
    assert (trajectory.start, trajectory.end, trajectory.duration) == (1.0, 3.1, pytest.approx(2.1, rel=1e-15))
    assert trajectory.breaks.size == 0


def test_smooth_waypoints_meet_their_points_with_continuous_acceleration(rng):
    t = np.cumsum(rng.uniform(0.1, 1.0, 20))
    x = rng.normal(size=(20, 3))
    trajectory = Trajectory.waypoints(t, x)
    np.testing.assert_allclose(trajectory.position(t), x, atol=1e-13)
    bend = trajectory.curve.polynomial
    jump = bend(t - 1e-9, nu=2) - bend(t + 1e-9, nu=2)
    third = np.abs(bend.c[0]).max() * 6.0
    assert np.abs(jump).max() <= 2e-9 * third * 1.01 + 1e-10
    assert third > 10.0


def test_straight_waypoints_have_breaks_where_the_velocity_changes():
    trajectory = Trajectory.waypoints([0, 1, 2, 4], [(0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 3, 0)], smooth=False)
    np.testing.assert_array_equal(trajectory.breaks, [2.0])
    np.testing.assert_allclose(trajectory.position([0.5, 3.0]), [(0.5, 0, 0), (2, 1.5, 0)], rtol=1e-15)
    np.testing.assert_allclose(trajectory.velocity([2.0 - 1e-9, 2.0]), [(1, 0, 0), (0, 1.5, 0)], atol=1e-15)
    np.testing.assert_allclose(trajectory.position(4.02), (2, 3.03, 0), rtol=1e-14)


def test_two_waypoints_are_a_line_either_way():
    for smooth in (True, False):
        trajectory = Trajectory.waypoints([0, 2], [(0, 0, 0), (1, 2, 3)], smooth=smooth)
        np.testing.assert_allclose(trajectory.position(0.5), (0.25, 0.5, 0.75), rtol=1e-14)


def test_sampled_circle_is_wrong_by_its_bound_and_not_less():
    # The cubic spline's error is x⁗ h⁴ / 384 at most: (2 π)⁴ / 384 / 200⁴ = 2.54e-9 m.
    circle = Trajectory.sampled(circle_positions, duration=2.0, rate=200.0)
    t = np.linspace(0.1, 1.9, 20011)
    error = np.linalg.norm(circle.position(t) - circle_positions(t), axis=1).max()
    assert 2.3e-9 < error < 2.6e-9


def test_sampled_ends_exactly_and_uses_at_least_the_rate():
    seen = []

    def function(t):
        seen.append(t)
        return np.stack([t, t, t], axis=1)

    trajectory = Trajectory.sampled(function, duration=0.995, rate=10.0)
    assert trajectory.end == 0.995
    assert len(seen[0]) == 11
    assert (seen[0][0], seen[0][-1]) == (0.0, 0.995)


def test_orientation_is_the_slerp_of_scipy_and_its_sign_never_jumps(rng):
    t = np.cumsum(rng.uniform(0.1, 1.0, 30))
    turns = Rotation.random(30, random_state=rng)
    flips = rng.choice([-1.0, 1.0], size=(30, 1))
    trajectory = Trajectory.waypoints(t, np.zeros((30, 3)), orientations=turns.as_quat() * flips)
    u = np.linspace(t[0], t[-1], 20001)
    q = trajectory.orientation(u)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=1e-14)
    expected = Slerp(t, turns)(u)
    # Angles below 1e-7 rad are lost in the arc cosine of scipy's magnitude; ours err by rounding alone.
    assert (expected.inv() * Rotation.from_quat(q)).magnitude().max() < 1e-7
    assert np.sum(q[1:] * q[:-1], axis=1).min() > 0.99
    np.testing.assert_array_equal(trajectory.orientation([t[0] - 5.0]), trajectory.orientation([t[0]]))
    np.testing.assert_allclose(trajectory.orientation([t[-1] + 5.0]), trajectory.orientation([t[-1]]), atol=1e-15)


def test_orientation_at_rest_stays_a_unit_quaternion():
    q = np.array([0.5, 0.5, 0.5, 0.5])
    trajectory = Trajectory.waypoints([0, 1, 2], np.zeros((3, 3)), orientations=[q, -q, q])
    np.testing.assert_allclose(trajectory.orientation([0.0, 0.7, 1.3, 2.0]), [q] * 4, rtol=1e-15)


def test_peak_speed_finds_speed_and_time_over_many_blocks():
    # x = t²: the speed 2 t is greatest at the end of the range.
    trajectory = Trajectory.waypoints([0, 1, 2], [(0, 0, 0), (1, 0, 0), (4, 0, 0)])
    speed, time = trajectory.peak_speed(0.0, 1.5, rate=1e5)
    assert speed == pytest.approx(3.0, rel=1e-12)
    assert time == pytest.approx(1.5, rel=1e-12)
    assert Trajectory.fixed((0, 0, 0)).peak_speed(1.0, 1.0) == (0.0, 1.0)


@pytest.mark.parametrize("places", [[0, 1, 4], [0, 3, 1], [0, 1, 2]], ids=["faster", "back", "even"])
def test_peak_speeds_of_short_motions_are_those_of_long_ones(places, monkeypatch):
    """All instants at once, and halves of ranges; both tell the first time of the largest speed."""
    made = [Trajectory.waypoints([0, 1, 2], [(x, 0, 0) for x in places]) for _ in range(2)]
    at_once = made[0].peak_speed(-0.05, 2.05)
    monkeypatch.setattr("clsim.scene.motion.motion.BATCH", 1)
    assert made[1].peak_speed(-0.05, 2.05) == pytest.approx(at_once, rel=2e-9)
    assert at_once[0] == np.linalg.norm(made[0].velocity(np.array(at_once[1])))


def test_values_are_frozen_and_do_not_follow_their_input():
    positions = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    trajectory = Trajectory.waypoints([0, 1, 2, 3], positions)
    positions[:] = 9.0
    np.testing.assert_allclose(trajectory.position(1.0), (1, 0, 0), atol=1e-15)
    with pytest.raises(AttributeError):
        trajectory.start = 1.0
    with pytest.raises(ValueError, match="read-only"):
        trajectory.curve.polynomial.c[0] = 1.0


NAN = math.nan
POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
BAD = [
    (lambda: Trajectory.fixed((1, 2)), "position", "shape 3"),
    (lambda: Trajectory.fixed((1, NAN, 2)), "position[1]", "finite"),
    (lambda: Trajectory.fixed((1, 1e9, 2)), "position[1]", "1e+08 m"),
    (lambda: Trajectory.fixed("here"), "position", "numbers"),
    (lambda: Trajectory.fixed((1, 1, 1), (0, 0, 0, 0.9)), "orientation", "norm is 0.9"),
    (lambda: Trajectory.line((0, 0, 0), (1, 0, 0), 0.0), "duration", "above 0 s"),
    (lambda: Trajectory.line((0, 0, 0), (1, 0, 0), 1e-300), "duration", "at least 1e-09 s"),
    (lambda: Trajectory.line((0, 0, 0), (1, 0, 0), True), "duration", "a number"),
    (lambda: Trajectory.line((0, 0, 0), (1, 0), 1.0), "end", "shape 3"),
    (lambda: Trajectory.circle((0, 0, 0), 0.0, 1.0, 1.0), "radius", "above 0 m"),
    (lambda: Trajectory.circle((0, 0, 0), 1.0, -1.0, 1.0), "period", "above 0 s"),
    (lambda: Trajectory.circle((0, 0, 0), 1.0, 1.0, NAN), "duration", "finite"),
    (lambda: Trajectory.circle((0, 0, 0), 1.0, 1.0, 1.0, axis=(0, 0, 0)), "axis", "0, 0, 0"),
    (lambda: Trajectory.circle((0, 0, 0), 1.0, 1.0, 1.0, phase="x"), "phase", "a number"),
    (lambda: Trajectory.waypoints([0], [(0, 0, 0)]), "times", "at least two"),
    (lambda: Trajectory.waypoints([0, 0.75, 0.5], POINTS), "times", "[2] = 0.5 s follows [1] = 0.75 s"),
    (lambda: Trajectory.waypoints([0, 1, 1], POINTS), "times", "[2] = 1 s follows [1] = 1 s"),
    (lambda: Trajectory.waypoints([0, 1, 1e99], POINTS), "times[2]", "within 2e+09 s"),
    (lambda: Trajectory.waypoints([0, 1, 2, 3], POINTS), "positions", "4 x 3"),
    (lambda: Trajectory.waypoints([0, 1, 2], POINTS, [(0, 0, 0, 1)] * 2), "orientations", "3 x 4"),
    (lambda: Trajectory.waypoints([0, 1, 2], POINTS, [(0, 0, 0, 1), (0, 0, 0, 2), (0, 0, 0, 1)]),
     "orientations[1]", "norm is 2"),
    (lambda: Trajectory.waypoints([0, 1, 2], POINTS, smooth="yes"), "smooth", "true or false"),
    (lambda: Trajectory.sampled("t", 1.0, 10.0), "function", "callable"),
    (lambda: Trajectory.sampled(lambda t: t, 1.0, 10.0), "function", "11 x 3"),
    (lambda: Trajectory.sampled(lambda t: np.full((len(t), 3), NAN), 1.0, 10.0), "function[0][0]", "finite"),
    (lambda: Trajectory.sampled(circle_positions, 1.0, 1e30), "rate", "at most"),
    (lambda: moving("line").peak_speed(1.0, 0.0), "end", "at least 1 s"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "field", "words"), BAD)
def test_bad_values_are_refused_by_field_rule_and_value(make, field, words):
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.field == field
    assert words in caught.value.problem


# Smoothing


def test_smoothing_of_given_strength_is_scipy_s_smoothing_spline(rng):
    t = np.cumsum(rng.uniform(0.5, 1.5, 60))
    y = np.sin(0.2 * t) + 0.1 * rng.normal(size=60)
    step = np.median(np.diff(t))
    for strength in (0.01, 3.0, 500.0):
        ours = y - curves._system(t).solve(strength, y)[1]
        scipys = make_smoothing_spline(t, y, lam=strength * step**3)(t)
        np.testing.assert_allclose(ours, scipys, atol=1e-10)  # their own five-diagonal solution's rounding


def test_trace_by_the_determinant_is_the_trace_of_the_full_matrix(rng):
    t = np.cumsum(rng.uniform(0.5, 1.5, 40))
    system = curves._system(t)
    for strength in (1e-3, 1.0, 1e5):
        trace = np.trace(np.stack([system.solve(strength, e)[1] for e in np.eye(40)], axis=1))
        logs = np.log(strength) + curves._STEP * np.arange(-3, 4)
        found = curves._derivative(np.array([system.solve(np.exp(u), t)[0] for u in logs]))
        np.testing.assert_allclose(found, [trace], rtol=1e-5)  # h⁶/140 = 1.7e-6 of the seventh derivative


def test_cross_validation_is_nearly_as_good_as_knowing_the_truth(rng):
    # Against the best strength that can be picked with the clean data in hand; mutants (no trace, half of it)
    # lose 50 % and more. The residual is the noise less what the fit takes, 1.25 / 2 of its share of
    # parameters: 225 of 2001 in the first column, 7 %.
    t = np.linspace(0.0, 20.0, 2001)
    clean = np.stack([np.sin(t), 1e-3 * np.cos(2 * t)], axis=1)
    noise = np.array([1e-4, 1e-5]) * rng.normal(size=(2001, 2))
    smoothed = smoothed_by(curves.smooth_by_cross_validation, t, clean + noise)
    system = curves._system(t)
    tries = [noise - system.solve(strength, clean + noise)[1] for strength in np.geomspace(1e-2, 1e8, 101)]
    best = np.sqrt(np.min([np.sum(left**2, axis=0) for left in tries], axis=0))
    left = np.sqrt(np.sum((smoothed.points - clean) ** 2, axis=0))
    assert np.all(left < 1.1 * best)
    rms = np.sqrt(np.mean(noise**2, axis=0))
    np.testing.assert_allclose(smoothed.residual / rms, [0.93, 0.975], atol=0.02)


def test_cross_validation_does_not_depend_on_the_units(rng):
    t = np.linspace(0.0, 3.0, 301)
    y = np.sin(t)[:, None] + 1e-3 * rng.normal(size=(301, 1))
    base = smoothed_by(curves.smooth_by_cross_validation, t, y)
    other = smoothed_by(curves.smooth_by_cross_validation, t * 1e9 + 5.0, y * 1e3)
    np.testing.assert_allclose(other.points, base.points * 1e3, rtol=1e-6, atol=1e-6)


def test_cross_validation_leaves_exact_data_and_flattens_pure_noise(rng):
    t = np.linspace(0.0, 2.0, 401)
    exact = smoothed_by(curves.smooth_by_cross_validation, t, circle_positions(t))
    # At the least strength λ = 1e-6 the residual is λ times the fourth difference, (2 π / 200)⁴ = 1e-6, but
    # λ times the second, 1e-3, at both ends, where the spline may not bend: 1e-9 sqrt(2 / 401) in all.
    assert np.all(exact.residual < 1.5e-10)
    noise = 1e-4 * rng.normal(size=(401, 1))
    flat = smoothed_by(curves.smooth_by_cross_validation, t, noise)
    assert flat.residual[0] == pytest.approx(np.std(noise), rel=0.03)


def test_residual_asked_for_is_residual_given(rng):
    t = np.cumsum(rng.uniform(0.009, 0.011, 500))
    y = np.stack([np.sin(5 * t), np.cos(3 * t), t], axis=1)
    smoothed = smoothed_by(curves.smooth_by_residual, t, y, 2e-3)
    np.testing.assert_allclose(smoothed.residual[:2], 2e-3, rtol=1e-5)
    assert smoothed.residual[2] < 1e-9  # a straight line has no residual to give


def test_smoothing_bears_times_that_nearly_coincide(rng):
    t = np.linspace(0.0, 5.0, 501)
    t[200] = t[199] + 1.1e-5  # a thousandth of a step
    y = np.sin(t)[:, None] + 1e-3 * rng.normal(size=(501, 1))
    smoothed = smoothed_by(curves.smooth_by_cross_validation, t, y)
    assert smoothed.residual[0] == pytest.approx(1e-3, rel=0.1)
    assert np.abs(smoothed.points[150:250, 0] - np.sin(t[150:250])).max() < 5e-4
