"""Materials from tables and from formulae: absorption, factors, impedances, solids, porous layers, roughness."""

import math
import warnings

import numpy as np
import pytest

from clsim.acoustics.reflection import (
    AIR_DENSITY,
    backed_layer_reflection,
    boundary_layer_admittance,
    porous_medium,
)
from clsim.errors import ClsimWarning, InputError
from clsim.scene.material.material import Material

EXACT = 1e-13  # a few roundings of float64
COSINES = [1.0, 0.5, 0.03]


# impedances


@pytest.mark.parametrize("impedance", [0.0, 1.0, 2.5 - 1.3j, 0.2 + 4j, 50.0 - 0.1j, -0.0 - 3j])
@pytest.mark.parametrize("cosine", COSINES)
def test_impedances_reflect_by_the_formula(impedance, cosine):
    material = Material.from_impedance([1e3, 50e3], [impedance, impedance])
    expected = (impedance * cosine - 1) / (impedance * cosine + 1)
    assert material.reflection_at(40e3, cosine) == pytest.approx(expected, rel=EXACT, abs=EXACT)
    assert material.is_complex
    assert material.depends_on_angle


def test_impedances_are_joined_over_octaves():
    material = Material.from_impedance([1e3, 4e3], [1.0 + 1j, 3.0 - 3j])
    zeta = 2.0 - 1.0j  # halfway
    assert material.reflection_at(2e3, 0.5) == pytest.approx((zeta * 0.5 - 1) / (zeta * 0.5 + 1), rel=EXACT)


# solids, fibres, roughness


@pytest.mark.parametrize(
    ("density", "speed", "loss"), [(2300.0, 3500.0, 1.03e-4), (2500.0, 5600.0, 5.9e-5), (7850.0, 5900.0, 1.8e-5)]
)
def test_hard_solids_reflect_nearly_all(density, speed, loss):
    """Concrete, glass, steel: 2 ρ c / Z is lost, to the first order."""
    material = Material.from_solid(density, speed, boundary_layer=False)
    factor = material.reflection_at(40e3, COSINES, 343.2)
    ratio = density * speed / (AIR_DENSITY * 343.2)
    np.testing.assert_allclose(factor, (ratio - 1) / (ratio + 1), rtol=EXACT)
    assert 1.0 - factor[0] == pytest.approx(loss, rel=0.02)
    assert factor[0] > 0.999
    assert (material.is_complex, material.depends_on_angle) == (False, False)


def test_the_boundary_layer_takes_its_part():
    """Kirchhoff's attenuation along a wall: a duct's, from the same admittance at grazing incidence.

    Per metre and per ratio of perimeter to area L/S it is ``Re(β) L / (2 S)``, which for a circular tube of radius a is
    ``sqrt(ω ν / 2) / (a c) (1 + (γ - 1) / sqrt(Pr))``: G. Kirchhoff 1868, in all textbooks.
    """
    f, radius, c = 1e3, 0.02, 343.2
    beta = boundary_layer_admittance(f, 0.0, c)
    kirchhoff = math.sqrt(2 * math.pi * f * 1.51e-5 / 2) / (radius * c) * (1 + 0.4 / math.sqrt(0.71))
    assert beta.real / radius == pytest.approx(kirchhoff, rel=1e-12)
    assert beta.imag == pytest.approx(beta.real, rel=1e-15)
    wall = Material.from_solid(1e6, 1e6)  # nothing but the boundary layer
    at = np.array([1.0, 0.5, 0.1])
    layer = boundary_layer_admittance(40e3, at, 343.2)
    np.testing.assert_allclose(wall.reflection_at(40e3, at), (at - layer) / (at + layer), rtol=1e-9)
    assert abs(wall.reflection_at(40e3)) == pytest.approx(0.9962, abs=1e-4)
    assert (wall.is_complex, wall.depends_on_angle) == (True, True)
    # At 60 degrees sin² is 3/4; 0.4 / sqrt(0.71) is the heat's share.
    assert layer[1] / layer[0] == pytest.approx(1 + 0.75 * math.sqrt(0.71) / 0.4, rel=1e-12)
    concrete = Material.from_solid(2300.0, 3500.0)
    bare = Material.from_solid(2300.0, 3500.0, boundary_layer=False).reflection_at(40e3)
    np.testing.assert_allclose(concrete.reflection_at(40e3, at), bare * (at - layer) / (at + layer), rtol=EXACT)


