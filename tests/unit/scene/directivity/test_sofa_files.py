"""Directivities in SOFA files."""

import sys
from pathlib import Path

import numpy as np
import pytest
from late import installed

import clsim
from clsim import SphericalDirectivity

sofar = installed("sofar")

FREQUENCIES = np.array([10e3, 15e3, 20e3])
SPEED = 343.0


def grid(step: float = 30.0) -> np.ndarray:
    """Return azimuths and elevations (n, 2) in degrees, poles once."""
    inner = [(a, e) for e in np.arange(-90.0 + step, 90.0, step) for a in np.arange(0.0, 360.0, step)]
    return np.array([(0.0, -90.0), *inner, (0.0, 90.0)])


def unit(angles: np.ndarray) -> np.ndarray:
    a, e = np.radians(angles).T
    return np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def pattern(directions: np.ndarray) -> np.ndarray:
    """Return values (n, 3) that differ in front, at the left and above."""
    x, y, z = directions.T
    return (1.0 + 0.4 * x + 0.3j * y + 0.2 * z)[:, None] * np.array([1.0, 0.9j, 0.8])


def transfer_functions(path: Path, **changes) -> Path:
    sofa = sofar.Sofa("FreeFieldDirectivityTF")
    for name in ("EmitterDescriptions", "Description"):
        sofa.delete(name)
    values = pattern(unit(grid()))
    sofa.ReceiverPosition = np.column_stack([grid(), np.full(len(grid()), 2.0)])
    sofa.N, sofa.Data_Real, sofa.Data_Imag = FREQUENCIES, values.real[None], values.imag[None]
    for name, value in changes.items():
        setattr(sofa, name, value)
    sofar.write_sofa(str(path), sofa)
    return path


def test_front_left_and_up_are_ours(tmp_path: Path) -> None:
    table = SphericalDirectivity.from_sofa(transfer_functions(tmp_path / "a.sofa"), name="a")
    assert table.band == (10e3, 20e3)
    towards = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(
        table.gain_towards(towards, 10e3, SPEED), [1.4, 0.6, 1 + 0.3j, 1.2], atol=1e-12
    )  # front, rear, left, up
    on_grid = table.gain_towards(unit(grid())[:, None], FREQUENCIES, SPEED)
    np.testing.assert_allclose(on_grid, pattern(unit(grid())), atol=1e-9)


def test_cartesian_positions_and_a_turned_moved_source(tmp_path: Path) -> None:
    # The source looks along +y with its top along +x; the microphones are told in the listener's axes, which look
    # along -x, and stand about the same point.
    view, up = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    source = np.column_stack([view, np.cross(up, view), up])  # front, left, up as columns
    listener = np.array([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]]).T
    place, centre = np.array([0.5, 1.0, -2.0]), np.array([0.0, 1.0, 0.0])
    world = 1.5 * unit(grid()) @ source.T + place
    path = transfer_functions(
        tmp_path / "turned.sofa",
        SourceView=view[None], SourceUp=up[None], SourcePosition=place[None], ListenerPosition=centre[None],
        ListenerView=np.array([[-1.0, 0, 0]]), ReceiverPosition=(world - centre) @ listener,
        ReceiverPosition_Type="cartesian", ReceiverPosition_Units="metre",
    )  # fmt: skip
    table = SphericalDirectivity.from_sofa(path)
    np.testing.assert_allclose(table.directions, unit(grid()), atol=1e-12)
    np.testing.assert_allclose(table.values, pattern(unit(grid())), atol=1e-12)


def test_one_of_several_measurements(tmp_path: Path) -> None:
    values = np.stack([pattern(unit(grid())), 2.0 * pattern(unit(grid()))])
    path = transfer_functions(tmp_path / "two.sofa", Data_Real=values.real, Data_Imag=values.imag)
    np.testing.assert_allclose(SphericalDirectivity.from_sofa(path, measurement=1).values, values[1])
    with pytest.raises(clsim.InputError, match="from 0 to 1, but is 2") as error:
        SphericalDirectivity.from_sofa(path, measurement=2)
    assert error.value.field == "measurement"


def test_one_frequency_and_options(tmp_path: Path) -> None:
    values = pattern(unit(grid()))[:, :1]
    path = transfer_functions(
        tmp_path / "one.sofa", N=np.array([10e3]), Data_Real=values.real[None], Data_Imag=values.imag[None]
    )
    table = SphericalDirectivity.from_sofa(path, outside="hold", relative_to_axis=True)
    assert table.band == (0.0, np.inf)
    assert table.gain_towards([1, 0, 0], 12e3, SPEED) == pytest.approx(1.0, abs=1e-4)


