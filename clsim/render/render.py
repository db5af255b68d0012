"""From paths or tracks to sound."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_count, as_number
from clsim.errors import InputError
from clsim.keywords import keywords_of
from clsim.paths.path_set import PathSet
from clsim.recording import Recording
from clsim.render.memory import within_memory
from clsim.render.options import RenderOptions
from clsim.render.planning import plan_paths, plan_tracks
from clsim.render.rendering import Rendering
from clsim.scene.signal.signal import Signal
from clsim.tracks.tracks import as_tracks

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from clsim.render.plan import Plan
    from clsim.tracks.tracks import Tracks


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
    InputError
        If an argument breaks a rule.
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


def render_tracks(
    signals: Sequence[Signal],
    tracks: Tracks,
    sampling_rate: float,
    *,
    starts: Sequence[float] | None = None,
    **options: Any,
) -> Recording:
    """Render signals along tracks, whoever computed these.

    Parameters
    ----------
    signals : sequence of Signal
        One per source of the tracks.
    tracks : Tracks
        From `track` or `Tracks.from_samples`.
    sampling_rate : float
        Of the recording, Hz; in baseband that of the signals.
    starts : sequence of float (signals,), optional
        Time at which each signal begins, s; 0 when left out.
    **options
        As of `RenderOptions`, but for those by which tracks are made.

    Returns
    -------
    Recording
        As of `render`.

    Raises
    ------
    InputError
        If an argument breaks a rule.
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
    return record(plan_tracks(list(zip(signals, begins, strict=True)), tracks, chosen))


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
    InputError
        If `first` is no whole number of chunks, or lies beyond the end.
    DeviceError
        If there is no OpenCL device, or it fails.
    """
    if as_count("first", first, at_most=plan.samples) % plan.chunk and first != plan.samples:
        raise InputError("first", f"must be a whole number of chunks of {plan.chunk} samples, but is {first}")
    yield from (Rendering(plan) if rendering is None else rendering).pieces(first)


def record(plan: Plan) -> Recording:
    """Return the recording of a plan, in memory as a whole."""
    size = plan.row_count * plan.samples * np.dtype(plan.sample_type).itemsize
    with within_memory("duration", "a whole recording (see `render_chunks`)", size):
        samples = np.empty((plan.row_count, plan.samples), dtype=plan.sample_type)
    rendering = Rendering(plan)
    for start, piece in rendering.pieces():
        samples[:, start : start + piece.shape[1]] = piece
    samples.flags.writeable = False
    paths = None if plan.tracks.of_scene is None else plan.tracks.of_scene.paths
    notes = (*plan.describe(), *rendering.describe())
    return Recording(
        samples, plan.sampling_rate, plan.row_names, paths, notes, plan.units, rendering.clipped, plan.carrier,
        plan.channels,
    )  # fmt: skip
