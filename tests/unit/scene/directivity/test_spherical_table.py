"""Directivities as tables over the whole sphere, and by formulae."""

import subprocess
import sys

import numpy as np
import pytest

import clsim
from clsim import SphericalDirectivity
from clsim.acoustics.directivity import piston_gain
from clsim.errors import InputError
from clsim.numerics.quaternions import rotate
from clsim.numerics.sphere import GridOnSphere, largest_hole, merged
from clsim.scene.directivity.directivity import AxisymmetricDirectivity, Directivity
from clsim.scene.directivity.patterns import FirstOrder, Omni, Piston

ANGLES = np.radians(np.linspace(0.0, 180.0, 181))
ALL = [Omni(), FirstOrder(0.0), FirstOrder(0.25), FirstOrder(), FirstOrder(1.0), Piston(0.0047), Piston(0.1)]


@pytest.mark.parametrize("directivity", ALL, ids=repr)
def test_gain_is_one_on_the_axis_and_nowhere_more(directivity):
    gain = directivity.gain(np.cos(ANGLES), 40e3, 343.0)
    assert gain.shape == ANGLES.shape
    assert gain[0] == pytest.approx(1.0, rel=1e-15)
    assert np.all(np.abs(gain) <= 1.0 + 1e-15)
    assert isinstance(directivity, AxisymmetricDirectivity)
    assert directivity.gain(np.zeros((3, 4)), 40e3, 343.0).shape == (3, 4)
    assert (directivity.is_complex, directivity.band) == (False, (0.0, np.inf))


def test_first_order_patterns():
    sides = np.array([1.0, 0.0, -1.0])
    np.testing.assert_array_equal(Omni().gain(sides, 1e3, 343.0), [1, 1, 1])
    np.testing.assert_array_equal(FirstOrder(1.0).gain(sides, 1e3, 343.0), [1, 1, 1])
    np.testing.assert_array_equal(FirstOrder(0.5).gain(sides, 1e3, 343.0), [1, 0.5, 0])
    np.testing.assert_array_equal(FirstOrder(0.25).gain(sides, 1e3, 343.0), [1, 0.25, -0.5])
    np.testing.assert_array_equal(FirstOrder(0.0).gain(sides, 1e3, 343.0), [1, 0, -1])


@pytest.mark.parametrize("frequency", [10e3, 40e3, 80e3])
@pytest.mark.parametrize("radius", [0.0047, 0.012])
def test_piston_is_the_integral_over_its_face(radius, frequency):
    # Far field of a disc: the mean of exp(i k x sin(theta)) over it. With x = a sin(u) the midpoint rule
    # over u converges faster than any power, so 1e-12 is rounding.
    u = (np.arange(200) + 0.5) * np.pi / 200 - np.pi / 2
    angles = np.radians([0.0, 1e-4, *range(1, 91)])
    phase = 2 * np.pi * frequency / 343.0 * radius * np.sin(u) * np.sin(angles)[:, None]
    integral = np.sum(np.cos(phase) * np.cos(u) ** 2, axis=1) / np.sum(np.cos(u) ** 2)
    np.testing.assert_allclose(Piston(radius).gain(np.cos(angles), frequency, 343.0), integral, rtol=0, atol=1e-12)


def test_piston_has_no_seam_near_the_axis():
    # Either side of the switch to the series, x = 1e-4, the gain differs from 1 by x^2/8 to rounding.
    frequency, c, radius = 343.0 / (2 * np.pi), 343.0, 1.0
    for x in (0.99e-4, 1.01e-4):
        gain = piston_gain(np.sqrt(1.0 - x**2), frequency, radius, c)
        assert gain == pytest.approx(1.0 - x**2 / 8.0, abs=1e-15)


def test_piston_keeps_its_value_at_the_baffle_behind_it():
    gain = Piston(0.0047).gain(np.array([0.0, -1e-9, -0.5, -1.0]), 40e3, 343.0)
    assert np.all(gain == gain[0])
    assert gain[0] != pytest.approx(1.0, abs=0.5)


@pytest.mark.parametrize("name", [name for name in Directivity.names() if name.startswith("MA40")])
def test_murata_s_transducers_have_a_beam_of_80_degrees(name):
    # The piston's radius has two digits: 1 % of it moves the level at 40 degrees by 0.13 dB.
    gain = Directivity.named(name).gain(np.cos(np.radians([40.0, 35.0, 45.0])), 40e3, 343.994)
    level = 20 * np.log10(gain)
    assert level[0] == pytest.approx(-6.02, abs=0.13)
    assert level[2] < -6.5
    assert level[1] > -5.5


