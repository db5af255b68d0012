"""Ends that sit in a wall are the limit of ends in front of it: the same paths, gains and delays, in every room."""

import numpy as np
import oracle
import pytest
from exhaustive import few
from proven import proven

import clsim
from clsim.paths.propagation import UniformAir
from clsim.paths.search import ray_shooting as shooting
from clsim.paths.search.beam_tree import BeamTree, Candidates
from clsim.paths.visibility.device import DeviceSearch
from clsim.paths.visibility.intervals import VisibilityQuery, trajectory_tables
from clsim.scene.ends import find_mount

WALL = clsim.Material.from_reflection(0.9)
SIZE = (8.0, 6.0, 3.0)
BOX = clsim.Shoebox(
    SIZE, {"default": WALL, "z_max": clsim.Material.from_reflection(0.5), "x_min": clsim.Material.from_reflection(-0.7)}
)
MESH = clsim.MeshRoom.joined([BOX])
CORNER = clsim.MeshRoom.from_plan([(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)], 3.0, WALL)
SCREEN = clsim.MeshRoom([(4, 1, 0.5), (4, 3, 0.5), (4, 3, 2), (4, 1, 2)], [(0, 1, 2), (0, 2, 3)], WALL)
PARTED = clsim.MeshRoom.joined([clsim.Shoebox(SIZE, WALL), SCREEN])
TONE = clsim.Signal.tone(40e3, 0.02, 192e3, fade=0.002)
ACROSS = clsim.Trajectory.line((2, 2, 1), (6, 4, 2), 0.3)
CEILING, SIDE = (3.0, 2.0, 3.0), (0.0, 3.0, 1.2)


def at(place: tuple[float, float, float], off: tuple[float, ...] = (0, 0, 0), by: float = 0.0) -> clsim.Trajectory:
    return clsim.Trajectory.fixed(np.array(place) + by * np.array(off))


def paths(room, source, receiver, source_flush=False, receiver_flush=False, order: int = 2, engine: str = "opencl"):
    scene = clsim.Scene(
        room, clsim.Air(), [clsim.Source("s", TONE, source, flush=source_flush)],
        [clsim.Receiver("r", receiver, flush=receiver_flush)],
    )  # fmt: skip
    return clsim.find_paths(scene, order, engine=engine, resolution=1e-4 if engine == "reference" else None)


def by_walls(found: clsim.PathSet, times: np.ndarray) -> dict[tuple[int, ...], np.ndarray]:
    """Return delay and gain (T, 2) of each sequence of walls, NaN where it is not heard."""
    table, out = found.table(times), {}
    for row, walls in enumerate(map(tuple, found.walls.tolist())):
        here = np.stack([table.delay[row], table.gain[row]], axis=1)
        before = out.get(walls, np.full_like(here, np.nan))
        out[walls] = np.where(np.isnan(here), before, here)
    return {walls: values for walls, values in out.items() if not np.isnan(values).all()}


@pytest.mark.parametrize("room", [BOX, MESH], ids=["shoebox", "mesh"])
@pytest.mark.parametrize("which", ["source", "receiver", "both", "both in one wall", "moving"])
def test_a_flush_end_is_the_limit_of_one_before_the_wall(device, room, which: str) -> None:
    times = np.array([0.01, 0.17, 0.29])

    def found(by: float) -> dict[tuple[int, ...], np.ndarray]:
        flush = by == 0.0
        ceiling, side = at(CEILING, (0, 0, -1), by), at(SIDE, (1, 0, 0), by)
        if which == "source":
            return by_walls(paths(room, ceiling, ACROSS, source_flush=flush), times)
        if which == "receiver":
            return by_walls(paths(room, ACROSS, side, receiver_flush=flush), times)
        if which == "moving":  # along its wall
            rail = clsim.Trajectory.line((1, 1, 3 - by), (5, 4, 3 - by), 0.3)
            return by_walls(paths(room, rail, ACROSS, source_flush=flush), times)
        if which == "both in one wall":
            side = at((5.0, 4.0, 3.0), (0, 0, -1), by)
        return by_walls(paths(room, ceiling, side, flush, flush), times)

    wanted = found(0.0)
    assert sum(np.isfinite(v[:, 0]).sum() for v in wanted.values()) == 25 * 3
    for by in (1e-4, 2e-6):
        near = found(by)
        assert near.keys() == wanted.keys()
        for walls, values in wanted.items():
            apart = np.abs(values - near[walls])
            # Two ends, each mirrored up to twice; gains of paths of at least 1 m change by 1/d² + absorption.
            assert np.nanmax(apart[:, 0]) * 343.0 < 4.5 * by
            assert np.nanmax(apart[:, 1]) < 4.5 * by
            assert np.array_equal(np.isnan(values), np.isnan(near[walls]))


@proven
def test_a_rigid_wall_doubles_what_sits_in_it(engine: str) -> None:
    """The direct path and the image in the wall are one arrival of twice the pressure, in sound as in the table."""
    rigid = clsim.Material.from_reflection(1.0)
    silent = clsim.Material.from_reflection(0.0)
    room = clsim.Shoebox(SIZE, {"default": silent, "z_max": rigid})
    for flush_source in (True, False):
        ends = (at(CEILING), at((5, 4, 1))) if flush_source else (at((5, 4, 1)), at(CEILING))
        found = paths(room, *ends, flush_source, not flush_source, order=1)
        free = paths(room, at((1, 1, 1)), at((1 + np.sqrt(12.0), 1, 1)), order=0)  # as far apart
        got, alone = (
            clsim.render(p, 192e3, engine=engine, duration=0.03, convolve_static=False).pressure[0]
            for p in (found, free)
        )
        some = np.arange(2000, 5700, 7)
        assert oracle.error_db(alone[some], oracle.as_the_paths_say(free, some / 192e3)) < -50.0
        np.testing.assert_allclose(got, 2.0 * alone, atol=2e-4 * np.abs(alone).max())


