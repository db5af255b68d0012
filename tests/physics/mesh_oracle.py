"""Which paths a mesh has, by trying every sequence of planes: float64, nothing shared with clsim's path finding.

A sequence of planes is valid from a source to a receiver if, walking back from the receiver towards the image of the
source, each plane is crossed strictly and inside one of its triangles, and no triangle of another plane stands in
the way of any leg.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SAME_DIRECTION = 1e-9  # 1 - |cos| of two normals
SAME_OFFSET = 1e-6  # m
EDGE = 1e-9  # barycentric: a hit on a triangle's edge counts
END = 1e-9  # of a leg: a triangle that touches its end does not stand in the way
CHUNK = 20_000  # sequences tried at a time
PAIRS = 1_000_000  # legs times triangles tested at a time


class Oracle:
    """Triangles grouped by plane, whether they touch or not.

    Parameters
    ----------
    vertices : (V, 3)
        m.
    triangles : (T, 3)
        Indices; the order of a triangle's corners does not matter.
    """

    def __init__(self, vertices: Array, triangles: Ints) -> None:
        self.corners = np.array(vertices, dtype=np.float64)[np.asarray(triangles)]  # (T, 3 corners, 3)
        self.plane_of, self.normals, self.offsets = _group(self.corners)
        self.planes = len(self.normals)
        self.across, self.from_side = _sides(self.corners)
        self.triangles = [np.flatnonzero(self.plane_of == plane) for plane in range(self.planes)]

    def images(self, sequence: tuple[int, ...], sources: Array) -> Array:
        """Mirror sources (T, 3) in one plane after the other."""
        image = np.array(sources, dtype=np.float64)
        for plane in sequence:
            image = self._mirror(image, np.full(len(image), plane))
        return image

    def valid(self, sequence: tuple[int, ...], sources: Array, receivers: Array) -> Bools:
        """Tell at which of T pairs of positions (T, 3) the sequence is a path."""
        sequences = np.tile(np.array(sequence, dtype=np.int64), (len(sources), 1))
        points, good = self._trace(sequences, np.array(sources, float), np.array(receivers, float))
        good[good] = self._clear(sequences[good], points[good])
        return good

    def paths(self, source: Array, receiver: Array, order: int) -> dict[tuple[int, ...], Array]:
        """Return every path of 0 to `order` reflections: its planes from the source on, its corners (N + 2, 3)."""
        found = {}
        for sequences in (s for n in range(order + 1) for s in self._sequences(n)):
            many = np.ones((len(sequences), 1))
            points, good = self._trace(sequences, many * np.asarray(source, float), many * np.asarray(receiver, float))
            sequences, points = sequences[good], points[good]
            clear = self._clear(sequences, points)
            for key, corners in zip(sequences[clear], points[clear], strict=True):
                found[tuple(key.tolist())] = corners
        return found

    def _sequences(self, length: int) -> Iterator[Ints]:
        """Yield all sequences without a plane twice running, in chunks (S, length)."""
        W = self.planes
        total = W * (W - 1) ** (length - 1) if length else 1
        for first in range(0, total, CHUNK):
            rest = np.arange(first, min(first + CHUNK, total))
            out = np.zeros((len(rest), length), dtype=np.int64)
            for k in range(length - 1, 0, -1):
                rest, out[:, k] = np.divmod(rest, W - 1)
            if length:
                out[:, 0] = rest
            for k in range(1, length):
                out[:, k] += out[:, k] >= out[:, k - 1]  # W - 1 choices: all but the plane before
            yield out

    def _mirror(self, points: Array, plane: Ints) -> Array:
        return points - 2 * self._height(points, plane)[:, None] * self.normals[plane]

    def _height(self, points: Array, plane: Ints) -> Array:
        return np.asarray(np.einsum("nk,nk->n", points, self.normals[plane]) - self.offsets[plane])

    def _trace(self, sequences: Ints, source: Array, receiver: Array) -> tuple[Array, Bools]:
        """Return corners (S, N + 2, 3), and which sequences hit all their planes inside triangles."""
        count, N = sequences.shape
        images = [source]
        for k in range(N):
            images.append(self._mirror(images[-1], sequences[:, k]))
        points = np.full((count, N + 2, 3), np.nan)
        points[:, 0], points[:, N + 1] = source, receiver
        alive = np.arange(count)
        for k in range(N - 1, -1, -1):
            plane, start, end = sequences[alive, k], points[alive, k + 2], images[k + 1][alive]
            a, b = self._height(start, plane), self._height(end, plane)
            crosses = a * b < 0
            alive, plane, start, end = alive[crosses], plane[crosses], start[crosses], end[crosses]
            a, b = a[crosses], b[crosses]
            hit = start + (a / (a - b))[:, None] * (end - start)
            points[alive, k + 1] = hit
            alive = alive[self._covered(hit, plane)]
        good = np.zeros(count, dtype=np.bool_)
        good[alive] = True
        return points, good

    def _covered(self, hits: Array, plane: Ints) -> Bools:
        """Tell which hits (M, 3) on their planes lie in one of the plane's triangles."""
        out = np.zeros(len(hits), dtype=np.bool_)
        for p in np.unique(plane):
            rows = np.flatnonzero(plane == p)
            here = self.triangles[p]
            for some in np.array_split(rows, 1 + len(rows) * len(here) // PAIRS):
                u, v = hits[some] @ self.across[:, here].swapaxes(1, 2) - self.from_side[:, None, here]
                out[some] = np.any((u >= -EDGE) & (v >= -EDGE) & (1 - u - v >= -EDGE), axis=1)
        return out

    def _clear(self, sequences: Ints, points: Array) -> Bools:
        """Tell which paths (S, N + 2, 3) have no triangle across a leg, but for the planes at the leg's ends."""
        clear = np.ones(len(points), dtype=np.bool_)
        N = sequences.shape[1]
        for some in np.array_split(np.arange(len(points)), 1 + len(points) * len(self.corners) // PAIRS):
            for k in range(N + 1):
                blocked = self._crossed(points[some, k], points[some, k + 1])
                if k > 0:
                    blocked &= self.plane_of != sequences[some, k - 1, None]
                if k < N:
                    blocked &= self.plane_of != sequences[some, k, None]
                clear[some] &= ~np.any(blocked, axis=1)
        return clear

    def _crossed(self, start: Array, end: Array) -> Bools:
        """Tell which triangles (M, T) cross legs from start (M, 3) to end (M, 3) strictly between their ends."""
        first = self.corners[:, 0]
        normal = np.cross(self.corners[:, 1] - first, self.corners[:, 2] - first)
        leg = end - start
        with np.errstate(divide="ignore", invalid="ignore"):  # legs parallel to a triangle do not cross it
            t = (np.sum(normal * first, axis=1) - start @ normal.T) / (leg @ normal.T)
        out = (t > END) & (t < 1 - END)
        m, i = np.nonzero(out)
        hit = start[m] + t[m, i, None] * leg[m]
        u, v = np.einsum("nk,snk->sn", hit, self.across[:, i]) - self.from_side[:, i]
        out[m, i] = (u >= -EDGE) & (v >= -EDGE) & (1 - u - v >= -EDGE)
        return np.asarray(out)


def _group(corners: Array) -> tuple[Ints, Array, Array]:
    """Return the plane of each triangle, and the planes' unit normals (W, 3) and offsets (W,), m.

    A triangle belongs to the first plane that its own normal, up to sign, and its own offset agree with.
    """
    plane_of, normals, offsets = [], np.zeros((0, 3)), np.zeros(0)
    for a, b, c in corners:
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if not length > 0:
            raise ValueError("a triangle without area has no plane")
        normal = normal / length
        offset = normal @ (a + b + c) / 3
        cos = normals @ normal
        same = (1 - np.abs(cos) <= SAME_DIRECTION) & (np.abs(np.sign(cos) * offset - offsets) <= SAME_OFFSET)
        if not np.any(same):
            normals, offsets = np.vstack([normals, normal]), np.append(offsets, offset)
            same = np.append(same, True)
        plane_of.append(int(np.argmax(same)))
    return np.array(plane_of), normals, offsets


def _sides(corners: Array) -> tuple[Array, Array]:
    """Return vectors (2, T, 3) and numbers (2, T): their product with a point less these are two barycentric coordinates.

    Those of the first and of the second corner; where both and what is left of 1 are 0 or more, a point in the plane of
    a triangle (T, 3, 3) lies in it.
    """
    a, b, c = (corners[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    across = np.stack([np.cross(normal, c - b), np.cross(normal, a - c)]) / np.sum(normal * normal, axis=1)[:, None]
    return across, np.einsum("stk,stk->st", across, np.stack([b, c]))
