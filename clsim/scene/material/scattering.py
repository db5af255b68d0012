"""How much of what a wall sends back leaves the mirror's direction: the scattering coefficient by frequency."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_floats, as_number
from clsim.errors import InputError
from clsim.scene.material.checks import checked_frequencies
from clsim.scene.material.tabulated import over_octaves

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats


@dataclass(frozen=True, eq=False)
class Scattering:
    """Shares of the energy sent back that are scattered, at increasing frequencies; held beyond the ends.

    Shapes: frequencies (n,) Hz; values (n,).
    """

    frequencies: Floats
    values: Floats

    def at(self, frequency: Floats) -> NDArray[Any]:
        """Return the shares (...) at frequencies (...), Hz."""
        return np.asarray(np.clip(self._curve(frequency), 0.0, 1.0))

    @cached_property
    def _curve(self) -> Callable[[Floats], NDArray[Any]]:
        return over_octaves(self.frequencies, self.values)


def as_scattering(value: Any) -> Scattering | None:
    """Return a scattering coefficient: of a number, or of a pair of frequencies, Hz, and values; None for nothing."""
    if value is None or isinstance(value, Scattering):
        return value
    if not isinstance(value, str) and not hasattr(value, "__len__"):
        number = as_number("scattering", value, at_least=0.0, at_most=1.0)
        return Scattering(np.array([1e3]), np.array([number])) if number else None
    try:
        frequencies, values = value
    except (TypeError, ValueError) as error:
        rule = "must be a number or a pair of frequencies and values"
        raise InputError("scattering", f"{rule}, but is {value!r:.80}") from error
    try:
        f = checked_frequencies(frequencies)
        shares = as_floats("values", values, (len(f),))
    except InputError as error:
        raise error.within("scattering") from error
    for i in np.flatnonzero((shares < 0.0) | (shares > 1.0))[:1]:
        raise InputError(f"scattering.values[{i}]", f"must be from 0 to 1, but is {shares[i]:g}")
    return Scattering(f, shares) if np.any(shares) else None
