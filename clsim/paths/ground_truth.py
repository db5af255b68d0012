"""Ground truth of the direct sound: what a location system is compared with, by time of reception or of emission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_choice, as_floats, texts
from clsim.errors import InputError
from clsim.numerics.quaternions import rotate
from clsim.packages import check_packages
from clsim.paths.arrivals import Kinematics, slices_of
from clsim.paths.labelled import categories, labelled_dataset, labelled_frame
from clsim.paths.legs.static import direct_paths
from clsim.paths.path_set import PathSet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.family import PairPaths

SCALARS = ("delay", "doppler_factor", "line_of_sight", "radial_speed", "reception_time")
VECTORS = ("arrival", "local_arrival", "source_position", "receiver_position")
_NEWTON_LIMIT = 60


@dataclass(frozen=True, slots=True, eq=False)
class DirectPath:
    """The direct sound between every source and receiver, (sources, receivers, T).

    Attributes
    ----------
    times : ndarray (T,)
        The instants that were given, s, by the scene's clock: of emission where `emitted` is true, else of
        reception.
    delay : ndarray (sources, receivers, T)
        From emission to reception, s, also where a wall is in the way; group delays in air that disperses.
    radial_speed : ndarray (sources, receivers, T)
        Speed of sound times the change of the delay by time of reception, ``c (1 - doppler_factor)``, m/s; positive
        where they part.
    reception_time : ndarray (sources, receivers, T)
        Times of reception, s; the sound was emitted at ``reception_time - delay``.
    arrival : ndarray (sources, receivers, T, 3)
        Unit vectors from the receiver back along the path, in the room; in wind normals of the wavefront.
    local_arrival : ndarray (sources, receivers, T, 3)
        The same in the axes of the receiver as it is turned at reception: +x is where it faces.
    """

    times: Floats
    delay: Floats
    doppler_factor: Floats  # (sources, receivers, T) received over emitted frequency, also where a wall is in the way
    line_of_sight: NDArray[np.bool_]  # (sources, receivers, T) whether the direct sound is received
    radial_speed: Floats
    reception_time: Floats
    arrival: Floats
    local_arrival: Floats
    source_position: Floats  # (sources, receivers, T, 3) the source at emission and the receiver at reception, m
    receiver_position: Floats  # likewise
    source_names: tuple[str, ...]  # along the first two axes
    receiver_names: tuple[str, ...]  # likewise
    emitted: bool  # whether `times` are times of emission

    def tdoa(self, reference: str | None = None) -> Floats:
        """Return the time differences of arrival of one emission at all receivers.

        reference: name of the receiver whose reception is subtracted; the first one where left out.

        Delays at one time of reception belong to different emissions. Their differences are no TDOA: they are wrong by
        the share ``v / c``, v the radial speed of the source; at 1.7 m/s that is 5 mm per metre.
        """
        if not self.emitted:
            raise InputError("emitted", "must be given to direct_path for a TDOA, but the times are of reception")
        names = self.receiver_names
        row = 0 if reference is None else names.index(as_choice("reference", reference, names))
        return np.asarray(self.reception_time - self.reception_time[:, row : row + 1])

    def to_dataframe(self) -> Any:
        """Return it as a pandas DataFrame, a row per source, receiver and time.

        result: columns ``times``, ``source``, ``receiver`` and a column for each field, vectors as ``arrival_x`` and so
        on; texts as categories, as in `PathTable.to_dataframe`; ``attrs["units"]`` holds the units.
        """
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        source, receiver, at = (index.ravel() for index in np.indices(self.delay.shape))
        columns = {
            "times": self.times[at],
            "source": categories(self.source_names, source),
            "receiver": categories(self.receiver_names, receiver),
        }
        columns |= {name: getattr(self, name).ravel() for name in SCALARS}
        for name in VECTORS:
            columns |= {f"{name}_{axis}": getattr(self, name)[..., i].ravel() for i, axis in enumerate("xyz")}
        return labelled_frame(columns)

    def to_xarray(self) -> Any:
        """Return it with named dimensions ``source``, ``receiver``, ``times`` and ``axis``, coordinates and units."""
        over = ("source", "receiver", "times")
        coordinates = {
            "source": ("source", texts(self.source_names)),
            "receiver": ("receiver", texts(self.receiver_names)),
            "times": ("times", self.times),
            "axis": ("axis", list("xyz")),
        }
        scalars = {name: (over, getattr(self, name)) for name in SCALARS}
        vectors = {name: ((*over, "axis"), getattr(self, name)) for name in VECTORS}
        dataset = labelled_dataset(scalars | vectors, coordinates)
        if self.emitted:
            dataset["times"].attrs["long_name"] = "time of emission"
        return dataset


def direct_path(
    paths: PathSet, times: Floats | None = None, motion: str = "retarded", *, emitted: Floats | None = None
) -> DirectPath:
    """Return the ground truth of the direct sound, by time of reception or of emission.

    Parameters
    ----------
    paths : PathSet
        Of the scene.
    times : array_like (T,), optional
        Times of reception, s, by the scene's clock: what a receiver gets at one instant.
    motion : {"retarded", "quasi-static"}
        As in `render`.
    emitted : array_like (T,), optional
        Times of emission, s, in place of times of reception: the same sound at all receivers, as for TDOA.

    Returns
    -------
    DirectPath
        Of every source and receiver.

    Raises
    ------
    InputError
        If both or neither of `times` and `emitted` are given, they are no finite numbers (T,), or the motion is no
        known word.

    Notes
    -----
    What is emitted at ``t_e`` is received at the solution of ``t - delay(t) = t_e``.

    Times beyond the ends of a trajectory are taken as `render` takes them: 0.05 s beyond an end it comes to rest.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3)
    >>> source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 3.0, 1.5)))
    >>> ends = [(4.0, 3.0, 1.5), (5.0, 3.0, 1.5)], [(2.0, 3.0, 1.5), (2.0, 3.0, 1.5)]
    >>> receivers = [clsim.Receiver(n, clsim.Trajectory.line(*e, duration=1.0)) for n, e in zip("ab", ends)]
    >>> paths = clsim.find_paths(clsim.Scene(room, clsim.Air(speed_of_sound=340.0), [source], receivers), 0)
    >>> truth = direct_path(paths, [0.0, 0.5])
    >>> truth.delay[0, 0] * 340.0, truth.radial_speed[0, 0].round(9), truth.line_of_sight[0, 0]
    (array([3. , 3.5]), array([1., 1.]), array([ True,  True]))
    >>> direct_path(paths, emitted=[0.0]).tdoa("b")[0, 0].round(9)  # 3 m / (339 m/s) - 1 m / (340 m/s)
    array([0.00590838])
    """
    if not isinstance(paths, PathSet):
        raise InputError("paths", f"must be a PathSet, but is {paths!r:.80}")
    if (times is None) == (emitted is None):
        raise InputError("times", f"must be given or else emitted, but {'neither is' if times is None else 'both are'}")
    kinematics = Kinematics(motion)
    scene, by_emission = paths.scene, emitted is not None
    instants = as_floats("emitted" if by_emission else "times", emitted if by_emission else times, (None,))
    names = tuple(s.name for s in scene.sources), tuple(r.name for r in scene.receivers)
    shape = (len(scene.sources), len(scene.receivers), len(instants))
    found = {name: np.empty(shape) for name in ("delay", "rate", "reception_time")}
    found |= {name: np.empty((*shape, 3)) for name in VECTORS}
    for pair in direct_paths(scene).pairs():
        for part in slices_of(len(instants), 1):
            received = reception_times(pair, instants[part], kinematics) if by_emission else instants[part]
            for name, values in _direct_sound(pair, received, kinematics).items():
                found[name][pair.source, pair.receiver, part] = values
    speed = np.array([scene.air.speed_at(source.emitted.centre_frequency) for source in scene.sources])
    rate, sight = found.pop("rate"), [in_sight(paths, s, times) for s, times in enumerate(found["reception_time"])]
    return DirectPath(
        times=instants, doppler_factor=1.0 - rate, line_of_sight=np.array(sight),
        radial_speed=speed[:, None, None] * rate, source_names=names[0], receiver_names=names[1],
        emitted=by_emission, **found,
    )  # fmt: skip


def _direct_sound(pair: PairPaths, received: Floats, kinematics: Kinematics) -> dict[str, Floats]:
    """Return delays, their rates, directions and positions of the direct path of a pair at times of reception (T,)."""
    scene = pair.family.scene
    source, receiver = scene.sources[pair.source].trajectory, scene.receivers[pair.receiver]
    arrivals = pair.arrivals(received, kinematics)
    delay = (arrivals.delay + pair.group_lag(arrivals))[0]
    left = received - delay if kinematics.retarded else received
    return {
        "delay": delay,
        "rate": arrivals.delay_rate[0],
        "reception_time": received,
        "arrival": arrivals.arrival[0],
        "local_arrival": rotate(receiver.orientation(received) * (-1.0, -1.0, -1.0, 1.0), arrivals.arrival[0]),
        "source_position": source.position(left),
        "receiver_position": receiver.trajectory.position(received),
    }


def reception_times(pair: PairPaths, emitted: Floats, kinematics: Kinematics) -> Floats:
    """Return the times of reception (T,) of what is emitted at times (T,), s, by Newton's method.

    The delay changes by less than a second per second below the speed of sound: there is one solution.
    """
    received = emitted
    for _ in range(_NEWTON_LIMIT):
        arrivals = pair.arrivals(received, kinematics)
        late = emitted + (arrivals.delay + pair.group_lag(arrivals))[0] - received
        received = received + late / (1.0 - arrivals.delay_rate[0])
        if np.all(np.abs(late) <= 1e-15 + 4e-16 * np.abs(received)):
            break
    return received


def in_sight(paths: PathSet, source: int, received: Floats) -> NDArray[np.bool_]:
    """Return a mask of the times of reception (receivers, T) at which the direct path of a source is there."""
    seen = np.zeros(received.shape, dtype=bool)
    for row in np.flatnonzero((paths.order == 0) & (paths.source == source)):
        times = received[paths.receiver[row]]
        seen[paths.receiver[row]] |= (times >= paths.start[row]) & (times < paths.end[row])
    return seen
