import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from scenes import DATA
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from clsim.errors import ClsimWarning, InputError
from clsim.scene.motion.trajectory import Trajectory

TUM_FILE = DATA / "trajectories" / "freiburg1_xyz-groundtruth.txt"
EUROC_FILE = DATA / "trajectories" / "V102_groundtruth.csv"


def real(path):
    if not path.exists():
        pytest.skip(f"no real data: {path} is missing")
    return path


def motion(count=60, step=0.1):
    t = step * np.arange(count)
    x = np.stack([np.sin(t), np.cos(t), 0.1 * t], axis=1)
    q = Rotation.from_rotvec(np.outer(t, [0.3, -0.2, 0.5])).as_quat()
    return t, x, q


def write(path, rows, head="t,x,y,z,qx,qy,qz,qw", separator=","):
    lines = [head, *(separator.join(str(cell) for cell in row) for row in rows)]
    path.write_text("\n".join(line for line in lines if line) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def rows():
    t, x, q = motion()
    return [list(map(float, (t[i] + 1000.0, *x[i], *q[i]))) for i in range(len(t))]


@pytest.fixture
def euroc_rows(rows):
    return [[1403715524907143168 + 100_000_000 * i, *row[1:4], row[7], *row[4:7], 0.0] for i, row in enumerate(rows)]


def by_points(path, form, **more):
    """Load without smoothing and without its warning."""
    with pytest.warns(ClsimWarning, match="Doppler noise"):
        return Trajectory.from_file(path, form, smooth=False, **more)


def refused(path, form="csv", **more):
    with pytest.raises(InputError) as caught:
        Trajectory.from_file(path, form, **more)
    return caught.value


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


# Faults: refused with line and value, or repaired by name. Row i stands in line i + 2.


def with_cell(rows, row, column, value):
    changed = [list(r) for r in rows]
    changed[row][column] = value
    return changed


def test_time_that_repeats_or_falls_is_refused_or_dropped(tmp_path, rows):
    for value, text in ((rows[10][0], "1001.0 follows 1001.0"), (1000.95, "1000.95 follows 1001.0")):
        path = write(tmp_path / "a.csv", with_cell(rows, 11, 0, value))
        error = refused(path)
        assert error.field == "path"
        assert "a.csv, line 13: time must increase strictly" in error.problem
        assert text in error.problem
        trajectory = Trajectory.from_file(path, "csv", repair=("times",))
        assert trajectory.notes[0] == "Dropped 1 of 60 rows (time does not increase), the first in line 13."
        assert len(trajectory.curve.polynomial.x) == 59 + 2


def test_times_after_a_backward_jump_are_dropped_until_they_increase_again(tmp_path, rows):
    changed = with_cell(with_cell(rows, 11, 0, 1000.5), 12, 0, 1000.6)
    trajectory = Trajectory.from_file(write(tmp_path / "a.csv", changed), "csv", repair=["times"])
    assert trajectory.notes[0].startswith("Dropped 2 of 60 rows")


def test_gap_is_refused_allowed_or_bridged(tmp_path, rows):
    path = write(tmp_path / "a.csv", rows[:20] + rows[26:])
    error = refused(path)
    assert "a.csv, line 22: must follow within 0.5 s (5 median steps)" in error.problem
    assert f"{rows[26][0]} is 0.7 s after {rows[19][0]}" in error.problem
    assert "line 22: must follow within 0.65 s (max_gap)" in refused(path, max_gap=0.65).problem
    assert len(Trajectory.from_file(path, "csv", max_gap=0.7).notes) == 1
    trajectory = Trajectory.from_file(path, "csv", repair=("gaps",))
    assert trajectory.notes[0] == "Bridged 1 gap longer than 0.5 s, the first before line 22, the longest 0.7 s."
    # The cubic across 0.7 s of a unit circle at 1 rad/s: 0.7⁴ / 384 and the ends' share, a few times that.
    t = np.linspace(1.9, 2.6, 30)
    wanted = np.stack([np.sin(t), np.cos(t), 0.1 * t], axis=1)
    assert np.abs(trajectory.position(t) - wanted).max() < 4 * 0.7**4 / 384


def test_seconds_of_motion_that_a_gap_makes_up_are_a_warning(tmp_path, rows):
    late = [[row[0] + 12.0, *row[1:]] for row in rows[20:]]
    path = write(tmp_path / "a.csv", rows[:20] + late)
    with pytest.warns(ClsimWarning, match=r"a\.csv: repair=.* makes up 12\.1 s of motion, .* before line 22"):
        Trajectory.from_file(path, "csv", repair=("gaps",))
    Trajectory.from_file(path, "csv", max_gap=13.0)  # told by the user, figure and all


def test_five_median_steps_are_no_gap(tmp_path, rows):
    Trajectory.from_file(write(tmp_path / "a.csv", rows[:20] + rows[24:]), "csv")


@pytest.mark.parametrize("cell", ["nan", "inf", "-Infinity", "", "abc", "1_0", "1;2", "0x10"])
@pytest.mark.parametrize(("column", "name"), [(0, "t"), (2, "y"), (7, "qw")])
def test_what_is_no_finite_number_is_refused_or_dropped(tmp_path, rows, cell, column, name):
    path = write(tmp_path / "a.csv", with_cell(rows, 3, column, cell))
    error = refused(path)
    assert error.problem == f"a.csv, line 5: {name} must be a finite number, but is {cell!r}"
    trajectory = Trajectory.from_file(path, "csv", repair=("nan",))
    assert trajectory.notes[0] == "Dropped 1 of 60 rows (no finite number), the first in line 5."
    np.testing.assert_allclose(trajectory.end, 5.9, atol=1e-12)


def test_dropping_the_first_row_moves_the_first_time(tmp_path, rows):
    path = write(tmp_path / "a.csv", with_cell(rows, 0, 3, "nan"))
    trajectory = by_points(path, "csv", repair=("nan",))
    assert trajectory.end == pytest.approx(5.8, abs=1e-12)
    np.testing.assert_allclose(trajectory.position(0.0), rows[1][1:4], atol=1e-12)


def test_jump_is_refused_or_dropped(tmp_path, rows):
    path = write(tmp_path / "a.csv", with_cell(rows, 30, 1, rows[30][1] + 5.0))
    error = refused(path)
    assert "a.csv, line 32: must not be faster than 20 m/s (max_speed), but is" in error.problem
    assert "away from line 31 after 0.1 s" in error.problem
    assert "m/s" in error.problem
    trajectory = Trajectory.from_file(path, "csv", repair=("jumps",))
    assert trajectory.notes[0] == "Dropped 1 of 60 rows (faster than 20 m/s), the first in line 32."
    with pytest.warns(ClsimWarning, match="accelerates"):
        Trajectory.from_file(path, "csv", max_speed=60.0, smooth=1e-3)


def test_jump_is_measured_in_metres(tmp_path, rows):
    millimetres = [[row[0], *(1e3 * np.array(row[1:4])), *row[4:]] for row in rows]
    path = write(tmp_path / "a.csv", millimetres)
    assert "faster than 20 m/s" in refused(path).problem
    Trajectory.from_file(path, "csv", scale=1e-3)


def test_quaternion_that_is_not_a_unit_is_refused_and_rounding_is_not(tmp_path, rows):
    off = with_cell(rows, 4, 7, rows[4][7] + 0.05)
    error = refused(write(tmp_path / "a.csv", off), repair=("times", "gaps", "nan", "jumps"))
    assert "a.csv, line 6: must have a unit quaternion, but its norm is 1.0" in error.problem
    rounded = [[*row[:4], *np.round(row[4:], 3)] for row in rows]
    trajectory = Trajectory.from_file(write(tmp_path / "b.csv", rounded), "csv")
    q = trajectory.orientation(np.linspace(0, 5.9, 99))
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=1e-14)


