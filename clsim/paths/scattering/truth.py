"""What a sonar should find out of every scatterer: range, radial speed and bearing, as each pair of ends hears it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from clsim.arrays import as_floats
from clsim.errors import InputError
from clsim.paths.arrivals import Kinematics
from clsim.paths.echo_truth import EchoTruth, echo_fields
from clsim.paths.scattering.search import direct_ways

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ScattererTruth(EchoTruth):
    """The way by every scatterer between every source and receiver, by no wall, (scatterers, sources, receivers, T).

    Delay, range and the other fields are those of `EchoTruth`.

    Attributes
    ----------
    scatterer_names : tuple of str
        Along the first axis.
    """

    scatterer_names: tuple[str, ...]

    KIND: ClassVar[str] = "scatterer"


def scatterer_truth(scene: Scene, times: Floats, motion: str = "retarded") -> ScattererTruth:
    """Return the truth about the scatterers of a scene.

    Parameters
    ----------
    scene : Scene
        With scatterers.
    times : array_like (T,)
        Times of reception, s, by the scene's clock.
    motion : {"retarded", "quasi-static"}
        As in `render`.

    Returns
    -------
    ScattererTruth
        Of every scatterer, source and receiver.

    Raises
    ------
    InputError
        If the scene has no scatterers, its air depends on the height or fluctuates, times are no finite numbers (T,),
        or the motion is no known word.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3)
    >>> at = clsim.Trajectory.fixed((1.0, 3.0, 1.5))
    >>> ends = [clsim.Source("s", tone, at)], [clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 3.1, 1.5)))]
    >>> ball = clsim.Scatterer.sphere("ball", 0.05, clsim.Trajectory.fixed((3.0, 3.05, 1.5)))
    >>> scene = clsim.Scene(room, clsim.Air(speed_of_sound=340.0), *ends, scatterers=[ball])
    >>> clsim.scatterer_truth(scene, [0.1]).range.round(4).ravel().tolist()
    [1.9506]
    """
    times = as_floats("times", times, (None,))
    kinematics = Kinematics(motion)
    if not scene.scatterers:
        raise InputError("scene", "must hold scatterers, but has none")
    shape = len(scene.scatterers), len(scene.sources), len(scene.receivers), len(times)
    delay, rate, away, bearing = np.empty(shape), np.empty(shape), np.empty(shape), np.empty((*shape, 3))
    for pair in direct_ways(scene).pairs():
        found = pair.arrivals(times, kinematics)
        here = (slice(None), pair.source, pair.receiver)
        delay[here], rate[here] = found.delay + pair.group_lag(found), found.delay_rate
        bearing[here] = found.arrival
        away[here] = found.more["second_length"]
    names = tuple(scatterer.name for scatterer in scene.scatterers)
    return ScattererTruth(**echo_fields(scene, times, delay, rate, away, bearing), scatterer_names=names)
