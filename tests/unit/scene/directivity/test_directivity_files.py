"""Directivities in text, NumPy and MATLAB files."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from exhaustive import few

import clsim
from clsim import AxialDirectivity

LEVELS = """# turntable, 2 m
angle, 30e3, 40e3

0, 0, 0
45, -2.5, -6
90, -10, -20
"""
PHASES = "angle;30000;40000\n0;0;0\n45;-10,5;-90\n90;-20;180\n"


@pytest.fixture
def arrays() -> dict[str, np.ndarray]:
    angles = np.arange(0.0, 181.0, 30.0)
    frequencies = np.array([30e3, 40e3, 50e3])
    turn = np.exp(1j * np.cos(np.radians(angles))[:, None] * frequencies / 20e3)
    return {"angles": angles, "frequencies": frequencies, "values": (1.1 + np.cos(np.radians(angles)))[:, None] * turn}


def test_text_files_have_frequencies_across_and_angles_down(tmp_path: Path) -> None:
    path = tmp_path / "beam.csv"
    path.write_text(LEVELS, "utf-8-sig")
    table = AxialDirectivity.from_csv(path, rear="hold", name="mine")
    assert table.frequencies.tolist() == [30e3, 40e3]
    assert table.angles_degrees.tolist() == [0, 45, 90]
    assert table.name == "mine"
    gain = table.gain(np.cos(np.radians([0.0, 45.0, 90.0])), 40e3, 343.0)
    np.testing.assert_allclose(20 * np.log10(gain), [0, -6, -20], atol=1e-9)
    path.write_text(LEVELS.replace(", ", "\t").replace(".5", ",5"))
    np.testing.assert_array_equal(AxialDirectivity.from_csv(path, rear="hold").values, table.values)
    path.write_text(LEVELS.replace("angle,", ",").replace("-2.5, -6", "0.75, -0.5"))
    linear = AxialDirectivity.from_csv(path, scale="linear", rear="hold")
    assert linear.values[1].tolist() == [0.75, -0.5]


def test_phases_come_from_a_second_file(tmp_path: Path) -> None:
    (tmp_path / "level.csv").write_text(LEVELS)
    (tmp_path / "phase.csv").write_text(PHASES)
    table = AxialDirectivity.from_csv(tmp_path / "level.csv", tmp_path / "phase.csv", rear="hold")
    assert table.is_complex
    gain = table.gain(np.cos(np.radians([45.0, 90.0])), np.array([30e3, 40e3]), 343.0)
    expected = 10 ** (np.array([-2.5, -20.0]) / 20) * np.exp(1j * np.radians([-10.5, 180.0]))
    np.testing.assert_allclose(gain, expected, atol=1e-12)
    (tmp_path / "phase.csv").write_text(PHASES.replace("45", "50"))
    with pytest.raises(clsim.InputError, match="has others") as error:
        AxialDirectivity.from_csv(tmp_path / "level.csv", tmp_path / "phase.csv", rear="hold")
    assert error.value.field == "phases_path"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds 0 rows"), ("# only a comment\n", "holds 0 rows"), ("angle,40e3\n", "holds 1 rows"),
        ("angle,40e3\n0,0\n90\n", "line 3 has 0"), ("angle,40e3\n0,0\n90,-3,-4\n", "line 3 has 2"),
        ("angle,40e3\n0,0\n90,much\n", "line 3 is '90,much'"), ("angle,forty\n0,0\n", "line 1 is"),
        ("angle\n0\n", "line 1 is 'angle'"),
    ],
)  # fmt: skip
def test_text_files_that_are_no_table_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "beam.csv"
    path.write_text(text)
    with pytest.raises(clsim.InputError) as error:
        AxialDirectivity.from_csv(path)
    assert error.value.field == "path"
    assert message in error.value.problem
    assert str(path) in error.value.problem


def test_values_in_files_are_checked_like_any_others(tmp_path: Path) -> None:
    path = tmp_path / "beam.csv"
    for old, new, field in (
        ("30e3", "50e3", "frequencies"), ("45,", "0,", "angles_degrees"), ("-6", "nan", "values[1][1]"),
        ("-6", "-inf", "values[1][1]"),
    ):  # fmt: skip
        path.write_text(LEVELS.replace(old, new, 1))
        with pytest.raises(clsim.InputError) as error:
            AxialDirectivity.from_csv(path, rear="hold")
        assert error.value.field == field


@pytest.mark.parametrize("kind", ["npz", "mat"])
def test_numpy_and_matlab_files(tmp_path: Path, arrays: dict[str, np.ndarray], kind: str) -> None:
    path = tmp_path / f"beam.{kind}"
    write = np.savez if kind == "npz" else lambda at, **named: scipy.io.savemat(at, named)
    read = AxialDirectivity.from_npz if kind == "npz" else AxialDirectivity.from_mat
    write(path, **arrays)
    np.testing.assert_array_equal(read(path).values, arrays["values"])
    write(path, theta=arrays["angles"], f=arrays["frequencies"], H=arrays["values"])
    names = {"angle": "theta", "frequency": "f", "values": "H"}
    np.testing.assert_array_equal(read(path, **names).angles_degrees, arrays["angles"])
    with pytest.raises(clsim.InputError, match=r'must be one of "H", "f", "theta", but is .angles.') as error:
        read(path)
    assert error.value.field == "angle"


def test_what_arrays_of_files_mean(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Whatever kind of file they come from: MATLAB's are read by a process of their own, which takes its time."""
    path, write, read = tmp_path / "beam.npz", np.savez, AxialDirectivity.from_npz
    write(path, **(arrays | {"values": -np.abs(arrays["values"])}))
    with pytest.raises(clsim.InputError) as error:
        read(path)
    assert error.value.field == "scale"
    assert read(path, scale="db").gain(1.0, 40e3, 343.0) == pytest.approx(10 ** (-2.1 / 20))
    assert read(path, scale="linear").gain(1.0, 40e3, 343.0) == pytest.approx(-2.1)
    write(path, **(arrays | {"values": arrays["values"].T}))
    np.testing.assert_array_equal(read(path).values, arrays["values"])
    write(path, **(arrays | {"values": arrays["values"][:-1]}))
    with pytest.raises(clsim.InputError, match="7 x 3, but are 6 x 3"):
        read(path)
    write(path, **(arrays | {"angles": np.radians(arrays["angles"]).astype(np.float32)}))
    np.testing.assert_array_equal(read(path, angle_unit="radian").angles_degrees, arrays["angles"])
    with pytest.raises(clsim.InputError, match='"degree", "radian"') as error:
        read(path, angle_unit="turn")
    assert error.value.field == "angle_unit"


