"""The field about a hard square pillar in two dimensions, by collocation on its outline: values for tests of edges.

Run as a program it prints the values that are stored in `PILLAR`.
"""

import numpy as np
from scipy.special import hankel2

C = 343.0
SIDE = 0.2  # m
SOURCE = (-2.0, 0.03)  # m, from the pillar's centre
RECEIVERS = [(1.5, y) for y in (-0.13, -0.06, 0.0, 0.05, 0.08, 0.095, 0.11, 0.13)]  # all out of sight
# Total over free field at the receivers, 40 kHz.
PILLAR = np.array(
    [
        (0.1677 - 0.279j),
        (-0.1215 - 0.0371j),
        (0.0363 + 0.0878j),
        (-0.1877 - 0.1153j),
        (0.1424 - 0.2348j),
        (0.2036 - 0.2983j),
        (0.2197 - 0.2375j),
        (0.368 - 0.0617j),
    ]
)


def outline(side: float, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Gauss points (N, G, 2), weights (N, G) and outward normals (N, 2) of elements, short near the corners."""
    count = int(np.ceil(side / step)) | 1
    share = np.linspace(0.0, 1.0, count + 1)
    ends = side * (share - np.sin(2.0 * np.pi * share) / (2.5 * np.pi) - 0.5)
    x, w = np.polynomial.legendre.leggauss(4)
    middle, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
    along, weight = middle[:, None] + half[:, None] * x, half[:, None] * w
    points, normals = [], []
    for angle in 0.5 * np.pi * np.arange(4):
        out, right = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        points.append(0.5 * side * out + along[..., None] * right)
        normals.append(np.tile(out, (count, 1)))
    return np.concatenate(points), np.tile(weight, (4, 1)), np.concatenate(normals)


def dipoles(x: np.ndarray, points: np.ndarray, weights: np.ndarray, normals: np.ndarray, k: float) -> np.ndarray:
    """Return what elements (N,) send to places (M, 2) as dipoles across the outline, (M, N)."""
    out = np.empty((len(x), len(points)), dtype=complex)
    for i, place in enumerate(x):
        away = points - place
        r = np.maximum(np.linalg.norm(away, axis=2), 1e-12)
        cosine = np.einsum("ngi,ni->ng", away, normals) / r
        out[i] = np.sum(weights * 0.25j * k * hankel2(1, k * r) * cosine, axis=1)
    return out


def pillar_field(side: float, frequency: float, elements: float = 9.0) -> np.ndarray:
    """Return the total over the free field at `RECEIVERS`, with so many elements in a wavelength."""
    k = 2.0 * np.pi * frequency / C
    points, weights, normals = outline(side, C / frequency / elements)
    middles = np.einsum("ngi,ng->ni", points, weights) / weights.sum(axis=1)[:, None]
    # Places within, where there is nothing, tell resonances of the inside apart.
    inside = np.random.default_rng(1).uniform(-0.45, 0.45, (40, 2)) * side

    def free(x: np.ndarray) -> np.ndarray:
        return -0.25j * hankel2(0, k * np.linalg.norm(x - np.array(SOURCE), axis=1))

    on = 0.5 * np.eye(len(points)) - dipoles(middles, points, weights, normals, k)
    matrix = np.concatenate([on, -dipoles(inside, points, weights, normals, k)])
    told = np.concatenate([free(middles), free(inside)])
    adjoint = matrix.conj().T
    pressure = np.linalg.solve(adjoint @ matrix, adjoint @ told)
    receivers = np.array(RECEIVERS)
    return 1.0 + dipoles(receivers, points, weights, normals, k) @ pressure / free(receivers)


if __name__ == "__main__":
    coarse, fine = pillar_field(SIDE, 40e3), pillar_field(SIDE, 40e3, 14.0)
    print(f"within {20.0 * np.log10(np.abs(coarse - fine).max()):.1f} dB")
    print([complex(np.round(value, 4)) for value in fine])
