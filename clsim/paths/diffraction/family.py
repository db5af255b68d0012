"""Paths over one edge, with reflections before and after it: two isometries and the field at a wedge."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from clsim.acoustics.diffraction import (
    ON_LINE,
    EdgeWay,
    edge_way,
    end_detour,
    lit_angles,
    off_line,
    partner_reflections,
    transition,
    wedge_terms,
)
from clsim.acoustics.edge_end import AT_CORNER, end_transition
from clsim.paths.arrivals import MACH_EXPONENT, Arrivals
from clsim.paths.diffraction.end_pieces import BOTH
from clsim.paths.diffraction.ways import EdgeView, RolledOut, edge_ways
from clsim.paths.diffraction.ways_over import WaysOver
from clsim.paths.propagation import UniformAir, arrivals_by
from clsim.paths.two_sided import TwoSidedPaths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.family import Rows
    from clsim.paths.response import SceneResponse

_LOUDEST = 3.0  # over the partners: four terms of a half at most, one of which may be continued beyond its boundary


@dataclass(frozen=True, slots=True, eq=False)
class EdgePaths(TwoSidedPaths):
    """Paths over one edge, and those over an end of one; each row is a piece between two boundaries of its terms.

    Shortly beyond its own interval a row goes on smoothly: what it takes over there is its partner's.

    Attributes
    ----------
    lit : ndarray (paths, 4) int8
        1 for terms whose partner is seen, -1 for those whose partner is not, 0 for terms that are left out. Over
        ends of edges, as the end changes sides, and 2 or -2 where both do at once, see `joined_over_ends`.
    end_place : ndarray (paths,)
        How far along the edge the end is that a path runs over, m; NaN for those over the edge itself.
    end_side : ndarray (paths,) int8
        1 while the shortest way over the line of the edge meets the edge, -1 while it passes the end.
    beside : ndarray (paths, 2) int8
        -1 where source or receiver goes on beyond the 0-face, 1 where beyond the n-face, 0 where as far beyond
        both.
    """

    frame: Floats  # (paths, 4, 3) start of the edge, m, and its vectors `across`, `out` and `along`, see `Edges`
    n: Floats  # (paths,) exterior angle over π
    faces: NDArray[np.int64]  # (paths, 2) walls of the 0-face and the n-face
    lit: NDArray[np.int8]
    end_place: Floats
    end_side: NDArray[np.int8]
    beside: NDArray[np.int8]
    edge_names: tuple[str, ...]  # of all edges of the room

    columns: ClassVar[tuple[str, ...]] = (
        "before_matrix", "before_offset", "after_matrix", "after_offset", "frame", "n", "faces", "lit",
        "end_place", "end_side", "beside",
    )  # fmt: skip

    costly: ClassVar[bool] = True

    @property
    def device(self) -> str | None:
        """The program for paths over one edge; it knows air of one speed alone, that rests."""
        media = [self.medium(source) for source in range(len(self.scene.sources))]
        still = all(isinstance(m, UniformAir) and m.wind is None and m.fluctuation is None for m in media)
        return "edges" if still else None

    @property
    def is_complex(self) -> bool:
        """True: the field at an edge has a phase of its own."""
        return True

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the edges, and of their two ends, edge by edge."""
        return (*self.edge_names, *(f"{end} of {name}" for name in self.edge_names for end in ("start", "end")))

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver.

        The way over the edge is the shortest one, so the change of the apex does not change its length: rates are those
        of two legs to a place at rest.
        """
        source, receiver = (end.trajectory for end in self.ends(rows))
        times, retarded = np.asarray(times, dtype=np.float64), motion == "retarded"
        index, medium = np.arange(len(self))[rows], self.medium(int(self.source[rows][0]))
        if self.scene.air.layers or medium.fluctuation is not None:
            return arrivals_by(partial(WaysOver, self, index), medium, (source, receiver), times, motion, amplitude)
        views = self._view("before", index), self._view("after", index)
        ways = edge_ways(
            views, self._beyond(index), self.end_place[index], source, receiver.position(times), times, medium, retarded
        )
        leaving, back = ways.parts
        direction, onwards = views[0].back(leaving), -views[1].back(back)
        sound, receding = ways.sound, ways.sound.growth(onwards, receiver.velocity(times))
        departure, length = sound.normal(direction), ways.length
        if sound.carried is not None:
            length = length * np.sum(departure * direction, axis=-1)
        ratio = 1.0 / (1.0 - ways.mach) if retarded else np.ones(ways.delay.shape)
        rate, factor = (receding - ways.mach) * ratio, ratio ** MACH_EXPONENT[amplitude]
        return Arrivals(
            ways.delay, rate, departure, -sound.normal(onwards), length, sound.through, None, ways.emission_time,
            factor, ratio,
        )  # fmt: skip

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): the field at the edge, spreading, air, walls, directivities.

        The phases of the transition are those at the time of emission, stretched by ``1 / (1 - M)`` as all that a
        moving source emits.
        """
        index = np.arange(len(self))[rows]
        source, receiver = self.ends(rows)
        shape = found.delay.shape
        emitted_at = source.trajectory.position(found.emission_time.ravel()).reshape(*shape, 3)
        wave = 2.0 * np.pi * at.frequencies / self.scene.air.speed_of_sound * found.frequency_ratio[..., None]
        response: Complexes = self._edge_field(
            index, self._view("before", index).places(emitted_at),
            self._view("after", index).places(receiver.trajectory.position(times)), wave, at,
        )  # fmt: skip
        response *= at.air(found) * found.mach_factor[..., None]
        self.reflect(response, index, found, at)
        at.apply_directivities(response, self.ends(rows), found, times)
        return response

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        """Return source, points of reflection and diffraction, and receiver (P, N + 2, 3) of paths of one pair."""
        index = np.arange(len(self))[rows]
        source, receiver = (end.trajectory for end in self.ends(rows))
        now = np.array([time])
        emitted_at = source.position(self.arrivals(index, now, motion).emission_time[:, 0])
        heard_at = np.broadcast_to(receiver.position(now), emitted_at.shape)
        places = self._apexes(index, emitted_at, heard_at)
        return self.vertices_by(index, emitted_at, places, heard_at)

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Return the lengths (P,) of the shortest ways between places (P, 3) and others, m."""
        index = np.arange(len(self))[rows]
        apexes = self._apexes(index, source, receiver)
        ends = (self.image(side, index, x) for side, x in (("before", source), ("after", receiver)))
        legs = sum(np.linalg.norm(end - apex, axis=1) for end, apex in zip(ends, apexes, strict=True))
        return np.asarray(legs + np.linalg.norm(apexes[1] - apexes[0], axis=1))

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F) times the largest field at an edge."""
        return _LOUDEST * at.largest_reflection(self.walls[rows])

    def _isometry(self, side: str, index: NDArray[np.int64]) -> tuple[Floats, Floats]:
        if side == "before":
            return self.before_matrix[index], self.before_offset[index]
        return self.after_matrix[index], self.after_offset[index]

    def _view(self, side: str, index: NDArray[np.int64]) -> EdgeView:
        """View of an endpoint from the edges of paths."""
        return EdgeView.of(*self._isometry(side, index), self.frame[index])

    def _beyond(self, index: NDArray[np.int64]) -> tuple[RolledOut, RolledOut] | None:
        """Return the views from two edges of paths beyond each other, or None for paths over one."""
        return None

    def _apexes(self, index: NDArray[np.int64], source: Floats, receiver: Floats) -> tuple[Floats, Floats]:
        """Points (P, 3), m, where paths between places (P, 3) meet their first edge, and their last."""
        ends = (
            self._view(side, index).places(x[:, None])[..., 0] for side, x in (("before", source), ("after", receiver))
        )
        (r_s, z_s), (r_r, z_r) = ((np.maximum(np.hypot(x, y), ON_LINE), z) for x, y, z in ends)
        end = self.end_place[index]
        place = np.where(np.isnan(end), edge_way(r_s, z_s, r_r, z_r).apex, end)
        apex = np.asarray(self.frame[index, 0] + place[:, None] * self.frame[index, 3])
        return apex, apex

    def _edge_field(
        self, index: NDArray[np.int64], emitted_at: Floats, heard_at: Floats, wave: Floats, at: SceneResponse
    ) -> Any:
        """Return the field (P, T, F) of ends seen at (3, P, T), by wave numbers (P, T, F), without its phase."""
        (r_s, t_s, z_s), (r_r, t_r, z_r) = (
            cylindrical(self.n[index], x, beside)
            for x, beside in zip((emitted_at, heard_at), self.beside[index].T, strict=True)
        )
        way = edge_way(r_s, z_s, r_r, z_r)
        angles = lit_angles(self.n[index][:, None], t_s, t_r)
        factors = partner_factors(self.n[index], self.faces[index], (t_s, t_r), (r_s + r_r) / way.length, at)
        field = self._at_wedge(
            index, angles, (r_s, r_r), way, wave, factors, self._ends_of(index, way, (r_s, z_s), (r_r, z_r))
        )
        return field / way.length[..., None]

    def _at_wedge(
        self, index: NDArray[np.int64], angles: Floats, distances: tuple[Floats, Floats], way: EdgeWay, wave: Floats,
        factors: list[Any], ends: EndsOfEdges,
    ) -> Any:  # fmt: skip
        """Compute the field (P, T, F) of edges and of their ends over that of the shortest ways.

        By the angles (P, T, 4) of the partners, the distances from the edges (P, T), and the faces' factors.
        """
        return utd_field(self.n[index], self.lit[index], angles, distances, way, wave, factors, ends)

    def _ends_of(
        self, index: NDArray[np.int64], way: EdgeWay, source: tuple[Floats, Floats], receiver: tuple[Floats, Floats]
    ) -> EndsOfEdges:
        end = self.end_place[index][:, None]
        # Towards the start or the stop of the edge its inside is on another side of the end.
        inside = np.where(end > 0.0, end - way.apex, way.apex)
        return EndsOfEdges.of(self.end_side[index], way, (source, receiver), end, inside)


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

    @staticmethod
    def of(
        side: NDArray[np.int8], way: EdgeWay, ends: tuple[tuple[Floats, Floats], tuple[Floats, Floats]], end: Floats,
        inside: Floats,
    ) -> EndsOfEdges:  # fmt: skip
        """Make it from r and z of source and receiver (P, T), m.

        `end` (P, 1) are the places of the ends, `inside` (P, T) how far inside the edges the shortest ways meet them.
        """
        signed, root = np.where(inside < 0.0, -1.0, 1.0) * side[:, None], np.zeros(way.length.shape)
        over = np.flatnonzero(side)
        if len(over):
            some = EdgeWay(way.length[over], way.apex[over], way.breadth[over])
            (r_s, z_s), (r_r, z_r) = ((r[over], z[over]) for r, z in ends)
            detour = end_detour(some, (r_s, z_s), (r_r, z_r), np.broadcast_to(end, (len(side), 1))[over])
            root[over] = signed[over] * np.sqrt(detour)
        return EndsOfEdges(side, root)

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
        at_end = end_transition(end, root[over])
        if both.any():  # half of either way round the boundary
            twice = np.exp(1j * (end[both] ** 2 + root[over][both] ** 2))
            at_end[both] -= np.where(end[both] < -AT_CORNER, twice, 0.0)
        found[over] = -1.0 * self.side[ends, None, None] * at_end
        return found