def test_impulse_responses_become_their_spectrum(tmp_path: Path, rng) -> None:
    # Two taps whose places differ by direction; the spectrum is a closed form.
    rate, count = 192e3, len(grid())
    samples = np.zeros((count, 64))
    first, second = 20, 20 + np.arange(count) % 7
    samples[:, first] = 1.0
    samples[np.arange(count), second] += 0.5
    sofa = sofar.Sofa("GeneralFIR")
    sofa.ReceiverPosition = np.column_stack([grid(), np.ones(count)])
    sofa.ReceiverPosition_Type, sofa.ReceiverPosition_Units = "spherical", "degree, degree, metre"
    sofa.SourcePosition, sofa.SourcePosition_Type = np.zeros((1, 3)), "cartesian"
    sofa.SourcePosition_Units = "metre"
    sofa.Data_IR, sofa.Data_SamplingRate = samples[None], rate
    sofa.Data_Delay = np.arange(count)[None].astype(float)
    sofar.write_sofa(str(tmp_path / "ir.sofa"), sofa)
    table = SphericalDirectivity.from_sofa(tmp_path / "ir.sofa")
    assert table.frequencies[[0, -1]].tolist() == [0.0, 96e3]
    turn = -2j * np.pi * table.frequencies / rate
    at = np.arange(count)[:, None]
    expected = np.exp(turn * (first + at)) + 0.5 * np.exp(turn * (second[:, None] + at))
    np.testing.assert_allclose(table.values, expected, atol=1e-10)
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(tmp_path / "ir.sofa", "a") as file:  # a convention that sofar does not know
        file.SOFAConventions = "FreeFieldDirectivityIR"
    np.testing.assert_array_equal(SphericalDirectivity.from_sofa(tmp_path / "ir.sofa").values, table.values)


def test_between_the_bins_of_an_impulse_response(tmp_path: Path) -> None:
    # A point source 8 mm in front of the centre, 1 m away: fractional delays, windowed sinc.
    rate, count = 192e3, len(grid(10.0))
    delay = (1.0 - 0.008 * unit(grid(10.0))[:, 0]) / SPEED * rate - 500.0
    n = np.arange(128)[None] - delay[:, None]
    samples = np.sinc(n) * np.where(np.abs(n) < 40, np.cos(np.pi * n / 80) ** 2, 0.0)
    sofa = sofar.Sofa("GeneralFIR")
    sofa.ReceiverPosition = np.column_stack([grid(10.0), np.ones(count)])
    sofa.ReceiverPosition_Type, sofa.ReceiverPosition_Units = "spherical", "degree, degree, metre"
    sofa.SourcePosition, sofa.SourcePosition_Type = np.zeros((1, 3)), "cartesian"
    sofa.SourcePosition_Units = "metre"
    sofa.Data_IR, sofa.Data_SamplingRate, sofa.Data_Delay = samples[None], rate, np.zeros((1, count))
    sofar.write_sofa(str(tmp_path / "ir.sofa"), sofa)
    table = SphericalDirectivity.from_sofa(tmp_path / "ir.sofa", relative_to_axis=True)
    towards = unit(np.array([[37.0, 21.0], [100.0, -63.0], [181.0, 4.0]]))
    for f in (20_123.0, 40_456.0, 60_789.0):
        expected = np.exp(2j * np.pi * f / SPEED * 0.008 * (towards[:, 0] - 1.0))
        np.testing.assert_allclose(table.gain_towards(towards, f, SPEED), expected, atol=2e-3)


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "bad.sofa"
    for content in (b"", b"hello" * 100, b"\x89HDF\r\n\x1a\n" + bytes(200)):
        path.write_bytes(content)
        with pytest.raises(clsim.InputError, match="must be a SOFA file") as error:
            SphericalDirectivity.from_sofa(path)
        assert error.value.field == "path"
    for missing in (tmp_path / "missing.sofa", tmp_path / "folder.sofa"):
        (tmp_path / "folder.sofa").mkdir(exist_ok=True)
        with pytest.raises(clsim.InputError, match="cannot be read"):
            SphericalDirectivity.from_sofa(missing)
    with pytest.raises(clsim.InputError, match=r"must end in \.sofa"):
        SphericalDirectivity.from_sofa(tmp_path / "beam.csv")


def test_sofa_files_cut_short(tmp_path: Path) -> None:
    whole = transfer_functions(tmp_path / "whole.sofa").read_bytes()
    for share in (0.2, 0.6, 0.95):
        (tmp_path / "cut.sofa").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(clsim.InputError):
            SphericalDirectivity.from_sofa(tmp_path / "cut.sofa")


def test_other_conventions_and_odd_geometry(tmp_path: Path) -> None:
    sofa = sofar.Sofa("SimpleFreeFieldHRIR")
    sofar.write_sofa(str(tmp_path / "hrir.sofa"), sofa)
    with pytest.raises(clsim.InputError, match=r"FreeFieldDirectivityTF.*'SimpleFreeFieldHRIR'"):
        SphericalDirectivity.from_sofa(tmp_path / "hrir.sofa")
    positions = np.column_stack([grid(), np.full(len(grid()), 2.0)])
    positions[3, 2] = 2.5
    for changes, message in (
        ({"ReceiverPosition": positions}, "on a sphere about the source"),
        ({"SourceUp": np.array([[2.0, 0, 0]])}, "different directions"),
        ({"ListenerPosition": np.full((1, 3), 0.3)}, "on a sphere about the source"),
        ({"N": FREQUENCIES[::-1].copy()}, "increase strictly"),
        ({"Data_Real": np.full((1, len(grid()), 3), np.nan)}, "must be finite"),
    ):
        with pytest.raises(clsim.InputError, match=message):
            SphericalDirectivity.from_sofa(transfer_functions(tmp_path / "odd.sofa", **changes))


def test_without_the_package_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = transfer_functions(tmp_path / "a.sofa")
    monkeypatch.setitem(sys.modules, "netCDF4", None)
    with pytest.raises(clsim.InputError, match=r"pip install 'clsim\[sofa\]'"):
        SphericalDirectivity.from_sofa(path)
