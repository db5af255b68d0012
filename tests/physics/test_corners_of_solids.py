"""Corners of a sheared box, a tetrahedron and a triangular sheet: the whole pressure and its jumps, at default settings.

Lines of sight and mirror paths are led past a corner, against line integrals over the edges (`corner_oracle`).
"""

from itertools import pairwise

import numpy as np
import pytest
from corner_oracle import Edge
from edge_fields import field, jumps

import clsim

C, FREQUENCIES, COUNT = 343.0, (20e3, 40e3), 10
HARD, SILENT = clsim.Material.from_reflection(1.0), clsim.Material.from_reflection(0.0)
MIDDLE = np.array([6.0, 6.0, 6.0])  # of a large room whose walls are silent
BOX_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
# Corners, faces, source, first and last place of the receiver, all from the middle, m.
CASES = {
    "mirrored by a sheared box": (
        [(-0.20834959626137023, -0.10147906402984407, -0.9980929346210026),
         (0.09414063208572959, 0.511249079519237, -0.24175455640229943),
         (0.3429982303781537, -0.4366325665480702, -0.31816558317249616),
         (0.6454884587252535, 0.17609557700101092, 0.4381727950462069),
         (-0.6454884587252535, -0.17609557700101092, -0.4381727950462069),
         (-0.3429982303781537, 0.4366325665480702, 0.31816558317249616),
         (-0.09414063208572959, -0.511249079519237, 0.24175455640229943),
         (0.20834959626137023, 0.10147906402984407, 0.9980929346210026)],
        BOX_FACES, (0.872823833376797, -0.035254222108006, -1.182360627738472),
        (2.373431001573282, 1.058388026810217, 0.841702700356073),
        (2.224031892228336, 0.951582198788898, 1.3335746458667455),
    ),
    "mirrored by a tetrahedron": (
        [(0.43487533109784454, -0.14779658761975817, 0.7982753597381638),
         (-0.5594741484869237, -0.49330803683929825, -0.12554979197894142),
         (0.4129405990092366, -0.1582493245032274, -0.8375167539661462),
         (-0.2347810088130628, 0.8245714669606641, 0.28385835039302826)],
        [(0, 1, 2), (3, 1, 0), (0, 2, 3), (3, 2, 1)], (0.230444373520465, 0.678658659912543, 1.326265398530497),
        (-0.98440079770208, 0.903382168950381, -0.1662032111698055),
        (-1.109950542504992, 0.868855286656399, 0.230815024242502),
    ),
    "sight through the corner of a sheet": (
        [(-0.29186727426824255, -0.7444208890072013, -0.025515372248011963),
         (0.614191683922121, 0.234088407943332, -0.4560385868185562),
         (-0.186297090155608, 0.6569377325425804, 0.4168047621625337)],
        [(0, 1, 2)], (-0.80700101881617, 0.9096358449451865, -0.428828032680161),
        (0.912998731648925, -0.067957185711188, -0.505058319343938),
        (1.038396461421444, 0.192458731866688, -0.42086184150744),
    ),
}  # fmt: skip
Solid = tuple[list[Edge], list[tuple[np.ndarray, np.ndarray]]]  # edges, and outlines of faces with their normals


def solid(corners: np.ndarray, faces: list[tuple[int, ...]]) -> Solid:
    """Return a convex solid, or a sheet of one face, with normals into the air."""
    outlines = [corners[list(face)] for face in faces]
    normals = [
        np.cross(p[1] - p[0], p[2] - p[0]) / np.linalg.norm(np.cross(p[1] - p[0], p[2] - p[0])) for p in outlines
    ]
    away = [np.sign(n @ (p.mean(axis=0) - corners.mean(axis=0))) or 1.0 for p, n in zip(outlines, normals, strict=True)]
    normals = [n * (sign if len(faces) > 1 else 1.0) for n, sign in zip(normals, away, strict=True)]
    sides: dict[frozenset[int], list[int]] = {}
    for i, face in enumerate(faces):
        for side in pairwise((*face, face[0])):
            sides.setdefault(frozenset(side), []).append(i)
    edges = []
    for side, of in sides.items():
        start, stop = corners[sorted(side)]
        along = (stop - start) / np.linalg.norm(stop - start)
        inward = [outlines[i].mean(axis=0) - start for i in of]
        inward = [(x - x @ along * along) / np.linalg.norm(x - x @ along * along) for x in inward]
        wedge = 2.0 * np.pi - (np.arccos(np.clip(inward[0] @ inward[1], -1.0, 1.0)) if len(of) == 2 else 0.0)
        edges.append(Edge(start, stop, inward[0], normals[of[0]], float(wedge)))
    return edges, list(zip(outlines, normals, strict=True))