def laboratory(path: Path, *, offset: float = 0.0, **changes: np.ndarray) -> np.ndarray:
    """Write a struct of a beam from -5° to 185° in radians, frequencies x angles; return its degrees and values."""
    degrees = np.arange(-5.0, 186.0, 5.0) + offset
    f = np.arange(38e3, 42e3, 34.0)
    turned = np.radians(degrees)[:, None]
    gain = (1.1 + np.cos(turned) + 0.02 * np.sin(turned)) * np.exp(-2j * np.pi * f * 1e-5)
    field = {"a": np.radians(degrees)[None, :], "f": f[:, None], "X": gain.T, "note": "rig 3"} | changes
    scipy.io.savemat(path, {"L10R": field, "other": np.arange(3.0)})
    return gain


STRUCT = {"variable": "L10R", "angle": "a", "frequency": "f", "values": "X", "angle_unit": "radian"}


@pytest.mark.parametrize("transposed", [False, True])
def test_a_struct_as_laboratories_store_it(tmp_path: Path, transposed: bool) -> None:
    gain = laboratory(tmp_path / "beam.mat")
    if transposed:
        laboratory(tmp_path / "beam.mat", X=gain)
    with pytest.warns(clsim.ClsimWarning, match=r"from -5° to 185°; .* within 0.0017 of"):
        table = AxialDirectivity.from_mat(tmp_path / "beam.mat", **STRUCT)
    np.testing.assert_allclose(table.angles_degrees, np.arange(0.0, 181.0, 5.0), atol=1e-9)
    np.testing.assert_array_equal(table.values, gain[1:-1])


def test_angles_beside_the_axis_make_its_values(tmp_path: Path) -> None:
    laboratory(tmp_path / "beam.mat", offset=2.5)
    with pytest.warns(clsim.ClsimWarning, match=r"from -2.5° to 187.5°"):
        table = AxialDirectivity.from_mat(tmp_path / "beam.mat", **STRUCT)
    assert table.angles_degrees[[0, 1, -2, -1]].tolist() == [0.0, 2.5, 177.5, 180.0]
    np.testing.assert_allclose(np.abs(table.values[[0, -1]]), [[2.1] * 118, [0.1] * 118], atol=1e-4)


