"""The ``[render]`` of a scene file: a key for each field of `RenderOptions`, of its type and with its default."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

from pydantic import Field, create_model

from clsim.render.baseband import Baseband
from clsim.render.interpolator import Bandlimited, Interpolator, Lagrange, TruncatedLagrange
from clsim.render.options import RenderOptions
from clsim.scene_file.model import Model, within


class _Part(Model):
    def build(self) -> Any:
        """Return the value of an option that the table stands for."""
        raise NotImplementedError


class _Lagrange(_Part):
    kind: Literal["lagrange"]
    order: int = 12

    def build(self) -> Interpolator:
        """Return the Lagrange interpolator."""
        return Lagrange(self.order)


class _TruncatedLagrange(_Part):
    kind: Literal["truncated-lagrange"]
    order: int
    length: int

    def build(self) -> Interpolator:
        """Return the truncated Lagrange interpolator."""
        return TruncatedLagrange(self.order, self.length)


class _Bandlimited(_Part):
    kind: Literal["bandlimited"] = "bandlimited"
    error_db: float = -90.0

    def build(self) -> Interpolator:
        """Return the band-limited interpolator."""
        return Bandlimited(self.error_db)


class _Baseband(_Part):
    carrier: float
    bandwidth: float
    sampling_rate: float | None = None

    def build(self) -> Baseband:
        """Return carrier and bandwidth, Hz."""
        return Baseband(self.carrier, self.bandwidth, self.sampling_rate)


InterpolatorModel = Annotated[_Lagrange | _TruncatedLagrange | _Bandlimited, Field(discriminator="kind")]
# Options whose values are no plain ones of TOML: type and default in the file.
_TABLES: dict[str, tuple[Any, Any]] = {
    "interpolator": (InterpolatorModel, _Bandlimited()),
    "baseband": (_Baseband | None, None),
}


class RenderTable(Model):
    """What `render_model` adds the keys to."""

    def build(self) -> dict[str, Any]:
        """Return the keyword arguments of `render`."""
        return {
            name: within(name, value.build) if isinstance(value, _Part) else value
            for name, value in self.arguments().items()
        }


def render_model(options: type[Any]) -> type[RenderTable]:
    """Return the model of a scene file's table that has a key for each field of a dataclass of options."""
    types = get_type_hints(options)
    plain = {f.name: (types[f.name], ... if f.default is MISSING else f.default) for f in fields(options)}
    keys: dict[str, Any] = plain | {name: form for name, form in _TABLES.items() if name in plain}
    return create_model("_Render", __base__=RenderTable, **keys)


if TYPE_CHECKING:
    RenderModel = RenderTable
else:
    RenderModel = render_model(RenderOptions)
