"""The options of a rendering: their types, defaults, bounds and docstring stand here and nowhere else."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field, fields
from typing import Any, Literal, get_args

from clsim.arrays import as_choice, as_count, as_flag, as_number
from clsim.errors import InputError
from clsim.render.baseband import Baseband, as_baseband
from clsim.render.interpolator import Bandlimited, Interpolator
from clsim.tracks.splines import DEFAULT_TRANSITION, as_transition

Motion = Literal["retarded", "quasi-static"]
Amplitude = Literal["wave-equation", "static", "convective"]
Responses = Literal["band", "centre"]
Engine = Literal["opencl", "reference"]
TailChoice = Literal["off", "auto"]
TailScattering = Literal["size", "material"]

_BANDLIMITED = Bandlimited()
_OF_TRACKS = {"of_tracks": True}  # metadata of options that `track` and `pruned` carry out
_WORDS = {
    "motion": Motion, "amplitude": Amplitude, "responses": Responses, "engine": Engine, "tail": TailChoice,
    "tail_scattering": TailScattering,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Options of a rendering, checked as a whole.

    Parameters
    ----------
    sampling_rate : float
        Sampling rate of the recording, Hz; signals are resampled to it. In baseband that of the signals.
    interpolator : Interpolator
        The fractional-delay filter: `Bandlimited`, `Lagrange` or `TruncatedLagrange`.
    motion : {"retarded", "quasi-static"}
        Whether an image is where it was when the sound was emitted, or where it is when it is received.
    amplitude : {"wave-equation", "static", "convective"}
        Exponent 1, 0 or 2 of ``1 / (1 - M)``, M the Mach number of the image towards the receiver.
    transition : float
        Time in which a path begins and ends, by a raised cosine centred on the boundary, up to 1 s. With 0 it does so
        at once, which splatters.
    responses : {"band", "centre"}
        Frequencies at which air, walls and directivities are evaluated: all of a signal's band, or its centre alone.
    response_error_db : float
        With ``responses="band"``, bound on the total error of the responses of all paths over the signal's band. It is
        -120 to -20 dB, relative to the level received within some 40 ms.
    baseband : (carrier, bandwidth), optional
        Render complex envelopes about a carrier, Hz, instead of the sound: what mixing it with
        ``exp(-2 pi j carrier t)``, a low-pass and decimation would give, several times faster. The bandwidth, both
        sides together, must hold signals and Doppler shifts; a third number chooses the sampling rate: see `Baseband`.
    prune_below_db : float, optional
        Leave out paths that stay below this level, -300 to -20 dB relative to the strongest arrival at the same
        receiver. The recording's notes give their number and a bound of their sum.
    engine : {"opencl", "reference"}
        The fast one or the exact one.
    device : str, optional
        An OpenCL device by id or part of its name (see ``clsim devices``); the best one when left out.
    duration : float, optional
        Length of the recording, s. Left out: until all emitted sound has been received, or until the first moving
        receiver's trajectory ends.
    chunk : int, optional
        Samples that are held at a time, rounded up to whole segments (of 18432 samples; in baseband of 32 blocks).
    convolve_static : bool
        Whether pairs of source and receiver that never move are rendered by their impulse response, exact to -110 dB,
        instead of path by path. It needs the OpenCL engine and a `Bandlimited` interpolator.
    narrowband : bool, optional
        Whether narrow-band parts of a signal are rendered as complex envelopes at low rates, several times faster. The
        rest (onsets, ends) is rendered at the recording's rate. It applies where the scene allows it, with the OpenCL
        engine and a `Bandlimited` interpolator. Left out: where an estimate says that it pays.
    channels : bool, optional
        Whether pairs of source and receiver with very many paths are rendered by impulse responses, sampled as fast as
        Doppler shifts change them. It applies where the scene allows it, on CPUs, with the OpenCL engine and a
        `Bandlimited` interpolator. Left out: where an estimate says that it pays.
    scattering_error_db : float, optional
        Bound on the error of paths by capsules, and by scatterers with the shadow of their outline, -120 to -40 dB,
        relative to the level of these paths. Their formulae are right within about 1 dB. They have delay filters and
        functions of frequency of their own. None: `response_error_db`, and shadows are rendered with all other paths.
        It applies with the OpenCL engine and a `Bandlimited` interpolator, and not in baseband.
    tail : {"off", "auto"}
        Whether the energy that image sources leave (higher orders, scattering by walls) is rendered as a diffuse tail
        by rays. "auto" makes a tail for sources whose signal reaches below 40 kHz, in closed rooms, where more than -60
        dB is left.
    tail_directions : int
        Directions from which tails arrive, 16 to 1024.
    tail_error_db : float
        Standard error of a tail's energies in windows of 20 ms, 0.02 to 3 dB, for which rays are traced.
    tail_seed : int
        Seed of the rays and of the tails' noise.
    tail_scattering : {"size", "material"}
        Whether walls scatter by their limited size as well, beyond images, or by their materials alone.

    Examples
    --------
    >>> RenderOptions(192e3, engine="reference").transition
    0.001
    >>> RenderOptions(192e3, chunk=0)
    Traceback (most recent call last):
        ...
    clsim.errors.InputError: chunk: must be at least 1, but is 0
    """

    sampling_rate: float
    _: KW_ONLY
    interpolator: Interpolator = _BANDLIMITED
    motion: Motion = field(default="retarded", metadata=_OF_TRACKS)
    amplitude: Amplitude = field(default="wave-equation", metadata=_OF_TRACKS)
    transition: float = field(default=DEFAULT_TRANSITION, metadata=_OF_TRACKS)
    responses: Responses = "band"
    response_error_db: float = -90.0
    baseband: Baseband | tuple[float, ...] | None = None
    prune_below_db: float | None = field(default=None, metadata=_OF_TRACKS)
    engine: Engine = "opencl"
    device: str | None = None
    duration: float | None = None
    chunk: int | None = None
    convolve_static: bool = True
    narrowband: bool | None = None
    channels: bool | None = None
    scattering_error_db: float | None = -60.0
    tail: TailChoice = "off"
    tail_directions: int = 64
    tail_error_db: float = 0.25
    tail_seed: int = 0
    tail_scattering: TailScattering = "size"

    def __post_init__(self) -> None:
        rate = as_number("sampling_rate", self.sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")
        for name, words in _WORDS.items():
            as_choice(name, getattr(self, name), get_args(words))
        if not isinstance(self.interpolator, Interpolator):
            raise InputError("interpolator", f"must be an interpolator, but is {self.interpolator!r:.80}")
        if self.device is not None and not isinstance(self.device, str):
            raise InputError("device", f"must be an id or part of a name, but is {self.device!r:.80}")
        checked: dict[str, Any] = {
            "sampling_rate": rate,
            "transition": as_transition(self.transition),
            "response_error_db": as_number(
                "response_error_db", self.response_error_db, at_least=-120.0, at_most=-20.0, unit="dB"
            ),
            "convolve_static": as_flag("convolve_static", self.convolve_static),
            "tail_directions": as_count("tail_directions", self.tail_directions, at_least=16, at_most=1024),
            "tail_error_db": as_number("tail_error_db", self.tail_error_db, at_least=0.02, at_most=3.0, unit="dB"),
            "tail_seed": as_count("tail_seed", self.tail_seed),
        }
        for name in ("narrowband", "channels"):
            if getattr(self, name) is not None:
                checked[name] = as_flag(name, getattr(self, name))
        if self.baseband is not None:
            if self.narrowband:
                raise InputError("narrowband", "must not be True in baseband, which is narrow as a whole")
            if self.tail != "off":
                raise InputError("tail", f"must be 'off' in baseband, but is {self.tail!r}")
            checked["baseband"] = as_baseband(self.baseband, rate)
            if not isinstance(self.interpolator, Bandlimited):
                raise InputError("interpolator", f"must be Bandlimited in baseband, but is {self.interpolator!r:.80}")
        for name, least, most in (("prune_below_db", -300.0, -20.0), ("scattering_error_db", -120.0, -40.0)):
            if getattr(self, name) is not None:
                checked[name] = as_number(name, getattr(self, name), at_least=least, at_most=most, unit="dB")
        if self.duration is not None:
            checked["duration"] = as_number("duration", self.duration, above=0.0, unit="s")
        if self.chunk is not None:
            checked["chunk"] = as_count("chunk", self.chunk, at_least=1)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @classmethod
    def for_tracks(cls, sampling_rate: float, **options: Any) -> RenderOptions:
        """Return the options of rendering tracks that are made already.

        Parameters
        ----------
        sampling_rate : float
            Sampling rate of the recording, Hz.
        **options
            See the class.
        """
        for name in (f.name for f in fields(cls) if f.metadata.get("of_tracks") and f.name in options):
            raise InputError(name, f"must be left out, for the tracks have it already, but is {options[name]!r:.80}")
        return cls(sampling_rate, **options)
