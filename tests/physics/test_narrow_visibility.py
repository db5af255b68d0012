"""Narrow parts where paths begin and end: against the reference engine, over all and about every boundary."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from made_meshes import l_room, pillar_room
from scenes import DATA

import clsim
from clsim.scene.room.mesh_files import read_mesh

RATE, PROMISED_DB = 192e3, -85.0
WALL = clsim.Material.from_reflection(0.9)
ABOUT = 0.02  # s to either side of a boundary
QUIET = 1e-2  # of the loudest, below which what sounds about a boundary is not looked at
pytestmark = [
    pytest.mark.usefixtures("device"),
    pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning"),  # signals that begin at once
]


@dataclass(frozen=True)
class Walk:
    """A source that walks through a room in which paths come and go."""

    room: clsim.MeshRoom
    way: clsim.Trajectory
    ear: tuple[float, float, float]
    signal: clsim.Signal
    order: int

    def paths(self) -> clsim.PathSet:
        ears = [clsim.Receiver("r", clsim.Trajectory.fixed(self.ear))]
        return clsim.find_paths(
            clsim.Scene(self.room, clsim.Air(), [clsim.Source("s", self.signal, self.way)], ears), self.order
        )

    def plan(self, **options: Any) -> clsim.Plan:
        return clsim.plan_render(self.paths(), RATE, duration=self.way.end, **{"narrowband": True} | options)


def round_a_corner() -> Walk:
    way = clsim.Trajectory.line((2.1, 5.9, 1.4), (2.5, 4.9, 1.4), 0.11)  # 10 m/s
    return Walk(clsim.MeshRoom(*l_room(), WALL), way, (7.0, 3.0, 1.6), clsim.Signal.tone(40e3, 0.11, RATE), 2)


def behind_a_pillar() -> Walk:
    # The direct sound, most of what is heard, is hidden at 66 ms.
    way = clsim.Trajectory.line((2.75, 1.5, 1.4), (3.45, 1.5, 1.4), 0.1)
    sweep = clsim.Signal.chirp(39e3, 41e3, 0.1, RATE)
    return Walk(clsim.MeshRoom(*pillar_room(), WALL), way, (4.7, 6.5, 1.4), sweep, 1)


def in_a_bedroom() -> Walk:
    mesh = DATA / "meshes" / "bedroom.obj"
    if not mesh.exists():
        pytest.skip("no bedroom.obj to test against")
    read = read_mesh(mesh, up="y")
    way = clsim.Trajectory.line((1.0, 0.2, 1.5), (1.6, 0.9, 1.5), 0.1)
    room = clsim.MeshRoom(read.vertices, read.triangles, WALL)
    return Walk(room, way, (1.2, -2.0, 1.0), clsim.Signal.tone(40e3, 0.1, RATE), 2)


def boundaries(walk: Walk, paths: clsim.PathSet) -> np.ndarray:
    """Return when paths begin or end within the run, s."""
    ends = np.concatenate([paths.start, paths.end])
    return np.unique(ends[(ends > ABOUT) & (ends < walk.way.end - 0.5 * ABOUT)])


def local_db(error: np.ndarray, wanted: np.ndarray, at: float) -> float:
    """Return the error in the 20 ms about an instant relative to what is heard in the 40 ms about it."""
    near, about = (slice(round((at - reach) * RATE), round((at + reach) * RATE)) for reach in (0.5 * ABOUT, ABOUT))
    level = np.sqrt(np.mean(wanted[about] ** 2))
    if level < QUIET * np.abs(wanted).max():
        return -np.inf
    return float(20.0 * np.log10(np.sqrt(np.mean(error[near] ** 2)) / level))


@pytest.mark.parametrize("case", [round_a_corner, behind_a_pillar, in_a_bedroom], ids=lambda case: case.__name__)
def test_paths_that_begin_and_end_are_heard_as_they_should(case: Any, measured) -> None:
    walk = case()
    paths = walk.paths()
    plan = clsim.plan_render(paths, RATE, duration=walk.way.end, narrowband=True)
    assert plan.allocation.narrow
    got = np.concatenate([piece for _, piece in clsim.render_chunks(plan)], axis=1)[0].astype(np.float64)
    wanted = clsim.render(paths, RATE, duration=walk.way.end, engine="reference").pressure[0]
    error = got - wanted
    assert 20.0 * np.log10(np.linalg.norm(error) / np.linalg.norm(wanted)) <= PROMISED_DB
    at = boundaries(walk, paths)
    assert len(at) >= 1
    found = max(local_db(error, wanted, t) for t in at)
    measured("narrow parts where paths begin and end", "reference engine", found, PROMISED_DB)
