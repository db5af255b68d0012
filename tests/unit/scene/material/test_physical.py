"""Materials from what they are made of: impedances, solids, fibres, roughness."""

import math

import numpy as np
import pytest

from clsim.acoustics.reflection import (
    AIR_DENSITY,
    backed_layer_reflection,
    boundary_layer_admittance,
    porous_medium,
)
from clsim.errors import InputError
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
