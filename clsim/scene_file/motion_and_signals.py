"""Tables of signals and trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.signal.signal import Signal
from clsim.scene_file.model import Model, Quaternion, Vector, within


class _Tone(Model):
    kind: Literal["tone"]
    frequency: float
    duration: float
    sampling_rate: float
    amplitude: float = 1.0
    phase: float = 0.0
    fade: float = 0.0

    def build(self, base: Path) -> Signal:
        return Signal.tone(**self.arguments())


class _Chirp(Model):
    kind: Literal["chirp"]
    start: float
    stop: float
    duration: float
    sampling_rate: float
    method: Literal["linear", "exponential"] = "linear"
    window: Literal["none", "tukey", "hann"] = "none"
    amplitude: float = 1.0
    fade: float = 0.0

    def build(self, base: Path) -> Signal:
        return Signal.chirp(**self.arguments())


class _Noise(Model):
    kind: Literal["noise"]
    duration: float
    sampling_rate: float
    seed: int
    band: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    rms: float = 1.0
    fade: float = 0.0

    def build(self, base: Path) -> Signal:
        """Return the noise, the same for the same seed."""
        return Signal.noise(**self.arguments())


class _Sequence(Model):
    kind: Literal["sequence"]
    sequence: Literal["mls", "gold"] = "mls"
    carrier: float
    chip_rate: float
    sampling_rate: float
    bits: int = 10
    code: int = 0
    repeats: int = 1
    rolloff: float = 0.5
    amplitude: float = 1.0

    def build(self, base: Path) -> Signal:
        arguments = self.arguments()
        return Signal.sequence(kind=arguments.pop("sequence"), **arguments)


class _Wav(Model):
    kind: Literal["wav"]
    path: str
    channel: int = 0
    scale: float = 1.0
    truncated: bool = False

    def build(self, base: Path) -> Signal:
        return Signal.from_wav(**self.arguments() | {"path": base / self.path})


PulseModel = Annotated[_Tone | _Chirp | _Noise | _Sequence | _Wav, Field(discriminator="kind")]


class _Pulses(Model):
    kind: Literal["pulses"]
    pulse: PulseModel
    period: float
    count: int

    def build(self, base: Path) -> Signal:
        return Signal.pulses(within("pulse", lambda: self.pulse.build(base)), self.period, self.count)


class _Fixed(Model):
    kind: Literal["fixed"]
    position: Vector
    orientation: Quaternion | None = None

    def build(self, base: Path) -> Trajectory:
        return Trajectory.fixed(self.position, orientation=self.orientation)


class _Line(Model):
    kind: Literal["line"]
    start: Vector
    end: Vector
    duration: float

    def build(self, base: Path) -> Trajectory:
        return Trajectory.line(self.start, self.end, self.duration)


class _Circle(Model):
    kind: Literal["circle"]
    center: Vector
    radius: float
    period: float
    duration: float
    axis: Vector = [0.0, 0.0, 1.0]
    phase: float = 0.0

    def build(self, base: Path) -> Trajectory:
        return Trajectory.circle(**self.arguments())


class _Swing(Model):
    kind: Literal["swing"]
    axis_point: Vector
    axis: Vector
    angles: list[float]
    times: list[float]
    origin: Vector | None = None

    def build(self, base: Path) -> Trajectory:
        return Trajectory.swing(**self.arguments())


class _Waypoints(Model):
    kind: Literal["waypoints"]
    times: list[float]
    positions: list[Vector]
    orientations: list[Quaternion] | None = None
    smooth: bool = True

    def build(self, base: Path) -> Trajectory:
        return Trajectory.waypoints(**self.arguments())


class _File(Model):
    kind: Literal["file"]
    path: str
    format: Literal["tum", "euroc", "csv", "rosbag"]
    topic: str | None = None
    columns: dict[str, str] | None = None
    time_scale: float = 1.0
    smooth: bool | float = True
    time_offset: float = 0.0
    rotate: Quaternion = [0.0, 0.0, 0.0, 1.0]
    scale: float = 1.0
    translate: Vector = [0.0, 0.0, 0.0]
    repair: list[Literal["times", "gaps", "nan", "jumps"]] = []
    max_speed: float = 20.0
    max_gap: float | None = None

    def build(self, base: Path) -> Trajectory:
        arguments = self.arguments()
        return Trajectory.from_file(base / arguments.pop("path"), **arguments)


SignalModel = Annotated[_Tone | _Chirp | _Noise | _Sequence | _Wav | _Pulses, Field(discriminator="kind")]
TrajectoryModel = Annotated[_Fixed | _Line | _Circle | _Swing | _Waypoints | _File, Field(discriminator="kind")]
