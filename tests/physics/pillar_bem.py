"""The field about hard pillars and walls in two dimensions, by collocation on their outline: values for tests of edges.

Run as a program it prints the values that are stored in `PILLAR` and `WALLS`.
"""

from typing import Any

import numpy as np
from scipy.special import hankel2

C = 343.0
SIDE = 0.2  # m
HEIGHT = 0.3  # m, of walls between two free ends
SOURCE = (-2.0, 0.03)  # m, from the pillar's centre
RECEIVERS = [(1.5, y) for y in (-0.13, -0.06, 0.0, 0.05, 0.08, 0.095, 0.11, 0.13)]  # all out of sight
# Total over free field at the receivers, 40 kHz.
PILLAR = np.array(
    [
        (0.1677 - 0.279j), (-0.1215 - 0.0371j), (0.0363 + 0.0878j), (-0.1877 - 0.1153j), (0.1424 - 0.2348j),
        (0.2036 - 0.2983j), (0.2197 - 0.2375j), (0.368 - 0.0617j),
    ]
)  # fmt: skip

WALLS = {  # by thickness, m
    0.002: np.array(
        [
            (-0.0552 + 0.0645j),
            (0.0713 - 0.1672j),
            (-0.0047 - 0.0222j),
            (0.0502 + 0.1152j),
            (-0.0037 + 0.1038j),
            (-0.176 + 0.0084j),
            (-0.2366 + 0.0024j),
            (-0.0745 - 0.1255j),
        ]
    ),
    0.005: np.array(
        [
            (-0.056 + 0.0632j),
            (0.068 - 0.1684j),
            (-0.0042 - 0.0221j),
            (0.0536 + 0.1155j),
            (-0.0031 + 0.1016j),
            (-0.1771 + 0.0107j),
            (-0.2348 + 0.0056j),
            (-0.0749 - 0.128j),
        ]
    ),
    0.01: np.array(
        [
            (-0.0578 + 0.0623j),
            (0.0642 - 0.1691j),
            (-0.0044 - 0.0226j),
            (0.0562 + 0.1154j),
            (-0.0039 + 0.0994j),
            (-0.1784 + 0.0134j),
            (-0.2321 + 0.0087j),
            (-0.0745 - 0.1307j),
        ]
    ),
    0.02: np.array(
        [
            (-0.0612 + 0.0614j),
            (0.0563 - 0.1712j),
            (-0.005 - 0.0235j),
            (0.0617 + 0.1153j),
            (-0.0055 + 0.0958j),
            (-0.1814 + 0.0195j),
            (-0.2273 + 0.0154j),
            (-0.0749 - 0.136j),
        ]
    ),
}


def outline(polygon: Any, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Gauss points (N, G, 2), weights (N, G) and outward normals (N, 2) of elements, short near the corners.

    The corners of the polygon go round it counterclockwise.
    """
    x, w = np.polynomial.legendre.leggauss(4)
    points, weights, normals = [], [], []
    for start, stop in zip(np.array(polygon), np.roll(polygon, -1, axis=0), strict=True):
        side = np.linalg.norm(stop - start)
        along = (stop - start) / side
        count = max(int(np.ceil(side / step)) | 1, 9)
        share = np.linspace(0.0, 1.0, count + 1)
        ends = side * (share - np.sin(2.0 * np.pi * share) / (2.5 * np.pi))
        middle, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
        points.append(start + (middle[:, None] + half[:, None] * x)[..., None] * along)
        weights.append(half[:, None] * w)
        normals.append(np.tile([along[1], -along[0]], (count, 1)))
    return np.concatenate(points), np.concatenate(weights), np.concatenate(normals)


def dipoles(x: np.ndarray, points: np.ndarray, weights: np.ndarray, normals: np.ndarray, k: float) -> np.ndarray:
    """Return the field (M, N) at places (M, 2) of elements (N,) as dipoles across the outline."""
    out = np.empty((len(x), len(points)), dtype=complex)
    for i, place in enumerate(x):
        away = points - place
        r = np.maximum(np.linalg.norm(away, axis=2), 1e-12)
        cosine = np.einsum("ngi,ni->ng", away, normals) / r
        out[i] = np.sum(weights * 0.25j * k * hankel2(1, k * r) * cosine, axis=1)
    return out


def field_behind(
    size: tuple[float, float], frequency: float, elements: float = 9.0, at: list[tuple[float, float]] = RECEIVERS
) -> np.ndarray:
    """Total over the free field at places behind a rectangle, with so many elements in a wavelength."""
    x, y = 0.5 * size[0], 0.5 * size[1]
    return field_about([[(-x, -y), (x, -y), (x, y), (-x, y)]], SOURCE, at, frequency, elements)


def field_about(
    polygons: list[list[tuple[float, float]]], source: tuple[float, float], at: list[tuple[float, float]],
    frequency: float, elements: float = 9.0,
) -> np.ndarray:  # fmt: skip
    """Total over the free field at places about convex polygons, with so many elements in a wavelength."""
    k, rng = 2.0 * np.pi * frequency / C, np.random.default_rng(1)
    parts = zip(*(outline(polygon, C / frequency / elements) for polygon in polygons), strict=True)
    points, weights, normals = (np.concatenate(part) for part in parts)
    middles = np.einsum("ngi,ng->ni", points, weights) / weights.sum(axis=1)[:, None]
    # Places within, where there is nothing, tell resonances of the inside apart.
    shares = rng.dirichlet(np.ones(len(polygons[0])), 40)
    inside = np.concatenate([0.9 * shares @ p + 0.1 * np.mean(p, axis=0) for p in map(np.array, polygons)])

    def free(x: np.ndarray) -> np.ndarray:
        return -0.25j * hankel2(0, k * np.linalg.norm(x - np.array(source), axis=1))

    on = 0.5 * np.eye(len(points)) - dipoles(middles, points, weights, normals, k)
    matrix = np.concatenate([on, -dipoles(inside, points, weights, normals, k)])
    told = np.concatenate([free(middles), free(inside)])
    adjoint = matrix.conj().T
    pressure = np.linalg.solve(adjoint @ matrix, adjoint @ told)
    receivers = np.array(at)
    return 1.0 + dipoles(receivers, points, weights, normals, k) @ pressure / free(receivers)


if __name__ == "__main__":
    for size in ((SIDE, SIDE), *((thickness, HEIGHT) for thickness in WALLS)):
        coarse, fine = field_behind(size, 40e3), field_behind(size, 40e3, 14.0)
        print(size, f"within {20.0 * np.log10(np.abs(coarse - fine).max()):.1f} dB")
        print([complex(np.round(value, 4)) for value in fine])
