"""Materials of walls: constructors, the built-in library, hard smooth solids and fibrous absorbers."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics import reflection as formulae
from clsim.arrays import LOUDEST, Floats, as_choice, as_count, as_floats, as_number
from clsim.errors import InputError, check_kind
from clsim.files.sound import as_scale, read_sound_file
from clsim.scene.material import reflecting_surface as surfaces

MIKI_RANGE = (0.01, 1.0)  # m³/kg, of frequency over flow resistivity
_CONSTRUCTORS = {"reflection": "factor", "absorption": "coefficients", "solid": None, "porous": None}
_RIGID = 1e12  # impedance over that of air beyond which nothing changes any more
_DENSEST, _STIFFEST = 1e7, 1e7  # kg/m³ and m/s, beyond all solids
_HARD = 1e5  # Pa s/m, impedance from which a solid reflects 99 % at least
_FEW = 512  # samples of an impulse response that are summed at once


def _constant(value: complex, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
    return np.full(frequency.shape, value)


def _given(factors: surfaces.Curve, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
    return factors(frequency)


def _absorbing(coefficients: surfaces.Curve, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
    return formulae.reflection_from_absorption(coefficients.share(frequency))


def _reacting(impedances: surfaces.Curve, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
    return formulae.reflection_from_impedance(impedances(frequency), cosine)


def _solid(of: tuple[float, float], layer: bool, frequency: Floats, cosine: Floats, speed_of_sound: float) -> Any:
    """Return the factor of a thick smooth solid of a density, kg/m³, and a sound speed, m/s."""
    # The mismatch of impedances at normal incidence is taken at all angles. Beyond some 10 degrees nothing at all can
    # be transmitted into a hard solid, so this takes away too much there: less than 2e-4 of the pressure for concrete.
    mismatch = formulae.mismatch_reflection(*of, speed_of_sound)
    if not layer:
        return np.full(frequency.shape, mismatch)
    beta = formulae.boundary_layer_admittance(frequency, cosine, speed_of_sound)
    return mismatch * formulae.reflection_from_impedance(1.0 / beta, cosine)


def _porous(resistivity: float, thickness: float, frequency: Floats, cosine: Floats, speed_of_sound: float) -> Any:
    """Return the factor of a fibrous absorber on a rigid wall, by Miki."""
    phase = 2.0 * math.pi * frequency / speed_of_sound * thickness
    return formulae.backed_layer_reflection(*formulae.porous_medium(frequency, resistivity), phase, cosine)


def _echoed(
    samples: Floats, rate: float, reference: float, band: tuple[float, float], frequency: Floats, *_: Any
) -> NDArray[Any]:
    """Return the spectrum ``sum h[n] exp(-2j π f (n - reference) / rate)``, at frequencies held within a band, Hz."""
    f, back = np.unique(np.clip(frequency, *band), return_inverse=True)
    turn = -2j * np.pi * f / rate  # per sample
    # A long sum as a short sum of short ones: few exponentials, and a product of matrices.
    rows = np.pad(samples, (0, -len(samples) % _FEW)).reshape(-1, _FEW)
    spectrum = np.zeros(len(f), dtype=np.complex128)
    for part in np.array_split(np.arange(len(f)), max(1, len(f) // 512)):
        short = np.exp(turn[part, None] * np.arange(_FEW)) @ rows.T
        spectrum[part] = (short * np.exp(turn[part, None] * _FEW * np.arange(len(rows)))).sum(axis=1)
    return np.asarray((spectrum * np.exp(-turn * reference))[back].reshape(frequency.shape))


@dataclass(frozen=True, slots=True)
class LibraryEntry:
    """A built-in material."""

    name: str  # what it is called, and what it is
    what: str  # likewise
    source: str  # where it is from, and how sure
    uncertainty: str  # likewise
    constructor: str  # the constructor of `Material` that makes it, without ``from_``, and its arguments
    arguments: dict[str, Any]  # likewise
    roughness: float  # root mean square of its heights, m
    scattering: Any  # (frequencies, values) share of the energy sent back that leaves the mirror's direction
    beyond: str  # what happens outside its table

    @property
    def estimated(self) -> bool:
        """Whether it is calculated from assumed properties."""
        return self.name.startswith("estimated-")


def _read(path: Path) -> dict[str, LibraryEntry]:
    content = tomllib.loads(path.read_text("utf-8"))
    library = {}
    for name, row in content["materials"].items():
        constructor = next(key for key in _CONSTRUCTORS if key in row)
        argument = _CONSTRUCTORS[constructor]
        arguments = {argument: row[constructor]} if argument else row[constructor]
        if constructor == "absorption":
            arguments |= {"frequencies": content["octaves"]}
        instead = row.get("ultrasound")
        advice = f"for ultrasound there is {instead!r}, an estimate" if instead else "measure it for ultrasound"
        library[name] = LibraryEntry(
            name, row["what"], content["sources"][row["source"]], row["uncertainty"], constructor, arguments,
            row.get("roughness", 0.0), row.get("scattering", 0.0),
            f"outside, the absorption at the nearest end is taken; {advice}",
        )  # fmt: skip
    return library


LIBRARY = _read(Path(__file__).with_name("library.toml"))
MATERIAL_NAMES = tuple(LIBRARY)


@dataclass(frozen=True, slots=True, eq=False)
class Material(surfaces.ReflectingSurface):
    """Acoustic properties of a wall: reflection, scattering and transmission by frequency and angle of incidence.

    Made by one of the constructors below, which all take `name` and `scattering`; `reflection_at` gives the factor.

    Parameters
    ----------
    model : SurfaceModel
        Model of the reflection factor.
    name : str
        Name in messages and tables.
    roughness : float
        Root mean square of the wall's heights, m: see `rough`.
    scattering : float or (frequencies, values), optional
        Share of the energy sent back that leaves the mirror's direction, 0 to 1, by frequency in Hz.
    transmission : SurfaceModel, optional
        Model of the transmission factor of the pressure: see `transmitting`.

    Examples
    --------
    >>> Material.from_reflection(0.9).reflection_at([20e3, 40e3]).tolist()
    [0.9, 0.9]
    """

    @classmethod
    def from_reflection(cls, factor: complex, name: str = "", *, scattering: Any = None) -> Material:
        """Return a material of one reflection factor of sound pressure.

        Parameters
        ----------
        factor : float or complex
            From -1 (pressure release) to 1 (rigid), or complex with a magnitude of 1 at most.
        """
        value = surfaces.as_factor("factor", factor)
        model = surfaces.SurfaceModel(partial(_constant, value), f"reflection {value:g}", isinstance(value, complex))
        return cls(model, name, scattering=scattering)

    @classmethod
    def from_absorption(
        cls, frequencies: ArrayLike, coefficients: ArrayLike, name: str = "", *, scattering: Any = None
    ) -> Material:
        """Return a material of absorption coefficients by frequency; factors are ``sqrt(1 - α)``, at all angles.

        Parameters
        ----------
        frequencies : array_like (n,)
            Positive and increasing, Hz.
        coefficients : array_like (n,)
            Shares of energy absorbed, 0 to 1. Monotone cubics over the logarithm of frequency join them; outside, the
            ends are held with a warning.

        Examples
        --------
        >>> Material.from_absorption([1e3, 4e3], [0.0, 0.72]).reflection_at([1e3, 2e3]).round(6).tolist()
        [1.0, 0.8]
        """
        f = surfaces.checked_frequencies(frequencies)
        alpha = surfaces.Curve(f, surfaces.as_column("coefficients", coefficients, f, 1.0))
        beyond = "outside, the absorption at the nearest end is taken"
        model = surfaces.of_table(f, partial(_absorbing, alpha), "absorption table", beyond=beyond)
        return cls(model, name, scattering=scattering)

    @classmethod
    def from_table(
        cls, frequencies: ArrayLike, factors: ArrayLike, outside: str | None = None, name: str = "", *,
        scattering: Any = None,
    ) -> Material:  # fmt: skip
        """Return a material of reflection factors by frequency, at all angles.

        Parameters
        ----------
        frequencies : array_like (n,)
            Positive and increasing, Hz.
        factors : array_like (n,)
            Real, -1 to 1, or complex with magnitudes of 1 at most.
        outside : {None, "hold"}
            Rule for frequencies outside the table: refused (None), or the factor at the nearest end.

        Warns
        -----
        ClsimWarning
            If the phase turns by more than 3/4 π between two frequencies: the table then cannot tell which way.

        Notes
        -----
        Monotone cubics join real factors over the logarithm of frequency. Complex ones first lose their mean delay,
        which is put back afterwards; of the rest monotone cubics over frequency join real and imaginary parts. So a
        delay stays one, and a factor may pass through zero.

        Examples
        --------
        >>> delay = Material.from_table([30e3, 50e3], np.exp([0.0, -0.4j]))
        >>> np.angle(delay.reflection_at(35e3)).round(6).item()
        -0.1
        """
        f = surfaces.checked_frequencies(frequencies)
        given = surfaces.as_complexes("factors", factors, len(f))
        for i in np.flatnonzero(np.abs(given) > 1.0 + surfaces.ROUNDING)[:1]:
            raise InputError(f"factors[{i}]", f"must have a magnitude of at most 1, but is {given[i]:g}")
        surfaces.check_clear_phase(f, given)
        turns = given.dtype.kind == "c"
        law, what = partial(_given, surfaces.Curve(f, given, True)), "complex table" if turns else "table of factors"
        model = surfaces.of_table(f, law, what, held=_goes_on(outside, "hold"), is_complex=turns)
        return cls(model, name, scattering=scattering)

    @classmethod
    def from_impedance(
        cls, frequencies: ArrayLike, impedances: ArrayLike, outside: str | None = None, name: str = "", *,
        scattering: Any = None,
    ) -> Material:  # fmt: skip
        """Return a locally reacting wall: sound moves it here and there, but not along it.

        Parameters
        ----------
        frequencies : array_like (n,)
            Positive and increasing, Hz.
        impedances : array_like (n,)
            Specific impedances over that of air, ``Z / (ρ c)``, without a unit, real or complex, with real parts of at
            least 0.
            Monotone cubics over the logarithm of frequency join real and imaginary parts.
        outside : {None, "hold"}
            Rule for frequencies outside the table: refused (None), or the impedance at the nearest end.

        Notes
        -----
        ``R = (ζ cos θ - 1) / (ζ cos θ + 1)``.

        Examples
        --------
        >>> panel = Material.from_impedance([40e3], [3.0 - 1.0j])
        >>> panel.reflection_at(40e3, [1.0, 0.5]).round(3).tolist()
        [(0.529-0.118j), (0.231-0.154j)]
        """
        f = surfaces.checked_frequencies(frequencies)
        given = surfaces.as_complexes("impedances", impedances, len(f)).astype(np.complex128)
        given.flags.writeable = False
        for i in np.flatnonzero(given.real < 0.0)[:1]:
            raise InputError(f"impedances[{i}]", f"must have a real part of at least 0 (passive), but is {given[i]:g}")
        for i in np.flatnonzero(np.abs(given) > _RIGID)[:1]:
            raise InputError(f"impedances[{i}]", f"must have a magnitude of at most {_RIGID:g}, but is {given[i]:g}")
        law, kind = partial(_reacting, surfaces.Curve(f, given)), {"is_complex": True, "depends_on_angle": True}
        model = surfaces.of_table(f, law, "locally reacting impedance", held=_goes_on(outside, "hold"), **kind)
        return cls(model, name, scattering=scattering)

    @classmethod
    def from_impulse_response(
        cls, samples: ArrayLike, sampling_rate: float, reference: float = 0.0, band: tuple[float, float] | None = None,
        outside: str | None = None, tolerance: float = 0.05, name: str = "", *, scattering: Any = None,
    ) -> Material:  # fmt: skip
        """Return the material whose reflection was measured as an impulse response; it holds at all angles.

        Parameters
        ----------
        samples : array_like (n,)
            Response to a unit impulse, whose spectrum is the factor. All of them count, so cut or window away
            what is not the wall's. At most 131 072.
        sampling_rate : float
            Hz.
        reference : float
            Index, perhaps between samples, at which a reflection by the wall's plane itself would be: 0 s.
        band : (low, high), optional
            Band in which the measurement is valid, Hz; from 0 Hz to half the sampling rate when left out.
        outside : {None, "hold"}
            Rule for frequencies outside the band: refused (None), or the factor at the nearest end.
        tolerance : float
            By how much magnitudes within the band may exceed 1, 0 to 1; they are then taken as 1. More is refused.

        Raises
        ------
        InputError
            If a value is out of bounds, or the response sends back more than it receives.

        Warns
        -----
        ClsimWarning
            If the last tenth of the samples still holds so much noise or echo that factors are off by more than 0.02.

        Examples
        --------
        >>> wall = Material.from_impulse_response([0.0, 0.0, 0.8], 192e3, reference=2)
        >>> abs(wall.reflection_at(40e3)).round(12).item()
        0.8
        """
        rate = as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")
        taps = as_floats("samples", samples, (None,), within=LOUDEST)
        reference = as_number("reference", reference, at_least=-1e6, at_most=1e6)
        tolerance = as_number("tolerance", tolerance, at_least=0.0, at_most=1.0)
        low, high = (0.0, 0.5 * rate) if band is None else as_floats("band", band, (2,)).tolist()
        if not 0.0 <= low < high <= 0.5 * rate:
            problem = f"must rise from 0 Hz or more to {0.5 * rate:g} Hz or less, but is {low:g}, {high:g}"
            raise InputError("band", problem)
        surfaces.check_passive_echo(taps, rate, (low, high), tolerance)
        surfaces.warn_of_noise(taps, name)
        covered = surfaces.EVERYWHERE if _goes_on(outside, "hold") else (low, high)
        law, what = partial(_echoed, taps, rate, reference, (low, high)), f"impulse response of {len(taps)} samples"
        return cls(surfaces.SurfaceModel(law, what, True, band=covered), name, scattering=scattering)

    @classmethod
    def from_wav(
        cls, path: str | PathLike[str], channel: int = 0, scale: float = 1.0, reference: float = 0.0,
        band: tuple[float, float] | None = None, outside: str | None = None, tolerance: float = 0.05, name: str = "", *,
        scattering: Any = None, truncated: bool = False,
    ) -> Material:  # fmt: skip
        """Return the material whose impulse response is one channel of a sound file.

        Parameters
        ----------
        path, channel, truncated
            As of `Signal.from_wav`.
        scale : float
            Value of full scale: 1 where the file holds the factor's own impulse response.
        reference, band, outside, tolerance, name
            See `from_impulse_response`.
        """
        channel, scale = as_count("channel", channel, at_least=0), as_scale(scale)
        samples, rate = read_sound_file(path, channel, truncated)
        taps = scale * samples.astype(np.float64)
        return cls.from_impulse_response(taps, rate, reference, band, outside, tolerance, name, scattering=scattering)

    @classmethod
    def from_solid(
        cls, density: float, sound_speed: float, boundary_layer: bool = True, name: str = "", *, scattering: Any = None
    ) -> Material:
        """Return a thick, hard, smooth, airtight solid.

        Parameters
        ----------
        density : float
            kg/m³.
        sound_speed : float
            Speed of longitudinal waves, m/s; density times sound speed is at least 1e5 Pa s/m.
        boundary_layer : bool
            Whether viscosity and heat conduction at the wall take their part. At 40 kHz this is 0.4 % of the pressure
            at normal incidence, and more at grazing incidence. Otherwise one real factor for all angles.

        Notes
        -----
        The mismatch of impedances is that of `clsim.acoustics.reflection.mismatch_reflection`, the boundary layer by
        `clsim.acoustics.reflection.boundary_layer_admittance`. Bending and resonances of thin plates are left out.

        Examples
        --------
        >>> concrete = Material.from_solid(2300.0, 3500.0)
        >>> abs(concrete.reflection_at(40e3, [1.0, 0.1])).round(3).tolist()
        [0.996, 0.889]
        """
        density = as_number("density", density, above=0.0, at_most=_DENSEST, unit="kg/m³")
        sound_speed = as_number("sound_speed", sound_speed, above=0.0, at_most=_STIFFEST, unit="m/s")
        if density * sound_speed < _HARD:
            problem = f"must be that of a hard solid, density times sound_speed at least {_HARD:g} Pa s/m, but that is "
            raise InputError("density", f"{problem}{density * sound_speed:g} Pa s/m; give its impedance")
        check_kind("boundary_layer", boundary_layer, bool, "true or false")
        law = partial(_solid, (density, sound_speed), boundary_layer)
        what = f"solid of {density:g} kg/m³ and {sound_speed:g} m/s"
        return cls(surfaces.SurfaceModel(law, what, boundary_layer, boundary_layer), name, scattering=scattering)

    @classmethod
    def from_porous(
        cls, flow_resistivity: float, thickness: float, outside: str | None = None, name: str = "", *,
        scattering: Any = None,
    ) -> Material:  # fmt: skip
        """Return a fibrous absorber on a rigid wall, by Miki's formula.

        Parameters
        ----------
        flow_resistivity : float
            Flow resistivity of the absorber, 100 to 1e7 Pa s/m².
        thickness : float
            Above 0, at most 10 m.
        outside : {None, "extend"}
            Rule where frequency over flow resistivity is not from 0.01 to 1 m³/kg, for which the formula was
            fitted: refused, or the formula is used all the same.

        Notes
        -----
        See `clsim.acoustics.reflection.porous_medium` and `backed_layer_reflection`: sound is refracted into the layer.

        Examples
        --------
        >>> wool = Material.from_porous(50e3, 0.02)
        >>> abs(wool.reflection_at(40e3, [1.0, 0.5])).round(2).tolist()
        [0.07, 0.13]
        """
        resistivity = as_number("flow_resistivity", flow_resistivity, at_least=100.0, at_most=1e7, unit="Pa s/m²")
        thickness = as_number("thickness", thickness, above=0.0, at_most=10.0, unit="m")
        fitted = MIKI_RANGE[0] * resistivity, MIKI_RANGE[1] * resistivity
        covered = surfaces.EVERYWHERE if _goes_on(outside, "extend") else fitted
        law = partial(_porous, resistivity, thickness)
        what = f"porous layer of {1e3 * thickness:g} mm and {resistivity:g} Pa s/m²"
        return cls(surfaces.SurfaceModel(law, what, True, True, covered), name, scattering=scattering)

    @classmethod
    def named(cls, name: str, *, scattering: Any = None) -> Material:
        """Return a built-in material.

        Parameters
        ----------
        name : str
            ``"rigid"`` (+1) and ``"pressure-release"`` (-1) are exact. ``"concrete"``, ``"brick"``, ``"carpet"`` and so
            on are published coefficients from 125 Hz to 4 kHz, held above with a warning. Those that begin with
            ``"estimated-"`` are calculated for ultrasound from assumed properties: no measurements. ``clsim
            materials`` lists all with source and uncertainty.

        Examples
        --------
        >>> float(Material.named("pressure-release").reflection_at(40e3))
        -1.0
        """
        entry = LIBRARY[as_choice("name", name, MATERIAL_NAMES)]
        made: Material = getattr(cls, f"from_{entry.constructor}")(
            **entry.arguments, name=name, scattering=entry.scattering if scattering is None else scattering
        )
        if made.model.beyond:
            made = replace(made, model=replace(made.model, beyond=entry.beyond))
        return made.rough(entry.roughness) if entry.roughness else made


def _goes_on(outside: str | None, extended: str) -> bool:
    return outside is not None and bool(as_choice("outside", outside, (extended,)))
