"""Materials: each constructor against its closed form, and everything that is no material."""

import cmath
import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from clsim.acoustics.reflection import (
    AIR_DENSITY,
    backed_layer_reflection,
    boundary_layer_admittance,
    porous_medium,
    reflection_from_absorption,
)
from clsim.errors import ClsimWarning, InputError
from clsim.scene.material.material import Material

EXACT = 1e-13  # a few roundings of float64
COSINES = [1.0, 0.5, 0.03]


# numbers


@pytest.mark.parametrize("factor", [-1.0, -0.3, 0, 0.9, 1, np.float32(0.5), 0.5 + 0j])
def test_a_real_factor_holds_at_every_frequency_and_angle(factor):
    material = Material.from_reflection(factor)
    assert material.reflection_at(1.0) == material.reflection_at(1e6, 0.1) == complex(factor).real
    assert material.reflection_at(40e3).dtype == np.float64
    assert not material.is_complex
    assert not material.depends_on_angle
    assert material.band == (0.0, math.inf)


def test_a_complex_factor_is_returned_as_it_is():
    material = Material.from_reflection(0.6 - 0.8j, "soft")
    assert material.is_complex
    assert material.reflection_at([1e3, 2e3], 0.5).tolist() == [0.6 - 0.8j] * 2
    assert material.name == "soft"
    assert Material.from_reflection(cmath.exp(2j)).reflection_at(1e3) == pytest.approx(cmath.exp(2j), rel=EXACT)


@pytest.mark.parametrize(
    "factor", [1.001, -1.001, np.nan, "1", None, True, 0.8 + 0.7j, complex(0, np.nan), [0.5], 1e300]
)
def test_bad_factors_are_refused(factor):
    with pytest.raises(InputError) as error:
        Material.from_reflection(factor)
    assert error.value.field == "factor"


def test_only_constructors_make_models():
    with pytest.raises(InputError) as error:
        Material(0.5)
    assert error.value.field == "model"
    with pytest.raises(InputError) as error:
        Material.from_reflection(0.5, 3)
    assert error.value.field == "name"


def test_materials_are_themselves():
    one, other = Material.from_reflection(0.5), Material.from_reflection(0.5)
    assert one == one
    assert one != other
    assert len({one, other, one}) == 2
    with pytest.raises(AttributeError):
        one.name = "wall"


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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Material.from_absorption([1e3, 2e3], [0.1, 1.1]), r"coefficients\[1\]: must be from 0 to 1, but is 1.1"),
        (lambda: Material.from_table([1e3, 2e3], [0.1, 0.8 + 0.7j]), r"factors\[1\]: must have a magnitude of at most 1, but is 0.8\+0.7j"),
        (lambda: Material.from_table([1e3, 2e3], [0.1, complex(0.0, np.inf)]), r"factors\[1\]: must be finite"),
        (lambda: Material.from_table([1e3], [0.1], outside="zero"), r'outside: must be one of "hold", but is \'zero\''),
        (lambda: Material.from_impedance([1e3], [1.0], outside="extend"), r'outside: must be one of "hold"'),
        (lambda: Material.from_impedance([1e3], [-0.1 + 2j]), r"impedances\[0\]: must have a real part of at least 0 \(passive\), but is -0.1\+2j"),
        (lambda: Material.from_impedance([1e3, 2e3], [1.0, 1e300j]), r"impedances\[1\]: must have a magnitude of at most 1e\+12"),
        (lambda: Material.from_impulse_response([1e300, 1e308], 192e3), r"samples\[1\]: must be within 1e\+12"),
        (lambda: Material.from_solid(0.0, 3500.0), "density: must be above 0"),
        (lambda: Material.from_solid(2300.0, np.nan), "sound_speed: must be finite"),
        (lambda: Material.from_solid(30.0, 400.0), "density: must be that of a hard solid, .* but that is 12000 Pa s/m"),
        (lambda: Material.from_solid(2300.0, 3500.0, 1), "boundary_layer: must be true or false, but is 1"),
        (lambda: Material.from_porous(10.0, 0.1), "flow_resistivity: must be at least 100 Pa s/m²"),
        (lambda: Material.from_porous(1e4, 0.0), "thickness: must be above 0 m"),
        (lambda: Material.from_porous(1e4, 0.1, "hold"), 'outside: must be one of "extend"'),
        (lambda: Material.from_reflection(1.0).rough(-1e-4), "rms: must be at least 0 m"),
        (lambda: Material.from_reflection(1.0).rough(1.0), "rms: must be at most 0.1 m"),
        (lambda: Material.from_reflection(1.0).rough("rough"), "rms: must be a number"),
        (lambda: Material.named("wool"), 'name: must be one of "rigid", .*"carpet"'),
    ],
)  # fmt: skip
def test_messages_name_field_rule_and_value(make, message):
    with pytest.raises(InputError, match=message):
        make()


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
def test_smooth_responses_are_joined_well(factor, error):
    """From 20 to 60 kHz, 2 kHz apart: better than straight lines, and than magnitude and phase apart."""
    f, at = np.arange(20e3, 61e3, 2e3), np.linspace(20e3, 60e3, 801)
    told, true = factor(f), factor(at)
    found = np.abs(Material.from_table(f, told).reflection_at(at) - true).max()
    straight = np.abs(np.interp(at, f, told.real) + 1j * np.interp(at, f, told.imag) - true).max()
    magnitude, phase = np.interp(at, f, np.abs(told)), np.interp(at, f, np.unwrap(np.angle(told)))
    apart = np.abs(magnitude * np.exp(1j * phase) - true).max()
    assert found < error < 0.5 * min(straight, apart)


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


