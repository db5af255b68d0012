"""What is left out of a search for paths is never heard: boxes around walls, hidden parts of apertures, sides of walls."""

from collections.abc import Callable

import numpy as np
import pytest
from exhaustive import exhaustive
from made_meshes import box, hall, joined, l_room, screen

import clsim
from clsim.opencl.device import find_device
from clsim.paths.visibility.device import MOST, DeviceLookup
from clsim.paths.visibility.occlusion import (
    Beams,
    Ears,
    Views,
    WallLookup,
    beam_planes,
    open_parts,
)
from clsim.scene.room.walls import Walls

WALL = clsim.Material.from_reflection(0.9)


def cluttered(rng: np.random.Generator, boxes: int = 12) -> clsim.MeshRoom:
    """Return a room with boxes that stand at all angles and through each other, and a screen."""
    things = [box((8, 6, 3))]
    for _ in range(boxes):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        corners, triangles = box(rng.uniform(0.2, 1.2, 3))
        things.append((corners @ turn.T + rng.uniform((0.5, 0.5, 0.5), (7, 5, 2.5)), triangles))
    return clsim.MeshRoom(*joined(*things, screen((2, 2, 0), (2, 1, 0), 2.0)), WALL)


ROOMS = {"hall": lambda rng: clsim.MeshRoom(*hall(5), WALL), "clutter": cluttered}
rooms = pytest.mark.parametrize("make", ROOMS.values(), ids=ROOMS)


def dense_crossings(walls: Walls, start: np.ndarray, stop: np.ndarray) -> set[tuple[int, int]]:
    """Return pairs of segment and wall, each looked at by itself."""
    found = set()
    for w in range(len(walls)):
        a, b = (x @ walls.normal[w] - walls.offset[w] for x in (start, stop))
        rows = np.flatnonzero(a * b < 0.0)
        hit = start[rows] + (a[rows] / (a[rows] - b[rows]))[:, None] * (stop[rows] - start[rows])
        found |= {(int(r), w) for r in rows[walls.holds(w, hit)]}
    return found


@rooms
def test_no_crossing_is_lost_among_the_boxes(make, rng) -> None:
    room = make(rng)
    start, stop = rng.uniform(*room.extent, (2, 300, 3))
    row, wall, piece = WallLookup(room.walls).crossings(start, stop)
    assert set(zip(row.tolist(), wall.tolist(), strict=True)) == dense_crossings(room.walls, start, stop)
    assert np.all((room.walls.first_piece[wall] <= piece) & (piece < room.walls.first_piece[wall + 1]))


def test_boxes_hold_walls_and_are_walked_in_depth(rng) -> None:
    room = cluttered(rng, 60)
    walls, tree = room.walls, room.walls.tree
    assert len(tree.middle) > 1, "boxes in boxes"
    boxes = tree.in_depth()
    assert sorted(boxes.wall[boxes.wall >= 0].tolist()) == list(range(len(walls)))
    for i, (middle, half) in enumerate(zip(boxes.middle, boxes.half, strict=True)):
        for wall in (w for w in boxes.wall[i : boxes.skip[i]] if w >= 0):
            assert np.all(np.abs(walls.hull_of(wall) - middle) <= half + 1e-9)
    assert boxes.skip[0] > 1
    low, high = (f.reduceat(walls.hull, walls.first_hull[:-1]) for f in (np.minimum, np.maximum))
    one, other = tree.meeting_boxes(low, high)
    meets = np.all((low[:, None] <= high) & (high[:, None] >= low), axis=2)
    assert set(zip(one.tolist(), other.tolist(), strict=True)) >= set(zip(*np.nonzero(meets), strict=True))


def views_of(walls: Walls, centre: np.ndarray, radius: float) -> Views:
    widths = np.diff(walls.first_hull)
    fill = np.minimum(np.arange(widths.max()), widths[:, None] - 1)
    every = np.arange(len(walls))
    centres = np.broadcast_to(centre, (len(walls), 3))
    hulls = walls.hull[walls.first_hull[:-1, None] + fill]
    return Views(centres, radius, centres[:, None], np.full(len(walls), -1), hulls, widths, every)


