"""Shadows of bodies on paths that walls reflect: all outlines near a path, as one factor of its pressure.

A path by a shadow is a path by walls again, with what bodies take away from its sound or add to it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.outline import CapsuleOutline, EllipsoidOutline, Outline
from clsim.acoustics.shade import LOUDEST_SHADE, shade
from clsim.acoustics.silhouette import WITHIN
from clsim.arrays import Floats
from clsim.numerics.quaternions import inverse, rotate
from clsim.paths.family import SHADOW, Integers, Links, Rows
from clsim.paths.legs.legs import StaticLeg, static_arrivals
from clsim.paths.response import Arrivals, Kinematics, SceneResponse
from clsim.paths.vertices.scatterer import centre_of
from clsim.scene.scatterer import CapsuleShape, Scatterer
from clsim.scene.scene import Scene

WIDER = 1.05  # zones of bodies that move, which see other lengths by their Mach number, of those of bodies at rest
_ROUNDS = 3  # of finding when sound passes a body, each by the Mach number of the body


@dataclass(frozen=True, slots=True, eq=False)
class ShadeVertex:
    """Shadows on P paths, of N in all: bodies are near S parts between walls, of path p from ``first[p]`` on.

    A part is where the room would be by the walls before it, as an image of the source's own.
    """

    path: NDArray[np.int64]  # (P,) which of the N
    first: NDArray[np.int64]  # (N + 1,)
    matrix: Floats  # (S, 3, 3) of that isometry
    offset: Floats  # (S, 3) likewise, m
    walls: Integers  # (S, N) these walls, -1 for none
    scatterers: tuple[Scatterer, ...]  # of the scene
    silent_ends: bool  # whether no path begins or ends, but where no body is near it

    kind: ClassVar[str] = "shade"
    interaction: ClassVar[int] = SHADOW
    names: ClassVar[tuple[str, ...]] = ()
    radius: ClassVar[float] = 0.0
    swiftest: ClassVar[None] = None
    costly: ClassVar[bool] = False
    is_complex: ClassVar[bool] = True
    varies: ClassVar[bool] = True
    one_by_one: ClassVar[bool] = True
    approximate: ClassVar[bool] = True
    outlined: ClassVar[bool] = True
    on_device: ClassVar[bool] = True

    def part(self, rows: Rows) -> ShadeVertex:
        """Return the shadows on some of the paths."""
        return replace(self, path=self.path[rows])

    def in_scene(self, scene: Scene) -> Self:
        """Return the same shadows with scatterers and walls of another scene."""
        leg = StaticLeg(self.matrix, self.offset).in_scene(scene, self.walls)
        return replace(self, offset=leg.offset, scatterers=tuple(scene.scatterers))

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        for name in ("path", "first", "matrix", "offset"):
            yield name, getattr(self, name)

    @property
    def moves(self) -> bool:
        """Whether any body moves or turns."""
        return not all(scatterer.is_static for scatterer in self.casting)

    @property
    def casting(self) -> list[Scatterer]:
        """The scatterers with outlines."""
        return [scatterer for scatterer in self.scatterers if scatterer.shape.outlined]

    def speeds(self, moving: bool) -> Floats:
        """Bounds (P,) of the speeds by which delays change: none, m/s."""
        return np.zeros(len(self))

    def on_static_legs(self, links: Links, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve the paths, which are those by walls."""
        return static_arrivals(links, times, kinematics)

    def respond(self, links: Links, found: Arrivals, times: Floats, passing: Any, at: SceneResponse) -> Any:
        """Responses (P, T, F) by what shadows add, and by what air and walls let pass, (P, T, F)."""
        wave, centre = 2.0 * np.pi * at.frequencies / links.chain.scene.air.speed_of_sound, centre_of(links)
        passed = np.ones((*found.delay.shape, len(wave)), dtype=np.complex128)
        for mine, ends, travel in self._parts_of(links, found, times):
            factor = passed[mine].reshape(-1, len(wave))
            _shade(self.casting, (wave, centre), ends, travel, factor)
            passed[mine] = factor.reshape(len(mine), -1, len(wave))
        return passing * (found.mach_factor / found.length)[..., None] * (passed - 1.0)

    def _parts_of(self, links: Links, found: Arrivals, times: Floats) -> Iterator[tuple[Any, Any, Any]]:
        """Yield paths, both ends (n, 3) of one part of each, m, and their `travel`, see `_near`: part after part."""
        leg, (source, receiver), sent = links.legs[0], links.motions, found.emission_time
        begin = source.position(sent.ravel()).reshape(*sent.shape, 3)
        received = np.broadcast_to(times, sent.shape)
        end = leg.turned_back(receiver.position(received.ravel()).reshape(begin.shape) - leg.offset[:, None])
        first, count = self.first[self.path], np.diff(self.first)[self.path]
        for number in range(int(count.max(initial=0))):
            mine = np.flatnonzero(count > number)
            part = first[mine] + number
            ends = [
                (x[mine] @ self.matrix[part].swapaxes(1, 2) + self.offset[part][:, None]).reshape(-1, 3)
                for x in (begin, end)
            ]
            yield mine, ends, tuple(x[mine].ravel() for x in (sent, received, found.frequency_ratio))

    def largest(self, links: Links, at: SceneResponse) -> float:
        """Bound of what shadows add to pressure: two bodies behind each other on the axis are the loudest."""
        return 1.0 + LOUDEST_SHADE**2

    def __len__(self) -> int:
        return len(self.path)