def difference(one: clsim.PathSet, other: clsim.PathSet, until: float) -> float:
    """Return for how long the path that differs most is heard in one but not in the other, s."""
    times = np.linspace(0.0, until, 100_001)

    def heard(found: clsim.PathSet) -> dict[tuple[int, ...], np.ndarray]:
        out: dict[tuple[int, ...], np.ndarray] = {}
        for walls, start, end in zip(map(tuple, found.walls.tolist()), found.start, found.end, strict=True):
            here = (times >= start) & (times < end)
            out[walls] = out.get(walls, False) | here
        return out

    first, second, never = heard(one), heard(other), np.zeros(len(times), dtype=bool)
    return max(until * float(np.mean(first.get(w, never) ^ second.get(w, never))) for w in {*first, *second})


WAY = clsim.Trajectory.waypoints([0.0, 0.5, 1.0], [(2, 8, 1.4), (2.5, 2, 1.5), (7, 1.5, 1.4)])
PAST = clsim.Trajectory.line((1, 1.2, 1), (7, 5.0, 1.6), 1.0)
MOVED = {
    "a corner's wall": (CORNER, (6.0, 4.0, 1.2), (0, -1, 0), WAY),
    "front of a screen": (PARTED, (4.0, 2.0, 1.2), (-1, 0, 0), PAST),
    "back of a screen": (PARTED, (4.0, 2.0, 1.2), (1, 0, 0), PAST),
}


@pytest.mark.parametrize("name", MOVED)
@pytest.mark.parametrize("flush_source", few([True, False]))
def test_paths_come_and_go_as_before_the_wall(device, name: str, flush_source: bool) -> None:
    """The other end walks behind the wall's plane and back: on the device as in NumPy, and as 2 µm before the wall."""
    room, place, side, other = MOVED[name]

    def found(by: float, order: int = 2, engine: str = "opencl") -> clsim.PathSet:
        end, flush = at(place, side, by), side if by == 0.0 else False
        if flush_source:
            return paths(room, end, other, flush, False, order, engine)
        return paths(room, other, end, False, flush, order, engine)

    flush = found(0.0)
    assert np.isfinite(flush.start).any()
    assert np.isfinite(flush.end).any()
    # A boundary of sight turns about an edge: 2 µm at one end are up to 10 µm at the other, 2 µs at 6 m/s.
    assert difference(flush, found(2e-6), 1.0) <= 2e-5
    if flush_source or name == "a corner's wall":
        assert difference(found(0.0, 1), found(0.0, 1, "reference"), 1.0) <= 2.5e-4  # each end to its resolution


def test_the_side_of_a_screen_decides(device) -> None:
    front, back = (paths(PARTED, at((4, 2, 1.2)), at((2, 2, 1.2)), side, order=1) for side in ((-1, 0, 0), (1, 0, 0)))
    by_screen = {(-1,), (len(PARTED.walls) - 1,)}  # the direct path, and the image in the screen
    assert by_screen <= {tuple(w) for w in front.walls.tolist()}
    assert not by_screen & {tuple(w) for w in back.walls.tolist()}


def test_a_flush_end_that_slides_costs_no_more_than_another(device) -> None:
    """Paths that an end a step before its wall never has are dismissed at once, however it slides."""
    rail = clsim.Trajectory.line((1, 1, 0), (3, 7, 0), 1.0)
    evaluations = []
    for flush in (True, False):
        way = rail if flush else clsim.Trajectory.line((1, 1, 0.5), (3, 7, 0.5), 1.0)
        scene = clsim.Scene(
            CORNER, clsim.Air(), [clsim.Source("s", TONE, way, flush=flush)], [clsim.Receiver("r", WAY)]
        )
        mounts = [find_mount(CORNER, end) for end in (*scene.sources, *scene.receivers)]
        ends = trajectory_tables(way, [WAY], mounts)
        query = VisibilityQuery(CORNER.walls, ends, UniformAir(343.0), np.zeros(1), np.ones(1), 1.0 / 48e3)
        tree = BeamTree(CORNER.walls, *ends.sphere(0), ends.receiver_spheres(), 10**6)
        parts = [c for c in tree.candidates(2) if len(c.row) and c.sequence.shape[1] == 2]
        both = Candidates.joined(parts)
        evaluations.append(DeviceSearch(query).find(both.sequence[both.row], both.receiver).evaluations / len(both.row))
    assert evaluations[0] < 2.0 * evaluations[1]


def test_rays_are_shot_from_before_the_wall(device, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("embreex")
    monkeypatch.setattr(shooting, "RAYS", 40_000)
    source = clsim.Source("s", TONE, at((4, 2, 1.2)), flush=(1, 0, 0))
    scene = clsim.Scene(PARTED, clsim.Air(), [source], [clsim.Receiver("r", at((6, 3, 1.4)))])
    wanted = {tuple(w) for w in clsim.find_paths(scene, 2).walls.tolist()}
    with pytest.warns(clsim.ClsimWarning, match="rays are shot, as asked"):
        shot = clsim.find_paths(scene, 2, finder="shooting")
    assert {tuple(w) for w in shot.walls.tolist()} == wanted
    assert (-1, -1) in wanted
    assert (len(PARTED.walls) - 1, -1) in wanted
