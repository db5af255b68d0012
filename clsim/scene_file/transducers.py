"""Tables of directivities, transducers and electronics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from clsim.errors import InputError
from clsim.scene.directivity.ambisonic import Ambisonic
from clsim.scene.directivity.axial_table import AxialDirectivity
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.directivity.head_related import HeadRelated, SphericalHead
from clsim.scene.directivity.patterns import FirstOrder, Omni, Piston
from clsim.scene.directivity.spherical_table import SphericalDirectivity
from clsim.scene.transducer.electronics import Electronics
from clsim.scene.transducer.transducer import Transducer
from clsim.scene_file.model import Model


class OmniModel(Model):
    """The same in every direction."""

    kind: Literal["omni"] = "omni"

    def build(self, base: Path) -> Directivity:
        return Omni()


class _FirstOrder(Model):
    kind: Literal["first-order"]
    weight: float = 0.5

    def build(self, base: Path) -> Directivity:
        return FirstOrder(self.weight)


class _Piston(Model):
    kind: Literal["piston"]
    radius: float

    def build(self, base: Path) -> Directivity:
        return Piston(self.radius)


class _Named(Model):
    kind: Literal["named"]
    name: str
    outside: Literal["hold"] | None = None

    def build(self, base: Path) -> Directivity:
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
        path = base / self.path
        return SphericalDirectivity.from_sofa(
            path, self.measurement, outside=self.outside, relative_to_axis=self.relative_to_axis, name=path.stem
        )


class _Ambisonic(Model):
    kind: Literal["ambisonic"]
    order: int = 1
    normalization: Literal["SN3D", "N3D"] = "SN3D"

    def build(self, base: Path) -> Directivity:
        return Ambisonic(self.order, self.normalization)


class HeadModel(Model):
    """A SOFA file of head-related responses."""

    kind: Literal["head"]
    path: str
    outside: Literal["hold"] | None = None

    def build(self, base: Path) -> Directivity:
        path = base / self.path
        return HeadRelated.from_sofa(path, outside=self.outside, name=path.stem)


class _SphericalHead(Model):
    kind: Literal["spherical-head"]
    radius: float = 0.0875
    ear_azimuth: float = 100.0

    def build(self, base: Path) -> Directivity:
        return SphericalHead(self.radius, self.ear_azimuth)


DirectivityModel = Annotated[
    OmniModel
    | _FirstOrder
    | _Piston
    | _Named
    | DirectivityTableModel
    | SofaModel
    | _Ambisonic
    | HeadModel
    | _SphericalHead,
    Field(discriminator="kind"),
]


class _NamedTransducer(Model):
    kind: Literal["named"]
    name: str

    def build(self, base: Path) -> Transducer:
        return Transducer.named(self.name)


class _Resonance(Model):
    kind: Literal["resonance"]
    frequency: float
    width: float
    sensitivity: float

    def build(self, base: Path) -> Transducer:
        return Transducer.resonance(**self.arguments())


class _ResponseTable(Model):
    kind: Literal["table"]
    frequencies: list[float]
    magnitudes: list[float]
    phases: list[float] | None = None
    outside: Literal["zero", "hold"] | None = None

    def build(self, base: Path) -> Transducer:
        values: Any = np.array(self.magnitudes)
        if self.phases is not None:
            if len(self.phases) != len(values):
                raise InputError("phases", f"must be one per magnitude, {len(values)}, but are {len(self.phases)}")
            values = values * np.exp(1j * np.array(self.phases))
        try:
            return Transducer.from_table(self.frequencies, values, self.outside)
        except InputError as error:
            raise InputError(error.field.replace("values", "magnitudes"), error.problem) from error


class _ImpulseResponse(Model):
    kind: Literal["impulse-response"]
    samples: list[float]
    sampling_rate: float

    def build(self, base: Path) -> Transducer:
        return Transducer.from_impulse_response(self.samples, self.sampling_rate)


class _ImpulseResponseFile(Model):
    kind: Literal["wav"]
    path: str
    channel: int = 0
    scale: float = 1.0
    truncated: bool = False

    def build(self, base: Path) -> Transducer:
        return Transducer.from_wav(**self.arguments() | {"path": base / self.path})


class ElectronicsModel(Model):
    """Arguments of `Electronics`."""

    ambient_noise_db: float | None = None
    snr_db: float | None = None
    reference_level_db: float | None = None
    self_noise_db: float | None = None
    seed: int = 0
    low_cut: float | None = None
    high_cut: float | None = None
    order: int = 2
    gain_db: float = 0.0
    adc_bits: int | None = None
    adc_full_scale: float | None = None
    clock_ppm: float = 0.0
    clock_offset: float = 0.0

    def build(self) -> Electronics:
        return Electronics(**self.arguments())


TransducerModel = Annotated[
    _NamedTransducer | _Resonance | _ResponseTable | _ImpulseResponse | _ImpulseResponseFile,
    Field(discriminator="kind"),
]