def test_names_are_known_to_who_imports_nothing_else():
    code = "import clsim; print(*clsim.Directivity.names(), clsim.Directivity.named('MA40S4S'))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["MA40S4S", "MA40S4R", "T4010A1", "Piston(radius=0.0047)"]


def test_nicera_s_transducer_has_the_published_levels():
    # As published for 40 kHz, 0 to 90 degrees in steps of 10.
    published = [0, 0, 0, -1, -3, -6, -9, -12, -14, -15]
    beam = Directivity.named("T4010A1")
    angles = np.radians(np.arange(0.0, 91.0, 10.0))
    np.testing.assert_allclose(20 * np.log10(beam.gain(np.cos(angles), 40e3, 343.0)), published, atol=1e-9)
    fine = np.radians(np.linspace(0.0, 180.0, 3601))
    level = 20 * np.log10(beam.gain(np.cos(fine), 40e3, 343.0))
    assert np.all(np.diff(level) <= 1e-9)
    np.testing.assert_allclose(level[fine > np.pi / 2], -15.0, atol=1e-9)
    assert not beam.is_complex
    with pytest.raises(InputError, match="outside"):
        beam.gain(np.ones(1), 41e3, 343.0)
    held = Directivity.named("T4010A1", outside="hold")
    np.testing.assert_array_equal(held.gain(np.cos(fine), 41e3, 343.0), beam.gain(np.cos(fine), 40e3, 343.0))


def test_bad_values_are_refused_by_name_of_patterns():
    for weight in (-0.1, 1.1, np.nan, "0.5", None):
        with pytest.raises(InputError) as error:
            FirstOrder(weight)
        assert error.value.field == "weight"
    for radius in (0.0, -1.0, np.inf, None):
        with pytest.raises(InputError) as error:
            Piston(radius)
        assert error.value.field == "radius"
    with pytest.raises(InputError, match="MA40S4R") as error:
        Directivity.named("MA40")
    assert error.value.field == "name"
    with pytest.raises(InputError, match="hold") as error:
        Directivity.named("MA40S4R", outside="zero")
    assert error.value.field == "outside"


def test_directivities_are_values():
    assert Piston(0.0047) == Directivity.named("MA40S4S")
    assert len({Omni(), Omni(), FirstOrder(), FirstOrder(0.5)}) == 2


@pytest.mark.parametrize("directivity", ALL, ids=repr)
def test_a_direction_is_seen_by_its_angle_from_the_axis(directivity):
    towards = np.stack([np.cos(ANGLES), 0.6 * np.sin(ANGLES), -0.8 * np.sin(ANGLES)], axis=-1)
    f = np.array([1e3, 40e3])
    gain = directivity.gain_towards(towards[:, None], f, 343.0)
    np.testing.assert_array_equal(gain, directivity.gain(np.cos(ANGLES)[:, None], f, 343.0))


def test_what_gives_no_gain_is_no_directivity():
    class Lacking(AxisymmetricDirectivity):
        is_complex = False
        band = (0.0, np.inf)

    with pytest.raises(TypeError, match="abstract"):
        Lacking()
    tone = clsim.Signal.tone(40e3, 0.1, 192e3)
    for given in (Lacking, "omni", lambda cosine: cosine):
        with pytest.raises(InputError, match=r"^directivity: must be a Directivity"):
            clsim.Source("s", tone, clsim.Trajectory.fixed((1, 1, 1)), directivity=given)


SPEED = 343.0
PLACES = np.array([[0.012, 0.004, -0.003], [-0.004, 0.006, 0.009]])  # m, of two unequal sources


