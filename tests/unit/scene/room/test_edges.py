"""Which edges of rooms diffract, where they are, and how much air is about them."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

import clsim

WALL = clsim.Material.from_reflection(0.9)
DOOR = clsim.Material.from_reflection(0.5)
ROOM = clsim.Shoebox((8.0, 6.0, 3.0), WALL)
L_PLAN = [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]


def block(low: ArrayLike, high: ArrayLike) -> clsim.MeshRoom:
    """Return a closed box that stands in a room."""
    box = clsim.Shoebox(np.subtract(high, low), WALL).as_mesh()
    return clsim.MeshRoom(box.vertices + np.asarray(low), box.triangles, WALL, labels=["block"] * 12)


def screen(low: float = 0.0) -> clsim.MeshRoom:
    corners = [(2, 2, low), (4, 2, low), (4, 2, 1), (2, 2, 1)]
    return clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], WALL, labels=["screen"] * 2)


def segments(room: clsim.MeshRoom) -> list[tuple]:
    """Return the ends, exterior angle and free ends of all edges, in an order that does not depend on directions."""
    edges = room.edges()
    found = []
    for a, b, n, free in zip(edges.start.round(9), edges.stop.round(9), edges.n, edges.free, strict=True):
        ends = sorted([(*(a + 0.0), bool(free[0])), (*(b + 0.0), bool(free[1]))])
        found.append((*ends, round(float(n), 9)))
    return sorted(found)


def test_rooms_without_edges() -> None:
    corner_of_60 = clsim.MeshRoom.from_plan([(0, 0), (4, 0), (2, 2 * np.sqrt(3.0))], 3.0, WALL)
    for room in (ROOM, ROOM.as_mesh(), corner_of_60):
        assert len(room.edges()) == 0
        assert room.edges().describe() == ["edges of the room: none that diffract"]


def test_inner_corners_but_those_of_an_integer_part_of_a_half_turn() -> None:
    corners = np.array([(0.0, 0.0), (5.0, 0.0), (7.0, 3.0), (2.0, 6.0)])
    before, after = np.roll(corners, 1, axis=0) - corners, np.roll(corners, -1, axis=0) - corners
    cosine = np.sum(before * after, axis=1) / np.linalg.norm(before, axis=1) / np.linalg.norm(after, axis=1)
    edges = clsim.MeshRoom.from_plan(corners, 3.0, WALL).edges()
    np.testing.assert_allclose(np.sort(edges.n), np.sort(np.arccos(cosine)) / np.pi, rtol=1e-9)
    assert "degrees of air" in edges.describe()[1]
    bay = clsim.MeshRoom.from_plan([(0, 0), (5, 0), (5, 3), (3, 3)], 3.0, WALL).edges()
    np.testing.assert_allclose(bay.n, [0.75])  # of 45, 90, 90 and 135 degrees


def test_the_corner_of_an_l() -> None:
    edges = clsim.MeshRoom.from_plan(L_PLAN, 3.0, WALL).edges()
    assert len(edges) == 1
    assert not edges.free.any()  # from floor to ceiling
    np.testing.assert_allclose(edges.n, 1.5)
    np.testing.assert_allclose(np.sort([edges.start[0], edges.stop[0]], axis=0), [(4, 5, 0), (4, 5, 3)], atol=1e-12)
    np.testing.assert_allclose(np.cross(edges.across, edges.out), edges.along, atol=1e-12)
    places = np.array([(5.0, 4.0, 1.0), (4.0, 2.0, 0.5), (3.0, 4.0, 2.0), (2.0, 5.0, 0.0), (3.0, 6.0, 1.0)])
    r, angle, z = edges.cylindrical(np.zeros(5, dtype=int), places)
    np.testing.assert_allclose(r, [np.sqrt(2.0), 3.0, np.sqrt(2.0), 2.0, np.sqrt(2.0)])
    from_below = np.degrees(angle if angle[0] < angle[-1] else 1.5 * np.pi - angle)
    np.testing.assert_allclose(from_below, [45.0, 90.0, 135.0, 180.0, 225.0])
    np.testing.assert_allclose(z if edges.along[0, 2] > 0.0 else 3.0 - z, places[:, 2], atol=1e-12)
    _, solid, _ = edges.cylindrical(np.zeros(2, dtype=int), np.array([(4.9, 5.1, 1.0), (4.1, 5.9, 1.0)]))
    assert sorted(np.degrees(solid).round()) == [-6.0, 276.0]  # beyond either face


def test_what_stands_in_a_room() -> None:
    on_floor = clsim.MeshRoom.joined([ROOM, block((2, 2, 0), (3, 3, 1))]).edges()
    assert len(on_floor) == 8  # those on the floor are inner corners
    assert sorted(on_floor.free.sum(axis=1)) == [1] * 4 + [2] * 4
    hanging = clsim.MeshRoom.joined([ROOM, block((2, 2, 0.5), (3, 3, 1))]).edges()
    assert (len(hanging), hanging.free.all()) == (12, True)
    pillar = clsim.MeshRoom.from_plan([(0, 0), (8, 0), (8, 5), (0, 5)], 3.0, WALL, [[(3, 2), (4, 2), (3, 3)]]).edges()
    assert not pillar.free.any()
    np.testing.assert_allclose(np.sort(180.0 * pillar.n), [270.0, 315.0, 315.0])


def test_edges_of_screens() -> None:
    hanging = screen(0.5).edges()
    assert (len(hanging), set(hanging.n), hanging.free.all()) == (4, {2.0}, True)
    assert all(a == b for a, b in hanging.faces)
    standing = clsim.MeshRoom.joined([ROOM, screen()]).edges()
    mine = standing.n == 2.0  # the mesh is open: which side of the room is inside is not known
    assert mine.sum() == 3
    assert np.all(standing.start[mine, 2] + standing.stop[mine, 2] > 0.0)  # not where it stands


def test_changes_of_material() -> None:
    corners = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)]
    triangles = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)]
    edges = clsim.MeshRoom(corners, triangles, [WALL, WALL, DOOR, DOOR]).edges()
    assert (edges.n == 1.0).sum() == 2  # one for each side
    assert {tuple(f) for f in edges.faces[edges.n == 1.0]} == {(0, 1), (1, 0)}
    assert (clsim.MeshRoom(corners, triangles, WALL).edges().n == 1.0).sum() == 0


def test_triangles_do_not_matter() -> None:
    """Nor do vertices within an edge, T-junctions, or where the room is."""
    room = clsim.MeshRoom.joined([ROOM, block((2, 2, 0), (3, 3, 1)), block((5, 1, 1), (6, 2, 2))])
    trimesh = pytest.importorskip("trimesh")
    vertices, triangles = trimesh.remesh.subdivide(room.vertices, room.triangles)
    finer = clsim.MeshRoom(vertices, triangles, WALL)
    assert segments(finer) == segments(room)
    vertices, triangles = trimesh.remesh.subdivide(room.vertices, room.triangles, face_index=[13, 20])
    open_mesh = set(segments(clsim.MeshRoom(vertices, triangles, WALL)))  # and the outer corners of the room
    assert open_mesh > set(segments(room))
    assert len(open_mesh) == len(segments(room)) + 12
    turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])[:3, :3]
    turned = clsim.MeshRoom(room.vertices @ turn.T + [10.0, -4.0, 2.0], room.triangles, WALL)
    back = (turned.edges().start - [10.0, -4.0, 2.0]) @ turn
    assert len(turned.edges()) == len(room.edges())
    np.testing.assert_allclose(np.sort(turned.edges().n), np.sort(room.edges().n))
    ends = np.concatenate([room.edges().start, room.edges().stop])
    assert all(np.linalg.norm(ends - x, axis=1).min() < 1e-9 for x in back)


def test_two_blocks_that_touch() -> None:
    """Side by side they are one block, and a smaller one on top leaves inner corners where it stands."""
    two = clsim.MeshRoom.joined([ROOM, block((1, 1, 1), (2, 2, 2)), block((2, 1, 1), (4, 2, 2))])
    one = clsim.MeshRoom.joined([ROOM, block((1, 1, 1), (4, 2, 2))])
    assert len(one.edges()) == 12
    assert set(segments(two)) > set(segments(one))  # and the outer corners of the room, since the mesh is not closed
    assert len(two.edges()) == 12 + 12
    top = clsim.MeshRoom.joined([ROOM, block((1, 1, 0), (3, 3, 1)), block((1.5, 1.5, 1), (2, 2, 2))])
    heights = [{a[2], b[2]} for a, b, n in segments(top)]
    assert heights.count({1.0}) == 4  # of the lower one's top, none of the upper one's foot
    assert heights.count({2.0}) == 4


def test_descriptions_name_edges() -> None:
    lines = clsim.MeshRoom.from_plan(L_PLAN, 3.0, WALL).edges().describe()
    assert lines[0] == "edges: 1 that diffract, 3 m together"
    assert "wall 2" in lines[1]
    assert "wall 3" in lines[1]
    assert "270 degrees of air, 3 m" in lines[1]
    assert sum(": free, " in line for line in screen().edges().describe()) == 4


def test_thin_panels_become_sheets() -> None:
    """In their middle, turned as they are; what is thicker, bent or part of the room stays."""
    trimesh = pytest.importorskip("trimesh")
    panel, thick = block((2, 2, 0.5), (4, 2.004, 1.5)), block((5, 2, 0.5), (6, 2.1, 1.5))
    turn = trimesh.transformations.rotation_matrix(0.4, [1.0, 2.0, 3.0])[:3, :3]
    turned = clsim.MeshRoom(panel.vertices @ turn.T + [0.0, 1.0, 0.5], panel.triangles, DOOR, labels=["door"] * 12)
    ladder = clsim.MeshRoom(
        [(0, 0, 0), (1e-3, 0, 0), (0, 1e-3, 0), (0, 0, 1e-3)], [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)], WALL
    )
    room = clsim.MeshRoom.joined([ROOM, turned, thick, ladder])
    sheets = room.with_sheets(0.017)
    assert len(room.with_sheets(0.0).triangles) == len(room.triangles)
    assert [note for note in sheets.notes if "sheet" in note] == ["door of 4 mm is taken as a sheet"]
    assert len(room.triangles) - len(sheets.triangles) == 10
    door = [w for w, name in enumerate(sheets.faces.names) if name.startswith("door")]
    assert len(door) == 1
    assert sheets.faces.materials[door[0]] is DOOR
    corners = (sheets.walls.hull_of(door[0]) - [0.0, 1.0, 0.5]) @ turn
    np.testing.assert_allclose(corners[:, 1], 2.002, atol=1e-12)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [(2, 2.002, 0.5), (4, 2.002, 1.5)])
    free = sheets.edges()
    assert (free.n == 2.0).sum() == 4
    assert sum("block" in name for name in free.names) == 12


def test_a_room_beside_whose_size_a_wall_is_nearly_a_point() -> None:
    """All places of the wall are within the tolerance of lines that run across it."""
    assert len(clsim.MeshRoom.from_plan([(0, 0), (4, 0), (4, 3), (0, 1e8)], 2.0, WALL).edges()) == 0
