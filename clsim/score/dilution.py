"""What the geometry of anchors makes of errors of ranges: the dilution of precision."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from clsim.arrays import Floats, as_choice, as_floats, as_number, read_only, short_repr
from clsim.packages import check_packages, check_pictures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Multilateration = Literal["toa", "tdoa"]
METHODS: tuple[str, ...] = get_args(Multilateration)
FLATTEST = 1e-9  # least singular value of a geometry that says something


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
        """Return a row for each place as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            Columns ``x``, ``y``, ``z``, in m, and ``gdop``.

        Raises
        ------
        InputError
            If pandas is missing.
        """
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        import pandas

        x, y = np.meshgrid(self.x, self.y)
        return pandas.DataFrame({"x": x.ravel(), "y": y.ravel(), "z": self.z, "gdop": self.gdop.ravel()})

    def plot(self) -> Axes:
        """Draw the map, and where the anchors are.

        Returns
        -------
        matplotlib.axes.Axes
            Of a new figure of pyplot.
        """
        check_pictures("plot")
        from matplotlib import pyplot

        figure, axes = pyplot.subplots(figsize=(6.4, 4.8), layout="constrained")
        finite = np.where(np.isfinite(self.gdop), self.gdop, np.nan)
        drawn = axes.pcolormesh(self.x, self.y, finite, shading="nearest", cmap="viridis_r")
        axes.plot(self.anchors[:, 0], self.anchors[:, 1], "k^", clip_on=False)
        figure.colorbar(drawn, label="dilution of precision")
        axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=f"z = {self.z:g} m; triangles: anchors")
        return axes


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

    Raises
    ------
    InputError
        If a value is not finite, or the method is none.

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
    anchors : array_like (n, 3)
        m.
    x : array_like (X,)
        m.
    y : array_like (Y,)
        m.
    z : float
        Height, m.
    method : {"toa", "tdoa"}
        As in `position`.

    Returns
    -------
    GdopMap
        Over all places (x, y, z).

    Raises
    ------
    InputError
        If a value is not finite, or the method is none.
    """
    places = as_floats("x", x, (None,)), as_floats("y", y, (None,))
    height, anchors = as_number("z", z, unit="m"), as_floats("anchors", anchors, (None, 3))
    over = [[gdop(anchors, np.array([a, b, height]), method) for a in places[0]] for b in places[1]]
    return GdopMap(read_only(np.array(over)), read_only(places[0]), read_only(places[1]), height, read_only(anchors))
