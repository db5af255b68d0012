"""Legs of paths, and vertices between them: what a kind of leg and a kind of vertex must provide.

A *leg* is a part of a path between two vertices or endpoints, reflected by any number of surfaces. A *vertex* is a
point at which a path changes direction otherwise: an edge, two edges, a scatterer. The paths of one kind of
leg and one kind of vertex are a `Chain`: specular paths are one static leg, edge paths a static leg, an edge and a
static leg, paths by a scatterer behind a body a moving leg, a scatterer and a moving leg.

Whatever tables, engines and searches ask of a path is asked of `Chain`, once. What depends on the kind of leg is a
method of `Links`: they solve the delay equation, the last leg first. A leg names its class as `links`. What depends on
the kind of vertex is a method of `Vertex`: where sound passes it (Fermat's principle), and what it makes of the sound.
A new kind of vertex is a class with the members of `Vertex`, a search that finds its paths, and its names in
``chain.py``.

Columns of legs and vertices have one row per path. A vertex with shadow boundaries (an edge) holds for each row the
side of each boundary on which the row is; its field goes on smoothly beyond the row's ends, so that the terms of both
sides cancel there.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.paths.family import BODY, NONE, SPECULAR, Instant, Rows
from clsim.paths.propagation import Medium, UniformAir
from clsim.paths.response import Arrivals, Kinematics, SceneResponse
from clsim.scene.scene import Scene

Integers = NDArray[np.signedinteger[Any]]
Columns = dict[str, Floats]
Pair = tuple[Floats, Floats]  # of source and receiver


class Vertex(Protocol):
    """Columns of P vertices of one kind.

    Attributes
    ----------
    kind : str
        Word for it.
    interaction : int
        Number of the kind, see `PathFamily`.
    names : tuple of str
        Objects that can be vertices.
    objects : ndarray (P,), (P, 2) or (P, 3)
        Number of each vertex, or of all edges of each, among the names.
    moves : bool
        Whether any vertex moves.
    radius : ndarray (P,) or float
        Half of the length by which paths may be shorter than `lengths`, m.
    swiftest : float or None
        Bound of the speed of any vertex, m/s; None for vertices of the room.
    nodes_at_a_time : int
        Number of nodes that are solved together.
    is_complex, varies, costly, one_by_one : bool
        Whether responses have phases; whether they change so much that a few instants do not tell of all; whether they
        are taken at few instants where they change slowly; whether each path may have an instant of its own.
    """

    def part(self, rows: Rows) -> Self:
        """Take some of the vertices."""

    def in_scene(self, scene: Scene) -> Self:
        """Make the same vertices in a scene that differs a little."""

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns on moving or static legs, as they are hashed."""

    def groups(self) -> list[NDArray[np.int64]]:
        """List vertices that can be solved together."""

    @property
    def on_device(self) -> bool:
        """Whether a program of nodes knows these vertices, if it knows their kind in the medium."""

    def speeds(self, moving: bool) -> Floats:
        """Bound the speeds of the vertices on moving or static legs, (P,) m/s."""

    def on_static_legs(self, links: Links, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve paths between static legs at times of reception (T,), s."""

    def on_moving_legs(self, links: Links, medium: UniformAir, times: Floats, kinematics: Kinematics) -> Any:
        """Solve paths between moving legs; the result has the `Events` of both legs as `first` and `last`."""

    def passed(self, events: Any, kinematics: Kinematics) -> Columns:
        """Compute ``length``, ``mach_factor`` and what else `respond` needs from what `on_moving_legs` found."""

    def places(self, links: Links, ends: Pair, times: Floats, kinematics: Kinematics) -> tuple[Floats, ...]:
        """Locate the first to last points (P, 3) of vertices between static legs, m; one point counts as both."""

    def respond(self, links: Links, found: Arrivals, times: Floats, passing: Any, at: SceneResponse) -> Any:
        """Compute responses (P, T, F) with the vertex's field, spreading, and what air and legs let pass (P, T, F)."""

    def largest(self, links: Links, at: SceneResponse) -> Floats | float:
        """Bound responses over those of the legs in free air of the same length, (P, F)."""

    def lengths(self, links: Links, ends: Pair, images: Pair, times: Instant) -> Floats:
        """Compute lengths (P,) between endpoints (P, 3), and their images, on static legs, m."""

    def moving_lengths(self, links: Links, ends: Pair, times: Instant) -> Floats:
        """Compute lengths (P,) between endpoints (P, 3) on moving legs, m."""

    def __len__(self) -> int: ...


@dataclass(frozen=True, slots=True, eq=False)
class Links(ABC):
    """Legs and vertices of some paths of a chain; a class for each kind of leg."""

    chain: Any  # `Chain` of which these are
    rows: Rows  # (P,) which
    legs: tuple[Any, ...]  # of these paths alone
    vertex: Any  # likewise
    ends: tuple[Any, ...]  # source and receiver of the first path; none without paths
    motions: tuple[Any, ...]  # their trajectories

    @abstractmethod
    def solve(self, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve the delay equation of paths at times of reception (T,), s."""

    @abstractmethod
    def places(self, time: float, kinematics: Kinematics) -> Floats:
        """Locate source, interactions and receiver (P, N + 2, 3) of what is received at a time (s), m."""

    @abstractmethod
    def lengths(self, source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Compute lengths (P,) between endpoints (P, 3), m, with all else where it is at times (P,) or one time, s."""

    @property
    @abstractmethod
    def surfaces(self) -> tuple[Integers, ...]:
        """Surfaces (P, N) of each leg: of static ones from the endpoint's side, of moving ones from the source's."""

    @property
    @abstractmethod
    def all_surfaces(self) -> Integers:
        """Surfaces (P, N) of all legs, -1 for none."""

    def part(self, rows: NDArray[np.int64]) -> Links:
        """Return the links of some of the paths, by their places among these."""
        some: Links = self.chain.links(np.arange(len(self.chain))[self.rows][rows])
        return some

    @property
    def medium(self) -> Medium:
        """Medium of the sound."""
        medium: Medium = self.chain.medium(int(self.chain.source[self.rows][0]))
        return medium

    def __len__(self) -> int:
        return len(self.legs[0])


def in_chunks(
    links: Links, times: Floats, nodes: int, solve: Callable[[Links, Floats], Columns],
    groups: list[NDArray[np.int64]] | None = None,
) -> Arrivals:  # fmt: skip
    """Solve paths at times (T,), so many nodes at a time that what is worked on stays in the cache."""
    if groups is None:
        groups = [np.arange(len(links))] if links.vertex is None else links.vertex.groups()
    columns: Columns = {}
    for mine in groups:
        some = links if len(mine) == len(links) else links.part(mine)
        parts = max(-(-len(times) * len(mine) // nodes), 1)
        for part in range(parts):
            here = slice(part * len(times) // parts, (part + 1) * len(times) // parts)
            for name, values in solve(some, times[here]).items():
                if name not in columns:
                    columns[name] = np.empty((len(links), len(times), *values.shape[2:]))
                columns[name][mine, here] = values
    always = {field.name: columns.pop(field.name) for field in fields(Arrivals) if field.name in columns}
    return Arrivals(**always, means=None, more=columns)


def met_in_order(
    counts: tuple[int, int], before: Integers, vertex: tuple[int, Integers] | None, after: Integers | None,
    between: Integers | None = None,
) -> tuple[Integers, Integers]:  # fmt: skip
    """Make interactions and objects (P, N) of paths from their surfaces and vertices, and counts of walls and faces."""
    walls, faces = counts
    things, at_vertex = before, NONE if vertex is None else vertex[0]
    if vertex is not None and after is not None:
        own = faces + np.atleast_2d(vertex[1].T).T
        inner = own[:, :0] if between is None else between  # mirrors between two vertices
        things = np.concatenate([before, own[:, :1], inner, own[:, 1:], after], axis=1)
    things = np.take_along_axis(things, np.argsort(things < 0, axis=1, kind="stable"), axis=1)
    kinds = np.select([things < 0, things < walls, things < faces], [NONE, SPECULAR, BODY], at_vertex)
    return kinds.astype(np.int8), np.where(things >= walls, things - walls, things)
