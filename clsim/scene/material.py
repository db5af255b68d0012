"""What walls are made of."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.reflection import reflection_from_absorption
from clsim.arrays import Complexes, Floats, as_choice, as_floats, as_number
from clsim.errors import ClsimWarning, InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_OCTAVES = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)  # Hz

# Absorption coefficients of diffuse sound in octave bands. Sources, by the letter that ends each row:
# S: E. Sengpiel, "Absorption coefficients of building materials and finishes",
#    www.sengpielaudio.com/calculator-RT60Coeff.htm
# C: T. J. Cox and P. D'Antonio, "Acoustic Absorbers and Diffusers", appendix A.
_ABSORPTION = {
    "concrete": ((0.01, 0.01, 0.015, 0.02, 0.02, 0.02), "S"),  # or tile
    "brick": ((0.03, 0.03, 0.03, 0.04, 0.05, 0.07), "S"),  # unglazed
    "plaster": ((0.013, 0.015, 0.02, 0.03, 0.04, 0.05), "S"),  # smooth, on tile or brick
    "glass": ((0.18, 0.06, 0.04, 0.03, 0.02, 0.02), "S"),  # large panes of heavy plate glass
    "linoleum": ((0.02, 0.03, 0.03, 0.03, 0.03, 0.02), "S"),  # on concrete
    "carpet": ((0.02, 0.06, 0.14, 0.37, 0.60, 0.65), "C"),  # heavy, on concrete
}
_FACTORS = {"rigid": 1.0, "pressure-release": -1.0}  # the two ideal walls, exact

MATERIAL_NAMES = (*_FACTORS, *_ABSORPTION)


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """How much sound a wall sends back: one factor, or a table of absorption by frequency.

    Parameters
    ----------
    reflection : float, optional
        Reflection factor of sound pressure at every frequency, -1 to 1: +1 rigid, -1 pressure release.
    name : str
        What to call it.
    frequencies : array_like (n,), optional
        Frequencies of the table, positive and increasing, Hz; in place of `reflection`.
    coefficients : array_like (n,), optional
        Absorption coefficients at `frequencies`, 0 to 1.

    Raises
    ------
    InputError
        If both or neither of factor and table are given, or a value is out of bounds.

    Notes
    -----
    The constructors `from_reflection`, `from_absorption` and `named` say more plainly what is meant.

    Examples
    --------
    >>> Material.from_reflection(0.9).reflection_at([20e3, 40e3]).tolist()
    [0.9, 0.9]
    """

    reflection: float | None = None
    name: str = ""
    frequencies: Floats | None = None
    coefficients: Floats | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError("name", f"must be a text, but is {self.name!r:.80}")
        if self.frequencies is None and self.coefficients is None:
            factor = as_number("reflection", self.reflection, at_least=-1.0, at_most=1.0)
            object.__setattr__(self, "reflection", factor)
            return
        if self.reflection is not None:
            raise InputError("reflection", "must be left out where a table of absorption is given")
        frequencies, coefficients = _checked_table(self.frequencies, self.coefficients)
        object.__setattr__(self, "frequencies", frequencies)
        object.__setattr__(self, "coefficients", coefficients)

    @classmethod
    def from_reflection(cls, factor: float) -> Material:
        """Return a material of one reflection factor of sound pressure, -1 to 1.

        Raises
        ------
        InputError
            If the factor is out of bounds.
        """
        return cls(as_number("factor", factor, at_least=-1.0, at_most=1.0))

    @classmethod
    def from_absorption(cls, frequencies: ArrayLike, coefficients: ArrayLike, name: str = "") -> Material:
        """Return a material of absorption coefficients by frequency.

        Parameters
        ----------
        frequencies : array_like (n,)
            Positive and increasing, Hz.
        coefficients : array_like (n,)
            Shares of energy absorbed, 0 to 1.
        name : str
            What to call it.

        Raises
        ------
        InputError
            If a value is out of bounds or the lengths differ.

        Examples
        --------
        >>> Material.from_absorption([1e3, 4e3], [0.0, 0.72]).reflection_at([1e3, 2e3]).round(6).tolist()
        [1.0, 0.8]
        """
        return cls(None, name, *_checked_table(frequencies, coefficients))

    @classmethod
    def named(cls, name: str) -> Material:
        """Return a built-in material.

        Parameters
        ----------
        name : str
            ``"rigid"`` (+1) and ``"pressure-release"`` (-1) are exact; ``"concrete"``, ``"brick"``,
            ``"plaster"``, ``"glass"``, ``"linoleum"`` and ``"carpet"`` are textbook coefficients from 125 Hz
            to 4 kHz. Above, their value at 4 kHz is held, with a warning: measure, or give a factor.

        Raises
        ------
        InputError
            If there is no such name; the message lists them.

        Examples
        --------
        >>> float(Material.named("pressure-release").reflection_at(40e3))
        -1.0
        """
        name = as_choice("name", name, MATERIAL_NAMES)
        if name in _FACTORS:
            return cls(_FACTORS[name], name)
        return cls.from_absorption(_OCTAVES, _ABSORPTION[name][0], name)

    @property
    def is_complex(self) -> bool:
        """Whether the factor has a phase."""
        return False

    @property
    def depends_on_angle(self) -> bool:
        """Whether the factor depends on the angle of incidence."""
        return False

    def reflection_at(
        self, frequency: ArrayLike, cosine: ArrayLike = 1.0, speed_of_sound: float = 343.2
    ) -> Floats | Complexes:
        """Return the reflection factor of sound pressure by frequency.

        Parameters
        ----------
        frequency : array_like
            Positive, Hz.

        Returns
        -------
        ndarray
            Factors of the shape of `frequency`, -1 to 1; from a table, the absorption is interpolated smoothly (by
            monotone cubics) over the logarithm of frequency and held at the ends.

        Raises
        ------
        InputError
            If the frequency is not positive.

        Warns
        -----
        ClsimWarning
            If the frequency lies outside the table.
        """
        frequency = np.asarray(frequency, dtype=np.float64)
        if not np.all((frequency > 0.0) & np.isfinite(frequency)):
            raise InputError("frequency", f"must be finite and above 0 Hz, but is {np.min(frequency):g} Hz")
        if self.reflection is not None:
            return np.full(frequency.shape, self.reflection)
        assert self.frequencies is not None
        assert self.coefficients is not None
        low, high = float(self.frequencies[0]), float(self.frequencies[-1])
        outside = (frequency < low * (1.0 - 1e-12)) | (frequency > high * (1.0 + 1e-12))
        if np.any(outside):
            warnings.warn(
                f"the material {self.name or 'without a name'!r} is known from {low:g} to {high:g} Hz, but "
                f"asked for at {frequency[outside].flat[-1]:g} Hz; the value at the nearest end is taken",
                ClsimWarning,
                stacklevel=2,
            )
        if len(self.frequencies) == 1:
            return np.full(frequency.shape, reflection_from_absorption(self.coefficients[0]))
        from scipy.interpolate import PchipInterpolator

        smooth = PchipInterpolator(np.log(self.frequencies), self.coefficients)  # without overshoot
        alpha = np.clip(smooth(np.log(np.clip(frequency, low, high))), 0.0, 1.0)
        return np.asarray(reflection_from_absorption(alpha))


def _checked_table(frequencies: ArrayLike | None, coefficients: ArrayLike | None) -> tuple[Floats, Floats]:
    f = as_floats("frequencies", frequencies, (None,))
    alpha = as_floats("coefficients", coefficients, (len(f),))
    for i, value in enumerate(f):
        if not value > 0.0:
            raise InputError(f"frequencies[{i}]", f"must be above 0 Hz, but is {value:g} Hz")
    falling = np.flatnonzero(np.diff(f) <= 0.0)
    if len(falling):
        i = int(falling[0]) + 1
        raise InputError(
            "frequencies",
            f"must increase strictly, but [{i}] = {f[i]:g} Hz follows [{i - 1}] = {f[i - 1]:g} Hz",
        )
    for i, value in enumerate(alpha):
        if not 0.0 <= value <= 1.0:
            raise InputError(f"coefficients[{i}]", f"must be from 0 to 1, but is {value:g}")
    return f, alpha
