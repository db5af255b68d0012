"""Motion from files: formats, smoothing, and two recordings."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from motion_rows import by_points, motion, refused, write
from scenes import DATA
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from clsim.errors import ClsimWarning
from clsim.scene.motion.trajectory import Trajectory

TUM_FILE = DATA / "trajectories" / "freiburg1_xyz-groundtruth.txt"
EUROC_FILE = DATA / "trajectories" / "V102_groundtruth.csv"


def real(path):
    if not path.exists():
        pytest.skip(f"no real data: {path} is missing")
    return path


# Formats


def test_all_formats_hold_the_same_motion(tmp_path, rows, euroc_rows):
    files = {
        "tum": write(tmp_path / "a.txt", rows, "# t x y z qx qy qz qw", " "),
        "euroc": write(tmp_path / "b.csv", euroc_rows, "#timestamp, p_x"),
        "csv": write(tmp_path / "c.csv", rows),
    }
    t, x, q = motion()
    for form, path in files.items():
        trajectory = by_points(path, form)
        assert (trajectory.start, trajectory.end) == (0.0, pytest.approx(5.9, abs=1e-12))
        np.testing.assert_allclose(trajectory.position(t), x, atol=1e-12)
        turn = Rotation.from_quat(trajectory.orientation(t)).inv() * Rotation.from_quat(q)
        assert turn.magnitude().max() < 1e-7
        assert trajectory.has_orientation
        assert trajectory.residual is None


def test_csv_columns_may_stand_in_any_order_beside_others(tmp_path, rows):
    mixed = [[row[3], "good", row[0], row[1], row[2]] for row in rows]
    trajectory = by_points(write(tmp_path / "a.csv", mixed, "z, quality ,t,x,y"), "csv")
    t, x, _ = motion()
    np.testing.assert_allclose(trajectory.position(t), x, atol=1e-12)
    assert not trajectory.has_orientation
    assert trajectory.notes[0] == "Columns not used: quality."


def test_comments_blank_lines_byte_order_mark_and_crlf_are_no_rows(tmp_path, rows):
    text = "\ufeff# made by hand\r\n\r\nt,x,y,z\r\n" + "".join(
        f"{row[0]},{row[1]},{row[2]},{row[3]}\r\n# between\r\n" for row in rows
    )
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("utf-8"))
    np.testing.assert_allclose(by_points(path, "csv").position(motion()[0]), motion()[1], atol=1e-12)


def test_columns_have_other_names_and_time_another_unit(tmp_path, rows):
    own = by_points(write(tmp_path / "a.csv", rows), "csv")
    alias = by_points(write(tmp_path / "b.csv", rows, "Time,pos_x,PY,position_z,q_x,quat_y,orientation_z,qw"), "csv")
    milli = [[1e3 * row[0], *row[1:]] for row in rows]
    path = write(tmp_path / "c.csv", milli, "t (ms),x,y,z,qx,qy,qz,qw")
    given = by_points(path, "csv", columns={"t": "t (ms)"}, time_scale=1e-3)
    swapped = by_points(path, "csv", columns={"t": "t (ms)", "x": "y", "y": "x"}, time_scale=1e-3)
    times = np.linspace(0.0, 5.9, 60)
    for other in (alias, given):
        np.testing.assert_allclose(other.position(times), own.position(times), atol=1e-9)
        np.testing.assert_allclose(other.orientation(times), own.orientation(times), atol=1e-9)
    np.testing.assert_allclose(swapped.position(times)[:, [1, 0, 2]], own.position(times), atol=1e-9)


def test_nanoseconds_since_1970_lose_nothing(tmp_path, euroc_rows):
    # float64 would round 1.4e18 ns to 256 ns; the third row stands out by 3 ns, which must be seen.
    euroc_rows[2][0] += 3
    trajectory = by_points(write(tmp_path / "a.csv", euroc_rows, ""), "euroc")
    knots = trajectory.curve.polynomial.x[1:-1]
    assert knots[2] - 0.2 == pytest.approx(3e-9, abs=1e-15)


def test_time_offset_is_the_time_of_the_first_row(tmp_path, rows):
    path = write(tmp_path / "a.csv", rows)
    late = by_points(path, "csv", time_offset=-2.5)
    assert (late.start, late.end) == (-2.5, pytest.approx(3.4, abs=1e-12))
    np.testing.assert_allclose(late.position(-2.5 + 0.35), by_points(path, "csv").position(0.35), atol=1e-12)


def test_placement_scales_then_turns_then_moves(tmp_path, rows):
    path = write(tmp_path / "a.csv", rows)
    quarter = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))  # +x to +y
    placed = by_points(path, "csv", scale=0.5, rotate=quarter, translate=(10, 20, 30))
    plain = by_points(path, "csv")
    t = np.linspace(0.0, 5.9, 101)
    x = plain.position(t)
    expected = np.stack([10 - 0.5 * x[:, 1], 20 + 0.5 * x[:, 0], 30 + 0.5 * x[:, 2]], axis=1)
    np.testing.assert_allclose(placed.position(t), expected, atol=1e-12)
    axes = Rotation.from_quat(placed.orientation(t)).apply([1.0, 0, 0])
    before = Rotation.from_quat(plain.orientation(t)).apply([1.0, 0, 0])
    np.testing.assert_allclose(axes, np.stack([-before[:, 1], before[:, 0], before[:, 2]], axis=1), atol=1e-12)


# Smoothing


def noisy_rows(rows, deviation, count=60):
    noise = deviation * np.random.default_rng(5).normal(size=(count, 3))
    return [[row[0], *(np.array(row[1:4]) + noise[i]), *row[4:]] for i, row in enumerate(rows)]


def test_smoothing_by_default_states_its_residual(tmp_path, rows):
    path = write(tmp_path / "a.csv", noisy_rows(rows, 1e-3))
    trajectory = Trajectory.from_file(path, "csv")
    assert trajectory.residual.shape == (3,)
    assert np.all((trajectory.residual > 3e-4) & (trajectory.residual < 1.5e-3))
    moved = ", ".join(f"{1e3 * r:.3g}" for r in trajectory.residual)
    assert f"moved by {moved} mm rms" in trajectory.notes[-1]
    assert "generalised cross-validation" in trajectory.notes[-1]
    rough = by_points(path, "csv")
    t, x, _ = motion()
    left = np.std(trajectory.position(t) - x)
    assert left < 0.8 * np.std(rough.position(t) - x)
    np.testing.assert_allclose(  # the residual is what was moved
        np.sqrt(np.mean((trajectory.position(t) - rough.position(t)) ** 2, axis=0)),
        trajectory.residual,
        rtol=1e-9,
    )


def test_smoothing_commutes_with_the_placement(tmp_path, rows):
    path = write(tmp_path / "a.csv", noisy_rows(rows, 1e-3))
    turn = Rotation.from_rotvec([0.4, -0.7, 1.1])
    placed = Trajectory.from_file(path, "csv", rotate=turn.as_quat(), translate=(1, 2, 3))
    t = np.linspace(0.0, 5.9, 77)
    expected = turn.apply(Trajectory.from_file(path, "csv").position(t)) + np.array([1, 2, 3])
    np.testing.assert_allclose(placed.position(t), expected, atol=1e-12)


def test_residual_by_name_is_left(tmp_path, rows):
    trajectory = Trajectory.from_file(write(tmp_path / "a.csv", rows), "csv", smooth=2e-3)
    np.testing.assert_allclose(trajectory.residual[:2], 2e-3, rtol=1e-5)
    assert "a residual of 2 mm" in trajectory.notes[-1]


def test_doppler_noise_is_told_where_nothing_is_smoothed(tmp_path):
    # 2000 points at 100 Hz, white noise of 0.1 mm on y: 1.573 * 1e-4 / 0.01 s = 15.7 mm/s, 1.83 Hz.
    t, x, _ = motion(2000, 0.01)
    clean = CubicSpline(t, x)
    x = x + [1e-5, 1e-4, 1e-5] * np.random.default_rng(6).normal(size=x.shape)
    path = write(tmp_path / "a.csv", np.column_stack([t, x]).tolist(), "t,x,y,z")
    with pytest.warns(ClsimWarning, match=r"1\.8 Hz of Doppler noise at 40 kHz") as caught:
        trajectory = Trajectory.from_file(path, "csv", smooth=False)
    assert Path(caught[0].filename).name == Path(__file__).name
    fine = np.linspace(1.0, 19.0, 50_001)
    noise = np.sqrt(np.mean((trajectory.velocity(fine) - clean(fine, 1)) ** 2, axis=0))
    np.testing.assert_allclose(noise, [1.573e-3, 1.573e-2, 1.573e-3], rtol=0.05)  # 2000 points: 3 * 1.6 %


def test_violent_motion_warns_of_its_acceleration(tmp_path):
    t = 0.01 * np.arange(301)
    x = 0.05 * np.sin(10.0 * math.pi * t)  # 49 m/s² along x and y, 70 m/s² together
    path = write(tmp_path / "a.csv", np.column_stack([t, x, x, 0 * x]).tolist(), "t,x,y,z")
    with pytest.warns(ClsimWarning, match=r"accelerates by (69|70)[.\d]* m/s²") as caught:
        Trajectory.from_file(path, "csv")
    assert Path(caught[0].filename).name == Path(__file__).name
    slow = write(tmp_path / "b.csv", np.column_stack([t, x, 0 * x, 0 * x]).tolist(), "t,x,y,z")
    Trajectory.from_file(slow, "csv")


# Real files


def high_pass_speed(trajectory, rate):
    """Return the rms over all axes of the speed's content above 12 Hz, m/s."""
    t = np.arange(trajectory.start, trajectory.end, 1.0 / rate)
    spectrum = np.fft.rfft(trajectory.velocity(t) * np.hanning(len(t))[:, None], axis=0)
    high = np.fft.rfftfreq(len(t), 1.0 / rate) > 12.0
    power = 2.0 * np.sum(np.abs(spectrum[high]) ** 2) / len(t) / np.sum(np.hanning(len(t)) ** 2)
    return math.sqrt(power)