def _shade(
    casting: list[Scatterer], waves: tuple[Floats, float], ends: tuple[Floats, Floats], travel: tuple[Floats, ...],
    passed: Any,
) -> None:  # fmt: skip
    """Multiply pressures (n, F) of sound between ends (n, 3), m, see `_near`, by the shades of bodies.

    Shades of capsules are found together, and so are those of ellipsoids.
    """
    for kind in {type(scatterer.shape): None for scatterer in casting}:
        some = [scatterer for scatterer in casting if isinstance(scatterer.shape, kind)]
        near = [_near(scatterer, waves[1], ends, travel) for scatterer in some]
        counts = np.array([len(rows) for rows, *_ in near], dtype=np.int64)
        if not counts.sum():
            continue
        begin, end, scale = (np.concatenate([seen[which] for seen in near]) for which in (1, 2, 3))
        factors = np.split(shade(_outlines(some, counts, scale), *waves, begin, end), np.cumsum(counts)[:-1])
        for (rows, *_), factor in zip(near, factors, strict=True):
            passed[rows] *= factor


def _outlines(scatterers: list[Scatterer], counts: NDArray[np.int64], scale: Floats) -> Outline:
    """Outlines of bodies of one kind, each as often as lines of sight pass it, and so many times its size."""
    sizes = np.array([scatterer.shape.semi_axes for scatterer in scatterers]).repeat(counts, axis=0) * scale[:, None]
    if isinstance(scatterers[0].shape, CapsuleShape):
        return CapsuleOutline(sizes[:, 0], sizes[:, 2] - sizes[:, 0])
    return EllipsoidOutline(sizes)


def _near(
    scatterer: Scatterer, centre: float, ends: tuple[Floats, Floats], travel: tuple[Floats, ...]
) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
    """Rows of sound that passes near one body, both ends (rows, 3) as that sees them, m, and what scales lengths.

    travel: when sound is sent and received (n,), s, and its frequency over that emitted (n,). It goes straight, and
    evenly: it is at a share of its way at that share of its time. A body that moves evenly meets, to the first order of
    its Mach number, the sound of still air between where both ends are relative to it when sound is there (K. Taylor,
    J. Sound Vib. 62 (1979), 409), at the frequency that it hears: instead of wave numbers, all lengths are scaled.
    """
    begin, along, (sent, received, ratio) = ends[0], ends[1] - ends[0], travel
    size = np.maximum(np.sum(along**2, axis=1), 1e-30)
    share, shape = np.full(len(begin), 0.5), scatterer.shape
    for _ in range(_ROUNDS):
        now = sent + share * (received - sent)
        away = scatterer.trajectory.position(now) - begin
        share = np.clip(np.sum(away * along, axis=1) / size, 0.0, 1.0)
    zone = WIDER * 2.0 * WITHIN * np.sqrt(0.5 * math.pi * np.sqrt(size) / centre)  # the widest, in the middle
    near = np.flatnonzero(np.linalg.norm(away - share[:, None] * along, axis=1) < shape.radius + zone)
    velocity, flight = scatterer.trajectory.velocity(now[near]), (received - sent)[near]
    scale = ratio[near] * (1.0 - np.sum(velocity * along[near], axis=1) * flight / size[near])
    before, after = ((velocity * span[near, None]) for span in (now - sent, received - now))
    seen = [before - away[near], (along - away)[near] - after]
    if scatterer.trajectory.has_orientation and len(near):
        back = inverse(scatterer.trajectory.orientation(now[near]))
        seen = [rotate(back, x) for x in seen]
    return near, scale[:, None] * seen[0], scale[:, None] * seen[1], scale
