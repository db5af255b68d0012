"""What a receiver should find out: the direct sound's delay, whether it is heard, and how fast its path grows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_choice, as_floats, texts
from clsim.errors import InputError
from clsim.packages import check_packages
from clsim.paths.arrivals import MOTIONS, slices_of
from clsim.paths.labelled import categories, labelled_dataset, labelled_frame
from clsim.paths.path_set import PathSet
from clsim.paths.specular.family import SpecularPaths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_OVER_TIME = ("delay", "doppler_factor", "line_of_sight", "radial_speed")


@dataclass(frozen=True, slots=True, eq=False)
class DirectPath:
    """The direct sound between every source and receiver, (sources, receivers, T).

    Attributes
    ----------
    times : ndarray (T,)
        Times of reception, s.
    delay : ndarray (sources, receivers, T)
        From emission to reception, s, also where a wall is in the way; group delays in air that disperses.
    doppler_factor : ndarray (sources, receivers, T)
        Received over emitted frequency, also where a wall is in the way.
    line_of_sight : ndarray (sources, receivers, T) of bool
        Whether it is heard.
    radial_speed : ndarray (sources, receivers, T)
        Speed of sound times the change of the delay by time of reception, ``c (1 - doppler_factor)``, m/s; positive
        where they part.
    source_names, receiver_names : tuple of str
        Along the first two axes.
    """

    times: Floats
    delay: Floats
    doppler_factor: Floats
    line_of_sight: NDArray[np.bool_]
    radial_speed: Floats
    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]

    def to_dataframe(self) -> Any:
        """Return it as a pandas DataFrame, a row per source, receiver and time.

        Returns
        -------
        pandas.DataFrame
            Columns ``times``, ``source``, ``receiver`` and a column for each field; texts as categories, as in
            `PathTable.to_dataframe`; ``attrs["units"]`` tells the units.

        Raises
        ------
        InputError
            If pandas is missing.
        """
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        source, receiver, at = (index.ravel() for index in np.indices(self.delay.shape))
        columns = {
            "times": self.times[at],
            "source": categories(self.source_names, source),
            "receiver": categories(self.receiver_names, receiver),
        }
        return labelled_frame(columns | {name: getattr(self, name).ravel() for name in _OVER_TIME})

    def to_xarray(self) -> Any:
        """Return it with named dimensions ``source``, ``receiver`` and ``times``, coordinates and units.

        Returns
        -------
        xarray.Dataset
            A variable for each field.

        Raises
        ------
        InputError
            If xarray is missing.
        """
        over = ("source", "receiver", "times")
        coordinates = {
            "source": ("source", texts(self.source_names)),
            "receiver": ("receiver", texts(self.receiver_names)),
            "times": ("times", self.times),
        }
        return labelled_dataset({name: (over, getattr(self, name)) for name in _OVER_TIME}, coordinates)


def direct_path(paths: PathSet, times: Floats, motion: str = "retarded") -> DirectPath:
    """Return the truth about the direct sound.

    Parameters
    ----------
    paths : PathSet
        Of the scene.
    times : array_like (T,)
        Times of reception, s, by the scene's clock.
    motion : {"retarded", "quasi-static"}
        As in `render`.

    Returns
    -------
    DirectPath
        Of every source and receiver.

    Raises
    ------
    InputError
        If times are no finite numbers (T,), or the motion is no known word.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3)
    >>> source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 3.0, 1.5)))
    >>> receiver = clsim.Receiver("r", clsim.Trajectory.line((4.0, 3.0, 1.5), (5.0, 3.0, 1.5), duration=1.0))
    >>> paths = clsim.find_paths(clsim.Scene(room, clsim.Air(speed_of_sound=340.0), [source], [receiver]), 0)
    >>> truth = direct_path(paths, [0.0, 0.5])
    >>> truth.delay[0, 0] * 340.0, truth.radial_speed[0, 0].round(9), truth.line_of_sight[0, 0]
    (array([3. , 3.5]), array([1., 1.]), array([ True,  True]))
    """
    if not isinstance(paths, PathSet):
        raise InputError("paths", f"must be a PathSet, but is {paths!r:.80}")
    times = as_floats("times", times, (None,))
    as_choice("motion", motion, MOTIONS)
    scene = paths.scene
    shape = (len(scene.sources), len(scene.receivers), len(times))
    delay, rate, seen = np.empty(shape), np.empty(shape), np.zeros(shape, dtype=bool)
    speed = np.array([scene.air.speed_at(source.emitted.centre_frequency) for source in scene.sources])
    for pair in SpecularPaths.direct(scene).pairs():
        for part in slices_of(len(times), 1):
            found = pair.arrivals(times[part], motion)
            delay[pair.source, pair.receiver, part] = (found.delay + pair.group_lag(found))[0]
            rate[pair.source, pair.receiver, part] = found.delay_rate[0]
    for row in np.flatnonzero(paths.order == 0):
        heard = (times >= paths.start[row]) & (times < paths.end[row])
        seen[paths.source[row], paths.receiver[row]] |= heard
    names = tuple(s.name for s in scene.sources), tuple(r.name for r in scene.receivers)
    return DirectPath(times, delay, 1.0 - rate, seen, speed[:, None, None] * rate, *names)