def test_repairs_that_would_take_half_of_the_rows_are_refused(tmp_path, rows):
    first = with_cell(rows, 0, 0, 5000.0)
    error = refused(write(tmp_path / "a.csv", first), repair=("times",))
    assert (error.field, error.problem[:27]) == ("repair", "would drop 59 of 60 rows of")
    broken = [[row[0], "x", *row[2:]] for row in rows]
    error = refused(write(tmp_path / "b.csv", broken), repair=("nan",))
    assert (error.field, error.problem[:27]) == ("repair", "would drop 60 of 60 rows of")


def test_all_repairs_at_once_are_all_reported(tmp_path, rows):
    changed = with_cell(with_cell(with_cell(rows, 5, 2, "nan"), 12, 0, 1000.0), 30, 1, 50.0)
    path = write(tmp_path / "a.csv", changed[:40] + changed[48:])
    notes = Trajectory.from_file(path, "csv", repair=("gaps", "nan", "jumps", "times")).notes
    assert [note.split()[0] for note in notes] == ["Dropped", "Dropped", "Dropped", "Bridged", "Smoothed"]
    assert [note.split("line ")[-1].split(",")[0].rstrip(".") for note in notes[:4]] == [
        "7",
        "14",
        "32",
        "42",
    ]


BAD_TEXT = [
    ("", "csv", "must begin with a header"),
    ("# nothing\n\n", "tum", "must hold at least 4 rows, but holds 0"),
    ("t,x,y,z\n0,0,0,0\n1,0,0,0\n2,0,0,0\n", "csv", "must hold at least 4 rows, but holds 3"),
    ("t,x,y\n0,0,0\n", "csv", "line 1: the header must name t,x,y,z"),
    ("0,1,2,3\n1,1,2,3\n", "csv", "line 1: the header must name t,x,y,z"),
    ("t,x,y,z,qx,qy,qz\n", "csv", "either all or none of qx,qy,qz,qw"),
    ("t,x,y,z,x\n", "csv", "must name x once"),
    ("t,x,y,z\n0,0,0,0\n1,0,0\n", "csv", "line 3: must have 4 columns, but has 3"),
    ("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1 9\n", "tum", "line 2: must have 8 columns, but has 9"),
    ("0,1,2,3,0,0,1\n", "euroc", "line 1: must have at least 8 columns, but has 7"),
    ("0.5,1,2,3,1,0,0,0\n", "euroc", "line 1: t must be whole nanoseconds, but is '0.5'"),
    ("t,x,y,z\n0,0,0,0\n1,1e300,0,0\n2,0,0,0\n3,0,0,0\n", "csv", "line 3: positions must be within 1e+08 m"),
    ("t,x,y,z\n0,0,0,0\n1e10,0,0,0\n2e10,0,0,0\n3e10,0,0,0\n", "csv", "must not last longer than 1e+09 s"),
    ("t,x,y,z\n0,0,0,0\n1e999999,0,0,0\n", "csv", "line 3: t must be a finite number"),
    ("t,x,y,z\n1,0,0,0\n1,0,0,0\n1,0,0,0\n1,0,0,0\n", "csv", "line 3: time must increase strictly"),
    ("0 1 2 3 1e300 0 0 1\n1 1 2 3 0 0 0 1\n", "tum", "line 1: must have a unit quaternion"),
]


