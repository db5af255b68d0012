"""Paths over one edge with the exact field of a wedge, at all frequencies and however near the edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.diffraction import transition, wedge_terms
from clsim.acoustics.exact_wedge import exact_wedge_terms
from clsim.paths.diffraction.family import EdgePaths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.acoustics.diffraction import EdgeWay
    from clsim.arrays import Floats
    from clsim.paths.diffraction.family import EndsOfEdges


@dataclass(frozen=True, slots=True, eq=False)
class ExactEdgePaths(EdgePaths):
    """Paths over one edge, and those over an end of one, whose wedge answers exactly."""

    @property
    def device(self) -> None:
        """None: the host makes their nodes, of whatever kind those of other edge paths are."""
        return None

    def _at_wedge(
        self, index: NDArray[np.int64], angles: Floats, distances: tuple[Floats, Floats], way: EdgeWay, wave: Floats,
        factors: list[Any], ends: EndsOfEdges,
    ) -> Any:  # fmt: skip
        return exact_field(self.n[index], self.lit[index], angles, distances, way, wave, factors, ends)


def exact_field(
    n: Floats, lit: NDArray[np.int8], angles: Floats, distances: tuple[Floats, Floats], way: EdgeWay, wave: Floats,
    factors: list[Any], ends: EndsOfEdges,
) -> Any:  # fmt: skip
    """Compute the exact field (P, T, F) of edges over that of the shortest ways, from what `utd_field` takes.

    Over an end each term is less by as much as it is in the uniform theory.
    """
    field = np.zeros(wave.shape, dtype=np.complex128)
    within = ((ends.side != 0)[:, None] & (ends.root >= 0.0))[..., None]
    sides = np.where(within, np.where(angles >= 0.0, 1, -1), np.where(lit < 0, -1, 1)[:, None])
    _, root = wedge_terms(n[:, None], angles, sides)
    terms = exact_wedge_terms(n[:, None], angles, sides, *distances, way, wave)
    for term, each in enumerate(terms):
        kept = np.flatnonzero(lit[:, term])
        over = np.flatnonzero(lit[:, term] * ends.side)
        if len(over):
            phase = root[over, :, term, None] * np.sqrt(wave[over] * way.breadth[over, :, None])
            each[over] *= ends.transition(over, lit[over, term], wave[over], phase) / transition(phase)
        field[kept] += each[kept] if factors[term] is None else (each * factors[term])[kept]
    return field