def test_a_layer_of_air_on_a_wall_is_a_delay():
    phase = np.linspace(0.1, 20.0, 50)
    for cosine in COSINES:
        got = backed_layer_reflection(1.0, 1.0, phase, cosine)
        np.testing.assert_allclose(got, np.exp(-2j * phase * cosine), rtol=0, atol=1e-12)


@pytest.mark.parametrize("ratio", [0.01, 0.05, 1.0])
def test_miki_in_its_other_form(ratio):
    """The form with 1000 f / σ, as it is printed too, with its own rounded coefficients."""
    X = 1000.0 * ratio
    impedance, index = porous_medium(ratio * 20e3, 20e3)
    for got, expected in ((impedance - 1, (5.50 - 8.43j) * X**-0.632), (index - 1, (7.81 - 11.41j) * X**-0.618)):
        assert got.real == pytest.approx(expected.real, rel=4e-3)
        assert got.imag == pytest.approx(expected.imag, rel=4e-3)


@pytest.mark.parametrize("cosine", COSINES)
def test_a_porous_layer_against_the_cotangent(cosine):
    f, c, sigma, d = np.geomspace(600.0, 50e3, 40), 343.2, 50e3, 0.006
    impedance, index = porous_medium(f, sigma)
    k = 2 * np.pi * f / c
    q = k * np.sqrt(index**2 - (1 - cosine**2))
    surface = -1j * impedance * (k * index / q) / np.tan(q * d)
    expected = (surface * cosine - 1) / (surface * cosine + 1)
    got = Material.from_porous(sigma, d).reflection_at(f, cosine, c)
    np.testing.assert_allclose(got, expected, rtol=1e-11)


def test_miki_is_refused_outside_its_range_or_extended_by_name():
    material = Material.from_porous(20e3, 0.02)
    assert material.band == (200.0, 20e3)
    with pytest.raises(
        InputError,
        match=r"from 200 to 20000 Hz, which the material \(porous layer of 20 mm and 20000 Pa s/m²\) covers, but is 40000 Hz",
    ):
        material.reflection_at(40e3)
    extended = Material.from_porous(20e3, 0.02, outside="extend")
    assert abs(extended.reflection_at(40e3)) < 1.0
    assert extended.reflection_at(10e3) == material.reflection_at(10e3)


@pytest.mark.parametrize(
    "make", [lambda: Material.from_reflection(-0.8), lambda: Material.from_impedance([40e3], [3 + 1j])]
)
def test_roughness_multiplies_by_its_loss(make):
    smooth, cosine, sigma, c = make(), np.array(COSINES), 0.3e-3, 340.0
    rough = smooth.rough(sigma)
    loss = np.exp(-2 * (2 * np.pi * 40e3 / c * sigma * cosine) ** 2)
    np.testing.assert_allclose(
        rough.reflection_at(40e3, cosine, c), loss * smooth.reflection_at(40e3, cosine, c), rtol=EXACT
    )
    assert rough.depends_on_angle
    assert rough.is_complex == smooth.is_complex
    assert type(rough) is Material
    twice = smooth.rough(3e-4).rough(4e-4)
    assert twice.roughness == pytest.approx(5e-4, rel=1e-15)
    assert smooth.rough(0.0).reflection_at(40e3) == smooth.reflection_at(40e3)
    assert not Material.from_reflection(1.0).rough(0.0).depends_on_angle


# absorption


