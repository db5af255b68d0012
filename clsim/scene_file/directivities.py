"""Tables of directivities."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from clsim.errors import InputError
from clsim.scene.directivity.axial_table import AxialDirectivity
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.directivity.patterns import FirstOrder, Omni, Piston
from clsim.scene.directivity.spherical_table import SphericalDirectivity
from clsim.scene_file.model import Model


class OmniModel(Model):
    """The same in every direction."""

    kind: Literal["omni"] = "omni"

    def build(self, base: Path) -> Directivity:
        """Return what it says."""
        return Omni()


class _FirstOrder(Model):
    kind: Literal["first-order"]
    weight: float = 0.5

    def build(self, base: Path) -> Directivity:
        """Return the directivity of first order."""
        return FirstOrder(self.weight)


class _Piston(Model):
    kind: Literal["piston"]
    radius: float

    def build(self, base: Path) -> Directivity:
        """Return the piston's directivity."""
        return Piston(self.radius)


class _Named(Model):
    kind: Literal["named"]
    name: str
    outside: Literal["hold"] | None = None

    def build(self, base: Path) -> Directivity:
        """Return the directivity that a file has by this name."""
        return Directivity.named(self.name, self.outside)


class DirectivityTableModel(Model):
    """A file of values by angle and frequency: ``.csv``, ``.txt``, ``.npz`` or ``.mat``."""

    kind: Literal["table"]
    path: str
    phases_path: str | None = None
    scale: Literal["linear", "db"] | None = None
    variable: str | None = None
    angle: str | None = None
    frequency: str | None = None
    values: str | None = None
    angle_unit: Literal["degree", "radian"] | None = None
    rear: Literal["hold", "mirror", "zero"] | None = None
    side: Literal["positive", "negative", "mean"] | None = None
    outside: Literal["hold"] | None = None
    relative_to_axis: bool = False

    def build(self, base: Path) -> Directivity:
        """Return what it says."""
        path = base / self.path
        options: dict[str, Any] = {
            name: getattr(self, name) for name in ("rear", "side", "outside", "relative_to_axis")
        } | {"name": path.stem}
        layout = {
            name: getattr(self, name)
            for name in ("variable", "angle", "frequency", "values", "angle_unit")
            if getattr(self, name) is not None
        }
        suffix = path.suffix.lower()
        if suffix in (".csv", ".txt"):
            for name in layout:
                raise InputError(
                    name, f"must be left out for text files, whose layout is fixed, but is {layout[name]!r}"
                )
            phases = None if self.phases_path is None else base / self.phases_path
            return AxialDirectivity.from_csv(path, phases, self.scale or "db", **options)
        if suffix not in (".npz", ".mat"):
            raise InputError("path", f"must end in .csv, .txt, .npz or .mat, but is {self.path!r:.80}")
        if self.phases_path is not None:
            raise InputError("phases_path", f"must be left out for {suffix} files, which can hold complex values")
        if suffix == ".npz" and self.variable is not None:
            raise InputError(
                "variable", f"must be left out for .npz files, which hold no structs, but is {self.variable!r}"
            )
        read = AxialDirectivity.from_npz if suffix == ".npz" else AxialDirectivity.from_mat
        return read(path, self.scale, **layout, **options)


class SofaModel(Model):
    """A SOFA file."""

    kind: Literal["sofa"]
    path: str
    measurement: int = 0
    outside: Literal["hold"] | None = None
    relative_to_axis: bool = False

    def build(self, base: Path) -> Directivity:
        """Return what it says."""
        path = base / self.path
        return SphericalDirectivity.from_sofa(
            path, self.measurement, outside=self.outside, relative_to_axis=self.relative_to_axis, name=path.stem
        )


DirectivityModel = Annotated[
    OmniModel | _FirstOrder | _Piston | _Named | DirectivityTableModel | SofaModel,
    Field(discriminator="kind"),
]
