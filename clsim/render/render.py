"""From tracks to sound."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_count
from clsim.errors import InputError
from clsim.opencl.device import find_device
from clsim.render.memory import within_memory
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.plan import Plan, plan_render, plan_tracks
from clsim.render.receiver_chain import ReceiverChain
from clsim.render.reference import ReferenceEngine
from clsim.render.source_filters import DEFAULT_RESPONSE_ERROR_DB
from clsim.render.static_pairs import Convolution
from clsim.tracks.tracks import SceneTracks, Tracks
from clsim.tracks.transition import DEFAULT_TRANSITION

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from clsim.paths.path_set import PathSet
    from clsim.recording import Recording
    from clsim.render.baseband import Baseband
    from clsim.render.interpolator import Interpolator
    from clsim.scene.signal.signal import Signal


def render(
    paths: PathSet,
    sampling_rate: float,
    *,
    interpolator: Interpolator | None = None,
    motion: str = "retarded",
    amplitude: str = "wave-equation",
    transition: float | str = DEFAULT_TRANSITION,
    response_error_db: float | str = DEFAULT_RESPONSE_ERROR_DB,
    baseband: Baseband | tuple[float, ...] | None = None,
    prune_below_db: float | None = None,
    engine: str = "opencl",
    device: str | None = None,
    duration: float | None = None,
    chunk: int | None = None,
    convolve_static: bool = True,
) -> Recording:
    """Return what every receiver of a scene hears.

    Parameters
    ----------
    paths : PathSet
        The paths of a scene, from `find_paths`.
    sampling_rate : float
        Of the recording, Hz; signals are brought to it. In baseband that of the signals.
    interpolator : Lagrange, TruncatedLagrange or Bandlimited, optional
        The fractional-delay filter, ``Bandlimited(error_db=-90)`` when left out.
    motion : {"retarded", "quasi-static"}
        Whether an image is where it was when the sound was emitted, or where it is when it is received.
    amplitude : {"wave-equation", "static", "convective"}
        Exponent 1, 0 or 2 of ``1 / (1 - M)``, M the Mach number of the image towards the receiver.
    transition : float or "gate"
        Seconds in which a path begins and ends, by a raised cosine centred on the boundary; or at once, which
        splatters.
    response_error_db : float or "centre"
        Bound on the error that the responses of all paths (air, walls, beams) add up to, over the signal's band, -120
        to -20 dB relative to what is heard within some 40 ms. With "centre" they are what they are at the centre of the
        signal's band.
    baseband : (carrier, bandwidth), optional
        Render complex envelopes about a carrier, Hz, instead of the sound: what mixing it with
        ``exp(-2 pi j carrier t)``, a low-pass and decimation would give, several times faster. The bandwidth, both
        sides together, must hold signals and Doppler shifts; a third number chooses the sampling rate: see `Baseband`.
    prune_below_db : float, optional
        Leave out paths that stay below this level, dB relative to the strongest arrival at the same receiver; the
        recording's notes tell how many, and a bound of what they add up to.
    engine : {"opencl", "reference"}
        The fast one or the exact one.
    device : str, optional
        An OpenCL device by id or part of its name (see ``clsim devices``); the best one when left out.
    duration : float, optional
        Length of the recording, s. Left out: until all that was emitted has been heard, or until the first moving
        receiver's trajectory ends.
    chunk : int, optional
        Samples that are held at a time, rounded up to whole segments (of 18432 samples; in baseband of 32 blocks).
    convolve_static : bool
        Whether pairs of source and receiver that never move are rendered by their impulse response, exact to -110 dB,
        instead of path by path; with the OpenCL engine and a `Bandlimited` interpolator.

    Returns
    -------
    Recording
        Sound pressure in Pa, float32; volts of receivers with a transducer; complex64 envelopes in baseband.

    Raises
    ------
    InputError
        If an argument breaks a rule.
    DeviceError
        If there is no OpenCL device, or it fails.

    Warns
    -----
    ClsimWarning
        If a receiver's converter clips.

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
    plan = plan_render(
        paths, sampling_rate, interpolator=interpolator, motion=motion, amplitude=amplitude,
        transition=transition, response_error_db=response_error_db, baseband=baseband, prune_below_db=prune_below_db,
        engine=engine, device=device, duration=duration, chunk=chunk, convolve_static=convolve_static,
    )  # fmt: skip
    return record(plan)


