"""Air that disperses: its wavenumber is causal, published figures, and what is heard through it."""

import numpy as np
import pytest

import clsim
from clsim.scene.air import Air

C0 = 343.994


# --- the wavenumber ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("air", [Air(), Air(-10.0, 0.8, 9e4, 325.0, dispersion=True), Air(40.0, 0.2, 1e5, "iso9613")])
def test_what_it_absorbs_is_what_it_absorbed(air):
    f = np.geomspace(1.0, 8e5, 500)
    np.testing.assert_allclose(-air.wavenumber_at(f).imag, air.absorption_at(f) * np.log(10.0) / 20.0, rtol=1e-12)
    still = Air(air.temperature_celsius, air.relative_humidity, air.pressure, air.speed_of_sound, dispersion=False)
    np.testing.assert_array_equal(air.absorption_at(f), still.absorption_at(f))
    assert still.speed_at(40e3) == still.group_speed_at(40e3) == air.speed_of_sound


@pytest.mark.parametrize(
    ("frequency", "faster", "shift", "degrees"),
    [
        (1e3, 0.0197, 0.57, 0.6), (20e3, 0.0497, 1.45, 30), (40e3, 0.0866, 2.52, 105), (80e3, 0.1185, 3.44, 288),
        (200e3, 0.1340, 3.89, 815),
    ],
)  # fmt: skip
def test_figures_of_air_at_20_degrees(frequency, faster, shift, degrees):
    """Speed against that at zero frequency, m/s, and shift in mm and phase in degrees over 10 m, to the last digit."""
    air = Air(20.0, 0.5, 101_325.0, C0, dispersion=True)
    c = air.speed_at(frequency)
    assert round(c - C0, 4) == faster
    assert round(10e3 * (1.0 - C0 / c), 2) == shift
    lead = np.degrees(10.0 * (2.0 * np.pi * frequency / C0 - air.wavenumber_at(frequency).real))
    assert round(lead, 1 if degrees < 1 else None) == degrees


def test_groups_are_as_fast_as_the_derivative_says():
    air, f, step = Air(), 40e3, 1.0
    k = air.wavenumber_at([f - step, f + step]).real
    assert air.group_speed_at(f) == pytest.approx(2.0 * np.pi * 2.0 * step / (k[1] - k[0]), rel=1e-9)
    assert air.group_speed_at(f) > air.speed_at(f) > air.speed_of_sound


def test_the_speed_is_what_the_absorption_asks_for():
    """The relation of Kramers and Kronig, by quadrature of the absorption a(v) over 1 Hz to 100 MHz.

    ``lead(f) = 2/pi f^3 P int a(v) / v^2 / (f^2 - v^2) dv``, without the classical part, which grows as the square of
    the frequency far beyond and whose own relaxation lies there. Below 1 Hz ``a(v) / v^2`` is constant.
    """
    air, cells = Air(), 200_000
    width = np.log(1e8) / cells
    v = np.exp((np.arange(cells) + 0.5) * width)
    with pytest.warns(clsim.ClsimWarning, match="10 Hz/Pa"):
        absorbed = -air.wavenumber_at(v).imag
    relaxed = absorbed - v**2 * (absorbed[-1] - absorbed[-2]) / (v[-1] ** 2 - v[-2] ** 2)
    for cell in (50_000, 90_000, 100_000, 115_000, 123_000, 132_000):
        f = v[cell] * np.exp(0.5 * width)  # between two cells: what is left and right of the pole cancels
        inside = np.sum(relaxed / v / (f**2 - v**2)) * width
        below = relaxed[0] / v[0] ** 2 * np.arctanh(1.0 / f) / f
        lead = 2.0 / np.pi * f**3 * (inside + below)
        assert lead == pytest.approx(2.0 * np.pi * f / air.speed_of_sound - air.wavenumber_at(f).real, rel=0.01)


def test_a_told_speed_holds_at_all_frequencies_unless_more_is_told():
    assert not Air(speed_of_sound=343.0).disperses
    assert Air(speed_of_sound=343.0).speed_at(40e3) == 343.0
    told = Air(speed_of_sound=343.0, dispersion=True)
    assert told.disperses
    assert told.speed_at(1e-2) == pytest.approx(343.0, rel=1e-12)
    assert Air(speed_of_sound="iso9613").disperses
    assert not Air(absorption=False).disperses
    with pytest.raises(clsim.InputError, match="without absorption") as error:
        Air(absorption=False, dispersion=True)
    assert error.value.field == "dispersion"
