"""Fields of edges and of their ends, over those of the shortest paths: uniform theory, or exact; faces' factors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import (
    AT_CORNER,
    EdgePath,
    adjacent_reflections,
    end_detour,
    end_transition,
    exact_wedge_terms,
    off_line,
    transition,
    wedge_terms,
)
from clsim.arrays import Complexes, Floats
from clsim.paths.response import SceneResponse

BOTH = 2  # times a term's side: both paths round its boundary count as much beyond the end


@dataclass(frozen=True, slots=True, eq=False)
class EndsOfEdges:
    """Ends of edges that P paths run over, at T times.

    Attributes
    ----------
    side : ndarray (P,) int8
        1 where the shortest way is taken to meet the edge, -1 where it passes the end; 0 of paths over the edge
        itself.
    """

    side: NDArray[np.int8]
    root: Floats  # (P, T) root of the detour by the end, √m; negative where the shortest way is on the other side
    corner: Floats  # (P,) angle at which the way comes to the corner itself, see `end_transition`

    @staticmethod
    def of(
        side: NDArray[np.int8], edge_path: EdgePath, ends: tuple[tuple[Floats, Floats], tuple[Floats, Floats]],
        end: Floats, inside: Floats, corner: Floats,
    ) -> EndsOfEdges:  # fmt: skip
        """Make it from r and z of source and receiver (P, T), m.

        `end` (P, 1) are the places of the ends, `inside` (P, T) how far inside the edges the shortest ways meet them.
        """
        signed, root = np.where(inside < 0.0, -1.0, 1.0) * side[:, None], np.zeros(edge_path.length.shape)
        over = np.flatnonzero(side)
        if len(over):
            some = EdgePath(edge_path.length[over], edge_path.apex[over], edge_path.breadth[over])
            (r_s, z_s), (r_r, z_r) = ((r[over], z[over]) for r, z in ends)
            detour = end_detour(some, (r_s, z_s), (r_r, z_r), np.broadcast_to(end, (len(side), 1))[over])
            root[over] = signed[over] * np.sqrt(detour)
        return EndsOfEdges(side, root, corner)

    def transition(self, rows: NDArray[np.int64], lit: NDArray[np.int8], wave: Floats, root: Floats) -> Complexes:
        """Compute the transition function of some rows' edges or ends (n, T, F), without the phase of the detour.

        By the sides of one term of the edge (n,), wave numbers (n, T, F), and roots of the phases of the term
        (n, T, F).
        """
        over = self.side[rows] != 0
        if not over.any():
            return transition(root)
        found, ends = np.empty(root.shape, dtype=np.complex128), rows[over]
        found[~over] = transition(root[~over])
        end, both = self.root[ends, :, None] * np.sqrt(wave[over]), np.abs(lit[over]) == BOTH
        at_end = end_transition(end, root[over], self.corner[ends, None, None])
        if both.any():  # half of either way round the boundary
            twice = np.exp(1j * (end[both] ** 2 + root[over][both] ** 2))
            at_end[both] -= np.where(end[both] < -AT_CORNER, twice, 0.0)
        found[over] = -1.0 * self.side[ends, None, None] * at_end
        return found


def utd_field(
    n: Floats, lit: NDArray[np.int8], angles: Floats, distances: tuple[Floats, Floats], edge_path: EdgePath,
    wave: Floats, factors: list[Any], ends: EndsOfEdges,
) -> Any:  # fmt: skip
    """Compute the field (P, T, F) of edges (P,) and of their ends over that of the shortest ways, see `Edges`.

    By the angles (P, T, 4) of the partners, the distances from the edges (P, T), wave numbers (P, T, F) and the faces'
    factors.
    """
    weight, root = wedge_terms(n[:, None], angles, np.sign(lit)[:, None])
    scale, field = np.sqrt(wave * edge_path.breadth[..., None]), np.zeros(wave.shape, dtype=np.complex128)
    for term in range(lit.shape[1]):
        kept = np.flatnonzero(lit[:, term])
        both = ends.transition(kept, lit[kept, term], wave[kept], root[kept, :, term, None] * scale[kept])
        both *= 0.5 * weight[kept, :, term, None]
        field[kept] += both if factors[term] is None else both * factors[term][kept]
    return field


def exact_field(
    n: Floats, lit: NDArray[np.int8], angles: Floats, distances: tuple[Floats, Floats], edge_path: EdgePath,
    wave: Floats, factors: list[Any], ends: EndsOfEdges,
) -> Any:  # fmt: skip
    """Compute the exact field (P, T, F) of edges over that of the shortest ways, from what `utd_field` takes.

    Over an end each term is less by as much as it is in the uniform theory.
    """
    field = np.zeros(wave.shape, dtype=np.complex128)
    within = ((ends.side != 0)[:, None] & (ends.root >= 0.0))[..., None]
    sides = np.where(within, np.where(angles >= 0.0, 1, -1), np.where(lit < 0, -1, 1)[:, None])
    _, root = wedge_terms(n[:, None], angles, sides)
    terms = exact_wedge_terms(n[:, None], angles, sides, *distances, edge_path, wave)
    for term, each in enumerate(terms):
        kept = np.flatnonzero(lit[:, term])
        over = np.flatnonzero(lit[:, term] * ends.side)
        if len(over):
            phase = root[over, :, term, None] * np.sqrt(wave[over] * edge_path.breadth[over, :, None])
            each[over] *= ends.transition(over, lit[over, term], wave[over], phase) / transition(phase)
        field[kept] += each[kept] if factors[term] is None else (each * factors[term])[kept]
    return field


def cylindrical(n: Floats, seen: Floats, beside: NDArray[np.int8]) -> tuple[Floats, Floats, Floats]:
    """Return r, θ and z of coordinates (3, P, T) about edges (P,), see `least_angle`."""
    x, y, z = seen
    return *off_line(n[:, None], x, y, least_angle(n, beside)[:, None]), z


def least_angle(n: Floats, beside: NDArray[np.int8]) -> Floats:
    """Origin of the angles about edges (P,).

    In the middle of the wedge; of ends that go on beyond the 0-face, -1, or beyond the n-face, 1, a quarter of the air
    before or after that: in the middle of a sheet they would jump at its very plane.
    """
    return np.asarray(0.5 * np.pi * (n - 2.0) + 0.25 * np.pi * n * beside)


def adjacent_factors(
    n: Floats, faces: NDArray[np.int64], angles: tuple[Floats, Floats], slope: Floats, at: SceneResponse
) -> list[Any]:
    """Multiply the reflection factors (P, T, F) of each term's partner; None for terms whose partners have none.

    Shapes: n (P,); faces (P, 2); slope (P, T).

    Our own derivation: on the boundary of a partner the angle from a face of one leg to the edge gives all angles of
    incidence, in steps of nπ; elsewhere both ends share what is left to the boundary. Behind a sheet that
    lets the share T of the pressure pass there is a path of T: the term past its edge stands for the rest, 1 - T.
    """
    (came, went), counts = angles, adjacent_reflections(n)
    sheets = np.flatnonzero(at.panels[faces[:, 0]] & (faces[:, 0] == faces[:, 1]))
    found: list[Any] = []
    for term, half in enumerate((0.5 * (went + came),) * 2 + (0.5 * (came - went),) * 2):
        product, count = None, counts[:, term]
        for bounce in range(count.max(initial=0)):
            turned = (bounce - count // 2) * np.pi * n
            wall = faces[:, ((term >= 2) * term + bounce) % 2]
            factor = face_factor(wall, np.cos(half + turned[:, None]) * slope, at)
            factor[bounce >= count] = 1.0
            product = factor if product is None else product * factor
        if len(sheets) and term < 2:
            product = np.ones((*slope.shape, len(at.frequencies)), dtype=np.complex128) if product is None else product
            passing = faces[sheets, 0] + at.surfaces
            product[sheets] -= face_factor(passing, (np.cos(half) * slope)[sheets], at)
        found.append(product)
    return found


def face_factor(walls: NDArray[np.int64], cosine: Floats, at: SceneResponse) -> Any:
    """Compute the reflection factors (P, T, F) of walls (P,) at cosines (P, T) of incidence, of any sign."""
    factor: Any = np.broadcast_to(at.reflection(walls[:, None])[:, None], (*cosine.shape, len(at.frequencies))).astype(
        np.complex128
    )
    for wall in np.unique(walls[at.angular[walls]]):
        here = np.flatnonzero(walls == wall)
        factor[here] = at.reflection_at(wall, np.abs(cosine[here]))
    return factor