def render_tracks(
    signals: Sequence[Signal],
    tracks: Tracks,
    sampling_rate: float,
    *,
    starts: Sequence[float] | None = None,
    interpolator: Interpolator | None = None,
    response_error_db: float | str = DEFAULT_RESPONSE_ERROR_DB,
    baseband: Baseband | tuple[float, ...] | None = None,
    engine: str = "opencl",
    device: str | None = None,
    duration: float | None = None,
    chunk: int | None = None,
    convolve_static: bool = True,
) -> Recording:
    """Return what is heard of signals along tracks, whoever computed these.

    Parameters
    ----------
    signals : sequence of Signal
        One per source of the tracks.
    tracks : Tracks
        From `track` or `Tracks.from_samples`.
    sampling_rate : float
        Of the recording, Hz.
    starts : sequence of float, optional
        Time at which each signal begins, s; 0 when left out.
    interpolator, response_error_db, baseband, engine, device, duration, chunk, convolve_static
        As in `render`.
    """
    plan = plan_tracks(
        signals, tracks, sampling_rate, starts=starts, interpolator=interpolator, response_error_db=response_error_db,
        baseband=baseband, engine=engine, device=device, duration=duration, chunk=chunk,
        convolve_static=convolve_static,
    )  # fmt: skip
    return record(plan)


def render_chunks(
    plan: Plan, *, first: int = 0, receiver_chain: ReceiverChain | None = None
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield the recording piece by piece, in bounded memory.

    Parameters
    ----------
    plan : Plan
        From `plan_render`.
    first : int
        Sample to begin with, a whole number of chunks: those before it were rendered earlier.
    receiving : ReceiverChain, optional
        The receivers' ends, with all that they remember of the pieces before. Behind each piece its ``state()`` is
        what another process needs to go on bit for bit, by ``restore``.

    Yields
    ------
    start : int
        First sample of the piece.
    samples : ndarray (receivers, n) float32
        Sound pressure in Pa, or V of receivers with a transducer: see ``plan.units``. In baseband complex64.

    Raises
    ------
    InputError
        If `first` is no whole number of chunks, or lies beyond the end.
    """
    if as_count("first", first, at_most=plan.samples) % plan.chunk and first != plan.samples:
        raise InputError("first", f"must be a whole number of chunks of {plan.chunk} samples, but is {first}")
    receiver_chain = ReceiverChain(plan) if receiver_chain is None else receiver_chain
    yield from _pieces(plan, receiver_chain, first)
    receiver_chain.warn()


def _pieces(plan: Plan, receiver_chain: ReceiverChain, first: int = 0) -> Iterator[tuple[int, NDArray[Any]]]:
    engine, convolution = _engine(plan), Convolution(plan)
    for start in range(first, plan.samples, plan.chunk):
        stop = min(start + plan.chunk, plan.samples)
        silence = (plan.receiver_count, stop - start)
        pressure = np.zeros(silence, plan.sample_type) if engine is None else engine.render(start, stop)
        convolution.add(pressure, start)
        yield start, receiver_chain(start, pressure)
    if isinstance(engine, OpenclEngine):
        engine.warn()


def _engine(plan: Plan) -> OpenclEngine | ReferenceEngine | None:
    """Return what renders the paths of a plan that are not convolved; None if there are none."""
    if plan.engine == "reference":
        return ReferenceEngine(plan)
    if len(plan.static_pairs.groups) == len(plan.tracks.groups):
        find_device(plan.device)  # a device that is not there is an error all the same
        return None
    return OpenclEngine(plan) if plan.baseband is None else BasebandEngine(plan)


def record(plan: Plan) -> Recording:
    """Return what the receivers of a plan record, held in memory as a whole."""
    from clsim.recording import Recording

    size = plan.receiver_count * plan.samples * np.dtype(plan.sample_type).itemsize
    with within_memory("duration", "a whole recording (see `render_chunks`)", size):
        samples = np.empty((plan.receiver_count, plan.samples), dtype=plan.sample_type)
    receiver_chain = ReceiverChain(plan)
    for start, piece in _pieces(plan, receiver_chain):
        samples[:, start : start + piece.shape[1]] = piece
    receiver_chain.warn()
    samples.flags.writeable = False
    paths = plan.tracks.paths if isinstance(plan.tracks, SceneTracks) else None
    notes = (*plan.describe(), *receiver_chain.describe())
    names = plan.tracks.receiver_names
    return Recording(samples, plan.sampling_rate, names, paths, notes, plan.units, receiver_chain.clipped, plan.carrier)
