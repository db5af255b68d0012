"""Positions from ranges to several anchors compared with the truth, and their dilution of precision."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import scipy

from clsim.arrays import Floats, as_choice, as_floats, as_number, read_only, short_repr, texts
from clsim.errors import InputError, check_packages, check_pictures
from clsim.pictures.view_page import html_table
from clsim.scene.room.protocol import Room
from clsim.score.ranging import RangingScore

if TYPE_CHECKING:
    from matplotlib.figure import Figure


from clsim.arrays import LOUDEST, QUIETEST
from clsim.paths.path_set import PathSet
from clsim.sensitivity.sensitivities import crb, sensitivities

Multilateration = Literal["toa", "tdoa"]
METHODS: tuple[str, ...] = get_args(Multilateration)
FLATTEST = 1e-9  # least singular value of a geometry that says something
_Given = tuple[Floats, Floats, Floats, tuple[str, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class GdopMap:
    """Dilution of precision over a plane.

    Attributes
    ----------
    gdop : ndarray (Y, X)
        As `gdop` returns it, m/m.
    x, y : ndarray (X,), (Y,)
        m.
    z : float
        Height of the plane, m.
    anchors : ndarray (n, 3)
        m.
    """

    gdop: Floats
    x: Floats
    y: Floats
    z: float
    anchors: Floats

    __repr__ = short_repr

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row for each place: ``x``, ``y``, ``z``, in m, and ``gdop``."""
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        import pandas

        x, y = np.meshgrid(self.x, self.y)
        return pandas.DataFrame({"x": x.ravel(), "y": y.ravel(), "z": self.z, "gdop": self.gdop.ravel()})

    def plot(self) -> Figure:
        """Draw the map, and where the anchors are."""
        check_pictures("plot")
        from matplotlib import pyplot

        figure, axes = pyplot.subplots(figsize=(6.4, 4.8), layout="constrained")
        finite = np.where(np.isfinite(self.gdop), self.gdop, np.nan)
        drawn = axes.pcolormesh(self.x, self.y, finite, shading="nearest", cmap="viridis_r")
        axes.plot(self.anchors[:, 0], self.anchors[:, 1], "k^", clip_on=False)
        figure.colorbar(drawn, label="dilution of precision")
        axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=f"z = {self.z:g} m; triangles: anchors")
        return figure


def gdop(anchors: Floats, place: Floats, method: str = "toa") -> float:
    """Return the dilution of precision at a place.

    Parameters
    ----------
    anchors : array_like (n, 3)
        m.
    place : array_like (3,)
        m.
    method : {"toa", "tdoa"}
        As in `position`.

    Returns
    -------
    float
        Standard deviation of the position over that of every range, a ratio; inf where the anchors leave it open.

    Notes
    -----
    The root of the trace, over the three coordinates, of ``(H' H)^-1``, with a row of H for each anchor: the unit
    vector from it to the place and, for differences, 1 (E. D. Kaplan, C. J. Hegarty, "Understanding GPS", 2nd edition,
    2006, section 7.3.1).
    """
    anchors, place = as_floats("anchors", anchors, (None, 3)), as_floats("place", place, (3,))
    as_choice("method", method, METHODS)
    away = place - anchors
    rows = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), FLATTEST)
    if method == "tdoa":
        rows = np.hstack([rows, np.ones((len(rows), 1))])
    if len(rows) < rows.shape[1]:
        return math.inf
    _, sizes, turned = np.linalg.svd(rows, full_matrices=False)
    if sizes[-1] < FLATTEST:
        return math.inf
    return float(np.linalg.norm(turned[:, :3] / sizes[:, None]))


def gdop_map(anchors: Floats, x: Floats, y: Floats, z: float, method: str = "toa") -> GdopMap:
    """Return the dilution of precision over a plane.

    Parameters
    ----------
    anchors, method
        As in `gdop`.
    x, y : array_like (X,), (Y,)
        m.
    z : float
        Height, m.
    """
    places = as_floats("x", x, (None,)), as_floats("y", y, (None,))
    height, anchors = as_number("z", z, unit="m"), as_floats("anchors", anchors, (None, 3))
    over = [[gdop(anchors, np.array([a, b, height]), method) for a in places[0]] for b in places[1]]
    return GdopMap(read_only(np.array(over)), read_only(places[0]), read_only(places[1]), height, read_only(anchors))


