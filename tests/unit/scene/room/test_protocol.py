"""Rooms of one's own: what a scene, its checks, the viewer and reports ask of a room is the protocol, and no class."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from clsim_barn.half_space import HalfSpace

import clsim
from clsim.output.result_files import _is_box
from clsim.paths.find_paths import ROOM_FINDERS
from clsim.paths.path_table import viewed
from clsim.scene.ends import find_mount
from clsim.scene.room.faces import Faces
from clsim.scene.room.protocol import ROOM_MEMBERS, Room, is_room
from clsim.scene.room.shoebox import ConvexRoom
from clsim.scene.scene import viewed_walls

WALL = clsim.Material.from_reflection(0.9)
TONE = clsim.Signal.tone(40e3, 0.01, 192e3, fade=1e-3)
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Cylinder(ConvexRoom):
    """An upright cylinder of planes over the origin."""

    radius: float
    height: float
    sides: int
    faces: Faces = field(init=False)

    def __post_init__(self) -> None:
        angle = 2.0 * np.pi * (np.arange(self.sides) + 0.5) / self.sides
        inwards = np.stack([-np.cos(angle), -np.sin(angle), 0.0 * angle], axis=1)
        away = np.full(self.sides, -self.radius * np.cos(np.pi / self.sides))
        names = (*(f"side {i}" for i in range(self.sides)), "floor", "ceiling")
        faces = Faces(np.vstack([inwards, UP, -UP]), np.append(away, [0.0, -self.height]), names, (WALL,) * len(names))
        object.__setattr__(self, "faces", faces)

    @property
    def extent(self):
        low, high = np.array([-self.radius, -self.radius, 0.0]), np.array([self.radius, self.radius, self.height])
        return low, high

    @property
    def volume(self):
        return 0.5 * self.sides * self.radius**2 * np.sin(2.0 * np.pi / self.sides) * self.height

    @property
    def surface_area(self):
        rim = 2.0 * self.sides * self.radius * np.sin(np.pi / self.sides)
        return 2.0 * self.volume / self.height + rim * self.height

    def as_mesh(self):
        angle = 2.0 * np.pi * np.arange(self.sides) / self.sides
        return clsim.MeshRoom.from_plan(self.radius * np.stack([np.cos(angle), np.sin(angle)], 1), self.height, WALL)

    def describe(self):
        return [f"room: a cylinder of {self.sides} sides"]


CYLINDER = Cylinder(3.0, 2.5, 24)
BOX = clsim.Shoebox((8.0, 6.0, 3.0), WALL)
LADDER = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]


def scene(room: Room, place, flush=False) -> clsim.Scene:
    way = place if isinstance(place, clsim.Trajectory) else clsim.Trajectory.fixed(place)
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
    return clsim.Scene(room, clsim.Air(), [clsim.Source("robot", TONE, way, flush=flush)], [ear])


@pytest.mark.parametrize("room", [HalfSpace(), CYLINDER], ids=["half-space", "cylinder"])
def test_a_room_of_ones_own_is_a_room_of_a_scene(room: Room) -> None:
    assert is_room(room)
    held = scene(room, clsim.Trajectory.line((0, 0, 0.5), (0, 1, 0.5), 1.0))
    assert held.describe() == room.describe()
    walls = viewed_walls(room)
    assert len(walls) == len(room.faces)
    assert sum(len(wall.triangles) for wall in walls) == len(room.as_mesh().triangles)
    assert not _is_box(room)
    with pytest.raises(clsim.InputError, match="must be a Shoebox or MeshRoom to find paths"):
        clsim.find_paths(held, 1)


def test_with_a_finder_its_paths_are_rendered_and_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ROOM_FINDERS, HalfSpace, HalfSpace.find_paths)
    paths = clsim.find_paths(scene(HalfSpace(), (0.0, 0.0, 0.5)), 1)
    table, c = paths.table([0.0]), paths.scene.air.speed_of_sound
    np.testing.assert_allclose(table.delay[:, 0] * c, [np.sqrt(2.25), np.sqrt(4.25)], rtol=1e-14)
    assert [table.name_objects(row) for row in range(2)] == ["direct", "floor"]
    np.testing.assert_allclose(paths.vertices(0.0)[1, 1], [1 / 3, 1 / 3, 0.0], atol=1e-12)
    heard = clsim.render(paths, 192e3, engine="reference", duration=0.02).pressure[0]
    times = np.arange(round(0.008 * 192e3), round(0.012 * 192e3)) / 192e3  # both sound, at their full level
    wanted = table.gain[:, :1] * np.sin(2.0 * np.pi * 40e3 * (times - table.delay[:, :1]))
    np.testing.assert_allclose(heard[round(0.008 * 192e3) :][: len(times)], wanted.sum(axis=0), atol=1e-3)
    assert viewed(paths, duration=0.02, frames=2)["frames"][0].labels


@pytest.mark.parametrize(
    ("room", "end", "message"),
    [
        (HalfSpace(), (0, 0, -0.5), r"sources\[0\]\.trajectory: must stay above the floor, but 'robot' is at \(0, 0, 0\) m at 0\.5"),
        (CYLINDER, (0, 0, -0.5), r"must stay inside the room, but 'robot' is at \(0, 0, 0\) m .* wall floor; an end in a wall"),
        (CYLINDER, (5.5, 0, 0.5), r"must stay inside the room, but 'robot' is at \(3\.003, 0, 0\.5\) m at 0\.546 s"),
    ],
)  # fmt: skip
def test_it_says_when_and_where_it_is_left(room: Room, end, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        scene(room, clsim.Trajectory.line((0, 0, 0.5), end, 1.0))


@pytest.mark.parametrize("room", [HalfSpace(), CYLINDER], ids=["half-space", "cylinder"])
def test_its_walls_hold_flush_ends(room: Room) -> None:
    mount = find_mount(room, scene(room, (0.5, 0, 0), True).sources[0])
    assert mount.normal.tolist() == [0, 0, 1]
    assert room.faces.names[mount.wall] == "floor"
    with pytest.raises(clsim.InputError, match="flush: must point into the room from floor"):
        scene(room, (0.5, 0, 0), (0, 0.1, -1))
    with pytest.raises(clsim.InputError, match=r"must stay in the plane|above the floor"):
        scene(room, clsim.Trajectory.line((0, 0, 0), (0, 0, 1), 1.0), True)


@pytest.mark.parametrize("name", ROOM_MEMBERS)
def test_what_a_room_lacks_is_named(name: str) -> None:
    class Lacking:
        def __getattr__(self, other: str):
            if other == name:
                raise AttributeError(other)
            return getattr(HalfSpace(), other)

    with pytest.raises(clsim.InputError, match=f"^room: must have all that a Room has, but Lacking lacks {name}$"):
        scene(Lacking(), (0, 0, 0.5))  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [None, "room", clsim.Shoebox, {"size": (1, 2, 3)}])
def test_what_is_no_room_is_refused(value) -> None:
    with pytest.raises(clsim.InputError, match=r"^room: must be a room"):
        scene(value, (0, 0, 0.5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"normals": [(0, 0, 2)]}, r"faces\.normals\[0\]: must be a unit vector, but has the length 2"),
        ({"offsets": [0, 1]}, r"faces\.offsets"),
        ({"names": ()}, r"faces\.names: must be one per wall, 1, but are 0"),
        ({"materials": ("wood",)}, r"faces\.materials\[0\]: must be a Material, but is 'wood'"),
    ],
)
def test_faces_are_checked(change: dict, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        Faces(**{"normals": [(0, 0, 1)], "offsets": [0], "names": ("floor",), "materials": (WALL,)} | change)


def test_a_tetrahedron_and_a_box_have_volume_and_area() -> None:
    solid = clsim.MeshRoom(*LADDER, WALL)
    assert solid.volume == pytest.approx(1 / 6)
    assert solid.surface_area == pytest.approx(1.5 + np.sqrt(3) / 2)
    assert clsim.MeshRoom(LADDER[0], LADDER[1][1:], WALL).volume is None
    assert (BOX.volume, BOX.surface_area) == (144.0, 180.0)
    for room in (BOX, CYLINDER):
        assert room.as_mesh().volume == pytest.approx(room.volume)
        assert room.as_mesh().surface_area == pytest.approx(room.surface_area)


def test_a_box_and_its_mesh_say_the_same() -> None:
    mesh = BOX.as_mesh()
    assert _is_box(BOX)
    assert not _is_box(mesh)
    assert mesh.faces.names == BOX.faces.names
    side = np.sign(np.sum(mesh.faces.normals * BOX.faces.normals, axis=1))
    np.testing.assert_allclose(side[:, None] * mesh.faces.normals, BOX.faces.normals, atol=1e-15)
    np.testing.assert_allclose(side * mesh.faces.offsets, BOX.faces.offsets, atol=1e-15)
    points = np.random.default_rng(7).uniform(-1, 9, (200, 3))
    assert BOX.contains(points).tolist() == mesh.contains(points).tolist()
    inside = points[BOX.contains(points)]
    np.testing.assert_allclose(mesh.clearance(inside), BOX.clearance(inside) - 1e-6, atol=1e-12)