# impulse responses


def test_the_impulse_response_of_a_delay():
    rate, at = 192e3, np.array([1e3, 40e3, 91e3])
    late = Material.from_impulse_response([0.0, 0.0, 0.0, 0.8], rate)
    expected = 0.8 * np.exp(-2j * np.pi * at * 3 / rate)
    np.testing.assert_allclose(late.reflection_at(at), expected, rtol=1e-12)
    for reference, shift in ((3, 0.0), (2.5, 0.5), (-1, 4.0)):
        material = Material.from_impulse_response([0.0, 0.0, 0.0, 0.8], rate, reference=reference)
        expected = 0.8 * np.exp(-2j * np.pi * at * shift / rate)
        np.testing.assert_allclose(material.reflection_at(at), expected, rtol=1e-12)
    assert late.is_complex
    assert not late.depends_on_angle


@pytest.mark.parametrize("count", [5, 512, 1300])  # less than, exactly and more than what is summed at once
def test_the_impulse_response_of_a_known_filter(rng, count):
    taps = rng.standard_normal(count) * np.exp(-10.0 * np.arange(count) / count)
    taps /= np.abs(taps).sum()
    at = rng.uniform(1.0, 96e3, (7, 100))
    expected = [np.sum(taps * np.exp(-2j * np.pi * f * np.arange(count) / 192e3)) for f in at.ravel()]
    got = Material.from_impulse_response(taps, 192e3).reflection_at(at)
    np.testing.assert_allclose(got, np.reshape(expected, at.shape), rtol=0, atol=1e-12)


