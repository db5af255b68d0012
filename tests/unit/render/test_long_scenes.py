"""Scenes that last for days, or hold very many receivers or paths: memory and time go by what moves."""

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scene_texts import receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.commands import run as run_command
from clsim.paths.path_set import PathSet
from clsim.paths.visibility.intervals import trajectory_tables
from clsim.render.plan import within_memory
from clsim.render.planning import plan_render
from clsim.scene.motion.instants import Instants
from clsim.scene.motion.motion import Motion
from clsim.scene.placement import first_approach, first_refused, nearest_within
from clsim.scene.room.walls import first_contact
from clsim.tracks.pruning import pruned
from clsim.tracks.tracks import SceneTracks, track
from clsim.workflow.pipeline import check_table_size, table_times

SIZE = (8.0, 6.0, 3.0)
ROOM = clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.9))
MESH = clsim.MeshRoom.joined([ROOM])
SHORT = clsim.Signal.tone(40e3, duration=0.001, sampling_rate=192e3, fade=0.0005)
DAYS = 1e6  # s
MOST_EVALUATIONS = 20_000  # instants of all motions together

SCENE = scene_text(
    source_at("robot", tone_of(40e3, 1000e3), (4.0, 3.0, 1.5)),
    receiver_at("ceiling", (1.0, 1.0, 2.9)),
    room={"kind": "shoebox", "size": (8.0, 6.0, 3.0), "walls": {"default": {"reflection": 0.9}}},
)


def scene_of(
    trajectory: clsim.Trajectory, signal: clsim.Signal = SHORT, start: float = 0.0, receivers: int = 1, room: Any = ROOM
) -> clsim.Scene:
    places = np.random.default_rng(1).uniform(0.2, 0.8, (receivers, 3))
    ears = clsim.receiver_array("r", places)
    return clsim.Scene(room, clsim.Air(), [clsim.Source("robot", signal, trajectory, start=start)], ears)


