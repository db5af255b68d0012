"""Beams: what can be reached from a ball through a flat aperture, many at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

BEHIND = 1e-9  # of the room's size, how far the space behind an aperture reaches before it
_SHORT = 1e-6  # of the room's size
_EVERYWHERE = np.array([0.0, 0.0, 0.0, -1.0])  # a half-space that holds all points


def beam_planes(
    centre: Floats, radius: float, ring: Floats, corners: NDArray[np.int64], normal: Floats, size: float
) -> Floats:
    """Return half-spaces whose intersection holds all that a ball's rays reach behind an aperture.

    Shapes: centre (n, 3) m; ring (n, m, 3); corners (n,); normal (n, 3).

    ring: corners of convex apertures, counterclockwise about `normal`; those beyond `corners` repeat the last one.

    size: of the room, m; edges too short against it to have a direction give no plane.

    A ray from the ball through the aperture stays, behind it, on the inner side of the plane that holds an edge and
    touches the ball from the inner side. A ball that reaches through the aperture's plane has rays to both sides, and
    one that reaches an edge's line has rays in all directions through it: these give no plane.
    """
    count, sides = ring.shape[:2]
    planes = np.empty((count, sides + 1, 4))
    along = np.roll(ring, -1, axis=1) - ring
    last = np.arange(count), corners - 1
    along[last] = ring[:, 0] - ring[last]
    length = np.linalg.norm(along, axis=2)
    real = (np.arange(sides) < corners[:, None]) & (length > _SHORT * size)
    along /= np.where(real, length, 1.0)[..., None]
    away = centre[:, None] - ring
    away -= np.einsum("nmi,nmi->nm", away, along)[..., None] * along
    distance = np.linalg.norm(away, axis=2)
    real &= distance > radius
    distance = np.where(real, distance, 1.0)
    away /= distance[..., None]
    across = np.cross(along, away)
    inward = np.cross(np.broadcast_to(normal[:, None], along.shape), along)
    across *= np.where(np.einsum("nmi,nmi->nm", across, inward) < 0.0, -1.0, 1.0)[..., None]
    sine = np.where(real, radius / distance, 0.0)[..., None]
    planes[:, :sides, :3] = np.sqrt(1.0 - sine**2) * across - sine * away
    planes[:, :sides, 3] = np.einsum("nmi,nmi->nm", planes[:, :sides, :3], ring)
    planes[:, :sides][~real] = _EVERYWHERE
    height = np.einsum("ni,ni->n", centre - ring[:, 0], normal)
    behind = -np.sign(height)[:, None] * normal
    planes[:, sides, :3] = behind
    planes[:, sides, 3] = np.einsum("ni,ni->n", behind, ring[:, 0]) - BEHIND * size
    planes[np.abs(height) <= radius] = _EVERYWHERE
    return planes


def clip_rings(ring: Floats, corners: NDArray[np.int64], planes: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return convex polygons cut by half-spaces (Sutherland and Hodgman), many at a time.

    Shapes: ring (n, m, 3); corners (n,); planes (n, p, 4); result (n, m', 3), (n,).
    """
    for p in range(planes.shape[1]):
        plane = planes[:, p]
        height = np.einsum("nmi,ni->nm", ring, plane[:, :3]) - plane[:, 3:]
        cut = np.flatnonzero((height < 0.0).any(axis=1))
        if len(cut):
            ring, corners = _cut(ring, corners, height, cut)
    return ring, corners


def _cut(
    ring: Floats, corners: NDArray[np.int64], height: Floats, cut: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int64]]:
    """Cut the polygons `cut` at height 0; keep what lies above."""
    points, high = ring[cut], height[cut]
    following = np.roll(points, -1, axis=1)
    following_high = np.roll(high, -1, axis=1)
    last = np.arange(len(cut)), np.maximum(corners[cut] - 1, 0)
    following[last], following_high[last] = points[:, 0], high[:, 0]
    exists = np.arange(ring.shape[1]) < corners[cut, None]
    stays = exists & (high >= 0.0)
    crosses = exists & ((high >= 0.0) != (following_high >= 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crosses, high / (high - following_high), 0.0)
    between = points + share[..., None] * (following - points)
    emitted = np.stack([stays, crosses], axis=2).reshape(len(cut), -1)
    source = np.stack([points, between], axis=2).reshape(len(cut), -1, 3)
    place = np.cumsum(emitted, axis=1) - 1
    count = place[:, -1] + 1
    width = max(ring.shape[1], int(count.max(initial=0)))
    if width > ring.shape[1]:
        ring = np.concatenate([ring, np.repeat(ring[:, -1:], width - ring.shape[1], axis=1)], axis=1)
    made = np.zeros((len(cut), width, 3))
    row, column = np.nonzero(emitted)
    made[row, place[row, column]] = source[row, column]
    filler = np.arange(width) >= count[:, None]
    tail = made[np.arange(len(cut)), np.maximum(count - 1, 0)]
    made = np.where(filler[..., None], tail[:, None], made)
    ring, corners = ring.copy(), corners.copy()
    ring[cut], corners[cut] = made, count
    return ring, corners
