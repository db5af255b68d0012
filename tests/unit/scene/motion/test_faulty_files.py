"""Faults in files of motion: refused with line and value, or repaired by name. Row i stands in line i + 2."""

import math

import numpy as np
import pytest
from motion_rows import by_points, refused, write

from clsim.errors import ClsimWarning, InputError
from clsim.scene.motion.trajectory import Trajectory


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


def test_rows_from_last_to_first_are_refused_as_that(tmp_path, rows):
    told = refused(write(tmp_path / "a.csv", rows[::-1])).problem
    assert told.startswith("a.csv, line 3: time must increase strictly (by 5e-10 s at least), but ")


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
    assert [note.split("line ")[-1].split(",")[0].rstrip(".") for note in notes[:4]] == ["7", "14", "32", "42"]


BAD_TEXT = [
    ("", "csv", "must begin with a header"),
    ("# nothing\n\n", "tum", "must hold at least 4 rows, but holds 0"),
    ("t,x,y,z\n0,0,0,0\n1,0,0,0\n2,0,0,0\n", "csv", "must hold at least 4 rows, but holds 3"),
    ("t,x,y\n0,0,0\n", "csv", "line 1: the header must name t,x,y,z"),
    ("0,1,2,3\n1,1,2,3\n", "csv", "line 1: the header must name t,x,y,z"),
    ("t,x,y,z,qx,qy,qz\n", "csv", "either all or none of qx,qy,qz,qw"),
    ("t,x,y,z,x\n", "csv", "must name x once"),
    ("t,pos_x,px,y,z\n", "csv", "must name x once, but names it as pos_x, px"),
    ("time_ms,x,y,z\n", "csv", "must name t,x,y,z"),
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
        ({"format": "kitti"}, "format"), ({"smooth": "strong"}, "smooth"), ({"smooth": 0.0}, "smooth"),
        ({"smooth": math.nan}, "smooth"), ({"time_offset": math.inf}, "time_offset"),
        ({"rotate": (0, 0, 0, 2)}, "rotate"), ({"rotate": (0, 0, 1)}, "rotate"), ({"scale": 0.0}, "scale"),
        ({"scale": -1.0}, "scale"), ({"translate": (0, 0)}, "translate"), ({"columns": ["t"]}, "columns"),
        ({"columns": {"t": 1}}, "columns"), ({"columns": {"time": "t"}}, "columns"),
        ({"columns": {"t": "clock"}}, "columns.t"), ({"columns": {"t": "t"}, "format": "tum"}, "columns"),
        ({"time_scale": 0.0}, "time_scale"), ({"time_scale": 1e-3, "format": "euroc"}, "time_scale"),
        ({"repair": "gaps"}, "repair"), ({"repair": ("gaps", "gap")}, "repair[1]"), ({"max_speed": 0.0}, "max_speed"),
        ({"max_gap": -1.0}, "max_gap"), ({"path": 3}, "path"), ({"path": ""}, "path"),
    ],
)  # fmt: skip
def test_bad_arguments_are_refused_by_name(tmp_path, rows, arguments, field):
    with pytest.raises(InputError) as caught:
        Trajectory.from_file(**({"path": write(tmp_path / "a.csv", rows), "format": "csv"} | arguments))
    assert caught.value.field == field