def test_an_impulse_response_that_sends_back_too_much_is_refused_or_clipped_within_the_tolerance():
    with pytest.raises(InputError, match=r"samples: must send back no more .* tolerance of 0.05, but one is 1.1 at "):
        Material.from_impulse_response([0.6, -0.5], 192e3)  # 1.1 at half the sampling rate, 0.1 at 0 Hz
    material = Material.from_impulse_response([0.6, -0.5], 192e3, tolerance=0.11)
    assert abs(material.reflection_at(96e3)) == pytest.approx(1.0, rel=1e-12)
    quiet = Material.from_impulse_response([0.6, -0.5], 192e3, band=(1e3, 10e3))
    expected = 0.6 - 0.5 * np.exp(-2j * np.pi * 5e3 / 192e3)
    assert quiet.reflection_at(5e3) == pytest.approx(expected, rel=1e-12)
    for outside in (500.0, 20e3):
        with pytest.raises(InputError, match="must be from 1000 to 10000 Hz, which"):
            quiet.reflection_at(outside)
    held = Material.from_impulse_response([0.6, -0.5], 192e3, band=(1e3, 10e3), outside="hold")
    assert held.reflection_at(20e3) == held.reflection_at(10e3)
    with pytest.raises(InputError, match="must be from 0 to 96000 Hz, which the material 'ir' covers, but is 96100 Hz"):
        Material.from_impulse_response([0.5], 192e3, name="ir").reflection_at(96.1e3)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"samples": []}, "samples"),
        ({"samples": [0.0, 0.0]}, "samples"),
        ({"samples": [0.5, np.nan]}, "samples[1]"),
        ({"samples": [[0.5]]}, "samples"),
        ({"samples": np.full(2**17 + 1, 1e-9)}, "samples"),
        ({"sampling_rate": 0.0}, "sampling_rate"),
        ({"sampling_rate": None}, "sampling_rate"),
        ({"reference": np.inf}, "reference"),
        ({"band": (2e3, 1e3)}, "band"),
        ({"band": (0.0, 97e3)}, "band"),
        ({"band": (-1.0, 9e3)}, "band"),
        ({"band": (1e3,)}, "band"),
        ({"tolerance": -0.1}, "tolerance"),
        ({"tolerance": 1.1}, "tolerance"),
        ({"outside": "zero"}, "outside"),
        ({"name": 1}, "name"),
    ],
)
def test_bad_impulse_responses_are_refused_by_name(arguments, field):
    with pytest.raises(InputError) as error:
        Material.from_impulse_response(**{"samples": [0.5], "sampling_rate": 192e3} | arguments)
    assert error.value.field == field


def test_noise_behind_an_impulse_response_is_a_warning(rng):
    taps = np.zeros(2000)
    taps[0] = 0.8
    noise = 1e-3 * rng.standard_normal(2000)
    # 1e-3 times the root of 2000 samples: 0.045.
    with pytest.warns(
        ClsimWarning, match=r"last tenth .* of 'ir' still holds 0.00.* rms, which over 2000 samples .* by some 0.04"
    ):
        noisy = Material.from_impulse_response(taps + noise, 192e3, tolerance=0.5, name="ir")
    f = np.linspace(10e3, 80e3, 200)
    spread = np.sqrt(np.mean(np.abs(noisy.reflection_at(f) - 0.8) ** 2))
    assert spread == pytest.approx(0.045, rel=0.15), "200 draws: 5 % in rms, times three"
    Material.from_impulse_response((taps + noise)[:200], 192e3)  # 0.014: said nothing of


def test_a_long_response_at_many_frequencies_takes_no_more_than_seconds():
    taps = np.zeros(2**17)
    taps[[0, -1]] = 0.3
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClsimWarning)
        material = Material.from_impulse_response(taps, 192e3)
    f = np.linspace(20e3, 60e3, 4096)
    expected = 0.3 + 0.3 * np.exp(-2j * np.pi * f * (2**17 - 1) / 192e3)
    np.testing.assert_allclose(material.reflection_at(f), expected, atol=1e-9)  # phases of 2.6e5 rad, to 1e-10


