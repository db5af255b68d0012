"""Derivatives of recordings by positions, clocks, air and walls, and what they say about noisy recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import LOUDEST, QUIETEST, Complexes, Floats, as_floats, read_only, short_repr
from clsim.errors import InputError, check_packages, not_one_of
from clsim.paths.path_set import PathSet
from clsim.render.options import RenderOptions
from clsim.render.plan import Plan, within_memory
from clsim.render.source_filters import SourceFilters
from clsim.sensitivity.adjoint import RUN, adjoint, arriving
from clsim.sensitivity.linear_map import FilteredTracks, LinearMap, plan_of, scene_tracks, through_ends
from clsim.sensitivity.parameters import Parameter, check_names, check_once, parameters_of

_WITHOUT_TAIL = "the diffuse tail is left out: derivatives are those of the sound over paths"
_SINGULAR = 1e-12  # least eigenvalue of normalised information that says something
_INVOLVED = 0.01  # least part in what is undetermined
_LARGEST = 1e100  # of derivatives of a loss


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """Derivatives of the signals at all receivers by some parameters of a scene.

    Attributes
    ----------
    jacobian : ndarray (parameters, rows, samples)
        Pa, or V of receivers with a transducer, per unit of the parameter; complex in baseband. Receivers have a row
        for each channel.
    parameters, units : tuple of str
        Name and unit of each parameter.
    receivers : tuple of str
        Names of the rows.
    sampling_rate : float
        Hz.
    notes : tuple of str
        What of the sound has no derivative.
    """

    jacobian: Floats | Complexes
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    receivers: tuple[str, ...]
    sampling_rate: float
    notes: tuple[str, ...] = ()

    __repr__ = short_repr

    def fisher(self, noise: Any) -> Floats:
        """Fisher information (parameters, parameters) for white Gaussian noise, per product of units of the parameters.

        Parameters
        ----------
        noise : float or array_like (receivers,)
            Standard deviation of a sample, in the unit of the signals, Pa or V, above 0; in baseband of its real and
            of its imaginary part.

        Raises
        ------
        InputError
            If noise is not from 1e-15 to 1e12, or not one number per receiver.

        Notes
        -----
        ``F_ij = sum over receivers and samples of dy/dθ_i dy/dθ_j / noise²`` (S. M. Kay, Fundamentals of Statistical
        Signal Processing: Estimation Theory, 1993, equation 3.31).
        """
        several = isinstance(noise, Sequence | np.ndarray) and not isinstance(noise, str)
        sigma = as_floats("noise", noise, (len(self.receivers),) if several else (), within=LOUDEST)
        if not np.all(sigma >= QUIETEST):
            raise InputError("noise", f"must be at least {QUIETEST:g}, but is {noise!r:.80}")
        rows = (self.jacobian / np.broadcast_to(sigma, len(self.receivers))[:, None]).reshape(len(self.parameters), -1)
        return np.asarray((rows @ rows.conj().T).real)

    def bounds(self, noise: Any) -> Floats:
        """Cramér-Rao bounds (parameters,): least standard deviations of unbiased estimates, in units of the parameters.

        Parameters
        ----------
        noise : float or array_like (receivers,)
            As of `fisher`, Pa or V.

        Raises
        ------
        InputError
            If noise is not from 1e-15 to 1e12, or the recording does not determine all parameters.
        """
        return crb(self.fisher(noise), self.parameters)

    def to_xarray(self) -> Any:
        """Return the Jacobian as an xarray DataArray (parameter, receiver, time), with units as a coordinate."""
        check_packages("to_xarray", "a DataArray", "tables", "xarray")
        import xarray

        time = np.arange(self.jacobian.shape[2]) / self.sampling_rate
        coordinates = {
            "parameter": list(self.parameters), "receiver": list(self.receivers), "time": time,
            "unit": ("parameter", list(self.units)),
        }  # fmt: skip
        return xarray.DataArray(self.jacobian, coordinates, ("parameter", "receiver", "time"), "jacobian")


def crb(information: Floats, names: Sequence[str]) -> Floats:
    """Return the roots of the diagonal of the inverse of an information matrix; it is scaled first."""
    scale = np.sqrt(np.diag(information))
    if np.any(scale == 0.0):
        raise InputError("wrt", f"must change the recording, but {names[int(np.argmin(scale))]} has no effect")
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] < _SINGULAR:
        involved = np.linalg.norm(vectors[:, values < _SINGULAR], axis=1) > _INVOLVED
        mixed = ", ".join(name for name, is_mixed in zip(names, involved, strict=True) if is_mixed)
        raise InputError("wrt", f"must be distinguishable, but {mixed} are not: fix one of them")
    return np.asarray(np.sqrt(np.sum(vectors**2 / values, axis=1)) / scale)


def sensitivities(paths: PathSet, wrt: Sequence[str], sampling_rate: float, **options: Any) -> Sensitivities:
    """Differentiate the signals at all receivers by positions, clocks, air and walls.

    Parameters
    ----------
    paths : PathSet
        The paths of a scene, from `find_paths`.
    wrt : sequence of str
        Names of parameters as in errors and scene files. A vector gives a parameter for each component.

        - ``sources[0].position``, ``receivers[3].position``, ``scatterers[0].position``, ``bodies[0].position``:
          displacement of the whole trajectory, m
        - ``sources[0].trajectory``: displacement of each of its points, m, as of `Trajectory.waypoints`
        - ``sources[0].orientation``: rotation about the room's axes, degrees
        - ``sources[0].start``, s, and ``sources[0].gain_db``, dB
        - ``receivers[3].electronics.clock_ppm``, ``….clock_offset``, s, and ``….gain_db``
        - ``air.temperature_celsius``, ``air.relative_humidity``, ``air.pressure``, ``air.speed_of_sound``, ``air.wind``
        - ``room.walls.floor.reflection``: of the reflection factor, at all frequencies and angles
        - ``room.walls.floor.displacement``: along the normal in `Room.faces`, m
    sampling_rate : float
        Sampling rate of the signals, Hz.
    **options
        As of `render`; pairs at rest and narrow bands are rendered as all others.

    Returns
    -------
    Sensitivities
        float64, in baseband complex128.

    Raises
    ------
    InputError
        If an argument breaks a rule, or a parameter has no derivative.
    DeviceError
        If there is no OpenCL device, or it fails.

    Notes
    -----
    Of a path of delay τ and response R the derivative has the same delay, and the response
    ``dR/dθ - 2j pi f dτ/dθ R``. Starts and ends of paths are not differentiated; noise, converters and the diffuse tail
    are left out.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3, fade=0.002)
    >>> robot = clsim.Source("robot", tone, clsim.Trajectory.fixed((4.0, 3.0, 1.5)))
    >>> ceiling = clsim.Receiver("ceiling", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))
    >>> paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [robot], [ceiling]), max_order=1)
    >>> found = sensitivities(paths, ["receivers[0].position"], 192e3, engine="reference", duration=0.02)
    >>> found.jacobian.shape, found.parameters[0], found.units[0]
    ((3, 1, 3840), 'receivers[0].position.x', 'm')
    """
    parameters = parameters_of(_checked(paths), wrt)
    linear = LinearMap.of(paths, parameters, options_of(sampling_rate, options))
    shape = len(parameters), linear.plan.row_count, linear.plan.samples
    with within_memory("wrt", "all derivatives (see `gradient`)", 8 * int(np.prod(shape))):
        jacobian = np.empty(shape, dtype=float if linear.plan.baseband is None else complex)
    linear.forward(jacobian)
    names, units = tuple(p.name for p in parameters), tuple(p.unit for p in parameters)
    notes = (_WITHOUT_TAIL,) if any(linear.plan.allocation.tails) else ()
    return Sensitivities(read_only(jacobian), names, units, linear.plan.row_names, linear.plan.sampling_rate, notes)


def gradient(
    paths: PathSet, loss_gradient: Any, wrt: Sequence[str], sampling_rate: float, **options: Any
) -> dict[str, Any]:
    """Differentiate a loss of the received signals by any number of parameters in one pass.

    Parameters
    ----------
    paths : PathSet
        The paths of a scene, from `find_paths`.
    loss_gradient : array_like (rows, samples)
        Derivative of the loss by each sample of the recording; in baseband that by the real part plus 1j times that by
        the imaginary one.
    wrt : sequence of str
        Names as of `sensitivities`, and, but in baseband, ``sources[0].signal`` for what a source without transducer
        emits.
    sampling_rate : float
        Sampling rate of the recording, Hz.
    **options
        As of `sensitivities`; the duration is that of `loss_gradient`.

    Returns
    -------
    dict
        The derivative by name: a number, (3,) of positions, (points, 3) of trajectories, (samples,) of signals.

    Raises
    ------
    InputError
        If an argument breaks a rule, or a parameter has no derivative.

    Notes
    -----
    It is the transpose of `sensitivities`: what arrives on each path is multiplied by the loss's derivative and
    brought to nodes, at which the tangents of all parameters are taken. A diffuse tail is left out.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3, fade=0.002)
    >>> robot = clsim.Source("robot", tone, clsim.Trajectory.fixed((4.0, 3.0, 1.5)))
    >>> ceiling = clsim.Receiver("ceiling", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))
    >>> paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [robot], [ceiling]), max_order=1)
    >>> sound = clsim.render(paths, 192e3, engine="reference", duration=0.02).pressure
    >>> by = gradient(paths, sound, ["receivers[0].position", "sources[0].gain_db"], 192e3)  # of half its energy
    >>> by["receivers[0].position"].shape, bool(by["sources[0].gain_db"] > 0.0)
    ((3,), True)
    """
    weights, settings = _weights(loss_gradient, options_of(sampling_rate, options))
    each = named(_checked(paths), wrt, settings)
    exponent = int(np.frexp(np.abs(weights).max())[1])  # sums are taken of weights about 1, which float32 holds
    weights, scale = weights * 2.0**-exponent, 2.0**exponent
    found, parameters = {}, [parameter for of_name in each.values() for parameter in of_name]
    if parameters:
        linear = LinearMap.of(paths, parameters, settings)
        values = iter(scale * adjoint(linear, _of_rows(weights, linear.plan.row_count)))
    for name, of_name in each.items():
        if not of_name:
            plan = plan_of(paths, settings)
            rows = _of_rows(weights, plan.row_count)
            found[name] = scale * _adjoint_signal(plan, _source_of(paths, name, settings), rows)
            continue
        part: Any = np.array([next(values) for _ in of_name])
        found[name] = part.reshape(-1, 3) if name.endswith(".trajectory") else part if len(part) > 1 else part[0]
    return found


def _adjoint_signal(plan: Plan, source: int, weights: Floats) -> Floats:
    """Return the transpose of a render as a function of what a source emits, at the sampling rate of the recording."""
    weights = through_ends(plan, np.array(weights, dtype=np.float64), transposed=True)
    filters, tracks = plan.source_filters[source], FilteredTracks.of(scene_tracks(plan))
    samples, half = filters.oversampling * filters.signal.count, filters.filter_half
    streams = np.zeros((len(filters.basis), samples + 2 * half))  # from sample -half on
    for i, pair in enumerate(plan.tracks.pairs):
        for start in range(0, plan.samples if pair.source == source else 0, RUN):
            times, emitted, mu, weight, _ = arriving(plan, i, filters, start, min(start + RUN, plan.samples))
            rows = weights[plan.rows_of_pair(i), None, None, start : start + len(times)]
            taken = np.sum(tracks.evaluate(i, times, filters.basis)[2] * weight * rows, axis=0)
            for p in np.flatnonzero(weight.any(axis=1)).tolist():
                _scatter(plan, filters, emitted[p], mu[p], taken[:, p], streams)
    each = [np.convolve(stream, taps[::-1], "valid") for stream, taps in zip(streams, filters.filters, strict=True)]
    return np.asarray(np.sum(each, axis=0)[:: filters.oversampling])


def _scatter(
    plan: Plan, filters: SourceFilters, emitted: NDArray[np.int64], mu: Floats, taken: Floats, streams: Floats
) -> None:
    """Add values (K, n) to streams (K, m) where taps would read them."""
    taps = plan.options.interpolator.taps(filters.bank, mu)
    places = emitted[:, None] + filters.bank.centre - np.arange(taps.shape[1]) + filters.filter_half
    inside = (places >= 0) & (places < streams.shape[1])
    for stream, values in zip(streams, taken, strict=True):
        spread = (taps * values[:, None])[inside]
        stream += np.bincount(places[inside], weights=spread, minlength=len(stream))


def options_of(sampling_rate: float, options: dict[str, Any]) -> RenderOptions:
    """Return the options of a render by their names."""
    known = [f.name for f in fields(RenderOptions) if f.kw_only]
    for name in options:
        if name not in known:
            raise InputError("options", not_one_of(name, known))
    return RenderOptions(sampling_rate, **options)


def named(paths: PathSet, wrt: Sequence[str], options: RenderOptions) -> dict[str, list[Parameter]]:
    """Return the parameters of names, none of signals that sources emit."""
    check_names(wrt)
    check_once(list(wrt))
    found = {}
    for name in wrt:
        found[name] = [] if name.endswith(".signal") else parameters_of(paths, [name])
        if not found[name]:
            _source_of(paths, name, options)
    check_once([parameter.name for of_name in found.values() for parameter in of_name])
    return found


def _weights(given: Any, options: RenderOptions) -> tuple[Floats | Complexes, RenderOptions]:
    """Return the loss's derivative (rows, samples), complex in baseband, and options with its duration."""
    parts = (given,) if options.baseband is None else (np.real(given), np.imag(given))
    weights: Any = 0.0
    for part, turn in zip(parts, (1.0, 1.0j), strict=False):
        weights = weights + turn * as_floats("loss_gradient", part, (None, None), within=_LARGEST)
    rate = options.sampling_rate if options.baseband is None else options.baseband[2] or options.sampling_rate
    duration = weights.shape[1] / rate
    if options.duration is not None and abs(options.duration - duration) * rate >= 1.0:
        raise InputError(
            "duration", f"must be that of loss_gradient, {duration:g} s, or left out, but is {options.duration:g} s"
        )
    return weights, replace(options, duration=duration)


def _source_of(paths: PathSet, name: str, options: RenderOptions) -> int:
    """Return the index of the source by whose signal a recording can be differentiated."""
    index = next((i for i in range(len(paths.scene.sources)) if name == f"sources[{i}].signal"), None)
    if index is None:
        raise InputError("wrt", f"must name signals of the scene's sources, but has {name!r:.80}")
    source = paths.scene.sources[index]
    if options.baseband is not None:
        raise InputError("wrt", f"must not have {name!r} in baseband: envelopes are those of a band of the signal")
    if source.transducer is not None or source.signal.sampling_rate != options.sampling_rate:
        raise InputError(
            name,
            f"must be emitted without transducer and at the sampling rate of the recording, {options.sampling_rate:g} "
            f"Hz, for a derivative, but is at {source.signal.sampling_rate:g} Hz",
        )
    return index


def _of_rows(weights: Any, rows: int) -> Any:
    if len(weights) != rows:
        raise InputError(
            "loss_gradient", f"must have a row for each receiver and channel, {rows}, but has {len(weights)}"
        )
    return weights


def _checked(paths: PathSet) -> PathSet:
    if not isinstance(paths, PathSet):
        raise InputError("paths", f"must be a PathSet, but is {paths!r:.80}")
    return paths
