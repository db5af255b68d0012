"""The air in the room."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clsim.acoustics import air as formulae
from clsim.arrays import Complexes, Floats, as_choice, as_flag, as_floats, as_number
from clsim.errors import InputError, check_kind, settle, warn
from clsim.numerics.band_filters import chebyshev_points
from clsim.scene.fluctuation import Fluctuation

ByHeight = float | tuple[float, float] | Callable[["Floats"], Any]  # a number, (lower, upper), or a function of heights
UNPLACED = (0.0, 1.0)  # m, heights of air that is in no room yet
MOST_TERMS = 33  # of polynomials


def height_profile(field: str, value: Any, **rule: Any) -> ByHeight:
    """Return normalised height profile: a number, a pair of numbers or a function; an equal pair becomes one number."""
    if callable(value):
        function: Callable[[Floats], Any] = value
        return function
    if isinstance(value, (list, tuple, np.ndarray)):
        low, high = (
            as_number(f"{field}[{i}]", v, **rule) for i, v in enumerate(as_floats(field, value, (2,)).tolist())
        )
        return low if low == high else (low, high)
    return as_number(field, value, **rule)


def at_heights(field: str, given: ByHeight, where: tuple[float, float], heights: Floats) -> Floats:
    """Return values of a height profile at heights (n,), m; a pair is interpolated linearly between two heights."""
    if isinstance(given, tuple):
        return given[0] + (given[1] - given[0]) * (heights - where[0]) / (where[1] - where[0])
    if not callable(given):
        return np.full(len(heights), given)
    found = np.asarray(given(heights), dtype=np.float64)
    if found.shape not in ((), heights.shape) or not np.all(np.isfinite(found)):
        problem = f"must return a finite number for each of {len(heights)} heights, but returns {found!r:.80}"
        raise InputError(field, problem)
    return np.broadcast_to(found, heights.shape)


def coefficients(values: Floats) -> Floats:
    """Return Chebyshev's coefficients (n, ...) of the polynomial with values (n, ...) at `chebyshev_points`."""
    count = len(values)
    turns = np.cos(np.arange(count)[:, None] * (np.pi * (np.arange(count) + 0.5) / count))
    turns[0] *= 0.5
    return np.asarray(np.tensordot(2.0 / count * turns, values, axes=1))


_COLDEST, _HOTTEST = -73.0, 100.0  # °C: 200 K, where ISO 9613-1 stops claiming anything, and boiling water
_THINNEST, _DENSEST = 1e4, 1e6  # Pa
_SLOWEST, _FASTEST = 100.0, 2000.0  # m/s: heavy gases, hydrogen, water
_STRONGEST = 0.5  # of the speed of sound, a wind
_FEWEST_TERMS = 3  # of polynomials of the height
_TIME_HELD, _LOSS_HELD = 1e-10, 1e-6  # relative errors of these at which more terms are not looked for
_TIME_WRONG = 3e-6  # the same of times, told from there on: 90 ns over 10 m
_EVALUATED_AT = np.array([1e3, 20e3, 40e3, 80e3, 200e3])  # Hz, at which absorption is held


