"""From paths or tracks to sound: a plan is made and carried out chunk by chunk, and receivers record its pressure."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, as_count, as_number
from clsim.errors import InputError, warn
from clsim.keywords import keywords_of
from clsim.numerics.convolution import StreamFilter
from clsim.opencl.device import find_device
from clsim.paths.path_set import PathSet
from clsim.recording import Recording
from clsim.render.contributions import State
from clsim.render.options import RenderOptions
from clsim.render.plan import SEGMENT, Plan, within_memory
from clsim.render.planning import Request, plan_paths
from clsim.scene.ends import Receiver
from clsim.scene.signal.signal import Signal
from clsim.scene.signal.waveforms import white_noise
from clsim.scene.transducer import Electronics
from clsim.tracks.tracks import Tracks, as_tracks

_Kind = Literal["highpass", "lowpass"]


@keywords_of(RenderOptions, PathSet)
def render(paths: PathSet, options: RenderOptions) -> Recording:
    """Render the sound at every receiver of a scene.

    Parameters
    ----------
    paths : PathSet
        The paths of a scene, from `find_paths`.
    options : RenderOptions
        Each is a keyword, but for the first, the sampling rate, which may also stand behind the paths.

    Returns
    -------
    Recording
        Sound pressure (receivers, samples) in Pa, float32; volts of receivers with a transducer; complex64 envelopes in
        baseband.

    Raises
    ------
    DeviceError
        If there is no OpenCL device, or it fails.

    Warns
    -----
    ClsimWarning
        If a receiver's converter clips, or something cannot be held as well as asked.

    Notes
    -----
    Each path is ``g(t) s(t - delay(t))``. The delay is applied by a Farrow bank whose branch signals are the emitted
    signal through fixed filters (C. W. Farrow, "A continuously variable digital delay element", ISCAS 1988).

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3, fade=0.002)
    >>> robot = clsim.Source("robot", tone, clsim.Trajectory.fixed((4.0, 3.0, 1.5)))
    >>> ceiling = clsim.Receiver("ceiling", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))
    >>> scene = clsim.Scene(room, clsim.Air(), [robot], [ceiling])
    >>> paths = clsim.find_paths(scene, max_order=1)
    >>> render(paths, 192e3, engine="reference", duration=0.02).pressure.shape
    (1, 3840)
    """
    return record(plan_paths(paths, options))


def record(plan: Plan) -> Recording:
    """Return the recording of a plan, in memory as a whole."""
    size = plan.row_count * plan.samples * np.dtype(plan.sample_type).itemsize
    with within_memory("duration", "a whole recording (see `render_chunks`)", size):
        samples = np.zeros((plan.row_count, plan.samples), dtype=plan.sample_type)
    rendering = Rendering(plan)
    for start, piece in rendering.pieces(into=samples):
        if not np.may_share_memory(piece, samples):
            samples[:, start : start + piece.shape[1]] = piece
    samples.flags.writeable = False
    paths = None if plan.tracks.of_scene is None else plan.tracks.of_scene.paths
    notes = (*plan.describe(), *rendering.describe())
    return Recording(
        samples, plan.sampling_rate, plan.row_names, paths, notes, plan.units, rendering.clipped, plan.carrier,
        plan.recorded,
    )  # fmt: skip


def render_tracks(
    signals: Sequence[Signal], tracks: Tracks, sampling_rate: float, *, starts: Sequence[float] | None = None,
    **options: Any,
) -> Recording:  # fmt: skip
    """Render signals along tracks, whoever computed these.

    Parameters
    ----------
    signals : sequence of Signal
        One per source of the tracks.
    tracks : Tracks
        From `track` or `Tracks.from_samples`.
    sampling_rate : float
        Sampling rate of the recording, Hz; in baseband that of the signals.
    starts : sequence of float (signals,), optional
        Time at which each signal begins, s; 0 when left out.
    **options
        As of `RenderOptions`, but for those by which tracks are made.

    Raises
    ------
    DeviceError
        If there is no OpenCL device, or it fails.

    Examples
    --------
    >>> import clsim
    >>> tracks = clsim.Tracks.from_samples([0.0, 1.0], [[0.010, 0.011]], [[0.3, 0.3]])
    >>> tone = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=48e3)
    >>> render_tracks([tone], tracks, 48e3, engine="reference", duration=0.05).pressure.shape
    (1, 2400)
    """
    tracks = as_tracks(tracks)
    if not isinstance(signals, list | tuple):
        raise InputError("signals", f"must be a list, but is {signals!r:.80}")
    for i, signal in enumerate(signals):
        if not isinstance(signal, Signal):
            raise InputError(f"signals[{i}]", f"must be a Signal, but is {signal!r:.80}")
    if len(signals) != tracks.source_count:
        raise InputError("signals", f"must be one per source, {tracks.source_count}, but are {len(signals)}")
    starts = [0.0] * len(signals) if starts is None else starts
    if len(starts) != len(signals):
        raise InputError("starts", f"must be one per signal, {len(signals)}, but are {len(starts)}")
    begins = [as_number(f"starts[{i}]", start, unit="s") for i, start in enumerate(starts)]
    chosen = RenderOptions.for_tracks(sampling_rate, **options)
    return record(Request(list(zip(signals, begins, strict=True)), tracks, chosen).plan())


def render_chunks(
    plan: Plan, *, first: int = 0, rendering: Rendering | None = None
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield the recording piece by piece, in bounded memory.

    Parameters
    ----------
    plan : Plan
        From `plan_render`.
    first : int
        Sample to begin with, a whole number of chunks: those before it were rendered earlier.
    rendering : Rendering, optional
        Of this plan, with all that it remembers of the pieces before. Behind each piece its ``state()`` is what another
        process needs to go on bit for bit, by ``restore``.

    Yields
    ------
    start : int
        First sample of the piece.
    samples : ndarray (receivers, n) float32
        Sound pressure in Pa, or V of receivers with a transducer: see ``plan.units``. In baseband complex64.

    Raises
    ------
    DeviceError
        If there is no OpenCL device, or it fails.
    """
    if as_count("first", first, at_most=plan.samples) % plan.chunk and first != plan.samples:
        raise InputError("first", f"must be a whole number of chunks of {plan.chunk} samples, but is {first}")
    yield from (Rendering(plan) if rendering is None else rendering).pieces(first)


