"""When paths of moving ends are heard, against a brute force that looks at every sample."""

import itertools
import re

import numpy as np
import pytest
from exhaustive import few
from made_meshes import box, joined, l_room, pillar_room, screen
from mesh_oracle import Oracle
from scenes import DATA

import clsim
from clsim.paths.search import mesh as mesh_paths
from clsim.paths.search import ray_shooting
from clsim.paths.visibility.device import DeviceSearch
from clsim.scene.room.mesh_files import read_mesh

WALL = clsim.Material.from_reflection(0.9)
C = 343.0
AIR = clsim.Air(speed_of_sound=C)


def scene_of(room, source: clsim.Trajectory, *receivers: clsim.Trajectory, rate: float = 192e3) -> clsim.Scene:
    signal = clsim.Signal.tone(0.2 * rate, min(source.end, 1.0), rate)
    ears = [clsim.Receiver(f"r{i}", r) for i, r in enumerate(receivers)]
    return clsim.Scene(room, AIR, [clsim.Source("s", signal, source)], ears)


def emitted(oracle: Oracle, sequence, source: clsim.Trajectory, at: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the source's positions when it emitted what is received, by fixed-point iteration."""
    delay = np.zeros(len(times))
    for _ in range(60):  # each shrinks the error by the Mach number
        position = source.position(np.clip(times - delay, 0.0, source.end))
        before, delay = delay, np.linalg.norm(oracle.images(sequence, position) - at, axis=1) / C
        if np.abs(delay - before).max() < 1e-14:
            break
    return source.position(np.clip(times - delay, 0.0, source.end))


def truth(oracle: Oracle, sequence, scene: clsim.Scene, times: np.ndarray, receiver: int = 0) -> np.ndarray:
    """Test a path's validity at times of reception."""
    at = scene.receivers[receiver].trajectory.position(times)
    return oracle.valid(sequence, emitted(oracle, sequence, scene.sources[0].trajectory, at, times), at)


def all_sequences(planes: int, order: int):
    for n in range(order + 1):
        for sequence in itertools.product(range(planes), repeat=n):
            if all(a != b for a, b in itertools.pairwise(sequence)):
                yield sequence


def by_sequence(paths: clsim.PathSet, oracle: Oracle, receiver: int = 0) -> dict[tuple[int, ...], list]:
    """Return the intervals of every sequence of the oracle's planes."""
    plane = np.empty(len(paths.scene.room.walls), dtype=int)
    plane[paths.scene.room.walls.of_triangle] = oracle.plane_of
    found: dict[tuple[int, ...], list] = {}
    for r, walls, start, end in zip(paths.receiver, paths.walls, paths.start, paths.end, strict=True):
        if r == receiver:
            found.setdefault(tuple(plane[walls[walls >= 0]].tolist()), []).append((start, end))
    return found


def differing_samples(intervals: list, valid: np.ndarray, times: np.ndarray) -> int:
    """Return the number of samples that are in an interval but not valid, or the reverse; a sample at either end is left out."""
    inside = np.zeros(len(times), dtype=bool)
    near = np.zeros(len(times), dtype=bool)
    step = times[1] - times[0]
    for start, end in intervals:
        inside |= (times >= start) & (times < end)
        near |= (np.abs(times - start) <= 1.001 * step) | (np.abs(times - end) <= 1.001 * step)
    return int(np.sum((inside != valid) & ~near))


@pytest.mark.parametrize("engine", ["opencl", "reference"])
@pytest.mark.parametrize("moving_receiver", [False, True])
def test_every_sample_of_a_walk_round_a_corner(engine: str, moving_receiver: bool, request) -> None:
    if engine == "opencl":
        request.getfixturevalue("device")
    room = clsim.MeshRoom(*l_room(), WALL)
    oracle = Oracle(room.vertices, room.triangles)
    source = clsim.Trajectory.waypoints([0.0, 0.2, 0.4, 0.6], [(2, 8, 1.4), (2, 5, 1.2), (3, 3, 1.4), (6.5, 2, 1.5)])
    receiver = clsim.Trajectory.fixed((7.2, 1.2, 2.0))
    if moving_receiver:
        receiver = clsim.Trajectory.circle((6.4, 2.2, 1.9), 0.6, 0.35, 0.6)
    rate = 4000.0
    scene = scene_of(room, source, receiver)
    order = 2 if engine == "opencl" else 1
    paths = clsim.find_paths(scene, order, resolution=1.0 / rate, engine=engine)
    found = by_sequence(paths, oracle)
    times = np.arange(round(0.6 * rate)) / rate
    ever = 0
    for sequence in all_sequences(oracle.planes, order):
        valid = truth(oracle, sequence, scene, times)
        ever += bool(valid.any())
        assert differing_samples(found.pop(sequence, []), valid, times) == 0, sequence
    assert not found
    assert ever > (20 if order == 2 else 5)
    assert np.sum(np.isfinite(paths.start)) >= 5, "paths are born on the way"


@pytest.mark.usefixtures("device")
def test_ends_are_right_to_a_sample_at_192_khz(rng) -> None:
    room = clsim.MeshRoom(*l_room(), WALL)
    oracle = Oracle(room.vertices, room.triangles)
    source = clsim.Trajectory.waypoints([0.0, 1.0, 2.0, 3.0], [(2, 8, 1.4), (2, 5, 1.2), (3, 3, 1.4), (6.5, 2, 1.5)])
    scene = scene_of(room, source, clsim.Trajectory.circle((6.4, 2.2, 1.9), 0.6, 1.5, 3.0))
    found = by_sequence(clsim.find_paths(scene, 3), oracle)
    step, ends, wrong = 1.0 / 192e3, 0, 0
    for sequence in all_sequences(oracle.planes, 2):  # one that is not found is heard never
        times = np.sort(rng.integers(0, round(3.0 / step), 300)) * step
        inside = np.zeros(len(times), dtype=bool)
        for start, end in found.get(sequence, []):
            inside |= (times >= start) & (times < end)
        assert np.array_equal(truth(oracle, sequence, scene, times), inside), sequence
    for sequence, intervals in found.items():
        for start, end in intervals:
            for instant, before, after in ((start, False, True), (end, True, False)):
                if np.isfinite(instant) and end - start > 3 * step:
                    seen = truth(oracle, sequence, scene, instant + step * np.array([-1.0, 1.0]))
                    ends += 1
                    wrong += seen.tolist() != [before, after]
    assert ends > 60
    assert wrong == 0


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.usefixtures("device")
def test_a_real_motion_in_a_real_room() -> None:
    mesh, motion = DATA / "meshes" / "bedroom.obj", DATA / "trajectories" / "freiburg1_xyz-groundtruth.txt"
    if not (mesh.exists() and motion.exists()):
        pytest.skip("no bedroom.obj and measured motion to test against")
    read = read_mesh(mesh, up="y")
    room = clsim.MeshRoom(read.vertices, read.triangles, WALL)
    oracle = Oracle(room.vertices, room.triangles)
    # 30 s within a ball of 0.36 m about (1.3, 0.6, 1.5).
    source = clsim.Trajectory.from_file(motion, "tum", max_gap=0.2, translate=(-1.5, -0.5, -1.4))
    rate = 100.0  # finer ones are looked at round the corner, above
    scene = scene_of(room, source, clsim.Trajectory.fixed((1.2, -2.0, 1.0)))
    paths = clsim.find_paths(scene, 2, resolution=1.0 / rate)
    found = by_sequence(paths, oracle)
    assert len(paths) > len(found) + 20, "paths come and go"
    times = np.arange(round(source.end * rate)) / rate
    for sequence in all_sequences(oracle.planes, 2):
        valid = truth(oracle, sequence, scene, times)
        assert differing_samples(found.pop(sequence, []), valid, times) == 0, sequence
    assert not found


@pytest.mark.usefixtures("device")
def test_the_direct_sound_vanishes_behind_a_pillar_and_comes_back() -> None:
    room = clsim.MeshRoom(*pillar_room(), WALL)
    way = clsim.Trajectory.line((2.0, 1.5, 1.4), (8.0, 1.5, 1.4), 2.0)
    paths = clsim.find_paths(scene_of(room, way, clsim.Trajectory.fixed((4.7, 6.5, 1.4))), 0)
    assert len(paths) == 2
    # The pillar's corners (4.2, 3.1) to (5.2, 4.1) as seen from (4.7, 6.5): shadow edges through its upper corners.
    left, right = (4.7 + (x - 4.7) / (4.1 - 6.5) * (1.5 - 6.5) for x in (4.2, 5.2))
    for instant, x in ((paths.end[0], left), (paths.start[1], right)):
        delay = np.hypot(x - 4.7, 5.0) / C
        assert instant == pytest.approx((x - 2.0) / 3.0 + delay, abs=2.0 / 192e3)


@pytest.mark.parametrize("engine", few(["opencl", "reference"]))
def test_gaps_beside_a_floor_are_heard_through_however_fast(engine: str, request) -> None:
    # Boards on the floor with gaps of 5 mm, 2 cm behind where the floor reflects, passed at 60 m/s: each gap is open for
    # 0.15 ms, while within 1 ms the reflection moves farther than to the boards. That is near to them, not to an edge.
    if engine == "opencl":
        request.getfixturevalue("device")
    boards = [screen((1.5 + 0.25 * i, 2.0, 0.0), (0.245, 0.0, 0.0), 1.5) for i in range(11)]
    room = clsim.MeshRoom(*joined(box((8, 6, 3)), *boards), WALL)
    oracle = Oracle(room.vertices, room.triangles)
    source = clsim.Trajectory.line((1.03, 1.0, 1.0), (7.03, 1.0, 1.0), 0.1)
    scene = scene_of(room, source, clsim.Trajectory.fixed((4.0, 3.0, 1.04)))
    found = by_sequence(clsim.find_paths(scene, 1, engine=engine), oracle)
    times = np.arange(0.0, 0.115, 1.0 / 192e3)
    for sequence in all_sequences(oracle.planes, 1):
        intervals, valid = found.pop(sequence, []), truth(oracle, sequence, scene, times)
        assert differing_samples(intervals, valid, times) == 0, sequence
        assert np.sum(np.diff(valid.astype(int)) == 1) == sum(0.0 < start < times[-1] for start, _ in intervals), (
            sequence
        )
    assert not found


@pytest.mark.usefixtures("device")
def test_intervals_of_a_path_neither_touch_nor_overlap() -> None:
    room = clsim.MeshRoom(*pillar_room(), WALL)
    way = clsim.Trajectory.circle((4.7, 3.6, 1.4), 1.5, 0.7, 1.4)
    paths = clsim.find_paths(scene_of(room, way, clsim.Trajectory.fixed((1.0, 6.5, 1.4))), 3)
    spans: dict[tuple, list] = {}
    for walls, start, end in zip(paths.walls.tolist(), paths.start, paths.end, strict=True):
        assert start < end
        spans.setdefault(tuple(walls), []).append((start, end))
    assert max(len(s) for s in spans.values()) >= 2
    for some in spans.values():
        for (_, end), (start, _) in itertools.pairwise(some):
            assert end < start


@pytest.mark.usefixtures("device")
def test_a_source_in_the_plane_of_an_inner_wall_settles_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluations = []
    find = DeviceSearch.find

    def counted(self, *paths):
        found = find(self, *paths)
        evaluations.append(found.evaluations)
        return found

    monkeypatch.setattr(DeviceSearch, "find", counted)
    # Sliding along x = 4, the plane of the L-room's inner wall: the shadow's edge runs through both ends all the time.
    room = clsim.MeshRoom(*l_room(), WALL)
    way = clsim.Trajectory.line((4.0, 1.0, 1.4), (4.0, 4.5, 1.4), 1.0)
    paths = clsim.find_paths(scene_of(room, way, clsim.Trajectory.fixed((4.0, 0.5, 1.2))), 2)
    assert paths.order.min() == 0
    assert np.all(np.isneginf(paths.start[paths.order == 0]))
    # To 1/16 sample a second has 3 million spans, for each of these paths. In spans of 1 ms: 172 000 in all.
    assert 0 < sum(evaluations) < 400_000


@pytest.mark.parametrize("engine", ["opencl", "reference"])
def test_ends_that_stand_still_hear_each_other_for_ever(engine: str, request) -> None:
    if engine == "opencl":
        request.getfixturevalue("device")
    room = clsim.MeshRoom(*l_room(), WALL)
    ends = clsim.Trajectory.fixed((2.0, 4.0, 1.4)), clsim.Trajectory.fixed((7.2, 1.2, 2.0))
    paths = clsim.find_paths(scene_of(room, *ends), 2, engine=engine)
    assert len(paths) > 15
    assert np.all(np.isneginf(paths.start))
    assert np.all(np.isposinf(paths.end))


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("moving_receiver", [False, True])
def test_smaller_cells_find_the_same(moving_receiver: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    room = clsim.MeshRoom(*l_room(), WALL)
    way = clsim.Trajectory.waypoints([0.0, 0.3, 0.6, 1.0], [(2, 8, 1.4), (2, 5, 1.2), (3, 3, 1.4), (6.5, 2, 1.5)])
    ear = clsim.Trajectory.fixed((7.2, 1.2, 2.0))
    if moving_receiver:
        ear = clsim.Trajectory.circle((6.4, 2.2, 1.9), 0.6, 0.35, 1.0)
    scene = scene_of(room, way, ear)
    whole = clsim.find_paths(scene, 2)
    monkeypatch.setattr(mesh_paths, "BEAM_LIMIT", 60)
    parts = clsim.find_paths(scene, 2, finder="beam-tree")
    assert parts.walls.tolist() == whole.walls.tolist()
    step = 1.01 / 16.0 / 192e3  # both within the resolution
    np.testing.assert_allclose(parts.start, whole.start, rtol=0, atol=step)
    np.testing.assert_allclose(parts.end, whole.end, rtol=0, atol=step)
    monkeypatch.setattr(mesh_paths, "BEAM_LIMIT", 5)
    with pytest.raises(clsim.InputError, match="max_order: must give at most 5 beams"):
        clsim.find_paths(scene, 2, finder="beam-tree")


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("mesh", [l_room(), pillar_room(), box((8, 9, 3))], ids=["L", "pillar", "box"])
def test_shooting_finds_the_same_in_a_small_room_and_says_that_it_can_miss(mesh, monkeypatch) -> None:
    pytest.importorskip("embreex")
    monkeypatch.setattr(ray_shooting, "RAYS", 500_000)
    room = clsim.MeshRoom(*mesh, WALL)
    way = clsim.Trajectory.line((2.0, 7.5, 1.4), (3.0, 2.0, 1.4), 1.0)
    scene = scene_of(room, way, clsim.Trajectory.fixed((7.2, 1.2, 2.0)))
    tree = clsim.find_paths(scene, 2, finder="beam-tree")
    with pytest.warns(clsim.ClsimWarning, match=r"small walls can be missed.* give 0 missed .*, besides \d+ found"):
        shot = clsim.find_paths(scene, 2, finder="shooting")
    assert shot.walls.tolist() == tree.walls.tolist()
    np.testing.assert_array_equal(shot.start, tree.start)
    np.testing.assert_array_equal(shot.end, tree.end)


@pytest.mark.usefixtures("device")
@pytest.mark.filterwarnings("ignore:.*Fresnel zone:clsim.ClsimWarning")  # of small walls
def test_few_rays_tell_how_many_paths_they_miss(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("embreex")
    monkeypatch.setattr(ray_shooting, "RAYS", 200)
    monkeypatch.setattr(ray_shooting, "_LEAST_RAYS", 200)
    slats = [screen((1.0 + 0.3 * i, 2.0, 0.5), (0.2, 0.1, 0.0), 2.0) for i in range(20)]
    scene = scene_of(
        clsim.MeshRoom(*joined(box((8, 6, 3)), *slats), WALL),
        clsim.Trajectory.fixed((2.1, 4.4, 1.3)),
        *(clsim.Trajectory.fixed((1.0 + 0.7 * i, 5.1, 1.1 + 0.1 * i)) for i in range(9)),
    )
    every = {tuple(w) for w in clsim.find_paths(scene, 2, finder="beam-tree").walls.tolist()}
    with pytest.warns(clsim.ClsimWarning, match="besides") as told:
        met = {tuple(w) for w in clsim.find_paths(scene, 2, finder="shooting").walls.tolist()}
    missed = len(every - met)
    assert met < every
    assert missed > 10
    estimate = float(re.search(r"give (\S+) missed", str(told[0].message))[1])
    assert 0.1 * missed < estimate < missed  # low, as walls differ in how many rays meet them


@pytest.mark.usefixtures("device")
def test_a_path_limit_stops_with_what_to_change() -> None:
    room = clsim.MeshRoom(*l_room(), WALL)
    way = clsim.Trajectory.fixed((2.0, 8.0, 1.4))
    scene = scene_of(
        room, clsim.Trajectory.line((2, 8, 1), (2, 7, 1), 1.0), clsim.Trajectory.fixed((1.0, 1.0, 1.0)), way
    )
    with pytest.raises(clsim.InputError, match=r"max_order: must give at most 10 paths \(path_limit\)"):
        clsim.find_paths(scene, 3, path_limit=10)
    shares: list[float] = []
    clsim.find_paths(scene, 3, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def test_a_source_that_may_be_as_fast_as_sound_at_a_corner_is_refused() -> None:
    # At 301 m/s: no bound below the speed of sound is known there, and none is made up.
    room = clsim.MeshRoom(*l_room(), WALL)
    times = [0.0, 0.50003, 0.52003, 1.5]  # a tenth of the way between knots
    corners = clsim.Trajectory.waypoints(
        times, [(2, 8, 1.4), (2, 7.9, 1.4), (3.2, 2, 1.4), (3.3, 2, 1.4)], smooth=False
    )
    scene = scene_of(room, corners, clsim.Trajectory.fixed((7.2, 1.2, 2.0)))
    with pytest.raises(
        clsim.InputError, match=r"must surely stay below the speed of sound, 343 m/s.*smooth its corners"
    ):
        clsim.find_paths(scene, 1, engine="reference")
