"""From the sound pressure at the receivers to what they record, piece by piece."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clsim.errors import InputError, warn
from clsim.render.plan import SEGMENT, Plan
from clsim.scene.signal.waveforms import white_noise
from clsim.scene.transducer.electronics import Electronics
from clsim.scene.transducer.transducer import StreamFilter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.ends import Receiver

_Kind = Literal["highpass", "lowpass"]


class ReceiverChain:
    """Transducers and electronics of a plan's receivers; chunks must come in order."""

    def __init__(self, plan: Plan, rows: range | None = None) -> None:
        self._plan, self._here = plan, rows or range(plan.row_count)
        self._ends = {
            row: ReceiverEnd(plan.receivers[receiver], plan.row_names[row], plan.sampling_rate)
            for receiver in receivers_with_ends(plan)
            for row in range(plan.row_count)[plan.rows_of(receiver)]
            if row in self._here
        }

    @property
    def clipped(self) -> tuple[int, ...]:
        """Samples of each row that the receiver's converter clipped so far."""
        return tuple(self._ends[i].clipped if i in self._ends else 0 for i in self._here)

    def __call__(self, start: int, pressure: NDArray[Any]) -> NDArray[Any]:
        """Return the recorded samples of the pressure (rows, n) in Pa from sample `start` on."""
        with np.errstate(over="ignore"):  # what float32 does not hold is refused
            out = np.array(pressure, dtype=self._plan.sample_type)
            for i, end in self._ends.items():
                row = i - self._here.start
                out[row] = end(start, np.asarray(pressure[row], dtype=np.float64))
        _check_finite(start, out, self._plan.row_names[self._here.start : self._here.stop])
        return out

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the state of the receivers after the chunks so far; noise and clocks have none."""
        return {f"receivers.{i}.{name}": value for i, end in self._ends.items() for name, value in end.state().items()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Continue from the `state` of another object of the same plan; other entries are ignored."""
        for i, end in self._ends.items():
            end.restore({name: state[f"receivers.{i}.{name}"] for name in end.state()})

    def describe(self) -> list[str]:
        """Describe the samples that the converters clipped, one line for each receiver."""
        samples = self._plan.samples
        return [
            f"receiver {end.name!r}: {end.clipped} of {samples} samples clipped at full scale"
            for end in self._ends.values()
            if end.electronics.step
        ]

    def warn(self) -> None:
        """Warn of samples that were clipped."""
        for i, end in self._ends.items():
            if end.clipped:
                receiver = int(np.searchsorted(self._plan.first_rows, i, side="right")) - 1
                warn(
                    f"receivers[{receiver}].electronics: {end.clipped} of {self._plan.samples} samples of {end.name!r} "
                    f"were clipped at adc_full_scale, {end.electronics.adc_full_scale:g} {end.unit}; "
                    "lower gain_db or raise it"
                )


def receivers_with_ends(plan: Plan) -> list[int]:
    """Return the receivers that have a transducer or electronics, in whose samples those before ring on."""
    if plan.baseband is not None:
        return []
    return [i for i, r in enumerate(plan.receivers) if r.transducer is not None or r.electronics is not None]


def _check_finite(start: int, samples: NDArray[Any], names: tuple[str, ...]) -> None:
    """Refuse samples (rows, n) of named rows, of time from `start` on, that are not finite."""
    parts = samples.view(np.float32)  # of envelopes, too
    if parts.size and np.isfinite(parts.max()) and np.isfinite(parts.min()):  # NaN is both
        return
    for i, k in np.argwhere(~np.isfinite(samples))[:1]:
        raise InputError(
            "receivers",
            f"must hear what float32 holds, but of {names[i]!r} sample {start + k} is {samples[i, k]}: lower "
            "amplitudes, sensitivities or gain_db; if all are moderate, please report this scene as a defect",
        )


class ReceiverEnd:
    """Transducer and electronics of one row, with all that they remember."""

    def __init__(self, receiver: Receiver, name: str, sampling_rate: float) -> None:
        self.name, self.unit = name, receiver.unit
        self.electronics = end = receiver.electronics or Electronics()
        self.clipped = 0
        end.check_rate(sampling_rate)
        sensitivity, self._transducer = 1.0, None
        if receiver.transducer is not None:
            sensitivity = receiver.transducer.sensitivity
            self._transducer = StreamFilter(receiver.transducer.impulse_response(sampling_rate), SEGMENT)
        self._ambient = _Noise(end.ambient_rms(sampling_rate), end.seed, f"ambient {name}")
        self._own = _Noise(end.self_rms(sampling_rate) * sensitivity, end.seed, f"self {name}")
        self._cuts = [_Cut(frequency, kind, end.order, sampling_rate) for frequency, kind in _cuts(end)]

    def __call__(self, start: int, samples: Floats) -> Floats:
        """Return the recorded samples of pressure (n,) in Pa from sample `start` on, a whole number of segments."""
        samples = self._ambient.added(start, samples)
        if self._transducer is not None:
            samples = self._transducer(samples)
        samples = self._own.added(start, samples)
        for cut in self._cuts:
            samples = cut(samples)
        samples = samples * 10 ** (self.electronics.gain_db / 20)
        return self._converted(samples) if self.electronics.step else samples

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the state after the samples so far."""
        state: dict[str, NDArray[Any]] = {f"cut{i}": cut.state for i, cut in enumerate(self._cuts)}
        if self._transducer is not None:
            state["ringing"] = self._transducer.ringing
        return state | {"clipped": np.array(self.clipped)}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Remember what another one remembered."""
        for i, cut in enumerate(self._cuts):
            cut.state = state[f"cut{i}"]
        if self._transducer is not None:
            self._transducer.ringing = state["ringing"]
        self.clipped = int(state["clipped"])

    def _converted(self, samples: Floats) -> Floats:
        """Round to the converter's steps, and count what is clipped."""
        codes = np.rint(samples / self.electronics.step)
        most = 2.0 ** ((self.electronics.adc_bits or 0) - 1)
        kept = np.clip(codes, -most, most - 1.0)
        self.clipped += int(np.count_nonzero(kept != codes))
        return kept * self.electronics.step


class _Noise:
    """White noise that depends on seed, purpose and sample only."""

    def __init__(self, rms: float, seed: int, purpose: str) -> None:
        digest = hashlib.sha256(f"{seed} {purpose}".encode()).digest()
        self._rms, self._stream = rms, int.from_bytes(digest[:8], "little")

    def added(self, start: int, samples: Floats) -> Floats:
        """Return samples with the noise added."""
        if self._rms == 0.0 or not len(samples):
            return samples
        return samples + self._rms * white_noise(self._stream, start, start + len(samples))


class _Cut:
    """A Butterworth filter, sample after sample."""

    def __init__(self, frequency: float, kind: _Kind, order: int, sampling_rate: float) -> None:
        from scipy.signal import butter

        self._sections: Any = butter(order, frequency, kind, fs=sampling_rate, output="sos")
        self.state = np.zeros((len(self._sections), 2))

    def __call__(self, samples: Floats) -> Floats:
        """Return filtered samples (n,)."""
        from scipy.signal import sosfilt

        out, self.state = sosfilt(self._sections, samples, zi=self.state)
        return np.asarray(out, dtype=np.float64)


def _cuts(end: Electronics) -> list[tuple[float, _Kind]]:
    kinds: tuple[tuple[float | None, _Kind], ...] = ((end.low_cut, "highpass"), (end.high_cut, "lowpass"))
    return [(frequency, kind) for frequency, kind in kinds if frequency is not None]