def outside(ring: np.ndarray, normal: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the distance of points (n, 3) of a plane outside of a convex ring about its normal, m; 0 or less within."""
    inward = np.cross(normal, np.roll(ring, -1, axis=0) - ring)
    length = np.linalg.norm(inward, axis=1)
    real = length > 1e-9
    return np.max(-np.sum((x[:, None] - ring[real]) * (inward[real] / length[real, None]), axis=2), axis=1)


@rooms
@pytest.mark.parametrize("radius", [0.0, 0.15])
def test_what_can_be_seen_is_never_taken_for_hidden(make: Callable, radius: float, rng) -> None:
    room = make(rng)
    walls, low, high = room.walls, *room.extent
    lost, left, seen = 0, 0, 0
    for centre in rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (6, 3)):
        views = views_of(walls, centre, radius)
        ring, corners = open_parts(walls, views, WallLookup(walls).crossings)
        left += int(np.sum(corners == 0))
        lost += int(np.sum((corners > 0) & ~np.all(ring[:, : views.ring.shape[1]] == views.ring, axis=(1, 2))))
        wall = np.repeat(np.arange(len(walls)), 30)
        share = rng.dirichlet(np.ones(4), len(wall))[..., None]
        at = np.sum(share * views.ring[wall][:, :4], axis=1)
        way = rng.normal(size=at.shape)
        place = centre + radius * rng.uniform(size=(len(at), 1)) * way / np.linalg.norm(way, axis=1, keepdims=True)
        blocked = np.zeros(len(at), dtype=bool)
        for r, w in dense_crossings(walls, place, at):
            blocked[r] |= walls.plane[w] != walls.plane[wall[r]]
        free = np.flatnonzero(~blocked)
        seen += len(free)
        for w in np.unique(wall[free]):
            rows = free[wall[free] == w]
            assert corners[w], f"wall {w} is seen from {place[rows[0]]}"
            assert outside(ring[w, : corners[w]], walls.normal[w], at[rows]).max() < 1e-9
    assert left > 0, "some walls are hidden as a whole"
    assert lost > 5, "others in part"
    assert seen > 500


@rooms
def test_walls_are_met_on_the_side_of_the_air(make, rng) -> None:
    room = make(rng)
    walls = room.walls
    places = rng.uniform(*room.extent, (60, 3))
    told = 0
    for place in places:
        sides = WallLookup(walls).air_sides(place)
        stop = place + 50.0 * (directions := rng.normal(size=(40, 3)))
        row, wall, _ = WallLookup(walls).crossings(np.broadcast_to(place, stop.shape), stop)
        height = walls.normal[wall] @ place - walls.offset[wall]
        share = height / -np.einsum("ni,ni->n", directions[row], walls.normal[wall])
        for r in range(len(stop)):
            mine = np.flatnonzero(row == r)
            if len(mine):
                first = mine[np.argmin(share[mine])]
                assert sides[wall[first]] * height[first] >= 0.0
                told += sides[wall[first]] != 0
    assert told > 500


def test_sides_of_what_is_no_closed_shell_are_not_told() -> None:
    corners, triangles = box((1, 1, 1))
    turned = triangles.copy()
    turned[0] = turned[0, ::-1]
    pane = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float), np.array([[0, 1, 2], [0, 2, 3]])
    sides = {
        "box": ((corners, triangles), True), "open": ((corners, triangles[1:]), False),
        "a triangle turned": ((corners, turned), False), "pane": (pane, False),
    }  # fmt: skip
    for name, (mesh, told) in sides.items():
        assert np.all((clsim.MeshRoom(*mesh, WALL).walls.outward != 0) == told), name
    walls = clsim.MeshRoom(corners, triangles[:, ::-1], WALL).walls
    heights = walls.normal @ [0.5, 0.5, 0.5] - walls.offset
    assert np.all(walls.outward * heights < 0.0), "outward, whatever the winding"
    assert np.all(WallLookup(walls).air_sides(np.array([0.4, 0.5, 0.6])) * heights > 0.0)


@pytest.mark.usefixtures("device")
@rooms
def test_the_device_looks_up_the_same_walls(make, rng) -> None:
    room = make(rng)
    walls = room.walls
    host, device = WallLookup(walls), DeviceLookup(walls, find_device(None))
    start, stop = rng.uniform(*room.extent, (2, 400, 3))
    wanted, got = (set(zip(*(x.tolist() for x in look.crossings(start, stop)), strict=True)) for look in (host, device))
    count = np.bincount([row for row, _, _ in wanted], minlength=len(start))
    assert {pair for pair in wanted if count[pair[0]] <= MOST} == {pair for pair in got if count[pair[0]] <= MOST}
    assert got <= wanted
    last = rng.integers(0, len(walls), 200)
    views = views_of(walls, room.extent[0], 0.0)
    centre = rng.uniform(*room.extent, (200, 3))
    ring, corners, normal = views.ring[last], views.corners[last], walls.normal[last]
    planes = beam_planes(centre, 0.2, ring, corners, normal, walls.size)
    beams = Beams(planes, centre, 0.2, last.astype(np.int32), 1e-7 * walls.size)
    places = rng.uniform(*room.extent, (3, 3))
    seen = rng.uniform(size=(3, len(walls))) < 0.5
    per_wall = np.where(seen, planes.shape[1], 0).ravel()
    ears = Ears(
        places, np.full(3, 0.1), seen,
        np.concatenate([planes[rng.integers(0, 200)] for _ in range(int(seen.sum()))]),
        np.concatenate([[0], np.cumsum(per_wall)]),
    )  # fmt: skip
    sides = rng.integers(-1, 2, len(walls))
    for listening in (None, ears):
        wanted, got = ([x.tolist() for x in look.meetings(beams, sides, listening)] for look in (host, device))
        pairs = [set(zip(*found, strict=True)) for found in (wanted, got)]
        assert pairs[0] == pairs[1]
        assert len(pairs[0]) > 20


def sequences(paths: clsim.PathSet) -> set[tuple[int, ...]]:
    return {tuple(w[w >= 0].tolist()) for w in paths.walls}


@pytest.mark.parametrize("bays", [6, exhaustive(40)])
def test_paths_in_a_hall_of_many_walls_are_reciprocal(bays: int) -> None:
    room = clsim.MeshRoom(*hall(bays), WALL)
    assert len(room.walls) == 24 * bays
    tone, middle = clsim.Signal.tone(40e3, 0.01, 192e3), 2.0 * bays
    places, found = [(middle - 8.7, -2.9, 3.6), (middle + 8.7, 1.4, 4.6)], []
    for mouth, ear in (places, places[::-1]):
        source = clsim.Source("s", tone, clsim.Trajectory.fixed(mouth))
        receiver = clsim.Receiver("r", clsim.Trajectory.fixed(ear))
        scene = clsim.Scene(room, clsim.Air(), [source], [receiver])
        found.append(sequences(clsim.find_paths(scene, 2, finder="beam-tree")))
    assert len(found[0]) > 10
    assert found[0] == {walls[::-1] for walls in found[1]}


def test_far_walls_in_one_plane_own_nothing_of_each_other() -> None:
    things = joined(
        l_room(), screen((1, 1, 0), (1, 0, 0), 1.0), screen((1.5, 1, 0), (1, 0, 0), 1.0),
        screen((5, 1, 0), (1, 0, 0), 1.0),
    )  # fmt: skip
    walls = clsim.MeshRoom(*things, WALL).walls
    first, second, far = (int(w) for w in walls.of_triangle[-6::2])
    assert walls.plane[first] == walls.plane[second] == walls.plane[far]
    twins = [walls.twin[walls.first_twin[w] : walls.first_twin[w + 1]].tolist() for w in (first, second, far)]
    assert twins == [[], [first], []]