@contextmanager
def few_looks(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fail where motions are asked for more instants than what moves can need."""
    evaluations = 0

    def counted(function: Any) -> Any:
        def count(self: Motion, t: Any) -> Any:
            nonlocal evaluations
            evaluations += np.size(t)
            assert evaluations <= MOST_EVALUATIONS
            return function(self, t)

        return count

    with monkeypatch.context() as patch:
        for name in ("position", "velocity"):
            patch.setattr(Motion, name, counted(getattr(Motion, name)))
        yield


@contextmanager
def little_memory(most: float) -> Iterator[None]:
    """Fail where Python's memory grows by more bytes."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] <= most
    finally:
        tracemalloc.stop()


def test_check_of_a_fixed_scene_of_days(tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "scene.toml").write_text(SCENE)
    with few_looks(monkeypatch), little_memory(40e6):
        assert main(["check", str(tmp_path / "scene.toml")]) == 0
    assert "1e+06 s" in capsys.readouterr().out


STILL = clsim.Trajectory.fixed((4.0, 3.0, 1.5))


@pytest.mark.parametrize(
    ("trajectory", "signal", "start"),
    [
        (STILL, clsim.Signal.tone(40e3, DAYS, 192e3), 0.0),
        (STILL, clsim.Signal.pulses(SHORT, 0.1, 90_000_000), 0.0),
        (STILL, SHORT, DAYS),
        (clsim.Trajectory.line((4, 3, 1.5), (4, 3, 1.5), 1e9), SHORT, DAYS),
        (clsim.Trajectory.line((4, 3, 1.5), (5, 3, 1.5), 1e9), SHORT, 0.0),
        (clsim.Trajectory.waypoints([0, 1e9], [(4, 3, 1.5), (5, 3, 1.5)]), SHORT, 0.0),
        (clsim.Trajectory.waypoints([0, 1, 1e9], [(4, 3, 1.5), (5, 3, 1.5), (5, 3, 1.5)], smooth=False), SHORT, 5e8),
        (clsim.Trajectory.waypoints([0, 5e8, 1e9], [(4, 3, 1.5), (5, 3, 1.5), (5, 4, 1.5)]), SHORT, 5e8),
        (clsim.Trajectory.circle((4, 3, 1.5), 1.0, period=60.0, duration=1e4), SHORT, 0.0),
    ],
    ids=["tone", "pulses", "start", "rest", "line", "two points", "legs", "spline", "circle"],
)
def test_days_take_little_time_and_memory(trajectory, signal, start, monkeypatch) -> None:
    with few_looks(monkeypatch), little_memory(15e6):
        for room in (ROOM, MESH):
            scene = scene_of(trajectory, signal, start, room=room)
        track(clsim.find_paths(scene_of(trajectory, signal, start), 1))
        assert len(scene.sources[0].emitted.energy_spectrum()[0]) > 1


def test_a_place_that_is_refused_is_told_after_days() -> None:
    late = clsim.Trajectory.waypoints(
        [0, 8e5, 8e5 + 1, DAYS], [(4, 3, 1), (4, 3, 1), (4, 3, 3.5), (4, 3, 1)], smooth=False
    )
    with pytest.raises(clsim.InputError, match=r"inside the room, but 'robot' is at \(4, 3, 3.*\) m at 800001 s"):
        scene_of(late)
    with pytest.raises(clsim.InputError, match=r"meets the wall .* at 800001 s"):
        scene_of(late, room=MESH)
    fast = clsim.Trajectory.waypoints(
        [0, 8e5, 8e5 + 0.01, DAYS], [(1, 3, 1), (1, 3, 1), (7, 3, 1), (7, 3, 1)], smooth=False
    )
    with pytest.raises(clsim.InputError, match=r"speed of sound, .* but 'robot' moves at 600 m/s at 800000 s"):
        scene_of(fast)


def random_motion(kind: int, duration: float, rng: np.random.Generator) -> clsim.Trajectory:
    low, high = np.array([0.2, 0.2, 0.2]), np.array([7.9, 5.9, 2.9])
    if kind == 0:
        centre, axis = rng.uniform([3, 2, 1], [5, 4, 2]), rng.normal(size=3)
        return clsim.Trajectory.circle(centre, rng.uniform(0.2, 2.5), rng.uniform(0.5, 4), duration, axis=axis)
    if kind == 1:
        return clsim.Trajectory.line(rng.uniform(low, high), rng.uniform(low, high + 0.2), duration)
    times = np.sort(rng.uniform(0.0, duration, 8))
    times[[0, -1]] = 0.0, duration
    return clsim.Trajectory.waypoints(times, rng.uniform(low, high, (8, 3)), smooth=kind == 2)


@pytest.mark.parametrize("kind", range(4), ids=["circle", "line", "spline", "legs"])
@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_missed_that_a_look_at_every_instant_finds(kind: int, seed: int) -> None:
    rng = np.random.default_rng([kind, seed])
    for _ in range(3):
        duration = rng.uniform(0.5, 4.0)
        motion, other = random_motion(kind, duration, rng), random_motion(int(rng.integers(4)), duration, rng)
        instants = Instants(0.0, duration, 1000.0)
        times = instants.times(np.arange(instants.count))
        places, velocity = motion.position(times), motion.velocity(times)
        assert first_refused(ROOM, motion, instants) == first_of(~ROOM.contains(places))
        contact = first_contact(MESH.walls, places)
        assert first_refused(MESH, motion, instants) == (None if contact is None else contact[0])
        speed = np.linalg.norm(velocity, axis=1)
        assert motion.peak_speed(0.0, duration)[0] == pytest.approx(speed.max(), rel=2e-9)
        half = 0.5 * instants.step
        moving = nearest_within(other.position(times) - places, other.velocity(times) - velocity, half)[0]
        found = first_approach(motion, other, 0.4, instants)
        assert (None if found is None else found[0]) == first_of(moving < 0.4)
        ears = rng.uniform(0.2, 2.8, (5, 3))
        still = np.stack([nearest_within(ear - places, -velocity, half)[0] for ear in ears], axis=1)
        found = first_approach(motion, ears, 0.4, instants)
        assert (None if found is None else found[0]) == first_of((still < 0.4).any(axis=1))
        assert found is None or still[found] < 0.4


def first_of(met: Any) -> int | None:
    return int(np.argmax(met)) if met.any() else None


@pytest.mark.parametrize("kind", range(4), ids=["circle", "line", "spline", "legs"])
def test_bounds_of_the_speed_hold_and_close_in(kind: int, rng: np.random.Generator) -> None:
    motion = random_motion(kind, 4.0, rng)
    begin = rng.uniform(-0.2, 4.2, 300)
    for length in (2.0, 0.1, 1e-4):
        bound = motion.speed_over(begin, begin + length)
        met = np.linalg.norm(motion.velocity(begin[:, None] + np.linspace(0.0, length, 40)), axis=2).max(axis=1)
        assert np.all(bound >= met * (1 - 1e-12))
    assert np.median(bound - met) < 1e-3


def test_many_receivers_are_looked_at_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SceneTracks, "delay_range", lambda *_: pytest.fail("a pair was looked at by itself"))
    scene = scene_of(clsim.Trajectory.line((4, 3, 1.5), (5, 3, 1.5), 1.0), receivers=100)
    plan = plan_render(clsim.find_paths(scene, 1), 192e3, duration=0.01)
    assert plan.memory_bytes > 0