def test_levels_beyond_the_axis_are_told_in_db() -> None:
    with pytest.warns(clsim.ClsimWarning, match=r"from -10° to 180°.* within 1.5 dB"):
        table = AxialDirectivity([-10, 0, 10, 180], [1e3], [[-2.0], [0.0], [-0.5], [-20.0]], scale="db")
    assert table.values.ravel().tolist() == [0.0, -0.5, -20.0]


@pytest.mark.parametrize(
    ("asked", "field", "message"),
    few([
        ({"variable": None}, "angle", "'L10R' is a struct: give variable=\"L10R\""),
        ({"variable": "R10L"}, "variable", 'must be one of "L10R", "other", but is \'R10L\''),
        ({"variable": "other"}, "variable", "must be a struct"),
        ({"angle": "b"}, "angle", 'must be one of "X", "a", "f", "note", but is \'b\''),
        ({"values": "note"}, "values", "numbers"),
    ], (0, 3)),
)  # fmt: skip
def test_structs_that_lack_something(tmp_path: Path, asked: dict, field: str, message: str) -> None:
    laboratory(tmp_path / "beam.mat")
    with pytest.raises(clsim.InputError) as error:
        AxialDirectivity.from_mat(tmp_path / "beam.mat", **(STRUCT | asked), scale="linear")
    assert error.value.field == field
    assert message in error.value.problem


@pytest.mark.parametrize(
    "content", few([b"", b"PK", b"PK\x03\x04" + bytes(100), b"MATLAB" + bytes(300), b"angle,1\n0,0\n"], (2, 3))
)
def test_files_that_are_not_what_they_claim(tmp_path: Path, content: bytes) -> None:
    for kind, read in (("npz", AxialDirectivity.from_npz), ("mat", AxialDirectivity.from_mat)):
        path = tmp_path / f"beam.{kind}"
        path.write_bytes(content)
        with pytest.raises(clsim.InputError, match="must be a") as error:
            read(path)
        assert error.value.field == "path"
    (tmp_path / "beam.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(clsim.InputError, match="must be a text file"):
        AxialDirectivity.from_csv(tmp_path / "beam.csv")


def test_files_cut_short(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "whole.npz", **arrays)
    scipy.io.savemat(tmp_path / "whole.mat", arrays)
    for kind, read in (("npz", AxialDirectivity.from_npz), ("mat", AxialDirectivity.from_mat)):
        whole = (tmp_path / f"whole.{kind}").read_bytes()
        for share in (0.1, 0.5, 0.9, 0.99) if kind == "npz" else (0.1, 0.9):
            (tmp_path / f"cut.{kind}").write_bytes(whole[: int(share * len(whole))])
            with pytest.raises(clsim.InputError) as error:
                read(tmp_path / f"cut.{kind}")
            assert error.value.field in ("path", "values", "frequencies")


def test_objects_and_single_arrays_are_no_table(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "objects.npz", **(arrays | {"values": np.array([{"a": 1}], dtype=object)}))
    np.save(tmp_path / "array.npy", arrays["values"])
    for name in ("objects.npz", "array.npy"):
        with pytest.raises(clsim.InputError, match=r"must be a \.npz file"):
            AxialDirectivity.from_npz(tmp_path / name)


def test_matlab_s_newer_format_says_what_to_do(tmp_path: Path) -> None:
    # The header of version 7.3, before an HDF5 file: 124 bytes of text, then version 2.0 and the order of bytes.
    header = b"MATLAB 7.3 MAT-file".ljust(124, b" ") + b"\x00\x02IM"
    (tmp_path / "new.mat").write_bytes(header.ljust(512, b"\x00") + b"\x89HDF\r\n\x1a\n")
    with pytest.raises(clsim.InputError, match="-v7") as error:
        AxialDirectivity.from_mat(tmp_path / "new.mat")
    assert error.value.field == "path"


@pytest.mark.parametrize("read", [AxialDirectivity.from_csv, AxialDirectivity.from_npz, AxialDirectivity.from_mat])
def test_missing_files_and_folders(tmp_path: Path, read) -> None:
    for path in (tmp_path / "missing.csv", tmp_path):
        with pytest.raises(clsim.InputError, match="cannot be read") as error:
            read(path)
        assert error.value.field == "path"