def pattern(directions: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Return (n, f): two directional sources at different places, out of step with each other."""
    x, y, z = directions.T
    k = 2 * np.pi * np.asarray(frequencies) / SPEED
    one, other = (np.exp(1j * k * (directions @ place)[:, None]) for place in PLACES)
    return 0.7 * one * (1 + 0.3 * x)[:, None] + 0.4j * other * (1 - 0.5 * y * z)[:, None]


def grid(step: float, *, poles: bool = True) -> np.ndarray:
    elevations = np.arange(-90.0, 90.1, step) if poles else np.arange(-90.0 + step / 2, 90.0, step)
    e, a = np.meshgrid(np.radians(elevations), np.radians(np.arange(0.0, 360.0, step)), indexing="ij")
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1).reshape(-1, 3)


def spiral(count: int) -> np.ndarray:
    """Return points spread evenly, on no grid."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + np.sqrt(5)) * i
    around = np.sqrt(1 - z**2)
    return np.column_stack([around * np.cos(turn), around * np.sin(turn), z])


def anywhere(rng: np.random.Generator, count: int = 3000) -> np.ndarray:
    points = rng.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


SETS = {
    "grid": grid(10.0), "grid without poles": grid(10.0, poles=False), "fine grid": grid(5.0),
    "spiral": spiral(648), "few": spiral(100),
}  # fmt: skip


@pytest.mark.parametrize("name", SETS)
def test_the_table_s_own_directions_come_back(name: str) -> None:
    f = np.array([10e3, 20e3, 40e3])
    table = SphericalDirectivity(SETS[name], f, pattern(SETS[name], f))
    assert table.is_complex
    gain = table.gain_towards(SETS[name][:, None], f, SPEED)
    np.testing.assert_allclose(gain, pattern(SETS[name], f), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "frequency", "allowed"),
    # Measured: -94, -56, -94, -83, -58, -72, -66 dB of the loudest direction.
    [
        ("grid", 5e3, -88), ("grid", 20e3, -50), ("grid without poles", 5e3, -88), ("fine grid", 20e3, -78),
        ("fine grid", 40e3, -53), ("spiral", 20e3, -66), ("few", 5e3, -60),
    ],
)  # fmt: skip
def test_between_directions_it_is_the_pattern(name: str, frequency: float, allowed: float, rng, measured) -> None:
    f = np.array([frequency])
    table = SphericalDirectivity(SETS[name], f, pattern(SETS[name], f))
    towards = anywhere(rng)
    expected = pattern(towards, f)[:, 0]
    error = table.gain_towards(towards, frequency, SPEED) - expected
    found = 20 * np.log10(np.abs(error).max() / np.abs(expected).max())
    measured("tables over the sphere", "two unequal sources", found, allowed)


def test_between_frequencies_it_is_the_pattern(rng) -> None:
    f, towards = np.arange(10e3, 30.1e3, 1e3), anywhere(rng, 500)
    table = SphericalDirectivity(SETS["fine grid"], f, pattern(SETS["fine grid"], f))
    between = np.arange(12.5e3, 28e3, 1e3)
    error = table.gain_towards(towards[:, None], between, SPEED) - pattern(towards, between)
    assert 20 * np.log10(np.abs(error).max()) < -60


@pytest.mark.parametrize("name", SETS)
def test_real_values_stay_real(name: str, rng) -> None:
    directions = SETS[name]
    table = SphericalDirectivity(directions, [1e3], 0.5 + 0.5 * directions[:, 1:2])  # loud towards +y, to the left
    assert not table.is_complex
    gain = table.gain_towards(np.array([[0, 1, 0], [0, -1, 0], [1, 0, 0]]), 1e3, SPEED)
    assert gain.dtype == np.float64
    np.testing.assert_allclose(gain, [1.0, 0.0, 0.5], atol=2e-4)


def test_poles_are_no_seam(rng) -> None:
    f = np.array([20e3])
    for name in ("grid", "grid without poles"):
        table = SphericalDirectivity(SETS[name], f, pattern(SETS[name], f))
        for pole in (1.0, -1.0):
            tilt = np.linspace(-0.02, 0.02, 41)  # a great circle over the pole
            towards = np.column_stack([np.sin(tilt) * 0.6, np.sin(tilt) * 0.8, pole * np.cos(tilt)])
            gain = table.gain_towards(towards, 20e3, SPEED)
            bends = np.abs(np.diff(gain, 2)).max() / 0.001**2
            assert bends < 1.2 * np.abs(np.diff(pattern(towards, f)[:, 0], 2)).max() / 0.001**2 + 0.05


def test_a_turned_table_is_the_table_turned(rng) -> None:
    turn = np.array([0.1, -0.3, 0.5, 0.8])
    turn /= np.linalg.norm(turn)
    f, points = np.array([10e3]), SETS["spiral"]
    table = SphericalDirectivity(points, f, pattern(points, f))
    turned = SphericalDirectivity(rotate(turn, points), f, pattern(points, f))
    towards = anywhere(rng, 200)
    np.testing.assert_allclose(
        turned.gain_towards(rotate(turn, towards), 10e3, SPEED), table.gain_towards(towards, 10e3, SPEED), atol=1e-8
    )


def test_grids_are_recognised_in_any_order(rng) -> None:
    points = grid(15.0)
    unique = merged(points, np.zeros((len(points), 1)))[0]
    assert len(unique) == 11 * 24 + 2  # a pole is one direction
    shuffled = unique[rng.permutation(len(unique))]
    found = GridOnSphere.of(shuffled)
    assert found is not None
    assert found.index.shape == (13, 24)
    np.testing.assert_allclose(np.cos(found.colatitudes), shuffled[found.index[:, 0], 2], atol=1e-12)
    assert GridOnSphere.of(shuffled[:-1]) is None
    assert GridOnSphere.of(spiral(200)) is None
    assert GridOnSphere.of(np.delete(unique, 5, axis=0)) is None