@dataclass(frozen=True, slots=True, init=False)
class Air:
    """Air of one pressure, that rests or moves as a whole; temperature and humidity can depend on the height.

    Parameters
    ----------
    temperature_celsius : float or (float, float) or callable
        Temperature, -73 to 100 °C, everywhere. Two values are those at the lower and the upper of `heights`, linear in
        height. A function takes heights (n,) in m and returns temperatures (n,).
    relative_humidity : float or (float, float) or callable
        From 0 to 1 (not per cent), likewise.
    pressure : float
        Static pressure, 10 kPa to 1 MPa, Pa.
    speed_of_sound : float or "iso9613" or None
        A speed, 100 to 2000 m/s; ISO 9613-1's formula by name; or None for Cramer's formula (1993, 314 ppm CO2).
    absorption : bool
        Whether the air absorbs sound, by ISO 9613-1; without it closed forms of walls and spreading hold exactly.
    dispersion : bool
        Whether the speed of sound depends on frequency, as it does where relaxations absorb; the speed is then that at
        zero frequency.
    wind : array_like (3,), optional
        Velocity of the air, below half the speed of sound, m/s; at rest when left out.
    heights : (float, float), optional
        Range of heights for which the pairs are valid, m; the room's lowest and highest point when left out.
    fluctuation : Fluctuation, optional
        Slow noise of delays; none when left out.

    Attributes
    ----------
    speed_of_sound : float
        The given speed, or what the formula gives, m/s; at half the room's height where it depends on the height.
    wind : tuple or None
        Velocity of the air, m/s; None where it rests.
    extent : tuple or None
        Lowest and highest point of the room that air which depends on the height is in, m.
    layers : tuple of Air
        Homogeneous layers of such air, at Chebyshev's points of `extent`, from the highest down; empty otherwise.
    state : tuple of float
        Temperature, °C, relative humidity and pressure, Pa; at half the room's height where they depend on it.

    Raises
    ------
    InputError
        If a value is out of bounds, there would be more water vapour than air, or air that does not absorb disperses.

    Warns
    -----
    ClsimWarning
        If the speed lies outside the range of Cramer's formula (0 to 30 °C, 75 to 102 kPa), or the absorption
        is less sure than within 20 %, which ISO 9613-1 is from -20 to 50 °C, below 200 kPa and from 0.005 %
        of vapour.

    Examples
    --------
    >>> air = Air(temperature_celsius=20.0, relative_humidity=0.5)
    >>> round(air.speed_of_sound, 3), round(float(air.absorption_at(40e3)), 3)
    (343.994, 1.318)
    """

    temperature_celsius: ByHeight
    relative_humidity: ByHeight
    pressure: float
    speed_of_sound: float = field(init=False)
    absorption: bool
    dispersion: bool
    wind: tuple[float, float, float] | None
    heights: tuple[float, float] | None
    fluctuation: Fluctuation | None
    extent: tuple[float, float] | None
    layers: tuple[Air, ...] = field(init=False, repr=False, compare=False)
    state: tuple[float, float, float] = field(init=False, repr=False, compare=False)  # °C, 1, Pa, half way up
    _requested_speed: float | str | None = field(repr=False)  # so that `dataclasses.replace` keeps what was asked for

    def __init__(
        self, temperature_celsius: ByHeight = 20.0, relative_humidity: ByHeight = 0.5, pressure: float = 101_325.0,
        speed_of_sound: float | str | None = None, absorption: bool = True, dispersion: bool = False,
        wind: ArrayLike | None = None, heights: ArrayLike | None = None, fluctuation: Fluctuation | None = None, *,
        extent: tuple[float, float] | None = None, _requested_speed: float | str | None = None,
    ) -> None:  # fmt: skip
        warm = height_profile(
            "temperature_celsius", temperature_celsius, at_least=_COLDEST, at_most=_HOTTEST, unit="°C"
        )
        humid = _checked_humidity(relative_humidity)
        pascal = as_number("pressure", pressure, at_least=_THINNEST, at_most=_DENSEST, unit="Pa")
        requested = _requested_speed if speed_of_sound is None else speed_of_sound
        if isinstance(requested, str):
            as_choice("speed_of_sound", requested, ("iso9613",))
        elif requested is not None:
            requested = as_number("speed_of_sound", requested, at_least=_SLOWEST, at_most=_FASTEST, unit="m/s")
        absorbs, disperses = as_flag("absorption", absorption), as_flag("dispersion", dispersion)
        if disperses and not absorbs:
            raise InputError("dispersion", "must be False in air without absorption, but is True")
        check_kind("fluctuation", fluctuation, Fluctuation | None, "a Fluctuation")
        settle(
            self, temperature_celsius=warm, relative_humidity=humid, pressure=pascal, absorption=absorbs,
            dispersion=disperses, heights=None if heights is None else _checked_heights(heights),
            fluctuation=fluctuation, extent=extent, _requested_speed=requested,
        )  # fmt: skip
        self._settle()
        settle(self, wind=_checked_wind(wind, self.speed_of_sound))

    def _settle(self) -> None:
        """Set the layers, the state at mid-height, and the derived quantities."""
        layered = not (isinstance(self.temperature_celsius, float) and isinstance(self.relative_humidity, float))
        layers = _layers(self) if layered and self.extent is not None else ()
        low, high = self.extent or self.heights or UNPLACED
        (celsius, humidity), pascal = self.at_height(np.array([0.5 * (low + high)]))[:, 0].tolist(), self.pressure
        vapour = formulae.vapour_fraction_giacomo(celsius, humidity, pascal)
        if vapour >= 1.0:
            problem = f"at {celsius:g} °C and {pascal:g} Pa {humidity:g} is nothing but water vapour"
            raise InputError("relative_humidity", f"must leave room for air, but {problem}")
        speed = self._requested_speed
        if speed is None:
            speed = formulae.speed_of_sound_cramer(celsius, humidity, pascal)
        elif isinstance(speed, str):
            speed = formulae.speed_of_sound_iso9613(celsius)
        settle(self, layers=layers, state=(celsius, humidity, pascal), speed_of_sound=speed)
        if not layers:  # of which each has told
            _warn_of_range(self, vapour)

    def at_height(self, height: Floats) -> Floats:
        """Return temperature, °C, and relative humidity, 0 to 1, (2, n) at each `height` (n,), m."""
        where = self.heights or self.extent or UNPLACED
        given = {"temperature_celsius": self.temperature_celsius, "relative_humidity": self.relative_humidity}
        return np.stack([at_heights(name, value, where, height) for name, value in given.items()])

    def between(self, lowest: float, highest: float) -> Air:
        """Return the air from `lowest` to `highest`, m: with layers if it depends on the height, else itself."""
        if isinstance(self.temperature_celsius, float) and isinstance(self.relative_humidity, float):
            return self
        return replace(self, extent=(lowest, highest))

    def by_height(self, quantity: Callable[[Air], ArrayLike]) -> Floats:
        """Return Chebyshev coefficients (terms, ...) over `extent` of a `quantity` of layers, in its unit, m or s."""
        if not self.layers:
            return np.asarray(quantity(self), dtype=np.float64)[None]
        return coefficients(np.array([quantity(layer) for layer in self.layers]))

    @property
    def slowest(self) -> float:
        """Lower bound of the propagation speed, against the wind, m/s."""
        slowest = min((layer.speed_of_sound for layer in self.layers), default=self.speed_of_sound)
        return slowest - (0.0 if self.wind is None else math.hypot(*self.wind))

    def describe(self) -> list[str]:
        """Return a description of the air, a line per fact."""
        celsius, humidity, _ = self.state
        lines = [
            f"air: {celsius:g} °C, {100.0 * humidity:g} % relative humidity, sound at {self.speed_of_sound:.2f} m/s"
            + (" half way up" if self.layers else "")
        ]
        if self.layers:
            low, high = self.extent or UNPLACED
            (cold, warm), (dry, damp) = self.at_height(np.array([low, high])).tolist()
            speeds = [layer.speed_of_sound for layer in self.layers]
            bend = ((max(speeds) - min(speeds)) / (high - low) / self.speed_of_sound) ** 2 * 1e3 / 24.0
            lines.append(
                f"air: {cold:g} °C, {100.0 * dry:g} % at {low:g} m to {warm:g} °C, {100.0 * damp:g} % at {high:g} m, "
                f"sound at {min(speeds):.2f} to {max(speeds):.2f} m/s; legs are straight, some {1e3 * bend:.2g} mm too "
                f"long over 10 m at most"
            )
        if self.wind is not None:
            lines.append("air: wind of ({:g}, {:g}, {:g}) m/s".format(*self.wind))
        if self.fluctuation is not None:
            given = self.fluctuation
            note = f"air: delays fluctuate by {1e6 * given.rms:g} µs, over {given.correlation_time:g} s and "
            lines.append(f"{note}{given.correlation_length:g} m, seed {given.seed}")
        return lines

    def absorption_at(self, frequency: ArrayLike) -> Floats:
        """Return the absorption (...) of pure tones by ISO 9613-1, dB/m, at half the room's height; 0 without.

        Parameters
        ----------
        frequency : array_like
            Frequencies of any shape, at least 0, Hz.

        Warns
        -----
        ClsimWarning
            Above 10 Hz/Pa (1.01 MHz at one atmosphere), where ISO 9613-1 states no accuracy.
        """
        f = np.asarray(frequency, dtype=np.float64)
        if not np.all((f >= 0.0) & np.isfinite(f)):
            raise InputError("frequency", "must be finite and at least 0 Hz")
        if not self.absorption:
            return np.zeros(f.shape)
        if np.any(f > 10.0 * self.pressure):
            note = f"the absorption of air is asked for at {np.max(f):g} Hz, but ISO 9613-1 states its accuracy "
            warn(f"{note}up to 10 Hz/Pa only, here {10.0 * self.pressure:g} Hz")
        return formulae.absorption_iso9613(f, *self.state)

    def wavenumber_at(self, frequency: ArrayLike) -> Complexes:
        """Return the complex wavenumber k (...) at a `frequency` (...), Hz: ``exp(j 2 pi f t - j k x)``, 1/m."""
        f = np.asarray(frequency, dtype=np.float64)
        k = 2.0 * np.pi / self.speed_of_sound * f - 1j * np.log(10.0) / 20.0 * self.absorption_at(f)
        return np.asarray(k - formulae.lead_iso9613(f, *self.state) if self.dispersion else k)

    def speed_at(self, frequency: float) -> float:
        """Return the speed of sound of a pure tone at a `frequency` above 0 Hz, that of its phase, m/s."""
        c = self.speed_of_sound
        if not self.dispersion:
            return c
        return c / (1.0 - c * float(formulae.lead_iso9613(frequency, *self.state)) / (2.0 * np.pi * frequency))

    def group_speed_at(self, frequency: float) -> float:
        """Return the group speed at a `frequency` of at least 0 Hz, at which envelopes travel, m/s."""
        c = self.speed_of_sound
        if not self.dispersion:
            return c
        return c / (1.0 - c * float(formulae.lead_slope_iso9613(frequency, *self.state)))