@pytest.mark.parametrize("moving", [False, True])
def test_the_longest_delay_is_that_of_the_groups(moving: bool) -> None:
    line = clsim.Trajectory.line((4, 3, 1.5), (5, 3, 1.5), 1.0)
    scene = scene_of(line if moving else STILL, receivers=5)
    clock = clsim.Electronics(clock_offset=0.01, clock_ppm=30.0)
    drifting = clsim.Receiver("drifting", clsim.Trajectory.line((1, 1, 1), (1, 2, 1), 1.0), electronics=clock)
    scene = clsim.Scene(
        ROOM, scene.air, [*scene.sources, clsim.Source("b", SHORT, STILL)], [*scene.receivers, drifting]
    )
    tracks = track(clsim.find_paths(scene, 2))
    for start, end in ((0.0, 0.0), (0.2, 0.7)):
        bounds = [tracks.delay_range(i, start, end)[1].max() for i in range(len(tracks.pairs))]
        assert tracks.longest_delay(start, end) == pytest.approx(max(bounds), rel=1e-14)
        first = [b for b, group in zip(bounds, tracks.pairs, strict=True) if group.source == 0]
        assert tracks.longest_delay(start, end, 0) == pytest.approx(max(first), rel=1e-14)


def test_paths_take_few_bytes() -> None:
    scene = scene_of(STILL, receivers=400)
    with little_memory(180 * 400 * 377):
        paths = clsim.find_paths(scene, 6)
        assert len(paths) == 400 * 377
        track(paths)


def test_paths_of_one_receiver() -> None:
    paths = clsim.find_paths(scene_of(STILL, receivers=3), 2)
    assert set(paths.at_receiver(1).receiver) == {1}
    assert len(paths.at_receiver(1)) == 25


def test_too_many_paths_are_refused() -> None:
    with pytest.raises(clsim.InputError, match=r"max_order: must give at most 10000000 paths \(path_limit\)"):
        clsim.find_paths(scene_of(STILL, receivers=2000), 16)


def test_a_path_table_is_made_in_pieces() -> None:
    paths = clsim.find_paths(scene_of(clsim.Trajectory.line((4, 3, 1.5), (5, 3, 1.5), 100.0)), 0)
    times = np.linspace(0.0, 100.0, 200_000)
    with little_memory(1.2 * (80 + 137) * len(times)):  # bytes of a row of either table
        table = paths.table(times)
        clsim.direct_path(paths, times)
    np.testing.assert_array_equal(table.delay[0, 70_000:70_003], paths.table(times[70_000:70_003]).delay[0])


def test_no_table_is_made_that_nobody_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PathSet, "table", lambda *_: pytest.fail("a table was made"))
    monkeypatch.setattr(run_command, "run_identity", lambda *_: {})
    monkeypatch.setattr(run_command, "render_sound", lambda *_: [])
    (tmp_path / "scene.toml").write_text(SCENE.replace("1e6", "0.01"))
    arguments = ["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), "--table", "none", "--no-plots"]
    assert main(arguments) == 0


def test_a_table_of_too_many_paths_is_refused() -> None:
    plan: Any = SimpleNamespace(path_count=1_000_001, duration=1.0, sampling_rate=192e3)
    with pytest.raises(
        clsim.InputError, match="--table: must be none for more than 1000000 paths, but there are 1000001"
    ):
        check_table_size(plan, "--table", "must be none")
    with pytest.warns(clsim.ClsimWarning, match="--table-rate"):
        assert len(table_times(plan, 100.0, "--table-rate")) == 2


def test_instants_of_tables_are_the_nearest_to_multiples_of_the_period() -> None:
    plan: Any = SimpleNamespace(path_count=10, duration=0.7, sampling_rate=192e3)
    assert table_times(plan, 10.0, "table_rate").tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]


def test_errors_name_what_asks_for_memory() -> None:
    scene = scene_of(STILL, clsim.Signal.tone(40e3, 1e6, 192e3))
    paths = clsim.find_paths(scene, 0)
    with pytest.raises(clsim.InputError, match=r"duration: must ask for less memory: a whole recording .* 732422 MiB"):
        clsim.render(paths, 192e3)
    plan = plan_render(paths, 192e3, chunk=10**12)
    assert plan.largest_field == "render.chunk"
    with pytest.raises(clsim.InputError, match=r"render.chunk: must ask for less memory: rendering needs about .* the"):
        within_memory(plan.largest_field, "rendering", plan.memory_bytes).__enter__()
    with (
        pytest.raises(clsim.InputError, match=r"receivers: .* there is not enough memory left"),
        within_memory("receivers", "it", 1.0),
    ):
        raise MemoryError


def test_motions_in_a_mesh_are_tabled_or_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsim.paths.visibility.intervals._MOST_KNOTS", 5000)
    resting = clsim.Trajectory.line((1, 1, 1), (1, 1, 1), 1e9)
    assert len(trajectory_tables(resting, [STILL, resting]).knots) == 3
    long = clsim.Trajectory.circle((4, 3, 1.5), 1.0, period=1.0, duration=1e7)
    with pytest.raises(
        clsim.InputError, match=r"receivers\[1\].trajectory: must be known within 0.001 m from 5000 places"
    ):
        trajectory_tables(STILL, [STILL, long])


def test_quiet_paths_at_rest_are_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    tracks = track(clsim.find_paths(scene_of(STILL), 2))
    short = pruned(tracks, -20.0, 1.0)
    with few_looks(monkeypatch):
        long = pruned(tracks, -20.0, DAYS)
    assert "left out" in long[1]
    assert long[1] == short[1]
