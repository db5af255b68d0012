"""Tables of materials."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from clsim.errors import InputError
from clsim.scene.material.material import Material
from clsim.scene.material.reflecting_surface import as_scattering
from clsim.scene_file.model import Model, within

# How many there are is checked in our own words; editors read it here.
Pair = Annotated[list[float], Field(json_schema_extra={"minItems": 2, "maxItems": 2})]
Complex = float | Pair  # a complex number is written [real, imaginary]


class _Absorption(Model):
    frequencies: list[float]
    coefficients: list[float]

    def build(self, base: Path) -> Material:
        return Material.from_absorption(**self.arguments())


class _Table(Model):
    frequencies: list[float]
    factors: list[Complex]
    outside: Literal["hold"] | None = None

    def build(self, base: Path) -> Material:
        return Material.from_table(**self.arguments() | {"factors": _numbers("factors", self.factors)})


class _Impedance(Model):
    frequencies: list[float]
    impedances: list[Complex]
    outside: Literal["hold"] | None = None

    def build(self, base: Path) -> Material:
        return Material.from_impedance(**self.arguments() | {"impedances": _numbers("impedances", self.impedances)})


class _Echo(Model):
    reference: float = 0.0
    band: Pair | None = None
    outside: Literal["hold"] | None = None
    tolerance: float = 0.05


class _ImpulseResponse(_Echo):
    samples: list[float]
    sampling_rate: float

    def build(self, base: Path) -> Material:
        return Material.from_impulse_response(**self.arguments())


class _ImpulseResponseFile(_Echo):
    path: str
    channel: int = 0
    scale: float = 1.0
    truncated: bool = False

    def build(self, base: Path) -> Material:
        return Material.from_wav(**self.arguments() | {"path": base / self.path})


class _Solid(Model):
    density: float
    sound_speed: float
    boundary_layer: bool = True

    def build(self, base: Path) -> Material:
        return Material.from_solid(**self.arguments())


class _Porous(Model):
    flow_resistivity: float
    thickness: float
    outside: Literal["extend"] | None = None

    def build(self, base: Path) -> Material:
        return Material.from_porous(**self.arguments())


class _Scattering(Model):
    frequencies: list[float]
    values: list[float]


class _Transmission(Model):
    surface_mass: float | None = None
    frequencies: list[float] | None = None
    losses_db: list[float] | None = None


class MaterialModel(Model):
    """One description of a wall's material, its roughness (m), its scattering coefficient, and what passes it."""

    reflection: Complex | None = None
    named: str | None = None
    absorption: _Absorption | None = None
    table: _Table | None = None
    impedance: _Impedance | None = None
    impulse_response: _ImpulseResponse | None = None
    wav: _ImpulseResponseFile | None = None
    solid: _Solid | None = None
    porous: _Porous | None = None
    roughness: float = 0.0
    scattering: float | _Scattering | None = None
    transmission: _Transmission | None = None

    def build(self, base: Path) -> Material:
        """Return the material; paths are relative to `base`."""
        ways = [name for name in type(self).model_fields if name not in ("roughness", "scattering", "transmission")]
        given = [name for name in ways if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError("", f"must have one of {', '.join(ways)}, but has {' and '.join(given) or 'none of them'}")
        material = self._built(given[0], base)
        if self.scattering is not None:
            told = self.scattering
            coefficients = told if isinstance(told, float) else (told.frequencies, told.values)
            material = replace(material, scattering=as_scattering(coefficients))
        if self.transmission is not None:
            material = within("transmission", partial(_transmitting, material, self.transmission))
        try:
            return material.rough(self.roughness) if self.roughness else material
        except InputError as error:
            raise InputError("roughness", error.problem) from error

    def _built(self, way: str, base: Path) -> Material:
        value = getattr(self, way)
        if not isinstance(value, str | float | list):
            make: partial[Material] = partial(value.build, base)
            return within(way, make)
        try:
            return Material.named(value) if isinstance(value, str) else Material.from_reflection(_number("", value))
        except InputError as error:  # the constructor's word for it is another
            raise InputError(way, error.problem) from error


_WORDS = frozenset(MaterialModel.model_fields)


def is_material(value: Any) -> bool:
    """Whether a table is one material, not materials by name, which are tables themselves.

    A material's own tables (``absorption``, ``solid`` ...) could be names of groups in a mesh as well: what stands in
    them tells.
    """
    return not isinstance(value, dict) or all(
        not isinstance(entry, dict) or (key in MaterialModel.model_fields and not entry.keys() & _WORDS)
        for key, entry in value.items()
    )


def _transmitting(material: Material, given: _Transmission) -> Material:
    try:
        return material.transmitting(**given.arguments())
    except InputError as error:  # the field is named by the caller
        raise InputError("" if error.field == "transmission" else error.field, error.problem) from error


def _number(field: str, value: float | list[float]) -> float | complex:
    if not isinstance(value, list):
        return value
    if len(value) != 2:
        raise InputError(field, f"must be a number or [real, imaginary], but is {value!r:.80}")
    return complex(*value)


def _numbers(field: str, values: list[float | list[float]]) -> list[float | complex]:
    return [_number(f"{field}[{i}]", value) for i, value in enumerate(values)]