def _checked_humidity(value: ByHeight) -> ByHeight:
    given = height_profile("relative_humidity", value, at_least=0.0)
    for humidity in () if callable(given) else (given,) if isinstance(given, float) else given:
        if humidity > 1.0:
            hint = f"; {humidity:g} per cent is {humidity / 100:g}" if humidity <= 100.0 else ""
            raise InputError("relative_humidity", f"must be from 0 to 1, but is {humidity:g}{hint}")
    return given


def _checked_heights(value: ArrayLike) -> tuple[float, float]:
    low, high = as_floats("heights", value, (2,)).tolist()
    if not low < high:
        raise InputError("heights", f"must be a lower and an upper one, but are {low:g} and {high:g} m")
    return low, high


def _layers(air: Air) -> tuple[Air, ...]:
    """Return the air at the Chebyshev points of the height polynomials; empty for uniform air."""
    terms = _FEWEST_TERMS
    while True:
        layers, more = _at_places(air, terms), _at_places(air, 2 * terms)
        if all(layer == layers[0] for layer in (*layers, *more)):
            return ()
        exact, held = _of_layers(more), coefficients(_of_layers(layers))
        made = np.polynomial.chebyshev.chebval(chebyshev_points(-1.0, 1.0, 2 * terms), held).T
        wrong = np.abs(made - exact).max(axis=0) / np.maximum(exact.max(axis=0), 1e-300)
        if (wrong[0] <= _TIME_HELD and wrong.max() <= _LOSS_HELD) or terms >= MOST_TERMS:
            break
        terms = 2 * terms - 1
    if wrong[0] > _TIME_WRONG:
        note = "temperature_celsius changes so suddenly with the height that travel times have an error of up to "
        warn(f"{note}{1e9 * 10.0 * wrong[0] * exact[:, 0].max():.3g} ns over 10 m; make the profile smoother")
    return layers