@dataclass(frozen=True, slots=True, eq=False)
class PositionScore:
    """Estimated positions and their ground truth.

    Attributes
    ----------
    names : tuple of str
        Names of the located objects, along the first axis.
    times : ndarray (positions,)
        Times of the emissions, s; of a round of several sources that of the first.
    estimated : ndarray (located, positions, 3)
        m; NaN where too few ranges were found.
    exact : ndarray (located, positions, 3)
        m.
    anchors : ndarray (anchors, 3)
        At 0 s, m.
    gdop : ndarray (located, positions)
        Dilution of precision at the true position by the anchors whose ranges were found, a ratio: standard deviation
        of the position over that of a range.
    """

    names: tuple[str, ...]
    times: Floats
    estimated: Floats
    exact: Floats
    anchors: Floats
    gdop: Floats

    __repr__ = short_repr

    @property
    def error(self) -> Floats:
        """Distance of estimated from true positions (located, positions), m; NaN where there is none."""
        return np.asarray(np.linalg.norm(self.estimated - self.exact, axis=-1))

    @property
    def bias(self) -> Floats:
        """Mean of estimated less true positions (3,), m."""
        found = (self.estimated - self.exact)[np.isfinite(self.error)]
        return np.asarray(found.mean(axis=0) if len(found) else np.full(3, math.nan))

    @property
    def deviation(self) -> Floats:
        """Standard deviation of estimated less true positions (3,), m."""
        found = (self.estimated - self.exact)[np.isfinite(self.error)]
        return np.asarray(found.std(axis=0) if len(found) else np.full(3, math.nan))

    @property
    def availability(self) -> float:
        """Share of positions for which there were ranges enough."""
        return float(np.mean(np.isfinite(self.error)))

    def percentile(self, percent: float) -> float:
        """Return the error that `percent` of the positions found do not exceed, 0 to 100 %, m; NaN without any."""
        percent = as_number("percent", percent, at_least=0.0, at_most=100.0, unit="%")
        found = self.error[np.isfinite(self.error)]
        return float(np.percentile(found, percent)) if len(found) else math.nan

    def to_dataframe(self) -> Any:
        """Return a row for each position as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            Columns ``name``, ``time``, ``x``, ``y``, ``z``, ``x_exact``, ``y_exact``, ``z_exact``, ``error`` and
            ``gdop``, in s and m.
        """
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        import pandas

        count = len(self.times)
        columns: dict[str, Any] = {
            "name": np.repeat(texts(self.names), count),
            "time": np.tile(self.times, len(self.names)),
        }
        for suffix, places in (("", self.estimated), ("_exact", self.exact)):
            columns |= {f"{axis}{suffix}": places[..., i].ravel() for i, axis in enumerate("xyz")}
        return pandas.DataFrame(columns | {"error": self.error.ravel(), "gdop": self.gdop.ravel()})

    def plot(self) -> Figure:
        """Draw estimated and true positions seen from above, and how errors are distributed."""
        check_pictures("plot")
        from matplotlib import pyplot

        figure, (plan, spread) = pyplot.subplots(1, 2, figsize=(11.0, 4.6), layout="constrained")
        plan.plot(*self.anchors[:, :2].T, "k^", label="anchors")
        for name, true, found in zip(self.names, self.exact, self.estimated, strict=True):
            plan.plot(*true[:, :2].T, "-", linewidth=1.0, label=name)
            plan.plot(*found[:, :2].T, ".", markersize=3.0, color=plan.lines[-1].get_color())
        plan.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
        plan.legend()
        size = np.sort(1e3 * self.error[np.isfinite(self.error)])
        spread.plot(size, 100.0 * (np.arange(len(size)) + 1.0) / max(len(size), 1), color="#1f77b4")
        spread.set(xlabel="error of the position (mm)", ylabel="share of the positions (%)", ylim=(0.0, 100.0))
        for axes in (plan, spread):
            axes.grid(alpha=0.25, linewidth=0.6)
        return figure

    def _repr_html_(self) -> str:
        rows = [(f"{p} % within", f"{1e3 * self.percentile(p):.3f} mm") for p in (50, 95)]
        rows.append(("bias (x, y, z)", ", ".join(f"{1e3 * b:.3f}" for b in self.bias) + " mm"))
        rows.append(("located", f"{100 * self.availability:.1f} %"))
        return html_table(f"PositionScore: {len(self.names)} located, {len(self.times)} times", ("", ""), rows)