def test_sound_files(tmp_path: Path, rng):
    taps = 0.02 * rng.standard_normal((64, 2))
    soundfile.write(tmp_path / "wall.wav", taps, 192000, subtype="FLOAT")
    f = np.array([20e3, 40e3])
    for channel in (0, 1):
        read = Material.from_wav(tmp_path / "wall.wav", channel, 0.5, 3, (10e3, 90e3), "hold", 0.01, "w")
        told = Material.from_impulse_response(
            0.5 * taps[:, channel].astype(np.float32).astype(float), 192e3, 3, (10e3, 90e3), "hold", 0.01, "w"
        )
        np.testing.assert_array_equal(read.reflection_at(f), told.reflection_at(f))
        assert (read.name, read.band) == ("w", (0.0, math.inf))
    (tmp_path / "text.wav").write_text("no sound")
    for arguments, field in (
        ((tmp_path / "none.wav",), "path"),
        ((tmp_path / "text.wav",), "path"),
        ((tmp_path,), "path"),
        ((3,), "path"),
        ((tmp_path / "wall.wav", 2), "channel"),
        ((tmp_path / "wall.wav", -1), "channel"),
        ((tmp_path / "wall.wav", 0, np.nan), "scale"),
        ((tmp_path / "wall.wav", 0, 0.0), "samples"),
        ((tmp_path / "wall.wav", 0, 1000.0), "samples"),
    ):
        with pytest.raises(InputError) as error:
            Material.from_wav(*arguments)
        assert error.value.field == field


# impedances


@pytest.mark.parametrize("impedance", [0.0, 1.0, 2.5 - 1.3j, 0.2 + 4j, 50.0 - 0.1j, -0.0 - 3j])
@pytest.mark.parametrize("cosine", COSINES)
def test_impedances_reflect_by_the_formula(impedance, cosine):
    material = Material.from_impedance([1e3, 50e3], [impedance, impedance])
    expected = (impedance * cosine - 1) / (impedance * cosine + 1)
    assert material.reflection_at(40e3, cosine) == pytest.approx(expected, rel=EXACT, abs=EXACT)
    assert material.is_complex
    assert material.depends_on_angle


def test_the_limits_of_impedances():
    soft, hard = Material.from_impedance([1e3], [0.0]), Material.from_impedance([1e3], [1e12])
    np.testing.assert_allclose(soft.reflection_at(1e3, COSINES), -1.0, rtol=EXACT)
    np.testing.assert_allclose(hard.reflection_at(1e3, COSINES), 1.0, rtol=1e-10)  # 2 / (0.03 · 1e12)
    matched = Material.from_impedance([1e3], [2.0])  # at 60 degrees nothing comes back
    assert abs(matched.reflection_at(1e3, 0.5)) < EXACT


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
    for got, expected in (
        (impedance - 1, (5.50 - 8.43j) * X**-0.632),
        (index - 1, (7.81 - 11.41j) * X**-0.618),
    ):
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


def test_thick_and_thin_porous_layers():
    thin = Material.from_porous(50e3, 1e-9)
    np.testing.assert_allclose(thin.reflection_at(40e3, COSINES), 1.0, atol=1e-4)
    impedance, _ = porous_medium(40e3, 50e3)
    thick = Material.from_porous(50e3, 10.0).reflection_at(40e3)
    assert thick == pytest.approx((impedance - 1) / (impedance + 1), rel=1e-12)
    # A porous absorber is no locally reacting one: what it would be at 80 degrees if it were.
    cosine = math.cos(math.radians(80.0))
    local = (impedance * cosine - 1) / (impedance * cosine + 1)
    assert abs(Material.from_porous(50e3, 10.0).reflection_at(40e3, cosine) - local) > 0.1


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


# scattering


def test_what_is_scattered_leaves_the_mirrors_direction():
    """Energies add up: in the mirror's direction, in others, and absorbed."""
    table = [500.0, 2000.0, 8000.0], [0.1, 0.5, 0.9]
    f, cosine = np.array([100.0, 500.0, 1000.0, 4000.0, 20e3]), np.array([[1.0], [0.3]])
    for material in (
        Material.from_absorption([100.0, 20e3], [0.1, 0.4], scattering=table),
        Material.from_impedance([100.0, 20e3], [3.0 - 1.0j, 2.0], scattering=table).rough(1e-3),
    ):
        smooth = replace(material, scattering=None, roughness=0.0)
        sent = np.abs(smooth.reflection_at(f, cosine)) ** 2
        np.testing.assert_allclose(material.energy_at(f, cosine), sent, rtol=EXACT)
        left = np.abs(material.reflection_at(f, cosine)) ** 2
        np.testing.assert_allclose(left, sent * (1.0 - material.scattered_share(f, cosine)), rtol=1e-12)
    wall = Material.from_reflection(0.9, scattering=table)
    np.testing.assert_allclose(wall.scattered_share(f), [0.1, 0.1, 0.3, 0.7, 0.9], rtol=1e-12)
    assert not wall.depends_on_angle
    assert wall.reflection_at(500.0) == pytest.approx(0.9 * math.sqrt(0.9), rel=EXACT)


