"""Edges as vertices: where paths pass them, and the field there; one edge, or two that share a face."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import EVEN, end_detour, lit_angles, path_over_edge, wedge_terms
from clsim.arrays import ByRow, Floats
from clsim.paths.family import DIFFRACTION, Columns, Instant, Links, Pair
from clsim.paths.legs.mirrors import EdgeLines
from clsim.paths.propagation import UniformAir, arrivals_by
from clsim.paths.response import RETARDED, Arrivals, Kinematics, SceneResponse
from clsim.paths.vertices import edge_field
from clsim.paths.vertices.edge_events import Chains, EdgeEvents, EdgeSolver
from clsim.scene.scene import Scene

Triple = tuple[Floats, Floats, Floats]

COLUMNS = ("edge", "over_end", "lit", "end_side", "beside", "corner")
LAWS = {"utd": edge_field.utd_field, "btm": edge_field.exact_field}


@dataclass(frozen=True, slots=True, eq=False)
class EdgeVertex(ByRow):
    """Edges or ends of edges that P paths pass; each row of a path is a segment between two boundaries of its terms.

    Shortly beyond its own interval a row goes on smoothly: what it takes over there is its adjacent path's.
    """

    edge: NDArray[np.int64]  # (P,) which of the lines
    over_end: NDArray[np.int8]  # (P,) 0 for paths over the start of the edge, 1 over its end, -1 over the edge itself
    # (P, 4) 1 for terms whose adjacent path is seen, -1 for those whose is not, 0 for terms that are left out.
    # Over ends of edges, as the end changes sides, and 2 or -2 where both do at once, see `joined_over_ends`.
    lit: NDArray[np.int8]
    # (P,) 1 while the shortest path over the line of the edge meets the edge, -1 while it passes the end; 0 for
    # paths over the edge itself.
    end_side: NDArray[np.int8]
    # (P, 2) -1 where source or receiver goes on beyond the 0-face, 1 where beyond the n-face, 0 where as far
    # beyond both.
    beside: NDArray[np.int8]
    corner: Floats  # (P,) angle at which paths over ends come to the corner itself, see `end_transition`, rad
    lines: EdgeLines  # edges of the room, on moving legs also of bodies
    model: str  # of the field: "utd" or "btm"

    interaction: ClassVar[int] = DIFFRACTION
    costly: ClassVar[bool] = True
    one_by_one: ClassVar[bool] = False  # poses are asked for
    is_complex: ClassVar[bool] = True  # the field has a phase of its own
    varies: ClassVar[bool] = False
    moves: ClassVar[bool] = False
    swiftest: ClassVar[None] = None
    radius: ClassVar[float] = 0.0
    nodes_at_a_time: ClassVar[int] = 8192
    loudest: ClassVar[float] = 3.0  # times an adjacent path: four terms of a half, one continued beyond its boundary

    @property
    def kind(self) -> str:
        """Kind of the vertex, with the law of its field."""
        return "edge" if self.model == "utd" else "exact edge"

    def in_scene(self, scene: Scene) -> Self:
        """Return the same vertices with the bodies of another scene; edges of the room stay where they are."""
        bodies = scene.bodies if self.lines.bodies else ()
        return replace(self, lines=replace(self.lines, bodies=tuple(bodies)))

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        of_kind = (
            (*COLUMNS[:5], "model") if moving else ("frame", "n", "faces", "lit", "end_place", "end_side", "beside")
        )
        for name in (*of_kind, *(["corner"] if np.any(self.corner != EVEN) else [])):
            yield name, getattr(self, name)
        if not moving:
            yield "edge_names", self.lines.names

    @property
    def frame(self) -> Floats:
        """Start of each edge, m, and its vectors `across`, `out` and `along`, (P, 4, 3), see `Edges`."""
        return self.lines.frames[self.edge]

    @property
    def n(self) -> Floats:
        """Exterior angles over π (P,)."""
        return self.lines.n[self.edge]

    @property
    def wedges(self) -> tuple[Floats, Floats]:
        """Exterior angles over π of the first and of the last edge of each path, (P,)."""
        return self.n, self.n

    @property
    def faces(self) -> NDArray[np.int64]:
        """Surfaces (P, 2) that are the 0-face and the n-face."""
        return self.lines.faces[self.edge]

    @property
    def end_place(self) -> Floats:
        """Where along the edge the end is that a path passes, (P,) m; NaN for paths over the edge itself."""
        length = self.lines.length[self.edge]
        return np.where(self.over_end < 0, np.nan, np.where(self.over_end == 0, 0.0, length))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the edges, and of their two ends, edge by edge."""
        names = self.lines.names
        return (*names, *(f"{end} of {name}" for name in names for end in ("start", "end")))

    @property
    def objects(self) -> NDArray[np.int64]:
        """Number of each edge or end among the names, (P,)."""
        return np.where(self.over_end < 0, self.edge, len(self.lines) + 2 * self.edge + self.over_end)

    @property
    def on_device(self) -> bool:
        """Whether a program of nodes knows these edges: all."""
        return True

    def speeds(self, moving: bool) -> Floats:
        """Bounds (P,) of the speeds of the edges, m/s."""
        peak = np.array([*(body.peak_speed for body in self.lines.bodies), 0.0])
        return peak[self.lines.owner[self.edge]]

    def groups(self) -> list[NDArray[np.int64]]:
        """Vertices that are solved together: all."""
        return [np.arange(len(self))]

    def views(self, links: Links) -> tuple[edge_field.EdgeView, edge_field.EdgeView]:
        """Take the views of the endpoints from the first and the last edge of each path."""
        first, last = (edge_field.EdgeView.of(leg.matrix, leg.offset, self.frame) for leg in links.legs)
        return first, last

    def met(self, source: Pair, receiver: Pair) -> tuple[Pair, Floats]:
        """Places on the first and last edges, and lengths, of shortest paths between ends at r and z, (P, T) m each."""
        edge_path = path_over_edge(*source, *receiver)
        return (edge_path.apex, edge_path.apex), edge_path.length

    def on_static_legs(self, links: Links, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve paths between static legs.

        The path over the edge is the shortest one, so the change of the apex does not change its length: rates are
        those of two legs to a place at rest.
        """
        (source, receiver), medium = links.motions, links.medium
        if links.chain.scene.air.layers or medium.fluctuation is not None:
            return arrivals_by(partial(edge_field.LayeredLengths, links), medium, (source, receiver), times, kinematics)
        views = self.views(links)
        found = edge_field.edge_lengths(
            views, self.met, self.end_place, source, receiver.position(times), times, medium, kinematics.retarded
        )
        leaving, back = found.parts
        direction, onwards = views[0].back(leaving), -views[1].back(back)
        sound, receding = found.sound, found.sound.growth(onwards, receiver.velocity(times))
        departure, length = sound.normal(direction), found.length
        if sound.carried is not None:
            length = length * np.sum(departure * direction, axis=-1)
        ratio = 1.0 / (1.0 - found.mach) if kinematics.retarded else np.ones(found.delay.shape)
        rate, factor = (receding - found.mach) * ratio, ratio**kinematics.exponent
        return Arrivals(
            found.delay, rate, departure, -sound.normal(onwards), length, sound.through, None, found.emission_time,
            factor, ratio,
        )  # fmt: skip

    def boundaries(self, links: Links, times: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute how far paths on static legs are inside the lit regions of terms, at times (T,), s.

        result: angles (P, T, 4), see `lit_angles`; detours (P, T, 4) over the edges against partners, m; and detours
        (P, T) over the ends, m.
        """
        found, (source, receiver), views = self.on_static_legs(links, times, RETARDED), links.motions, self.views(links)
        emitted_at = source.position(found.emission_time.ravel()).reshape(*found.delay.shape, 3)
        seen = views[0].places(emitted_at), views[1].places(receiver.position(times))
        (r_s, t_s, z_s), (r_r, t_r, z_r) = map(edge_field.cylindrical, self.wedges, seen, self.beside.T)
        angles = lit_angles(self.n[:, None], t_s, t_r)
        (_, root), edge_path = wedge_terms(self.n[:, None], angles), path_over_edge(r_s, z_s, r_r, z_r)
        places = np.broadcast_to(self.end_place[:, None], edge_path.length.shape)
        end = end_detour(edge_path, (r_s, z_s), (r_r, z_r), places)
        return angles, root**2 * edge_path.breadth[..., None], end

    def on_moving_legs(self, links: Links, medium: UniformAir, times: Floats, kinematics: Kinematics) -> EdgeEvents:
        """Solve paths between moving legs."""
        before, after = links.legs
        chains = Chains(before.surfaces, after.surfaces, self.edge, self.over_end)
        solver = EdgeSolver(before.mirrors, self.lines, links.motions, medium, kinematics.retarded)
        found: EdgeEvents = solver.find(chains, times)
        return found

    def passed(self, events: EdgeEvents, kinematics: Kinematics) -> Columns:
        """Columns of arrivals on moving legs.

        As the edge sees it the field falls with the length L of the path between both images there, and with how much
        later it is there for a second of emission: ``1 / (L dt/dt_e)``, the inverse of the frequency at the edge over
        that emitted. What is left out is of the order of V² / c² of the edge (angles of its faces), and of what it
        turns or speeds up during a period.
        """
        stretch = events.carried / events.doppler if kinematics.retarded else np.ones_like(events.doppler)
        return {
            "length": self._seen_length(events) / events.carried, "mach_factor": stretch**-kinematics.exponent,
            "emitted_at": np.stack(events.source, axis=-1), "receiver_at": np.stack(events.receiver, axis=-1),
            "doppler": events.doppler, "carried": events.carried, "onwards": events.last.delay,
        }  # fmt: skip

    def _seen_length(self, events: EdgeEvents) -> Floats:
        """Lengths (P, T) of paths on moving legs as their edges see them, m."""
        return np.asarray(np.hypot(*events.source[::2]) + np.hypot(*events.receiver[::2]))

    def places(self, links: Links, ends: Pair, times: Floats, kinematics: Kinematics) -> tuple[Floats, ...]:
        """Locate the first and last edge's points (P, 3), m, of paths between endpoints (P, 3) on static legs."""
        return self._apexes(links, ends)

    def lengths(self, links: Links, ends: Pair, images: Pair, times: Instant) -> Floats:
        """Lengths (P,) of the shortest paths between endpoints (P, 3), and their images, on static legs, m."""
        apexes = self._apexes(links, ends)
        legs = sum(np.linalg.norm(end - apex, axis=1) for end, apex in zip(images, apexes, strict=True))
        return np.asarray(legs + np.linalg.norm(apexes[1] - apexes[0], axis=1))

    def moving_lengths(self, links: Links, places: Pair, times: Instant) -> Floats:
        """Lengths (P,) between endpoints (P, 3) on moving legs, with all where it is at times, m."""
        (r_s, z_s), (r_r, z_r) = self._rested(links, places, (self.edge, self.edge), times)
        over = np.where(self.over_end == 1, self.lines.length[self.edge], 0.0)
        place = np.where(self.over_end < 0, path_over_edge(r_s, z_s, r_r, z_r).apex, over)
        return np.asarray(np.hypot(r_s, place - z_s) + np.hypot(r_r, place - z_r))

    def _rested(self, links: Links, places: Pair, edges: tuple[Any, Any], times: Instant) -> tuple[Pair, Pair]:
        """Distances r and places z (P,) about an edge of both endpoints' images, with all where it is at times, m."""
        count = len(self)
        now, none = np.array(np.broadcast_to(times, count)[:, None]), np.zeros((count, 1))
        (before, after), found = links.legs, []
        for place, walls, edge in zip(places, (before.surfaces.T, after.surfaces.T[::-1]), edges, strict=True):
            image = place[:, None]
            for met in walls:
                plane = before.mirrors.planes(met, now, none, None)
                image = image - 2.0 * plane.height(none, image)[..., None] * plane.normal
            away = image[:, 0] - self.lines.placed(edge, none, now)[:, 0]
            along = self.lines.axes(edge, now)[2][:, 0]
            found.append((np.linalg.norm(np.cross(away, along), axis=1), np.sum(away * along, axis=1)))
        return found[0], found[1]

    def respond(self, links: Links, found: Arrivals, times: Floats, passing: Any, at: SceneResponse) -> Any:
        """Responses (P, T, F) by the field at the edge, and by what air and legs let pass, (P, T, F).

        The phases of the transition are those of the frequency that the edge hears: on static legs that at emission,
        multiplied by ``1 / (1 - M)`` as all that a moving source emits.
        """
        wave = 2.0 * np.pi * at.frequencies / links.chain.scene.air.speed_of_sound
        if links.legs[0].moving:
            ends = (np.moveaxis(found.more[name], 2, 0) for name in ("emitted_at", "receiver_at"))
            (r_s, t_s, z_s), (r_r, t_r, z_r) = ends
            t_s, t_r = (_turned(n, side, t) for n, side, t in zip(self.wedges, self.beside.T, (t_s, t_r), strict=True))
            wave = wave * found.more["doppler"][..., None]
            middle = found.more.get("middle", np.zeros((1, 1)))
            response = self._field((r_s, t_s, z_s), (r_r, t_r, z_r), middle, wave, at)
            response *= passing
            response *= (found.mach_factor * found.more["carried"])[..., None]
            return response
        source, receiver = links.motions
        emitted_at = source.position(found.emission_time.ravel()).reshape(*found.delay.shape, 3)
        views, wave = self.views(links), wave * found.frequency_ratio[..., None]
        response = self.static_field(views[0].places(emitted_at), views[1].places(receiver.position(times)), wave, at)
        response *= passing * found.mach_factor[..., None]
        return response

    def static_field(self, emitted_at: Floats, receiver_at: Floats, wave: Floats, at: SceneResponse) -> Any:
        """Field (P, T, F) of endpoints seen at (3, P, T), by wave numbers (P, T, F), without its phase."""
        seen = zip(self.wedges, (emitted_at, receiver_at), self.beside.T, strict=True)
        source, receiver = (edge_field.cylindrical(n, x, side) for n, x, side in seen)
        return self._field(source, receiver, self.end_place[:, None], wave, at)

    def _field(self, source: Triple, receiver: Triple, end: Floats, wave: Floats, at: SceneResponse) -> Any:
        """Field (P, T, F) of endpoints at r, θ, z about the edges, over that at 1 m; their ends are at `end`, m."""
        (r_s, t_s, z_s), (r_r, t_r, z_r) = source, receiver
        edge_path, n = path_over_edge(r_s, z_s, r_r, z_r), self.n
        # Towards the start or the stop of the edge its inside is on another side of the end.
        inside = np.where(self.over_end[:, None] == 1, end - edge_path.apex, edge_path.apex)
        ends = edge_field.EndsOfEdges.of(self.end_side, edge_path, ((r_s, z_s), (r_r, z_r)), end, inside, self.corner)
        factors = edge_field.adjacent_factors(n, self.faces, (t_s, t_r), (r_s + r_r) / edge_path.length, at)
        angles = lit_angles(n[:, None], t_s, t_r)
        field = LAWS[self.model](n, self.lit, angles, (r_s, r_r), edge_path, wave, factors, ends)
        return field / edge_path.length[..., None]

    def largest(self, links: Links, at: SceneResponse) -> float:
        """Bound of the field over a path without edges."""
        return self.loudest

    def _apexes(self, links: Links, ends: Pair) -> Pair:
        place, apex = np.where(np.isnan(self.end_place), self._met_by(links, ends)[0], self.end_place), self.frame
        apex = np.asarray(apex[:, 0] + place[:, None] * apex[:, 3])
        return apex, apex

    def _met_by(self, links: Links, ends: Pair) -> Pair:
        """Places (P,) on the first and last edges, m, of shortest paths between endpoints (P, 3) on static legs."""
        seen = (edge_field.polar(view.places(x[:, None])) for view, x in zip(self.views(links), ends, strict=True))
        first, last = self.met(*seen)[0]
        return first[:, 0], last[:, 0]

    def __len__(self) -> int:
        return len(self.edge)


def _turned(n: Floats, side: NDArray[np.int8], angle: Floats) -> Floats:
    """Angles (P, T) about edges as they go on beyond a face, see `least_angle`."""
    turns = np.floor((angle - edge_field.least_angle(n, side)[:, None]) / (2.0 * np.pi))
    return np.asarray(angle - 2.0 * np.pi * turns)
