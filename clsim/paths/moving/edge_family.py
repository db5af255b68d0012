"""Paths over one edge of a body among any mirrors, and those over one edge of the room among mirrors that move."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from clsim.acoustics.diffraction import edge_way, lit_angles
from clsim.arrays import read_only
from clsim.paths.arrivals import MACH_EXPONENT, Arrivals
from clsim.paths.diffraction.exact import exact_field
from clsim.paths.diffraction.family import EndsOfEdges, least_angle, partner_factors, utd_field
from clsim.paths.family import BODY, DIFFRACTION, NONE, SPECULAR
from clsim.paths.moving.edge_events import Chains, EdgeSolver
from clsim.paths.moving.edge_lines import EdgeLines
from clsim.paths.moving.mirrors import ROOM
from clsim.paths.moving.moving_paths import MovingPaths
from clsim.paths.propagation import UniformAir

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.family import Instant, Rows
    from clsim.paths.moving.edge_events import EdgeEvents
    from clsim.paths.response import SceneResponse

_AT_A_TIME = 8192  # nodes that are looked at together: what is worked on stays in the cache
_LOUDEST = 3.0  # over the partners, as of `EdgePaths`


@dataclass(frozen=True, slots=True, eq=False)
class EdgeArrivals(Arrivals):
    """What paths over edges bring, with what their responses need.

    Attributes
    ----------
    emitted_at, heard_at : ndarray (P, T, 3)
        r, θ and z of the images of both ends as the edge sees them, from where sound is diffracted.
    """

    cosine: Floats  # (P, T, N) of the angle of incidence at each mirror, those before the edge first
    emitted_at: Floats
    heard_at: Floats
    doppler: Floats  # (P, T) see `EdgeEvents`
    carried: Floats  # likewise


@dataclass(frozen=True, eq=False)
class MovingEdgePaths(MovingPaths):
    """Paths over one edge, or one of its ends, of which the edge or a mirror belongs to a body.

    Each row is a piece between two boundaries of its terms, as of `EdgePaths`, and goes on smoothly beyond its ends.

    Attributes
    ----------
    before, after : ndarray (paths, N) int
        Mirrors before the edge and after it, both from the source's side, filled up with -1; see `Mirrors`.
    lit : ndarray (paths, 4) int8
        1 for terms whose partner is seen, -1 for those whose partner is not, 0 for terms that are left out.
    end_side : ndarray (paths,) int8
        1 while the shortest way over the line of the edge meets the edge, -1 while it passes the end that the path
        runs over, 0 for paths over the edge itself.
    beside : ndarray (paths, 2) int8
        -1 where source or receiver is on the side of the 0-face, 1 where on that of the n-face: angles beyond go
        on.
    """

    interactions: NDArray[np.signedinteger[Any]] = field(init=False, repr=False)
    objects: NDArray[np.signedinteger[Any]] = field(init=False, repr=False)
    before: NDArray[np.int32]
    after: NDArray[np.int32]
    edge: NDArray[np.int64]  # (paths,) which, of `EdgeLines`
    over_end: NDArray[np.int8]  # (paths,) 0 for paths over its start, 1 over its stop, -1 over the edge itself
    lit: NDArray[np.int8]
    end_side: NDArray[np.int8]
    beside: NDArray[np.int8]
    model: str  # of the field at an edge

    columns: ClassVar[tuple[str, ...]] = ("before", "after", "edge", "over_end", "lit", "end_side", "beside")
    costly: ClassVar[bool] = True

    def __post_init__(self) -> None:
        walls, faces = len(self.scene.room.faces), len(self.mirrors.normal)
        of_end = faces + len(self.lines) + 2 * self.edge + self.over_end
        met = np.where(self.over_end < 0, faces + self.edge, of_end)[:, None]
        things = np.concatenate([self.before, met, self.after], axis=1).astype(np.int32)
        things = np.take_along_axis(things, np.argsort(things < 0, axis=1, kind="stable"), axis=1)
        kinds = np.select([things < 0, things < walls, things < faces], [NONE, SPECULAR, BODY], DIFFRACTION)
        object.__setattr__(self, "interactions", read_only(kinds.astype(np.int8)))
        object.__setattr__(self, "objects", read_only(np.where(things >= walls, things - walls, things)))
        super().__post_init__()

    @cached_property
    def lines(self) -> EdgeLines:
        """Edges of the room and of bodies."""
        return EdgeLines.of(self.scene)

    @property
    def is_complex(self) -> bool:
        """True: the field at an edge has a phase of its own."""
        return True

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the faces of bodies, of the edges, and of the two ends of these, edge by edge."""
        faces, edges = (name for body in self.scene.bodies for name in body.faces), self.lines.names
        return (*faces, *edges, *(f"{end} of {name}" for name in edges for end in ("start", "end")))

    def _chains(self, index: NDArray[np.int64]) -> Chains:
        return Chains(self.before[index], self.after[index], self.edge[index], self.over_end[index])

    def events(self, rows: Rows, times: Floats, motion: str = "retarded") -> EdgeEvents:
        """Events of diffraction and reflection of paths between one source and one receiver.

        Shapes: rows (P,); times (T,) s.
        """
        index = np.arange(len(self))[rows]
        source, receiver = self.ends(index)
        medium = self.medium(int(self.source[index[0]]))
        assert isinstance(medium, UniformAir)
        ends = source.trajectory, receiver.trajectory
        solver = EdgeSolver(self.mirrors, self.lines, ends, medium, motion == "retarded")
        return solver.find(self._chains(index), times)

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver.

        As the edge sees it the field falls with the length L of the way between both images there, and with how much
        later it is there for a second of emission: ``1 / (L dt/dt_e)``, the inverse of the frequency at the edge over
        that emitted. What is left out is of the order of V² / c² of the edge (angles of its faces), and of what it
        turns or speeds up during a period.
        """
        times, index = np.asarray(times, dtype=np.float64), np.arange(len(self))[rows]
        parts = -(-len(times) * len(index) // _AT_A_TIME)
        found = [self._arrivals(index, some, motion, amplitude) for some in np.array_split(times, max(parts, 1))]
        names = [f.name for f in fields(EdgeArrivals) if f.name != "means"]
        columns: dict[str, Any] = {name: np.concatenate([each[name] for each in found], axis=1) for name in names}
        return EdgeArrivals(**columns, means=None)

    def _arrivals(self, index: NDArray[np.int64], times: Floats, motion: str, amplitude: str) -> dict[str, Floats]:
        events, retarded = self.events(index, times, motion), motion == "retarded"
        first, last = events.first, events.last
        delay, together = first.delay + last.delay, first.rate + last.rate
        mach = first.mach if retarded else np.zeros_like(first.mach)
        stretch = events.carried / events.doppler if retarded else np.ones_like(delay)
        length = np.hypot(*events.source[::2]) + np.hypot(*events.receiver[::2])
        return {
            "delay": delay, "delay_rate": together - first.rate * last.rate if retarded else together,
            "departure": first.departure, "arrival": last.arrival,
            "length": length / events.carried, "through": first.distance + last.distance,
            "emission_time": times - delay if retarded else np.broadcast_to(times, delay.shape),
            "mach_factor": stretch ** -MACH_EXPONENT[amplitude], "frequency_ratio": 1.0 / (1.0 - mach),
            "cosine": np.concatenate([first.cosine, last.cosine], axis=2),
            "emitted_at": np.stack(events.source, axis=-1), "heard_at": np.stack(events.receiver, axis=-1),
            "doppler": events.doppler, "carried": events.carried,
        }  # fmt: skip

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): the field at the edge, air, mirrors, directivities.

        The phases of the transition are those of the frequency that the edge hears.
        """
        index, here = np.arange(len(self))[rows], cast("EdgeArrivals", found)
        wave = 2.0 * np.pi * at.frequencies / self.scene.air.speed_of_sound * here.doppler[..., None]
        response: Any = self._edge_field(index, here, wave, at)
        surfaces = np.concatenate([self.before[index], self.after[index]], axis=1)
        response *= at.air(found) * at.reflection(surfaces)[:, None, :]
        response *= (found.mach_factor * here.carried)[..., None]
        for bounce, met in enumerate(surfaces.T):
            for wall in np.unique(met[at.angular[met]]).tolist():
                rows_here = np.flatnonzero(met == wall)
                response[rows_here] *= at.reflection_at(wall, here.cosine[rows_here, :, bounce])
        at.apply_directivities(response, self.ends(rows), found, times)
        return cast("Complexes", response)

    def _edge_field(self, index: NDArray[np.int64], found: EdgeArrivals, wave: Floats, at: SceneResponse) -> Any:
        """Return the field (P, T, F) by wave numbers (P, T, F), over that at 1 m and without its phase."""
        edge, lit = self.edge[index], self.lit[index]
        (r_s, t_s, z_s), (r_r, t_r, z_r) = (np.moveaxis(x, 2, 0) for x in (found.emitted_at, found.heard_at))
        way, n = edge_way(r_s, z_s, r_r, z_r), self.lines.n[edge]
        t_s, t_r = (_beside(n, side, t) for side, t in zip(self.beside[index].T, (t_s, t_r), strict=True))
        factors = partner_factors(n, self.lines.faces[edge], (t_s, t_r), (r_s + r_r) / way.length, at)
        law = exact_field if self.model == "btm" else utd_field
        over_end = self.over_end[index]  # places are counted from the end
        inside = np.where(over_end[:, None] == 1, -way.apex, way.apex)
        ends = EndsOfEdges.of(self.end_side[index], way, ((r_s, z_s), (r_r, z_r)), np.zeros((1, 1)), inside)
        field = law(n, lit, lit_angles(n[:, None], t_s, t_r), (r_s, r_r), way, wave, factors, ends)
        return field / way.length[..., None]

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        """Return source, points of interaction and receiver (P, N + 2, 3) of paths of one pair."""
        index = np.arange(len(self))[rows]
        events = self.events(index, np.array([time]), motion)
        found = np.full((len(index), self.objects.shape[1] + 2, 3), np.nan)
        counts = np.sum(self.before[index] >= 0, axis=1), np.sum(self.after[index] >= 0, axis=1)
        for p, (n, m) in enumerate(zip(*counts, strict=True)):
            found[p, : n + 2] = events.first.place[p, 0, : n + 2]
            found[p, n + 2 : n + m + 3] = events.last.place[p, 0, 1 : m + 2]
        return found

    def _lengths(self, index: NDArray[np.int64], source: Floats, receiver: Floats, times: Instant) -> Floats:
        now, none = np.array(np.broadcast_to(times, index.shape)[:, None]), np.zeros((len(index), 1))
        edge, end = self.edge[index], self.over_end[index]
        ends = []
        for place, walls in ((source, self.before[index].T), (receiver, self.after[index].T[::-1])):
            image = place[:, None]
            for met in walls:
                plane = self.mirrors.planes(met, now, none, None)
                image = image - 2.0 * plane.height(none, image)[..., None] * plane.normal
            ends.append(image[:, 0] - self.lines.placed(edge, none, now)[:, 0])
        along = self.lines.axes(edge, now)[2][:, 0]
        (r_s, z_s), (r_r, z_r) = ((np.linalg.norm(np.cross(x, along), axis=1), np.sum(x * along, axis=1)) for x in ends)
        over = np.where(end == 1, self.lines.length[edge], 0.0)
        place = np.where(end < 0, edge_way(r_s, z_s, r_r, z_r).apex, over)
        return np.asarray(np.hypot(r_s, place - z_s) + np.hypot(r_r, place - z_r))

    @cached_property
    def speeds(self) -> Floats:
        """Sums (paths,) of the bounds of the speeds of the bodies on each path's way, m/s."""
        peak = np.array([*(body.peak_speed for body in self.scene.bodies), 0.0])
        owner = np.append(self.mirrors.owner, ROOM)[np.concatenate([self.before, self.after], axis=1)]
        return read_only(peak[owner].sum(axis=1) + peak[self.lines.owner[self.edge]])

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F) times the largest field at an edge."""
        return _LOUDEST * at.largest_reflection(np.concatenate([self.before[rows], self.after[rows]], axis=1))


def _beside(n: Floats, side: NDArray[np.int8], angle: Floats) -> Floats:
    """Return angles (P, T) about edges as they go on beyond a face, see `least_angle`."""
    turns = np.floor((angle - least_angle(n, side)[:, None]) / (2.0 * np.pi))
    return np.asarray(angle - 2.0 * np.pi * turns)
