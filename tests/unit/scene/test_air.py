import pickle
from dataclasses import replace

import numpy as np
import pytest

from clsim.errors import ClsimWarning, InputError
from clsim.scene.air import Air


def test_speed_is_the_one_asked_for():
    assert Air().speed_of_sound == pytest.approx(343.994, abs=5e-4)
    assert Air(speed_of_sound="iso9613").speed_of_sound == pytest.approx(343.2, rel=1e-15)
    assert Air(speed_of_sound=340).speed_of_sound == 340.0


def test_absorption_keeps_the_shape_and_is_zero_at_zero_frequency():
    absorption = Air().absorption_at(np.array([[0.0, 1e3], [40e3, 80e3]]))
    assert absorption.shape == (2, 2)
    assert absorption[0, 0] == 0.0
    assert np.all(np.diff(absorption.ravel()) > 0.0)
    assert f"{Air().absorption_at(40e3):.3f}" == "1.318"


def test_classical_absorption_far_above_relaxation_grows_with_the_square():
    # At 1 MHz the relaxations are saturated to under 1 % of the classical part, so doubling gives 4 to 2 %.
    low, high = Air().absorption_at([0.5e6, 1e6])
    assert high / low == pytest.approx(4.0, rel=0.04)
    assert high / low < 4.0


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("relative_humidity", 50, "50 per cent is 0.5"), ("relative_humidity", -0.1, "at least 0"),
        ("relative_humidity", 1000.0, "from 0 to 1"), ("relative_humidity", float("nan"), "finite"),
        ("temperature_celsius", 293.15, "at most 100 °C"), ("temperature_celsius", -100.0, "at least -73 °C"),
        ("temperature_celsius", "20", "must be a number"), ("pressure", 1013.25, "at least 10000 Pa"),
        ("pressure", 0.0, "at least"), ("speed_of_sound", 0.0, "at least 100 m/s"),
        ("speed_of_sound", "cramer", "iso9613"), ("speed_of_sound", True, "must be a number"),
        ("speed_of_sound", [343.0], "must be a number"), ("absorption", 0, "must be True or False"),
        ("absorption", "iso9613", "must be True or False"), ("dispersion", None, "must be True or False"),
    ],
)  # fmt: skip
def test_bad_values_are_refused_by_name(field, value, problem):
    with pytest.raises(InputError, match=problem) as error:
        Air(**{field: value})
    assert error.value.field == field


def test_air_that_is_all_water_is_refused():
    with pytest.raises(InputError, match="nothing but water vapour") as error:
        Air(90.0, 1.0, 50e3, speed_of_sound=343.0)
    assert error.value.field == "relative_humidity"


def test_doubtful_speed_warns_unless_the_speed_is_given():
    with pytest.warns(ClsimWarning, match="Cramer"):
        Air(temperature_celsius=35.0)
    with pytest.warns(ClsimWarning, match="Cramer"):
        Air(pressure=70e3)
    Air(temperature_celsius=35.0, speed_of_sound="iso9613")  # warnings are errors: none here
    Air(pressure=70e3, speed_of_sound=343.0)


def test_air_without_absorption_has_none_at_any_frequency():
    air = Air(absorption=False)
    np.testing.assert_array_equal(air.absorption_at([[0.0, 1e3], [40e3, 2e6]]), np.zeros((2, 2)))
    assert air.speed_of_sound == Air().speed_of_sound
    assert air != Air()
    Air(relative_humidity=0.0, absorption=False)  # nothing to doubt: no warning
    with pytest.raises(InputError, match="at least 0 Hz"):
        air.absorption_at(-1.0)


def test_doubtful_absorption_warns():
    with pytest.warns(ClsimWarning, match="ISO 9613-1"):
        Air(temperature_celsius=60.0, speed_of_sound=365.0)
    with pytest.warns(ClsimWarning, match="ISO 9613-1"):
        Air(relative_humidity=0.0)
    with pytest.warns(ClsimWarning, match="10 Hz/Pa"):
        Air().absorption_at([40e3, 2e6])


def test_the_warning_points_at_the_caller():
    with pytest.warns(ClsimWarning) as caught:
        Air(temperature_celsius=35.0)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("frequency", [-1.0, np.nan, np.inf, [1e3, -1e3]])
def test_bad_frequencies_are_refused(frequency):
    with pytest.raises(InputError) as error:
        Air().absorption_at(frequency)
    assert error.value.field == "frequency"


def test_air_is_a_value():
    assert Air() == Air(20.0, 0.5, 101_325.0)
    assert hash(Air()) == hash(Air())
    with pytest.raises(AttributeError):
        Air().pressure = 0.0


def test_another_temperature_has_another_speed_unless_it_was_given() -> None:
    assert replace(Air(), temperature_celsius=30.0) == Air(temperature_celsius=30.0)
    assert replace(Air(speed_of_sound="iso9613"), temperature_celsius=30.0).speed_of_sound == pytest.approx(
        343.2 * (303.15 / 293.15) ** 0.5, rel=1e-12
    )
    assert replace(Air(speed_of_sound=340.0), temperature_celsius=30.0).speed_of_sound == 340.0
    number = Air().speed_of_sound
    assert Air(relative_humidity=0.3, speed_of_sound=number).speed_of_sound == number
    assert pickle.loads(pickle.dumps(Air(pressure=9e4))) == Air(pressure=9e4)