def test_a_table_of_absorption_is_met_at_its_points_and_smooth_and_monotone_between():
    material = Material.from_absorption([1e3, 4e3, 16e3, 64e3], [0.1, 0.5, 0.5, 0.9])
    for frequency, alpha in ((1e3, 0.1), (4e3, 0.5), (8e3, 0.5), (16e3, 0.5), (64e3, 0.9)):
        assert material.reflection_at(frequency) == pytest.approx(np.sqrt(1.0 - alpha), rel=EXACT)
    between = material.reflection_at(np.geomspace(1e3, 64e3, 4001))
    assert np.all(np.diff(between) <= 1e-15)
    assert np.abs(np.diff(between**2, 2)).max() < 1e-5, "no corners: those of straight lines would be 3e-4"
    # Between two points there is one line, over the logarithm of frequency.
    two = Material.from_absorption([1e3, 4e3], [0.1, 0.5])
    assert two.reflection_at(2e3) == pytest.approx(np.sqrt(0.7), rel=EXACT)


def test_outside_a_table_of_absorption_the_end_is_held_with_one_warning():
    material = Material.from_absorption([1e3, 4e3], [0.19, 0.36], "felt")
    said = set()
    for frequency, factor in ((40e3, 0.8), ([100.0, 50e3], [0.9, 0.8])):
        with pytest.warns(ClsimWarning, match="'felt' covers 1000 to 4000 Hz; outside") as told:
            held = material.reflection_at(frequency)
        np.testing.assert_allclose(held, factor, rtol=1e-15)
        said |= {str(w.message) for w in told}
    assert len(said) == 1, "the same words, so that they are shown once"
    material.reflection_at([1e3 * (1 - 1e-10), 4e3 * (1 + 1e-10)])  # rounding is not outside


def test_a_table_of_one_row():
    assert Material.from_absorption([40e3], [0.36]).reflection_at(40e3) == pytest.approx(0.8, rel=1e-15)
    assert Material.from_table([40e3], [0.6j]).reflection_at(40e3) == pytest.approx(0.6j, rel=EXACT)
    assert Material.from_impedance([40e3], [3.0]).reflection_at(40e3) == pytest.approx(0.5, rel=EXACT)


TABLES = {
    "coefficients": Material.from_absorption, "factors": Material.from_table, "impedances": Material.from_impedance,
}  # fmt: skip


@pytest.mark.parametrize("values", TABLES)
@pytest.mark.parametrize(
    ("frequencies", "given", "field"),
    [
        ([1e3, 1e3], [0.1, 0.2], "frequencies"),
        ([2e3, 1e3], [0.1, 0.2], "frequencies"),
        ([1e3, np.nextafter(1e3, 2e3)], [0.1, 0.2], "frequencies"),
        ([0.0, 1e3], [0.1, 0.2], "frequencies[0]"),
        ([1e3, np.inf], [0.1, 0.2], "frequencies[1]"),
        ([], [], "frequencies"),
        (None, [0.1], "frequencies"),
        ([1e3], None, "values"),
        ([1e3, 2e3], [0.1], "values"),
        ([1e3, 2e3], [0.1, np.nan], "values[1]"),
        ([1e3, 2e3], [0.1, "x"], "values"),
        ([1e3, 2e3], [[0.1], [0.2, 0.3]], "values"),
        ([1e3, 2e3], [-1.1, 1.0], "values[0]"),
    ],
)
def test_bad_tables_are_refused_by_name(values, frequencies, given, field):
    with pytest.raises(InputError) as error:
        TABLES[values](frequencies, given)
    assert error.value.field == field.replace("values", values)


