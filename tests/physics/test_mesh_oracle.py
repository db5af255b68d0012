"""The oracle of meshes against closed forms, before anything is compared with it."""

import itertools

import numpy as np
import pytest
from made_meshes import box, cut_box, hall, joined, l_room, pillar_room, screen
from mesh_oracle import Oracle

SIZE = np.array([5.0, 4.0, 3.0])
SOURCE = np.array([1.31, 0.87, 1.13])
RECEIVER = np.array([3.77, 2.59, 1.91])


def length(corners):
    return float(np.sum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))


def shoebox_images(order):
    """Return order and distance of each image of a box, by the lattice: x -> 2 n L + x or 2 n L - x."""
    axes = []
    for k in range(3):
        per_axis = []
        for n, flip in itertools.product(range(-order, order + 1), (0, 1)):
            bounces = abs(2 * n - flip)
            per_axis.append((bounces, 2 * n * SIZE[k] + (-SOURCE[k] if flip else SOURCE[k]) - RECEIVER[k]))
        axes.append(per_axis)
    images = []
    for (a, x), (b, y), (c, z) in itertools.product(*axes):
        if a + b + c <= order:
            images.append((a + b + c, float(np.sqrt(x * x + y * y + z * z))))
    return sorted(images)


@pytest.mark.parametrize("order", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("mesh", [box(SIZE), cut_box(SIZE)], ids=["12 triangles", "300 triangles"])
def test_box_has_the_images_of_the_lattice(mesh, order):
    oracle = Oracle(*mesh)
    assert oracle.planes == 6
    found = oracle.paths(SOURCE, RECEIVER, order)
    wanted = shoebox_images(order)
    assert len(found) == len(wanted) == 1 + 2 * order * (2 * order**2 + 3 * order + 4) // 3
    got = sorted((len(key), length(corners)) for key, corners in found.items())
    assert [n for n, _ in got] == [n for n, _ in wanted]
    np.testing.assert_allclose([d for _, d in got], [d for _, d in wanted], rtol=1e-13)


def test_paths_begin_and_end_where_they_should_and_reflect_as_light_does():
    oracle = Oracle(*l_room())
    found = oracle.paths(SOURCE, RECEIVER, 3)
    assert len(found) > 30
    for key, corners in found.items():
        np.testing.assert_array_equal(corners[[0, -1]], [SOURCE, RECEIVER])
        legs = np.diff(corners, axis=0)
        legs /= np.linalg.norm(legs, axis=1)[:, None]
        for k, plane in enumerate(key):
            n = oracle.normals[plane]
            assert abs(n @ corners[k + 1] - oracle.offsets[plane]) < 1e-12
            np.testing.assert_allclose(legs[k + 1], legs[k] - 2 * (legs[k] @ n) * n, atol=1e-12)
            assert abs(legs[k] @ n) > 1e-3
        image = oracle.images(key, SOURCE[None])[0]
        assert length(corners) == pytest.approx(np.linalg.norm(image - RECEIVER), rel=1e-13)


def test_planes_are_one_whether_connected_or_not_and_whichever_way_they_turn():
    vertices, triangles = joined(screen([1, 0, 0], [1, 1, 0], 2), screen([4, 3, 1], [-1, -1, 0], 2), box(SIZE))
    oracle = Oracle(vertices, triangles)
    assert oracle.planes == 7
    assert oracle.plane_of[:4].tolist() == [0, 0, 0, 0]
    assert Oracle(*joined(screen([0, 0, 0], [1, 0, 0], 2), screen([0, 2e-6, 0], [1, 0, 0], 2))).planes == 2
    assert Oracle(*joined(screen([0, 0, 0], [1, 0, 0], 2), screen([0, 5e-7, 0], [1, 0, 0], 2))).planes == 1
    assert Oracle(*joined(screen([0, 0, 0], [1, 0, 0], 2), screen([0, 0, 0], [1, 1e-4, 0], 2))).planes == 2


def test_a_screen_blocks_what_crosses_it_and_nothing_else():
    open_room = Oracle(*box(SIZE)).paths(SOURCE, RECEIVER, 2)
    mesh = joined(box(SIZE), screen([2.5, 0.5, 0.0], [0.0, 3.0, 0.0], 2.0))
    oracle = Oracle(*mesh)
    assert oracle.plane_of[-1] == 6
    found = oracle.paths(SOURCE, RECEIVER, 2)
    assert () not in found
    for key, corners in open_room.items():
        crossing = []
        for a, b in itertools.pairwise(corners):
            if (a[0] - 2.5) * (b[0] - 2.5) < 0:
                y, z = (a + (2.5 - a[0]) / (b[0] - a[0]) * (b - a))[1:]
                crossing.append(0.5 < y < 3.5 and z < 2.0)
        assert (key in found) is not any(crossing)
    # Source and receiver stand at either side: a single reflection on the screen joins none of them.
    assert (6,) not in found
    beside = oracle.paths(SOURCE, [1.0, 2.5, 1.0], 1)
    assert (6,) in beside
    assert (6,) not in oracle.paths(SOURCE, [2.0, 2.5, 2.9], 1)  # the hit would be above the screen


def test_l_room_is_dark_round_its_corner():
    """The inner corner is at (4, 5): what the straight line passes at its far side is hidden."""
    oracle = Oracle(*l_room())
    assert oracle.planes == 8
    source, behind = np.array([7.0, 3.0, 1.5]), np.array([2.0, 8.0, 1.4])
    seen = np.array([2.0, 6.0, 1.4])  # the line passes x = 4 at y = 4.8
    assert () not in oracle.paths(source, behind, 0)
    assert () in oracle.paths(source, seen, 0)
    found = oracle.paths(source, behind, 1)
    # By hand: west (x = 0) passes x = 4 at y = 4.67 and south (y = 0) at y = 3.6; north, east, floor and ceiling above 5.
    hits = sorted(corners[1, :2].tolist() for corners in found.values())
    np.testing.assert_allclose(hits, [[0, 8 - 5 * 2 / 9], [2 + 5 * 8 / 11, 0]], rtol=1e-13, atol=1e-13)


def test_l_room_is_lit_where_the_line_clears_the_corner():
    """Receivers on a line behind the corner: the shadow's edge is where the straight line meets it."""
    oracle = Oracle(*l_room())
    source = np.array([7.0, 3.0, 1.5])
    y = np.linspace(5.1, 8.9, 77)
    receivers = np.stack([np.full(77, 2.0), y, np.full(77, 1.0)], axis=1)
    at_corner = 3.0 + (y - 3.0) * (7.0 - 4.0) / (7.0 - 2.0)
    np.testing.assert_array_equal(oracle.valid((), np.tile(source, (77, 1)), receivers), at_corner < 5.0)


def test_pillar_hides_what_is_behind_it():
    oracle = Oracle(*pillar_room())
    assert oracle.planes == 10
    assert () not in oracle.paths([2.0, 3.5, 1.0], [8.0, 3.7, 1.2], 0)
    assert () in oracle.paths([2.0, 2.0, 1.0], [8.0, 2.1, 1.2], 0)
    # Floor and ceiling end at the pillar: no reflection comes from inside it.
    for corners in oracle.paths([2.0, 2.2, 1.0], [8.0, 5.1, 1.2], 2).values():
        x, y = corners[1:-1, :2].T
        assert not np.any((x > 4.2 + 1e-9) & (x < 5.2 - 1e-9) & (y > 3.1 + 1e-9) & (y < 4.1 - 1e-9))


def test_valid_says_what_paths_says(rng):
    oracle = Oracle(*pillar_room())
    sources = rng.uniform([0.2, 0.2, 0.2], [4.0, 7.8, 2.8], (12, 3))
    receivers = rng.uniform([5.4, 0.2, 0.2], [9.8, 7.8, 2.8], (12, 3))
    found = [oracle.paths(s, r, 2) for s, r in zip(sources, receivers, strict=True)]
    for n in range(3):
        for sequence in itertools.product(range(oracle.planes), repeat=n):
            if n == 2 and sequence[0] == sequence[1]:
                continue
            wanted = [sequence in paths for paths in found]
            np.testing.assert_array_equal(oracle.valid(sequence, sources, receivers), wanted)


@pytest.mark.parametrize("mesh", [l_room(), pillar_room(), hall(3)], ids=["L", "pillar", "hall"])
def test_the_way_back_is_the_same(mesh):
    oracle = Oracle(*mesh)
    source, receiver = np.array([1.3, 0.9, 1.1]), np.array([7.1, 2.6, 1.9])
    there, back = oracle.paths(source, receiver, 2), oracle.paths(receiver, source, 2)
    assert len(there) > 10
    assert set(there) == {key[::-1] for key in back}
    for key, corners in there.items():
        np.testing.assert_allclose(corners, back[key[::-1]][::-1], atol=1e-11)


# The made meshes


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (box(SIZE), 60), (cut_box(SIZE), 60), (l_room(), 3 * (8 * 5 + 4 * 4)), (pillar_room(), 3 * 79), (hall(3), None),
        (hall(), None),
    ],
    ids=["box", "cut box", "L", "pillar", "hall 3", "hall"],
)  # fmt: skip
def test_made_rooms_are_watertight(mesh, volume):
    vertices, triangles = mesh
    assert vertices.dtype == np.float64
    assert set(triangles.ravel()) == set(range(len(vertices)))
    assert len(np.unique(vertices, axis=0)) == len(vertices)
    sides = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert set(np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)[1]) == {2}
    assert len(np.unique(sides, axis=0)) == len(sides)  # once each way: all triangles turn alike
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-3
    enclosed = np.sum(a * np.cross(b, c)) / 6  # positive: normals point outwards
    assert enclosed == pytest.approx(volume, rel=1e-12) if volume else enclosed > 500