def crossed(outline: np.ndarray, normal: np.ndarray, one: np.ndarray, other: np.ndarray) -> bool:
    """Whether a line between two places crosses a convex face."""
    heights = (one - outline[0]) @ normal, (other - outline[0]) @ normal
    if heights[0] * heights[1] >= 0.0:
        return False
    met = one + (other - one) * heights[0] / (heights[0] - heights[1])
    turns = [np.cross(b - a, met - a) @ normal for a, b in pairwise([*outline, outline[0]])]
    return bool(min(turns) > 0.0 or max(turns) < 0.0)


def pressure(thing: Solid, source: np.ndarray, receiver: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Return the pressure (F,) of first order: direct, mirrored, and of the edges."""
    edges, faces = thing
    images = [] if any(crossed(*face, source, receiver) for face in faces) else [source]
    for outline, normal in faces:
        heights = (source - outline[0]) @ normal, (receiver - outline[0]) @ normal
        image = source - 2.0 * heights[0] * normal
        if (min(heights) > 0.0 or (len(faces) == 1 and max(heights) < 0.0)) and crossed(
            outline, normal, image, receiver
        ):
            images.append(image)
    apart = np.linalg.norm(np.array(images).reshape(-1, 3) - receiver, axis=1)[:, None]
    found = np.sum(np.exp(-1j * k * apart) / apart, axis=0)
    seen = [edge for edge in edges if edge.seen_from(source) and edge.seen_from(receiver)]
    return found + sum(edge.field(source, receiver, k) for edge in seen)


@pytest.mark.parametrize("case", CASES)
def test_walks_past_corners_of_solids(case: str) -> None:
    """Within -60 dB of the free field, with jumps below -100 dB of the strongest path; slivers left -31 to +4 dB."""
    corners, faces, *places = CASES[case]
    source, first, last = np.array(places)
    triangles = [(face[0], *pair) for face in faces for pair in pairwise(face[1:])]
    thing = clsim.MeshRoom(np.array(corners) + MIDDLE, triangles, HARD)
    scene = clsim.Scene(
        clsim.MeshRoom.joined([clsim.Shoebox((12.0, 12.0, 12.0), SILENT), thing]),
        clsim.Air(absorption=False, speed_of_sound=C),
        [clsim.Source("s", clsim.Signal.tone(40e3, 0.12, 192e3, fade=0.01), clsim.Trajectory.fixed(source + MIDDLE))],
        [clsim.Receiver("r", clsim.Trajectory.line(first + MIDDLE, last + MIDDLE, 1.0))],
    )
    paths = clsim.find_paths(scene, 1, diffraction=1)
    times = (np.arange(COUNT) + 0.5) / COUNT
    walk = first + times[:, None] * (last - first)
    waves = 2.0 * np.pi * np.array(FREQUENCIES) / C
    wanted = np.array([pressure(solid(np.array(corners), faces), source, place, waves) for place in walk])
    apart = np.linalg.norm(walk - source, axis=1)
    changes = np.unique(np.concatenate([x for family in paths.families for x in (family.start, family.end)]))
    changes = changes[(changes > 0.0) & (changes < 1.0)]
    for frequency, right in zip(FREQUENCIES, wanted.T, strict=True):
        assert 20.0 * np.log10(np.max(np.abs(field(paths, times, frequency) - right) * apart)) < -60.0
        assert 20.0 * np.log10(np.max(jumps(paths, changes, frequency))) < -100.0