def test_without_scattering_nothing_changes():
    for none in (None, 0.0, ([1e3], [0.0])):
        assert Material.from_reflection(0.9, scattering=none).scattering is None
    assert "scatters" in Material.named("concrete", scattering=0.2).describe()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (1.2, r"scattering: must be at most 1, but is 1.2"),
        ("much", r"scattering: must be a number or a pair of frequencies and values, but is 'much'"),
        (([1e3, 500.0], [0.1, 0.2]), r"scattering\.frequencies: must increase strictly"),
        (([1e3], [0.1, 0.2]), r"scattering\.values: must have the shape 1, but has 2"),
        (([1e3, 2e3], [0.1, 1.5]), r"scattering\.values\[1\]: must be from 0 to 1, but is 1.5"),
    ],
)
def test_scattering_is_a_share(value, message):
    with pytest.raises(InputError, match=message):
        Material.from_reflection(0.9, scattering=value)


# all of them


def some_materials() -> st.SearchStrategy[Material]:
    """Return any material that the constructors make, perhaps rough."""
    f = st.lists(st.integers(50, 200_000), min_size=1, max_size=6, unique=True).map(sorted)
    unit = st.builds(lambda r, a: r * cmath.exp(1j * a), st.floats(0.0, 1.0), st.floats(-3.2, 3.2))
    zeta = st.builds(complex, st.floats(0.0, 1e6), st.floats(-1e6, 1e6))

    def rows(make, values, *rest):
        return f.flatmap(
            lambda at: st.lists(values, min_size=len(at), max_size=len(at)).map(lambda v: make(at, v, *rest))
        )

    taps = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=30).map(
        lambda t: [x / max(1.0, sum(map(abs, t))) for x in t]
    )
    smooth = st.one_of(
        st.floats(-1.0, 1.0).map(Material.from_reflection),
        unit.map(Material.from_reflection),
        rows(Material.from_absorption, st.floats(0.0, 1.0)),
        rows(Material.from_table, unit, "hold"),
        rows(Material.from_table, st.floats(-1.0, 1.0), "hold"),
        rows(Material.from_impedance, zeta, "hold"),
        taps.filter(any).map(lambda t: Material.from_impulse_response(t, 192e3, band=(1.0, 96e3), outside="hold")),
        st.builds(Material.from_solid, st.floats(100.0, 2e4), st.floats(1e3, 1e4), st.booleans()),
        st.builds(Material.from_porous, st.floats(100.0, 1e7), st.floats(1e-6, 10.0), st.just("extend")),
    )
    return st.builds(lambda m, rms: m.rough(rms), smooth, st.sampled_from([0.0, 1e-4, 0.1]))


@settings(max_examples=400, deadline=None)
@given(st.data())
def test_no_wall_sends_back_more_than_it_receives(data):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClsimWarning)
        material = data.draw(some_materials())
        f = np.array(data.draw(st.lists(st.floats(1.0, 1e6), min_size=1, max_size=5)))
        cosine = np.array(data.draw(st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=5)))
        factor = material.reflection_at(f, cosine[:, None], data.draw(st.floats(250.0, 450.0)))
    assert factor.shape == (len(cosine), len(f))
    assert np.all(np.isfinite(factor))
    assert np.abs(factor).max() <= 1.0 + 4e-16, "a complex magnitude rounds"
    assert factor.dtype == (np.complex128 if material.is_complex else np.float64)
    if not material.depends_on_angle:
        np.testing.assert_array_equal(factor, np.broadcast_to(factor[:1], factor.shape))


