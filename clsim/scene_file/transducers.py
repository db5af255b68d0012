"""Tables of transducers and electronics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from clsim.errors import InputError
from clsim.scene.transducer.electronics import Electronics
from clsim.scene.transducer.transducer import Transducer
from clsim.scene_file.model import Model


class _NamedTransducer(Model):
    kind: Literal["named"]
    name: str

    def build(self, base: Path) -> Transducer:
        """Return the built-in transducer of this name."""
        return Transducer.named(self.name)


class _Resonance(Model):
    kind: Literal["resonance"]
    frequency: float
    width: float
    sensitivity: float

    def build(self, base: Path) -> Transducer:
        """Return the transducer with this resonance."""
        return Transducer.resonance(**self.arguments())


class _ResponseTable(Model):
    kind: Literal["table"]
    frequencies: list[float]
    magnitudes: list[float]
    phases: list[float] | None = None
    outside: Literal["zero", "hold"] | None = None

    def build(self, base: Path) -> Transducer:
        """Return the transducer with this table of a response."""
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
        """Return the transducer with this impulse response."""
        return Transducer.from_impulse_response(self.samples, self.sampling_rate)


class _ImpulseResponseFile(Model):
    kind: Literal["wav"]
    path: str
    channel: int = 0
    scale: float = 1.0
    truncated: bool = False

    def build(self, base: Path) -> Transducer:
        """Return the transducer whose impulse response a file holds."""
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
        """Return what it says."""
        return Electronics(**self.arguments())


TransducerModel = Annotated[
    _NamedTransducer | _Resonance | _ResponseTable | _ImpulseResponse | _ImpulseResponseFile,
    Field(discriminator="kind"),
]