def test_directions_given_twice_are_averaged() -> None:
    points = np.vstack([spiral(50), spiral(50)[3:4]])
    values = np.ones((51, 1))
    values[50] = 3.0
    table = SphericalDirectivity(points, [1e3], values)
    assert len(table.directions) == 50
    assert table.gain_towards(points[3], 1e3, SPEED) == pytest.approx(2.0)


def test_relative_to_the_axis(rng) -> None:
    f = np.linspace(10e3, 20e3, 41)
    points = SETS["spiral"]
    through_air = np.exp(-2j * np.pi * f * 3e-3)
    table = SphericalDirectivity(points, f, pattern(points, f) * through_air, relative_to_axis=True)
    np.testing.assert_allclose(table.gain_towards([1, 0, 0], f, SPEED), 1.0, atol=1e-6)
    towards = anywhere(rng, 100)
    expected = pattern(towards, f) / pattern(np.array([[1.0, 0, 0]]), f)
    np.testing.assert_allclose(table.gain_towards(towards[:, None], f, SPEED), expected, atol=2e-3)


def test_frequencies_and_shapes() -> None:
    f = np.array([10e3, 20e3])
    table = SphericalDirectivity(SETS["few"], f, pattern(SETS["few"], f))
    assert table.band == (10e3, 20e3)
    assert isinstance(table, Directivity)
    assert not isinstance(table, AxisymmetricDirectivity)
    assert table.gain_towards([1, 0, 0], 15e3, SPEED).shape == ()
    assert table.gain_towards(np.ones((4, 5, 1, 3)), f, SPEED).shape == (4, 5, 2)
    assert table.gain_towards([1, 0, 0], np.full((2, 3), 15e3), SPEED).shape == (2, 3)
    pairs = table.gain_towards(SETS["few"][:2], f, SPEED)
    np.testing.assert_allclose(pairs, np.diag(pattern(SETS["few"][:2], f)), atol=1e-9)
    with pytest.raises(clsim.InputError, match="outside"):
        table.gain_towards([1, 0, 0], 21e3, SPEED)
    held = SphericalDirectivity(SETS["few"], f, pattern(SETS["few"], f), outside="hold")
    assert np.abs(held.gain_towards([1, 0, 0], 30e3, SPEED)) == pytest.approx(
        np.abs(held.gain_towards([1, 0, 0], 20e3, SPEED))
    )


def test_holes() -> None:
    assert largest_hole(np.vstack([np.eye(3), -np.eye(3)])) == pytest.approx(54.7356, abs=1e-3)
    assert largest_hole(grid(10.0)) < 10.0
    assert largest_hole(np.eye(3)) == 180.0


UPPER = spiral(200)[:100]


@pytest.mark.parametrize(
    ("directions", "frequencies", "values", "field", "message"),
    [
        (UPPER, [1e3], np.ones((100, 1)), "directions", "all lie on one side"),
        (spiral(200)[:140], [1e3], np.ones((140, 1)), "directions", "no gap wider than 60°"),
        (np.eye(3), [1e3], np.ones((3, 1)), "directions", "surround"),
        (np.zeros((9, 3)), [1e3], np.ones((9, 1)), "directions[0]", "length above 0"),
        (np.ones((9, 2)), [1e3], np.ones((9, 1)), "directions", "shape"),
        (np.full((9, 3), np.nan), [1e3], np.ones((9, 1)), "directions[0][0]", "finite"),
        (np.empty((0, 3)), [1e3], np.ones((0, 1)), "directions", "empty"),
        (spiral(50), [1e3], np.ones((1, 50)), "values", "50 x 1, but are 1 x 50; transpose"),
        (spiral(50), [1e3], np.full((50, 1), np.nan), "values[0][0]", "finite"),
        (spiral(50), [1e3], np.zeros((50, 1)), "values", "not all be 0"),
        (spiral(50), [2e3, 1e3], np.ones((50, 2)), "frequencies", "increase"),
        (spiral(4001), [1e3], np.ones((4001, 1)), "directions", "at most 4000"),
    ],
)
def test_bad_values_are_refused_by_name(directions, frequencies, values, field: str, message: str) -> None:
    with pytest.raises(clsim.InputError) as error:
        SphericalDirectivity(directions, frequencies, values)
    assert error.value.field == field
    assert message in error.value.problem