class Rendering:
    """A plan's contributions and receivers, with their state between chunks.

    Parameters
    ----------
    plan : Plan
        From `plan_render`.

    Raises
    ------
    DeviceError
        If the plan's device is missing, even where nothing needs it.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._receivers = ReceiverChain(plan)
        self._pressure = PressureSum(plan)

    @property
    def clipped(self) -> tuple[int, ...]:
        """Samples at each receiver that its converter clipped so far."""
        return self._receivers.clipped

    def pieces(self, first: int = 0, into: NDArray[Any] | None = None) -> Iterator[tuple[int, NDArray[Any]]]:
        """Yield the recording chunk by chunk; see `render_chunks`.

        Parameters
        ----------
        first : int
            Sample to begin with, the first one of a chunk.
        into : ndarray (receivers, samples), optional
            Zeros, in which pieces are rendered where they need no other type.

        Yields
        ------
        start : int
            First sample of the piece.
        samples : ndarray (receivers, n)
            Pa or V.
        """
        for start in range(first, self._plan.samples, self._plan.chunk):
            yield start, self._receivers(start, self._pressure(start, into))
        self._pressure.warn()
        self._receivers.warn()

    def state(self) -> State:
        """Return all that is remembered of the pieces so far: what another process needs to go on bit for bit."""
        return self._pressure.state() | self._receivers.state()

    def restore(self, state: State) -> None:
        """Go on where another one of the same plan was, by its `state`: arrays of any shape."""
        self._pressure.restore(state)
        self._receivers.restore(state)

    def describe(self) -> list[str]:
        """Describe the result, one line for each fact."""
        return self._receivers.describe()


class PressureSum:
    """Sum of a plan's contributions, chunk by chunk."""

    def __init__(self, plan: Plan) -> None:
        if plan.options.engine == "opencl":
            find_device(plan.options.device)
        self._plan = plan
        self._adding = tuple(contribution.begin() for contribution in plan.contributions)

    def __call__(self, start: int, into: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return the pressure (rows, n), Pa, of the chunk from `start` on, in zeros `into` if they have its type."""
        plan = self._plan
        stop = min(start + plan.chunk, plan.samples)
        if into is None or into.dtype != plan.pressure_type:
            pressure = np.zeros((plan.row_count, stop - start), plan.pressure_type)
        else:
            pressure = into[:, start:stop]
        for adding in self._adding:
            adding.add(pressure, start)
        return pressure

    def until(self, last: int) -> None:
        for adding in self._adding:
            adding.until(last)

    def shared(self, first: int, last: int) -> list[str]:
        return [f"{i}.{name}" for i, adding in enumerate(self._adding) for name in adding.shared(first, last)]

    def made(self, name: str) -> NDArray[Any]:
        number, _, rest = name.partition(".")
        return self._adding[int(number)].made(rest)

    def look_up(self, find: Callable[[str], NDArray[Any]]) -> None:
        def found(number: int, name: str) -> NDArray[Any]:
            return find(f"{number}.{name}")

        for i, adding in enumerate(self._adding):
            adding.look_up(partial(found, i))

    def state(self) -> State:
        parts: State = {}
        for i, adding in enumerate(self._adding):
            parts |= {f"contribution{i}.{name}": value for name, value in adding.state().items()}
        return parts

    def restore(self, state: State) -> None:
        for i, adding in enumerate(self._adding):
            mine = f"contribution{i}."
            adding.restore({name.removeprefix(mine): state[name] for name in state if name.startswith(mine)})

    def warn(self) -> None:
        for adding in self._adding:
            adding.warn()


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
            out = np.array(pressure, dtype=self._plan.sample_type, copy=True if self._ends else None)
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
            f"must receive what float32 holds, but of {names[i]!r} sample {start + k} is {samples[i, k]}: lower "
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
        state: dict[str, NDArray[Any]] = {f"cut{i}": cut.state for i, cut in enumerate(self._cuts)}
        if self._transducer is not None:
            state["ringing"] = self._transducer.ringing
        return state | {"clipped": np.array(self.clipped)}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
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
        from scipy.signal import sosfilt

        out, self.state = sosfilt(self._sections, samples, zi=self.state)
        return np.asarray(out, dtype=np.float64)


def _cuts(end: Electronics) -> list[tuple[float, _Kind]]:
    kinds: tuple[tuple[float | None, _Kind], ...] = ((end.low_cut, "highpass"), (end.high_cut, "lowpass"))
    return [(frequency, kind) for frequency, kind in kinds if frequency is not None]