def test_models_are_passive_by_themselves_not_by_being_clipped():
    f, cosine = np.geomspace(100.0, 100e3, 200), np.array([1e-3, 0.1, 0.5, 1.0])[:, None]
    for sigma in (1e3, 1e4, 1e5):
        for thickness in (1e-3, 1e-2, 1e-1):
            model = Material.from_porous(sigma, thickness, "extend").model
            inside = f[(f >= 0.01 * sigma) & (f <= sigma)]
            assert np.abs(model.factor(inside, cosine, 343.2)).max() <= 1.0
    assert np.abs(Material.from_solid(2300.0, 3500.0).model.factor(f, cosine, 343.2)).max() <= 1.0


@pytest.mark.parametrize("frequency", [0.0, -1.0, np.nan, np.inf, [1e3, -2.0], 5e-324, 1e300])
def test_bad_frequencies_are_refused(frequency):
    with pytest.raises(InputError) as error:
        Material.from_reflection(0.5).reflection_at(frequency)
    assert error.value.field == "frequency"


@pytest.mark.parametrize("cosine", [0.0, -0.5, 1.001, np.nan, [1.0, 0.0]])
def test_bad_cosines_are_refused(cosine):
    with pytest.raises(InputError, match="cosine: must be above 0 and at most 1, but is"):
        Material.from_reflection(0.5).reflection_at(40e3, cosine)


@pytest.mark.parametrize("speed", [0.0, 1e-300, np.inf, np.nan, None])
def test_bad_speeds_of_sound_are_refused(speed):
    with pytest.raises(InputError) as error:
        Material.from_reflection(0.5).reflection_at(40e3, 1.0, speed)
    assert error.value.field == "speed_of_sound"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("high",), "frequency: must be numbers, but is 'high'"),
        ((1e3, "steep"), "cosine: must be numbers, but is 'steep'"),
        (([1e3, 2e3], [1.0, 1.0, 1.0]), r"cosine: must broadcast with frequency, \(2,\), but has \(3,\)"),
    ],
)
def test_what_is_no_number_or_does_not_broadcast_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Material.from_reflection(0.5).reflection_at(*arguments)


def test_frequency_and_angle_broadcast():
    material = Material.from_impedance([1e3, 50e3], [1.0 + 1j, 3.0]).rough(1e-4)
    f, cosine = np.geomspace(1e3, 50e3, 4), np.array(COSINES)[:, None]
    together = material.reflection_at(f, cosine)
    assert together.shape == (3, 4)
    for i, c in enumerate(COSINES):
        for j, frequency in enumerate(f):
            assert together[i, j] == pytest.approx(complex(material.reflection_at(frequency, c)), rel=EXACT)
    assert material.reflection_at(40e3, 1.0 + 1e-12) == material.reflection_at(40e3)  # a rounded cosine
    flat = Material.from_reflection(0.5).reflection_at(f, cosine)
    assert flat.shape == (3, 4)
    flat[0, 0] = 0.1  # the caller's own
    assert flat[1, 0] == 0.5


@pytest.mark.parametrize(
    ("material", "words"),
    [
        (Material.from_reflection(0.9), "reflection 0.9"),
        (Material.from_reflection(0.5j).rough(1e-4), "reflection 0+0.5j, 0.1 mm rough"),
        (Material.from_absorption([1e3], [0.5]), "absorption table"),
        (Material.from_table([1e3], [0.5]), "table of factors"),
        (Material.from_table([1e3], [0.5j]), "complex table"),
        (Material.from_impedance([1e3], [1.0]), "locally reacting impedance"),
        (Material.from_impulse_response([0.5], 48e3), "impulse response of 1 samples"),
        (Material.from_solid(2300.0, 3500.0), "solid of 2300 kg/m³ and 3500 m/s"),
        (Material.from_porous(1e4, 0.02), "porous layer of 20 mm and 10000 Pa s/m²"),
    ],
)
def test_materials_say_what_they_are(material, words):
    assert material.describe() == words
