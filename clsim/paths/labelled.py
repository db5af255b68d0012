"""Columns and dimensions with units, as pandas and xarray take them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import texts
from clsim.packages import check_packages

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_OF_RECEPTION = {"units": "s", "long_name": "time of reception"}
ATTRIBUTES: dict[str, dict[str, str]] = {
    "times": _OF_RECEPTION,
    "delay": {"units": "s", "long_name": "delay from emission to reception"},
    "doppler_factor": {"units": "1", "long_name": "received over emitted frequency"},
    "doppler_shift": {"units": "Hz", "long_name": "received less emitted frequency at the signal's centre"},
    "gain": {"units": "1", "long_name": "received over emitted pressure at 1 m, at the signal's centre frequency"},
    "departure": {"units": "1", "long_name": "unit vector from the source along the path"},
    "arrival": {"units": "1", "long_name": "unit vector from the receiver back along the path"},
    "local_arrival": {"units": "1", "long_name": "the same in the receiver's axes, +x where it faces"},
    "reception_time": {"units": "s", "long_name": "time of reception"},
    "source_position": {"units": "m", "long_name": "position of the source at emission"},
    "receiver_position": {"units": "m", "long_name": "position of the receiver at reception"},
    "radial_speed": {"units": "m/s", "long_name": "speed at which the direct path grows"},
    "line_of_sight": {"long_name": "whether the direct sound is received"},
    "order": {"long_name": "number of interactions"},
    "objects": {"long_name": "what the path meets, from the source's side"},
    "interactions": {"long_name": "0 specular reflection, 1 diffraction, 2 scattering, 3 body, 4 transmission"},
}


def categories(values: Sequence[str], which: NDArray[np.integer[Any]]) -> Any:
    """Return a categorical column of pandas: the texts of `values` in the rows `which`."""
    import pandas

    kinds, code = np.unique(texts(values), return_inverse=True)
    return pandas.Categorical.from_codes(code[which], kinds)


def labelled_frame(columns: dict[str, Any]) -> Any:
    """Return columns as a pandas DataFrame with what is known of their units."""
    import pandas

    frame = pandas.DataFrame(columns)
    units = {name: ATTRIBUTES.get(re.sub("_[xyz]$", "", name), {}).get("units", "") for name in columns}
    frame.attrs["units"] = {name: unit for name, unit in units.items() if unit}
    return frame


def labelled_dataset(variables: dict[str, Any], coordinates: dict[str, Any]) -> Any:
    """Return variables, each (dimensions, values), with coordinates and what is known of the units of both."""
    check_packages("to_xarray", "a Dataset", "tables", "xarray")
    import xarray

    def told(what: dict[str, Any]) -> dict[str, Any]:
        """Return variables, each with the attributes of its name."""
        return {name: (*value, ATTRIBUTES.get(name, {})) for name, value in what.items()}

    return xarray.Dataset(told(variables), told(coordinates))