def test_hand_held_trajectory_has_one_gap_and_is_refused_until_it_is_allowed():
    problem = refused(real(TUM_FILE), "tum").problem
    assert "line 1022: must follow within 0.05 s (5 median steps)" in problem
    assert "0.1101 s after" in problem


def test_hand_held_trajectory_loses_its_noise():
    rough = by_points(real(TUM_FILE), "tum", max_gap=0.2)
    assert "2.8 Hz of Doppler noise" in rough.notes[-1]
    smooth = Trajectory.from_file(TUM_FILE, "tum", repair=("gaps",))
    assert "Bridged 1 gap" in smooth.notes[0]
    assert smooth.end == pytest.approx(30.0896, abs=1e-9)
    # Noise by third to fifth differences is 66 to 154 µm; smoothing must take that and stay below it.
    assert np.all((smooth.residual > 50e-6) & (smooth.residual < 155e-6))
    assert high_pass_speed(rough, 200.0) > 0.015
    assert high_pass_speed(smooth, 200.0) < 0.004
    t = np.linspace(0.0, smooth.end, 5001)
    assert np.linalg.norm(smooth.position(t) - rough.position(t), axis=1).max() < 2e-3
    assert np.allclose(np.linalg.norm(smooth.orientation(t), axis=1), 1.0, rtol=1e-14)
    assert smooth.peak_speed(0.0, smooth.end)[0] == pytest.approx(0.589, abs=0.01)


def test_drone_trajectory_loads_as_it_is():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trajectory = Trajectory.from_file(real(EUROC_FILE), "euroc")
    assert trajectory.end == pytest.approx(83.505, abs=1e-6)
    assert np.all((trajectory.residual > 1e-6) & (trajectory.residual < 30e-6))
    np.testing.assert_allclose(trajectory.position(0.0), (0.515356, 1.996773, 0.971104), atol=1e-4)
    # First quaternion, w x y z in the file.
    np.testing.assert_allclose(trajectory.orientation(0.0), (0.789985, -0.205376, 0.554528, 0.161996), atol=2e-4)
    assert trajectory.peak_speed(0.0, trajectory.end)[0] == pytest.approx(2.19, abs=0.02)
    # The file's own velocities at 41.75 s are those of the curve.
    row = np.loadtxt(EUROC_FILE, delimiter=",", comments="#", skiprows=8000, max_rows=1)
    time = (row[0] - 1403715524907143168) * 1e-9
    np.testing.assert_allclose(trajectory.velocity(time), row[8:11], atol=0.02)
