"""Materials from tables: absorption and factors by frequency."""

import math
import warnings

import numpy as np
import pytest

from clsim.acoustics.reflection import (
    reflection_from_absorption,
)
from clsim.errors import ClsimWarning, InputError
from clsim.scene.material.material import Material

EXACT = 1e-13  # a few roundings of float64


# absorption


def test_energy_is_conserved():
    alpha = np.linspace(0.0, 1.0, 11)
    # sqrt and square round once each: some 1e-16.
    np.testing.assert_allclose(reflection_from_absorption(alpha) ** 2 + alpha, 1.0, rtol=1e-15)


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
    "coefficients": Material.from_absorption,
    "factors": Material.from_table,
    "impedances": Material.from_impedance,
}


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
    for array in (material.model.frequencies, material.model.factors):
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
    ("factor", "error"),
    [(Material.from_porous(60e3, 0.01).reflection_at, 0.003), (echoes, 0.031)],
)
def test_smooth_responses_are_joined_well(factor, error, measured):
    """From 20 to 60 kHz, 2 kHz apart: better than straight lines, and than magnitude and phase apart."""
    f, at = np.arange(20e3, 61e3, 2e3), np.linspace(20e3, 60e3, 801)
    told, true = factor(f), factor(at)
    found = np.abs(Material.from_table(f, told).reflection_at(at) - true).max()
    straight = np.abs(np.interp(at, f, told.real) + 1j * np.interp(at, f, told.imag) - true).max()
    magnitude, phase = np.interp(at, f, np.abs(told)), np.interp(at, f, np.unwrap(np.angle(told)))
    apart = np.abs(magnitude * np.exp(1j * phase) - true).max()
    assert measured("complex tables, rows 2 kHz apart", "formula", found, error, "of the incident pressure") < error
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
