import numpy as np
import pytest

from clsim.acoustics.reflection import reflection_from_absorption
from clsim.errors import ClsimWarning, InputError
from clsim.scene.material import MATERIAL_NAMES, Material


@pytest.mark.parametrize("factor", [-1.0, -0.3, 0, 0.9, 1])
def test_a_factor_holds_at_every_frequency(factor):
    material = Material.from_reflection(factor)
    assert material.reflection_at(1.0) == material.reflection_at(1e6) == factor
    assert Material(factor, "wall").reflection_at(40e3) == factor


@pytest.mark.parametrize("factor", [1.001, -1.001, np.nan, "1", None, True])
def test_bad_factors_are_refused(factor):
    with pytest.raises(InputError) as error:
        Material.from_reflection(factor)
    assert error.value.field == "factor"
    with pytest.raises(InputError) as error:
        Material(factor)
    assert error.value.field == "reflection"


def test_energy_is_conserved():
    alpha = np.linspace(0.0, 1.0, 11)
    # sqrt and square round once each: some 1e-16.
    np.testing.assert_allclose(reflection_from_absorption(alpha) ** 2 + alpha, 1.0, rtol=1e-15)


def test_a_table_is_met_at_its_points_and_smooth_and_monotone_between():
    material = Material.from_absorption([1e3, 4e3, 16e3, 64e3], [0.1, 0.5, 0.5, 0.9])
    for frequency, alpha in ((1e3, 0.1), (4e3, 0.5), (8e3, 0.5), (16e3, 0.5), (64e3, 0.9)):
        assert material.reflection_at(frequency) == pytest.approx(np.sqrt(1.0 - alpha), rel=1e-13)
    between = material.reflection_at(np.geomspace(1e3, 64e3, 4001))
    assert np.all(np.diff(between) <= 1e-15)
    assert np.abs(np.diff(between**2, 2)).max() < 1e-5, "no corners: those of straight lines would be 3e-4"
    # Between two points there is one line, over the logarithm of frequency.
    two = Material.from_absorption([1e3, 4e3], [0.1, 0.5])
    assert two.reflection_at(2e3) == pytest.approx(np.sqrt(0.7), rel=1e-13)


def test_outside_the_table_the_end_is_held_with_a_warning():
    material = Material.from_absorption([1e3, 4e3], [0.19, 0.36], "felt")
    with pytest.warns(ClsimWarning, match="'felt' is known from 1000 to 4000 Hz, but asked for at 40000 Hz"):
        assert material.reflection_at(40e3) == pytest.approx(0.8, rel=1e-15)
    with pytest.warns(ClsimWarning):
        assert material.reflection_at(100.0) == pytest.approx(0.9, rel=1e-15)


def test_a_table_of_one_row():
    assert Material.from_absorption([40e3], [0.36]).reflection_at(40e3) == pytest.approx(0.8, rel=1e-15)


@pytest.mark.parametrize(
    ("frequencies", "coefficients", "field"),
    [
        ([1e3, 1e3], [0.1, 0.2], "frequencies"),
        ([2e3, 1e3], [0.1, 0.2], "frequencies"),
        ([0.0, 1e3], [0.1, 0.2], "frequencies[0]"),
        ([1e3, np.inf], [0.1, 0.2], "frequencies[1]"),
        ([], [], "frequencies"),
        (None, [0.1], "frequencies"),
        ([1e3], None, "coefficients"),
        ([1e3, 2e3], [0.1], "coefficients"),
        ([1e3, 2e3], [0.1, 1.1], "coefficients[1]"),
        ([1e3, 2e3], [-0.1, 1.0], "coefficients[0]"),
        ([1e3, 2e3], [0.1, "x"], "coefficients"),
    ],
)
def test_bad_tables_are_refused_by_name(frequencies, coefficients, field):
    with pytest.raises(InputError) as error:
        Material.from_absorption(frequencies, coefficients)
    assert error.value.field == field


def test_factor_and_table_together_are_refused():
    with pytest.raises(InputError) as error:
        Material(0.5, "both", [1e3], [0.1])
    assert error.value.field == "reflection"
    with pytest.raises(InputError) as error:
        Material(0.5, 3)
    assert error.value.field == "name"


def test_tables_are_kept_read_only_and_apart_from_what_was_given():
    given = np.array([1e3, 2e3])
    material = Material.from_absorption(given, [0.0, 0.36])
    given[:] = 1.0
    assert material.reflection_at(2e3) == pytest.approx(0.8, rel=1e-15)
    with pytest.raises(ValueError, match="read-only"):
        material.coefficients[0] = 1.0


@pytest.mark.parametrize("name", MATERIAL_NAMES)
def test_every_named_material_can_be_had(name):
    material = Material.named(name)
    assert material.name == name
    assert -1.0 <= material.reflection_at(1e3) <= 1.0


def test_named_materials_have_their_published_values():
    assert Material.named("rigid").reflection_at(40e3) == 1.0
    assert Material.named("pressure-release").reflection_at(40e3) == -1.0
    assert Material.named("carpet").reflection_at(1e3) == pytest.approx(np.sqrt(1 - 0.37), rel=1e-14)
    assert Material.named("glass").reflection_at(125.0) == pytest.approx(np.sqrt(1 - 0.18), rel=1e-14)
    with pytest.warns(ClsimWarning, match="carpet"):
        Material.named("carpet").reflection_at(40e3)


def test_unknown_names_are_refused_with_a_list():
    for name in ("wood", "", None, ["carpet"]):
        with pytest.raises(InputError, match="carpet") as error:
            Material.named(name)
        assert error.value.field == "name"


@pytest.mark.parametrize("frequency", [0.0, -1.0, np.nan])
def test_bad_frequencies_are_refused(frequency):
    with pytest.raises(InputError):
        Material.from_reflection(0.5).reflection_at(frequency)
