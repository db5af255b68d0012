"""Materials: numbers, scattering, what all of them keep to, and everything that is no material."""

import cmath
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from exhaustive import few
from hypothesis import given, settings
from hypothesis import strategies as st

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


NAN, INF = math.nan, math.inf
FACTORS = [1.001, -1.001, NAN, "1", None, True, 0.8 + 0.7j, complex(0, NAN), [0.5], 1e300]
REFUSED = [
    *((lambda v: Material.from_reflection(v), value, "factor: ") for value in FACTORS),
    (lambda v: Material(v), 0.5, "model: "), (lambda v: Material.from_reflection(0.5, v), 3, "name: "),
    *((lambda v: Material.from_reflection(0.5).reflection_at(v), value, "frequency: ")
      for value in (0.0, -1.0, NAN, INF, [1e3, -2.0], 5e-324, 1e300)),
    *((lambda v: Material.from_reflection(0.5).reflection_at(40e3, v), value, "cosine: must be above 0 and at most 1, but is")
      for value in (0.0, -0.5, 1.001, NAN, [1.0, 0.0])),
    *((lambda v: Material.from_reflection(0.5).reflection_at(40e3, 1.0, v), value, "speed_of_sound: ")
      for value in (0.0, 1e-300, INF, NAN, None)),
    (lambda v: Material.from_reflection(0.5).reflection_at(v), "high", "frequency: must be numbers, but is 'high'"),
    (lambda v: Material.from_reflection(0.5).reflection_at(1e3, v), "steep", "cosine: must be numbers, but is 'steep'"),
    (lambda v: Material.from_reflection(0.5).reflection_at([1e3, 2e3], v), [1.0, 1.0, 1.0],
     r"cosine: must broadcast with frequency, \(2,\), but has \(3,\)"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "value", "message"), REFUSED)
def test_bad_values_are_refused_by_name(make, value, message):
    with pytest.raises(InputError, match="^" + message):
        make(value)


def test_materials_are_themselves():
    one, other = Material.from_reflection(0.5), Material.from_reflection(0.5)
    assert one == one
    assert one != other
    assert len({one, other, one}) == 2
    with pytest.raises(AttributeError):
        one.name = "wall"


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


@pytest.mark.parametrize("draws", few([100, 400]))
def test_no_wall_sends_back_more_than_it_receives(draws):
    settings(max_examples=draws, deadline=None)(given(st.data())(it_sends_back_no_more_than_it_receives))()


def it_sends_back_no_more_than_it_receives(data):
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