def position(scores: RangingScore | Sequence[RangingScore], method: str = "toa") -> PositionScore:
    """Return positions by multilateration of measured ranges, and their errors.

    Parameters
    ----------
    scores : RangingScore or sequence of RangingScore
        Of one source: it is located by the receivers. Of several sources of one recording: every receiver is located by
        the sources, from emission k of all of them.
    method : {"toa", "tdoa"}
        Whether the times of emission are known, or are found, too, from differences of times of arrival.

    Returns
    -------
    PositionScore
        Estimates within the room's extent, NaN where fewer than 3 (of differences, 4) ranges were found.

    Notes
    -----
    Least squares of the ranges' errors, by trust regions from the middle of the room (scipy). Anchors in one plane
    leave two solutions; the room's extent decides. A source's true position is that at the beginning of its pulse, a
    receiver's that at reception of the first source's; anchors are where they are then.
    """
    as_choice("method", method, METHODS)
    several = [scores] if isinstance(scores, RangingScore) else list(scores)
    if not several or not all(isinstance(score, RangingScore) for score in several):
        raise InputError("scores", f"must be one RangingScore at least, but is {scores!r:.80}")
    if any(score.scene is not several[0].scene for score in several):
        raise InputError("scores", "must be of one recording, but are of several")
    delay, exact, anchors, names = _by_source(several[0]) if len(several) == 1 else _by_receivers(several)
    least = 3 if method == "toa" else 4
    if delay.shape[2] < least:
        raise InputError("scores", f"must give {least} anchors at least for {method}, but give {delay.shape[2]}")
    room, c = several[0].scene.room, several[0].scene.air.speed_of_sound
    estimated, dilution = np.full(exact.shape, math.nan), np.full(exact.shape[:2], math.nan)
    for i, k in np.ndindex(*dilution.shape):
        found = np.isfinite(delay[i, k])
        if np.count_nonzero(found) >= least:
            estimated[i, k] = _located(anchors[i, k, found], c * delay[i, k, found], method, room)
            dilution[i, k] = gdop(anchors[i, k, found], exact[i, k], method)
    return PositionScore(
        names, several[0].emission_times[: exact.shape[1]], read_only(estimated), read_only(exact),
        read_only(anchors[0, 0]), read_only(dilution),
    )  # fmt: skip


def _by_source(score: RangingScore) -> _Given:
    """Return delays (1, K, anchors), true places (1, K, 3), anchors (1, K, anchors, 3) and the source's name."""
    source = score.scene.sources[score.source]
    received = score.emission_times + np.nan_to_num(score.exact)  # (anchors, K)
    places = [end.trajectory.position(t) for end, t in zip(score.scene.receivers, received, strict=True)]
    exact = source.trajectory.position(score.emission_times)
    return score.delay.T[None], exact[None], np.stack(places, axis=1)[None], (source.name,)


def _by_receivers(scores: list[RangingScore]) -> _Given:
    """Return delays (receivers, K, anchors), true places (receivers, K, 3), anchors and the receivers' names."""
    rounds = min(len(score.emission_times) for score in scores)
    first = scores[0]
    received = (first.emission_times + np.nan_to_num(first.exact))[:, :rounds]
    exact = [end.trajectory.position(t) for end, t in zip(first.scene.receivers, received, strict=True)]
    sources = [first.scene.sources[score.source] for score in scores]
    places = [s.trajectory.position(r.emission_times[:rounds]) for s, r in zip(sources, scores, strict=True)]
    anchors = np.broadcast_to(np.stack(places, axis=1), (len(exact), rounds, len(scores), 3))
    delays = np.stack([score.delay[:, :rounds] for score in scores], axis=2)
    return delays, np.stack(exact), anchors, first.receiver_names


def _located(anchors: Floats, ranges: Floats, method: str, room: Room) -> Floats:
    """Return the place (3,) within a room that fits ranges (n,) to anchors (n, 3) best, m."""
    low, high = room.extent
    middle = 0.5 * (low + high)
    free = method == "tdoa"  # what all ranges have in common
    start, reach = np.append(middle, 0.0), 10.0 * float(np.abs(ranges).max() + np.linalg.norm(high - low))

    def errors(unknown: Floats) -> Floats:
        away = np.linalg.norm(unknown[:3] - anchors, axis=1)
        return np.asarray(away + (unknown[3] if free else 0.0) - ranges)

    def slopes(unknown: Floats) -> Floats:
        away = unknown[:3] - anchors
        rows = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), FLATTEST)
        return np.hstack([rows, np.ones((len(rows), 1))]) if free else rows

    count = 4 if free else 3
    bounds = np.append(low, -reach)[:count], np.append(high, reach)[:count]
    found: Any = scipy.optimize.least_squares(
        errors, start[:count], slopes, bounds, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12
    )
    return np.asarray(found.x[:3])


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
    Echoes that overlap are separated as far as the recording can: no separation of paths is assumed (Y. Shen and
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
