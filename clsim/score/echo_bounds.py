"""Bounds of position by noise, of what knows all echoes and of what hears the direct sound alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsim.arrays import LOUDEST, QUIETEST, Floats, as_number, short_repr
from clsim.errors import InputError
from clsim.paths.path_set import PathSet
from clsim.sensitivity.sensitivities import crb, sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class EchoBounds:
    """Least standard deviations of unbiased estimates of some parameters from one noisy recording.

    Attributes
    ----------
    parameters, units : tuple of str
        Name and unit of each parameter.
    with_echoes : ndarray (parameters,)
        For an estimator that simulates all paths, in `units`: m, s, ppm.
    free_field : ndarray (parameters,)
        From the direct sound alone, without any echo, in `units`: m, s, ppm. NaN where that does not determine them.
    """

    parameters: tuple[str, ...]
    units: tuple[str, ...]
    with_echoes: Floats
    free_field: Floats

    __repr__ = short_repr


def echo_bounds(paths: PathSet, wrt: Sequence[str], noise: float, sampling_rate: float, **options: Any) -> EchoBounds:
    """Compute Cramér-Rao bounds of parameters with and without the echoes of a room.

    Parameters
    ----------
    paths : PathSet
        The paths of a scene, from `find_paths`.
    wrt : sequence of str
        Names as of `clsim.sensitivities`, all of which are estimated together.
    noise : float
        Standard deviation of white noise in each sample, in the unit of the recording, 1e-15 to 1e12.
    sampling_rate : float
        Sampling rate of the recording, Hz.
    **options
        As of `clsim.sensitivities`.

    Raises
    ------
    InputError
        If an argument breaks a rule, or the recording does not determine the parameters.

    Notes
    -----
    Echoes that overlap are told apart as far as the recording can: no separation of paths is assumed (Y. Shen and
    M. Z. Win, "Fundamental limits of wideband localization", IEEE Trans. Inf. Theory 56(10), 2010).

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    >>> chirp = clsim.Signal.chirp(35e3, 45e3, 0.005, sampling_rate=192e3, fade=0.002)
    >>> robot = clsim.Source("robot", chirp, clsim.Trajectory.fixed((4.0, 3.0, 1.5)))
    >>> ceiling = clsim.Receiver("ceiling", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))
    >>> paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [robot], [ceiling]), max_order=1)
    >>> found = echo_bounds(paths, ["sources[0].position"], 1e-3, 192e3, engine="reference")
    >>> bool(found.with_echoes.max() < 1e-4), bool(np.isnan(found.free_field).all())  # one range is no position
    (True, True)
    """
    sigma = as_number("noise", noise, at_least=QUIETEST, at_most=LOUDEST)
    echoes = sensitivities(paths, wrt, sampling_rate, **options)
    length = echoes.jacobian.shape[2] / sampling_rate
    direct = PathSet(paths.scene, tuple(f.part(np.flatnonzero(f.order == 0)) for f in paths.families))
    alone = sensitivities(direct, wrt, sampling_rate, **options | {"duration": length})
    try:
        free = crb(alone.fisher(sigma), alone.parameters)
    except InputError:
        free = np.full(len(alone.parameters), np.nan)
    return EchoBounds(echoes.parameters, echoes.units, echoes.bounds(sigma), free)
