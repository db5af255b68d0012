from fractions import Fraction

import numpy as np
import pytest

import clsim
from clsim.acoustics.directivity import piston_gain
from clsim.errors import InputError
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


@pytest.mark.parametrize("directivity", ALL, ids=repr)
def test_gain_keeps_the_shape(directivity):
    assert directivity.gain(np.zeros((3, 4)), 40e3, 343.0).shape == (3, 4)


def test_first_order_patterns():
    sides = np.array([1.0, 0.0, -1.0])
    np.testing.assert_array_equal(Omni().gain(sides, 1e3, 343.0), [1, 1, 1])
    np.testing.assert_array_equal(FirstOrder(1.0).gain(sides, 1e3, 343.0), [1, 1, 1])
    np.testing.assert_array_equal(FirstOrder(0.5).gain(sides, 1e3, 343.0), [1, 0.5, 0])
    np.testing.assert_array_equal(FirstOrder(0.25).gain(sides, 1e3, 343.0), [1, 0.25, -0.5])
    np.testing.assert_array_equal(FirstOrder(0.0).gain(sides, 1e3, 343.0), [1, 0, -1])


def test_piston_is_the_integral_over_its_face():
    # Far field of a disc: the mean of exp(i k x sin(theta)) over it. With x = a sin(u) the midpoint rule
    # over u converges faster than any power, so 1e-12 is rounding.
    frequency, c, radius = 40e3, 343.0, 0.01
    u = (np.arange(200) + 0.5) * np.pi / 200 - np.pi / 2
    wavenumber = 2 * np.pi * frequency / c
    for angle in np.radians([0.0, 1e-4, 1.0, 20.0, 45.0, 70.0, 90.0]):
        phase = wavenumber * radius * np.sin(u) * np.sin(angle)
        integral = np.sum(np.cos(phase) * np.cos(u) ** 2) / np.sum(np.cos(u) ** 2)
        assert piston_gain(np.cos(angle), frequency, radius, c) == pytest.approx(integral, abs=1e-12)


def bessel_beam(x: float) -> float:
    """Return 2 J1(x) / x by its power series, which converges everywhere, in whole multiples of 2^-200.

    Terms are below e^x: for x to 20 that leaves 200 bits, and cancellation takes none that count.
    """
    one = 1 << 200
    square, term, total = int(Fraction(x) ** 2 * one) // 4, one, 0
    for m in range(60):
        total += term
        term = -term * square // ((m + 1) * (m + 2) * one)
    return total / one


@pytest.mark.parametrize("frequency", [10e3, 25e3, 40e3, 60e3, 80e3])
@pytest.mark.parametrize("radius", [0.0047, 0.012])
def test_piston_is_within_a_tenth_of_a_decibel_of_the_series_at_all_angles(radius, frequency):
    angles = np.radians(np.arange(0.0, 90.01, 1.0))
    x = 2 * np.pi * frequency / 343.0 * radius * np.sin(angles)
    expected = np.array([bessel_beam(float(v)) for v in x])
    gain = Piston(radius).gain(np.cos(angles), frequency, 343.0)
    loud = np.abs(expected) > 10 ** (-40 / 20)
    assert loud.sum() > 60
    np.testing.assert_array_less(np.abs(20 * np.log10(gain[loud] / expected[loud])), 1e-6)
    np.testing.assert_allclose(gain, expected, atol=1e-12)


def test_formulae_are_real_and_known_everywhere():
    for directivity in ALL:
        assert not directivity.is_complex
        assert directivity.band == (0.0, np.inf)


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


def test_piston_is_omnidirectional_at_low_frequency():
    # 1 - (ka)^2/8 at 90 degrees.
    ka = 2 * np.pi * 100.0 * 0.0047 / 343.0
    assert Piston(0.0047).gain(np.zeros(1), 100.0, 343.0)[0] == pytest.approx(1 - ka**2 / 8, abs=ka**4 / 100)


@pytest.mark.parametrize("name", [name for name in Directivity.names() if name.startswith("MA40")])
def test_murata_s_transducers_have_a_beam_of_80_degrees(name):
    # The piston's radius has two digits: 1 % of it moves the level at 40 degrees by 0.13 dB.
    gain = Directivity.named(name).gain(np.cos(np.radians([40.0, 35.0, 45.0])), 40e3, 343.994)
    level = 20 * np.log10(gain)
    assert level[0] == pytest.approx(-6.02, abs=0.13)
    assert level[2] < -6.5
    assert level[1] > -5.5


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


def test_bad_values_are_refused_by_name():
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