def _at_places(air: Air, count: int) -> tuple[Air, ...]:
    """Return uniform air at each Chebyshev point of the height range."""
    assert air.extent is not None
    given = air.at_height(chebyshev_points(*air.extent, count))
    return tuple(
        Air(celsius, humidity, air.pressure, air._requested_speed, air.absorption, air.dispersion)
        for celsius, humidity in given.T.tolist()
    )


def _of_layers(layers: tuple[Air, ...]) -> Floats:
    """Return slownesses and absorptions (n, 1 + frequencies) of layers."""
    return np.array([[1.0 / layer.speed_of_sound, *layer.absorption_at(_EVALUATED_AT)] for layer in layers])


def _checked_wind(value: ArrayLike | None, speed_of_sound: float) -> tuple[float, float, float] | None:
    if value is None:
        return None
    x, y, z = as_floats("wind", value, (3,)).tolist()
    most = _STRONGEST * speed_of_sound
    if math.hypot(x, y, z) >= most:
        problem = f"must be slower than half the speed of sound, {most:.6g} m/s, but is {math.hypot(x, y, z):.6g} m/s"
        raise InputError("wind", problem)
    return (x, y, z) if x or y or z else None


def _warn_of_range(air: Air, vapour: float) -> None:
    """Warn of a speed outside the range of Cramer's formula, and of absorption that ISO 9613-1 is less sure of."""
    celsius, percent = air.state[0], formulae.vapour_percent_iso9613(*air.state)
    has = f"but the air has {celsius:g} °C, {air.pressure / 1e3:g} kPa"
    inside = 0.0 <= celsius <= 30.0 and 75e3 <= air.pressure <= 102e3 and vapour <= 0.06
    if air._requested_speed is None and not inside:
        note = "Cramer's formula of the speed of sound holds from 0 to 30 °C, 75 to 102 kPa and up to 6 % of vapour, "
        warn(f'{note}{has} and {100 * vapour:.3g} %; give speed_of_sound as a number or as "iso9613"')
    if air.absorption and not (-20.0 <= celsius <= 50.0 and air.pressure < 200e3 and percent >= 0.005):
        warn(
            "ISO 9613-1 gives the absorption of air within 20 % from -20 to 50 °C, below 200 kPa and from 0.005 % of "
            f"vapour, {has} and {percent:.3g} %"
        )