def test_tables_are_kept_read_only_and_apart_from_what_was_given():
    given_frequencies, given_factors = np.array([1e3, 2e3]), np.array([0.1, 0.5j])
    material = Material.from_table(given_frequencies, given_factors)
    given_frequencies[:], given_factors[:] = 1.0, 1.0
    assert material.reflection_at(2e3) == pytest.approx(0.5j, rel=EXACT)
    for array in (material.model.frequencies, material.model.law.args[0].values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


# factors


def test_a_table_of_real_factors_passes_through_zero():
    material = Material.from_table([1e3, 4e3], [-0.5, 0.5])
    assert not material.is_complex
    assert material.reflection_at(2e3) == pytest.approx(0.0, abs=1e-15)
    assert material.reflection_at([1e3, 4e3]).tolist() == [-0.5, 0.5]


def test_a_delay_stays_a_delay_between_the_rows_of_a_table(rng):
    f = np.arange(20e3, 61e3, 2e3)
    delay = 100e-6  # the phase turns by 1.26 rad from row to row
    material = Material.from_table(f, 0.7 * np.exp(-2j * np.pi * f * delay))
    at = rng.uniform(20e3, 60e3, 1000)
    exact = 0.7 * np.exp(-2j * np.pi * at * delay)
    np.testing.assert_allclose(
        material.reflection_at(at), exact, rtol=0, atol=1e-12
    )  # 60 kHz · 100 µs · 2 pi · eps · rows
    # Straight lines between real and imaginary parts would lose 19 % halfway.
    straight = np.interp(at, f, np.cos(2 * np.pi * f * delay)) - np.cos(2 * np.pi * at * delay)
    assert np.abs(straight).max() > 0.15


def echoes(f):
    """Return the factor of a panel with two faces, which comes near zero every 10 kHz."""
    return 0.5 * np.exp(-2j * np.pi * f * 20e-6) + 0.45 * np.exp(-2j * np.pi * f * 120e-6)


@pytest.mark.parametrize(
    ("factor", "error"), [(Material.from_porous(60e3, 0.01).reflection_at, 0.003), (echoes, 0.031)]
)
def test_smooth_responses_are_joined_well(factor, error, measured):
    """From 20 to 60 kHz, 2 kHz apart: better than straight lines, and than magnitude and phase apart."""
    f, at = np.arange(20e3, 61e3, 2e3), np.linspace(20e3, 60e3, 801)
    told, true = factor(f), factor(at)
    found = np.abs(Material.from_table(f, told).reflection_at(at) - true).max()
    straight = np.abs(np.interp(at, f, told.real) + 1j * np.interp(at, f, told.imag) - true).max()
    magnitude, phase = np.interp(at, f, np.abs(told)), np.interp(at, f, np.unwrap(np.angle(told)))
    apart = np.abs(magnitude * np.exp(1j * phase) - true).max()
    measured("complex tables, rows 2 kHz apart", "formula", found, error, "of the incident pressure")
    assert error < 0.5 * min(straight, apart)


def test_a_complex_table_passes_through_zero():
    f = np.array([1e3, 2e3, 3e3])
    material = Material.from_table(f, [0.5j, 0.0, -0.5j])
    np.testing.assert_allclose(material.reflection_at([1.5e3, 2e3, 2.5e3]), [0.25j, 0.0, -0.25j], atol=1e-15)
    # All 0 is real, and 0.
    assert Material.from_table([1e3, 2e3], [0.0, 0j]).reflection_at(1.5e3) == 0.0


def test_a_phase_that_could_turn_either_way_is_a_warning():
    with pytest.warns(ClsimWarning, match=r"the phase turns by 3.00 rad from 1000 to 2000 Hz, one way or the other"):
        Material.from_table([1e3, 2e3], np.exp([0.0, 3.0j]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Material.from_table([1e3, 2e3], np.exp([0.0, 2.3j]))


@pytest.mark.parametrize("make", [lambda o: Material.from_table([1e3, 2e3], [0.5, 0.5j], o, "felt"),
                                  lambda o: Material.from_impedance([1e3, 2e3], [1.0, 2j], o, "felt")])  # fmt: skip
def test_outside_a_table_of_factors_is_refused_or_held_by_name(make):
    for frequency in (999.0, 2001.0):
        with pytest.raises(
            InputError, match="must be from 1000 to 2000 Hz, which the material 'felt' covers, but is"
        ) as error:
            make(None).reflection_at([1.5e3, frequency])
        assert error.value.field == "frequency"
    held = make("hold")
    assert held.band == (0.0, math.inf)
    np.testing.assert_allclose(held.reflection_at([1.0, 1e6]), held.reflection_at([1e3, 2e3]), rtol=EXACT)
