"""A room: the air above a floor."""

import numpy as np

import clsim
from clsim.paths.chain import Chain
from clsim.paths.legs.legs import image_columns
from clsim.paths.options import PathOptions
from clsim.scene.room.edges import Edges
from clsim.scene.room.faces import Contact, Faces

WALL = clsim.Material.from_reflection(0.9)
UP = np.array([0.0, 0.0, 1.0])


class HalfSpace:
    """The air above a floor, of which 20 m are drawn; a room needs no base class."""

    faces = Faces(UP[None], np.zeros(1), ("floor",), (WALL,))
    extent = (np.array([-10.0, -10.0, 0.0]), np.array([10.0, 10.0, 10.0]))
    volume = None
    surface_area = 400.0
    scale = None
    is_convex = True
    is_closed = False

    def contains(self, positions):
        return np.asarray(positions)[:, 2] > 0.0

    surrounds = contains

    def clearance(self, positions, mount=None):
        height = positions[:, 2] if mount is None else mount.lifted(positions)[:, 2]
        return height if mount is None else np.minimum(height, mount.clearance(positions))

    def first_contact(self, positions, mount=None):
        refused = np.flatnonzero(self.clearance(positions, mount) <= 0.0)
        return Contact(int(refused[0]), "must stay above the floor", "is", "!") if len(refused) else None

    def walls_at(self, position):
        return np.flatnonzero(np.abs(position[2:]) < 1e-6)

    def edges(self):
        return Edges.none()

    def as_mesh(self):
        corners = [(-10, -10, 0), (10, -10, 0), (10, 10, 0), (-10, 10, 0)]
        return clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], WALL, labels=["floor"] * 2)

    def describe(self):
        return ["room: all that is above a floor"]

    @staticmethod
    def find_paths(scene: clsim.Scene, room: "HalfSpace", search: PathOptions) -> Chain:
        """Find the direct sound and its reflection by the floor, for each source and receiver."""
        orders = min(search.max_order, 1) + 1
        pairs = len(scene.sources) * len(scene.receivers)
        pair, order = np.divmod(np.arange(pairs * orders), orders)
        source, receiver = np.divmod(pair.astype(np.int32), np.int32(len(scene.receivers)))
        mirrors = np.stack([np.eye(3), np.diag([1.0, 1.0, -1.0])])
        ever = np.full(len(pair), -np.inf), np.full(len(pair), np.inf)
        walls = (order - 1).astype(np.int32)[:, None]
        images = image_columns(walls, mirrors[order], np.zeros((len(pair), 3)))
        return Chain(scene, source, receiver, order.astype(np.int32), *ever, **images)