def utd_field(
    n: Floats, lit: NDArray[np.int8], angles: Floats, distances: tuple[Floats, Floats], way: EdgeWay, wave: Floats,
    factors: list[Any], ends: EndsOfEdges,
) -> Any:  # fmt: skip
    """Compute the field (P, T, F) of edges (P,) and of their ends over that of the shortest ways, see `EdgePaths`.

    By the angles (P, T, 4) of the partners, the distances from the edges (P, T), wave numbers (P, T, F) and the faces'
    factors.
    """
    weight, root = wedge_terms(n[:, None], angles, np.sign(lit)[:, None])
    scale, field = np.sqrt(wave * way.breadth[..., None]), np.zeros(wave.shape, dtype=np.complex128)
    for term in range(lit.shape[1]):
        kept = np.flatnonzero(lit[:, term])
        both = ends.transition(kept, lit[kept, term], wave[kept], root[kept, :, term, None] * scale[kept])
        both *= 0.5 * weight[kept, :, term, None]
        field[kept] += both if factors[term] is None else both * factors[term][kept]
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


def partner_factors(
    n: Floats, faces: NDArray[np.int64], angles: tuple[Floats, Floats], slope: Floats, at: SceneResponse
) -> list[Any]:
    """Multiply the reflection factors (P, T, F) of each term's partner; None for terms whose partners have none.

    Shapes: n (P,); faces (P, 2); slope (P, T).

    Our own derivation: on the boundary of a partner the angle from a face of one leg to the edge gives all angles of
    incidence, in steps of nπ; elsewhere both ends share what is left to the boundary.
    """
    (came, went), counts = angles, partner_reflections(n)
    found: list[Any] = []
    for term, half in enumerate((0.5 * (went + came),) * 2 + (0.5 * (came - went),) * 2):
        product, count = None, counts[:, term]
        for bounce in range(count.max(initial=0)):
            turned = (bounce - count // 2) * np.pi * n
            wall = faces[:, ((term >= 2) * term + bounce) % 2]
            factor = face_factor(wall, np.cos(half + turned[:, None]) * slope, at)
            factor[bounce >= count] = 1.0
            product = factor if product is None else product * factor
        found.append(product)
    return found


def face_factors(faces: NDArray[np.int64], cosine: Floats, at: SceneResponse) -> list[Any]:
    """Return the reflection factors (P, T, F) of the 0-face and of the n-face (P, 2).

    The cosine (P, T) is that of the angle of incidence of a reflection where it comes or goes, the same for both ends
    elsewhere.
    """
    return [face_factor(walls, cosine, at) for walls in faces.T]


def face_factor(walls: NDArray[np.int64], cosine: Floats, at: SceneResponse) -> Any:
    """Compute the reflection factors (P, T, F) of walls (P,) at cosines (P, T) of incidence, of any sign."""
    factor: Any = np.broadcast_to(at.reflection(walls[:, None])[:, None], (*cosine.shape, len(at.frequencies))).astype(
        np.complex128
    )
    for wall in np.unique(walls[at.angular[walls]]):
        here = np.flatnonzero(walls == wall)
        factor[here] = at.reflection_at(wall, np.abs(cosine[here]))
    return factor