@pytest.mark.parametrize(("text", "form", "words"), BAD_TEXT)
def test_bad_text_is_refused(tmp_path, text, form, words):
    path = tmp_path / "a.txt"
    path.write_text(text, encoding="utf-8")
    error = refused(path, form)
    assert error.field == "path"
    assert words in error.problem
    assert "a.txt" in error.problem


def test_missing_file_folder_and_binary_are_refused(tmp_path):
    assert "missing.csv cannot be read: No such file" in refused(tmp_path / "missing.csv").problem
    assert "cannot be read: Is a directory" in refused(tmp_path).problem
    (tmp_path / "a.csv").write_bytes(b"RIFF\xff\xfe\x00\x80")
    assert "must be a text file" in refused(tmp_path / "a.csv").problem
    (tmp_path / "b.csv").write_bytes(b"t,x\x00y,z\n")
    assert "zero byte" in refused(tmp_path / "b.csv").problem


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"format": "kitti"}, "format"),
        ({"smooth": "strong"}, "smooth"),
        ({"smooth": 0.0}, "smooth"),
        ({"smooth": math.nan}, "smooth"),
        ({"time_offset": math.inf}, "time_offset"),
        ({"rotate": (0, 0, 0, 2)}, "rotate"),
        ({"rotate": (0, 0, 1)}, "rotate"),
        ({"scale": 0.0}, "scale"),
        ({"scale": -1.0}, "scale"),
        ({"translate": (0, 0)}, "translate"),
        ({"repair": "gaps"}, "repair"),
        ({"repair": ("gaps", "gap")}, "repair[1]"),
        ({"max_speed": 0.0}, "max_speed"),
        ({"max_gap": -1.0}, "max_gap"),
        ({"path": 3}, "path"),
        ({"path": ""}, "path"),
    ],
)
def test_bad_arguments_are_refused_by_name(tmp_path, rows, arguments, field):
    with pytest.raises(InputError) as caught:
        Trajectory.from_file(**({"path": write(tmp_path / "a.csv", rows), "format": "csv"} | arguments))
    assert caught.value.field == field


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
